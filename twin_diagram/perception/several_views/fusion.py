"""Makes one measurement of an object of those of several cameras: pure functions.

Each camera errs by the noise of its image and by what is left of its calibration's error, which no averaging over
images removes. Poses are weighted by the inverse of both together; what is left of the calibrations, of which one
camera's is independent of another's, goes along as a covariance of its own (as the `rest`), for whoever averages over
images must not average it away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.several_views.view_memory import TUNING as VIEWS
from twin_diagram.signals import chi_square, rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    together: float = 0.002
    """Images taken within this of each other are of one time [s]."""

    newest: float = 1.6
    """What a camera showed counts for so many of its periods: an image that comes late is waited for."""

    moved: float = 0.001
    """What moves by more than this between two cameras' images [m] (and a radius of a decimetre by its turn) is as the
    newest of them shows it."""

    radius: float = 0.1
    """That radius [m]."""

    gate: float = 0.999
    """Poses whose differences from their mean are longer, squared and in deviations, than χ² of 6 for each camera but
    one is with this probability are farther apart than is claimed: the claim grows by as much."""


TUNING = Tuning()


@dataclass(frozen=True)
class SeenBy:
    """What one camera's newest image showed of an object.

    Attributes:
        measured: of it, with the image's noise.
        rest: (6, 6) what is left of the camera's calibration there.
        velocity: (6,) angular [rad/s], linear [m/s] in W.
        odds: logarithm of the odds that it is not turned the other way round.
        period: between two images of this camera [s].
    """

    measured: PoseMeasurement
    rest: Array
    velocity: Array
    odds: float
    period: float


@dataclass(frozen=True)
class FusedPose:
    """What the cameras show together.

    Attributes:
        measured: in the place of one camera's.
        rest: (6, 6) what is left of the calibrations; None: no camera shows it.
        weights: (V, 6, 6) share of each camera in the pose; zeros where it has none.
    """

    measured: PoseMeasurement
    rest: Array | None
    weights: Array


def fuse(seen: Sequence[SeenBy], symmetric_about_z: bool = False) -> FusedPose:
    """Return one measurement of those of several cameras.

    Found by one it is there, whatever others do not see. Where none finds it, its place is empty if one of them sees it
    to be (the time is then of that image, which is counted once), and hidden otherwise.

    Args:
        seen: by each camera, its newest image.
        symmetric_about_z: it looks the same however it is turned about its own z axis.
    """
    weights = np.zeros((len(seen), 6, 6))
    newest = max(one.measured.time for one in seen)
    found = [v for v, one in enumerate(seen) if one.measured.quality > 0 and _counts(one, newest)]
    if not found:
        empty = [one.measured for one in seen if one.measured.quality < 0 and _counts(one, newest)]
        if empty:
            return FusedPose(max(empty, key=lambda one: (one.time, -one.quality)), None, weights)
        last = max((one.measured for one in seen), key=lambda one: one.time)
        quality = min(last.quality, 0.0)
        return FusedPose(PoseMeasurement(quality, last.time, last.pose, last.covariance), None, weights)
    latest = max(seen[v].measured.time for v in found)
    found = [v for v in found if not _moved_since(seen[v], latest)]
    best = min(found, key=lambda v: (_spread(seen[v]), v))
    found = [v for v in found if v == best or _agree(seen[v], seen[best], symmetric_about_z)]
    if any(_turned(seen[v], seen[best], symmetric_about_z) for v in found):
        surest = max(found, key=lambda v: (seen[v].odds, -_spread(seen[v])))
        found = [v for v in found if not _turned(seen[v], seen[surest], symmetric_about_z)]
        best = min(found, key=lambda v: (_spread(seen[v]), v))
    if len(found) == 1:
        weights[found[0]] = np.eye(6)
        return FusedPose(seen[found[0]].measured, seen[found[0]].rest, weights)
    return _weighted(seen, found, best, latest, weights, symmetric_about_z)


def _weighted(
    seen: Sequence[SeenBy], found: Sequence[int], best: int, latest: float, weights: Array, symmetric: bool
) -> FusedPose:
    """Return the mean of those found, each weighted by its noise and what is left of its calibration."""
    reference = seen[best].measured.pose
    # Cameras that take pictures in turn show each image in as many measurements as there are cameras.
    times = [seen[v].measured.time for v in found]
    often = 1.0 if max(times) - min(times) <= TUNING.together else float(len(found))
    offsets = np.array([_difference(seen[v].measured.pose, reference, symmetric) for v in found])
    noise = np.array([often * seen[v].measured.covariance for v in found])
    rests = np.array([seen[v].rest for v in found])
    information = np.linalg.inv(noise + rests)
    shares = np.linalg.inv(information.sum(axis=0)) @ information
    mean = np.einsum("vij,vj->i", shares, offsets)
    apart = offsets - mean
    limit = float(chi_square.quantile(TUNING.gate, 6 * (len(found) - 1)))
    wide = max(1.0, float(np.einsum("vi,vij,vj->", apart, information, apart)) / limit)
    covariance = np.einsum("vij,vjk,vlk->il", shares, noise, shares)
    # What they are too far apart by stays from image to image, also where calibrations are told to be exact.
    rest = wide * np.einsum("vij,vjk,vlk->il", shares, rests, shares) + (wide - 1.0) * covariance
    q = rotations.normalized(rotations.multiply(rotations.exp(mean[:3]), reference[:4]))
    pose = np.concatenate([q, reference[4:] + mean[3:]])
    quality = max(seen[v].measured.quality for v in found)
    for v, share in zip(found, shares, strict=True):
        weights[v] = share
    return FusedPose(PoseMeasurement(quality, latest, pose, _symmetric(covariance)), _symmetric(rest), weights)


def _counts(one: SeenBy, newest: float) -> bool:
    return one.measured.time >= 0.0 and newest - one.measured.time <= TUNING.newest * one.period


def _moved_since(one: SeenBy, latest: float) -> bool:
    """Return whether an object has moved between a camera's image and the latest that shows it."""
    since = latest - one.measured.time
    spin, speed = np.linalg.norm(one.velocity[:3]), np.linalg.norm(one.velocity[3:])
    return bool(since * (speed + TUNING.radius * spin) > TUNING.moved)


def _spread(one: SeenBy) -> float:
    return float(np.trace((one.measured.covariance + one.rest)[3:, 3:]))


def _agree(one: SeenBy, other: SeenBy, symmetric: bool) -> bool:
    return float(np.linalg.norm(_difference(one.measured.pose, other.measured.pose, symmetric)[3:])) <= VIEWS.apart


def _turned(one: SeenBy, other: SeenBy, symmetric: bool) -> bool:
    turn = _difference(one.measured.pose, other.measured.pose, symmetric)[:3]
    return float(np.linalg.norm(turn)) > VIEWS.turned


def _difference(pose: Array, reference: Array, symmetric: bool) -> Array:
    """Return (6,) what takes a reference to a pose; of round things no turn about their axis."""
    q = rotations.fold_about_z(pose[:4], reference[:4]) if symmetric else pose[:4]
    return np.concatenate([rotations.difference(q, reference[:4]), pose[4:] - reference[4:]])


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + matrix.T) / 2)
