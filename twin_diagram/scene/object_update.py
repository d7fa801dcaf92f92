"""How images change what is known of an object's pose: pure functions on arrays.

Two hypotheses about an object take turns. At *rest* its pose is constant (with a trace of random walk), so images
average: a still object does not jitter. *Moving*, it has constant velocity driven by white acceleration. What decides:

- a measurement within the gate updates the filter; at rest, the running mean of the whitened innovations is watched,
  and when it leaves its band (slow motion: each step within the noise, all steps the same way) the object moves;
- a measurement beyond the gate is not used but remembered. When the next one agrees with it, the object did move, and
  the filter restarts on the pair, with the velocity that the pair gives. A single outlier changes nothing. A jump that
  no object can make (a registration that flipped by half a turn) needs a longer run of agreeing measurements;
- when the mean velocity has been small for some images, the object rests.

What the numbers of a filter mean is said in `object_filter`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular

from twin_diagram.scene.object_filter import TUNING as OBJECT_FILTER
from twin_diagram.scene.object_filter import (
    VELOCITY_INDEX,
    FilterLayout,
    FilterSettings,
    Mode,
    initial_filters,
    propagate,
)
from twin_diagram.scene.taken_over import LinearMotion
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, PoseMeasurement


@dataclass(frozen=True)
class Tuning:
    """Gates and memories of the two hypotheses.

    Gates follow from χ² of 6 and how often they are asked; the others were chosen by hand at 15 images a second, where
    `tests/scene` holds how soon a motion is followed, and `sims/closed_loop.py --seeds 20` the objects' errors.
    """

    gate: float = 24.0
    """Largest squared Mahalanobis distance of an innovation that is used: χ² of 6, probability 0.9995."""

    trend_gate: float = 30.0
    """The same for the running mean of innovations, which is tested at every image."""

    trend_memory: float = 0.7
    """Weight of the past in the running mean of whitened innovations, per image."""

    velocity_memory: float = 0.75
    """Weight of the past in the running mean of velocities, per image."""

    calm_images: int = 4
    """This many slow images in a row make a moving object rest."""

    significant: float = 2.0
    """A mean velocity within so many standard deviations of what scatter makes of none is none: what is half hidden by
    the arm scatters as if it moved to and fro."""

    reacquire_images: int = 4
    """This many agreeing measurements make the filter believe a jump that no object can make."""

    agreement_time: float = 0.5
    """Two rejected measurements farther apart than this are not compared [s], …"""

    agreement_share: float = 1.5
    """… nor farther apart than this times what lay between the last one that was used and the first of them: a camera
    that takes one picture a second has none nearer."""

    fastest: float = 2.0
    """No object is faster [m/s]."""

    fastest_turn: float = 10.0
    """No object turns faster [rad/s]."""

    vaguest: float = 1e6
    """Largest variance that a measurement may tell of a direction [rad², m²]: a kilometre. More is none that a camera
    has, and beside it the others' are lost in rounding."""

    noise_scales: tuple[float, float] = (0.02, 25.0)
    """Bounds of the true scatter's variance over the variance claimed."""

    scatter_share: float = 0.3
    """No measurement scatters by less than this share of the floor, that is of the error which all measurements
    share."""

    lasting_share: float = 0.5
    """Of a variance that is claimed and does not show as scatter, this share is an error that lasts as long as what is
    seen of the object does: when the arm comes before half of it, its pose shifts by as much, and it does not move."""


TUNING = Tuning()


_AVERAGING: Final = (1.0 + TUNING.trend_memory) / (1.0 - TUNING.trend_memory)
"""The variance of unit white noise over that of its running mean."""

_SLOW_START: Final = np.array([0.5**2] * 3 + [0.1**2] * 3)
"""Variances of a velocity that nobody has seen yet [rad²/s², m²/s²]."""


def usable(measurement: PoseMeasurement, last_seen: float, now: float) -> bool:
    """Return whether a measurement is one: found, finite, a pose, newer than the last and not from the future.

    Its covariance must be one, too, and tell no more than `Tuning.vaguest`.
    """
    if not (measurement.quality > 0 and last_seen < measurement.time <= now + 1e-9 and measurement.time >= 0):
        return False
    if not (np.isfinite(measurement.pose).all() and np.isfinite(measurement.covariance).all()):
        return False
    if abs(np.linalg.norm(measurement.pose[:4]) - 1) > 1e-3:
        return False
    variances = np.linalg.eigvalsh(_symmetric(measurement.covariance))
    return bool(variances[0] > -1e-9 and variances[-1] < TUNING.vaguest)


def update(
    filter_: Array,
    measurement: PoseMeasurement,
    now: float,
    tuning: FilterSettings,
    symmetric_about_z: bool = False,
    before: LinearMotion | None = None,
) -> Array:
    """Return one object's filter after a measurement; the filter itself where the measurement is unusable.

    Args:
        filter_: (FILTER_SIZE,).
        measurement: of this object.
        now: the present time, at or after the capture [s].
        tuning: see `FilterSettings`.
        symmetric_about_z: the object looks the same however it is turned about its own z axis.
        before: how what nobody had recognised went there; None: it rested, or nothing was there.
    """
    if not usable(measurement, float(filter_[FilterLayout.LAST_SEEN]), now):
        return filter_
    time = measurement.time
    pose = np.concatenate([rotations.normalized(measurement.pose[:4]), measurement.pose[4:]])
    claimed, scale = _symmetric(measurement.covariance), filter_[FilterLayout.NOISE_SCALE]
    noise = scale * claimed + np.diag(tuning.floor * TUNING.scatter_share**2)
    mode = filter_[FilterLayout.MODE]
    if begins_anew(filter_, time, tuning):
        return at_rest(time, pose, noise) if before is None else under_way(time, pose, noise, before)

    belief = propagate(filter_[None], time, tuning)
    predicted, velocity, covariance = belief.poses[0], belief.velocities[0], belief.covariances[0]
    if symmetric_about_z:
        pose[:4] = rotations.fold_about_z(pose[:4], predicted[:4])
    innovation = pose_difference(pose, predicted)
    expected = _symmetric(covariance[:6, :6] + noise)
    lasting = TUNING.lasting_share * max(0.0, 1.0 - scale) * claimed
    factor = np.linalg.cholesky(expected)
    whitened = solve_triangular(factor, innovation, lower=True)
    surprising = whitened @ whitened > TUNING.gate
    if surprising and np.sum(_whitened(innovation, expected + lasting) ** 2) > TUNING.gate:
        return _surprised(filter_, time, pose, noise, tuning, symmetric_about_z)

    gain_t = solve_triangular(factor, covariance[:6, :], lower=True)  # L⁻¹ H P, so that K ν = gain_tᵀ whitened
    correction = gain_t.T @ whitened
    covariance = covariance - gain_t.T @ gain_t
    after = filter_.copy()
    after[FilterLayout.LAST_SEEN] = time
    after[FilterLayout.POSE] = moved(predicted, correction[:6])
    after[FilterLayout.VELOCITY] = velocity + correction[6:]
    after[FilterLayout.REJECTED] = 0.0
    after[FilterLayout.REMEMBERED_TIME] = NEVER
    _learn_scatter(after, filter_, whitened)
    if mode == Mode.REST:
        # What lasts is as large in the mean as in each, what scatters is less by `_AVERAGING`.
        trend = _whitened(innovation, expected + lasting * _AVERAGING) if lasting.any() else whitened
        covariance = _watch_rest(after, covariance, noise, trend)
    else:
        over = (time - filter_[FilterLayout.LAST_SEEN]) / (1 - TUNING.velocity_memory)
        covariance = _watch_motion(after, covariance, tuning, np.sqrt(2 * np.diagonal(noise)) / over)
    after[FilterLayout.COVARIANCE] = _symmetric(covariance).ravel()
    return after


def pose_difference(pose_b: Array, pose_a: Array) -> Array:
    """Return (6,) perturbation (φ, δp) that takes pose a to pose b."""
    return np.concatenate([rotations.difference(pose_b[:4], pose_a[:4]), pose_b[4:] - pose_a[4:]])


def moved(pose: Array, perturbation: Array) -> Array:
    """Return (7,) the pose with a perturbation (φ, δp) applied."""
    q = rotations.normalized(rotations.multiply(rotations.exp(perturbation[:3]), pose[:4]))
    return np.concatenate([q, pose[4:] + perturbation[3:]])


def begins_anew(filter_: Array, time: float, tuning: FilterSettings) -> bool:
    """Tell whether a measurement at a time [s] would be the first that a filter knows of."""
    lost = time - filter_[FilterLayout.LAST_SEEN] > tuning.lost_after
    return bool(filter_[FilterLayout.MODE] == Mode.NONE or lost)


def under_way(time: float, pose: Array, covariance: Array, motion: LinearMotion) -> Array:
    """Return the filter (FILTER_SIZE,) of an object that is under way at a time [s], at a pose (7) known by (6, 6)."""
    after = at_rest(time, pose, covariance)
    after[FilterLayout.MODE] = Mode.MOVING
    after[FilterLayout.VELOCITY.start + 3 : FilterLayout.VELOCITY.stop] = motion.velocity
    after[FilterLayout.MEAN] = after[FilterLayout.VELOCITY]
    after[FilterLayout.CALM] = -TUNING.calm_images  # its turning is not known yet
    whole = after[FilterLayout.COVARIANCE].reshape(12, 12)
    whole[VELOCITY_INDEX[:3], VELOCITY_INDEX[:3]] = _SLOW_START[:3]
    whole[VELOCITY_INDEX[3:], VELOCITY_INDEX[3:]] = motion.variance
    return after


def at_rest(time: float, pose: Array, covariance: Array) -> Array:
    """Return the filter (FILTER_SIZE,) of an object that rests since a time [s] at a pose (7) known by (6, 6)."""
    after = initial_filters(1)[0]
    after[FilterLayout.MODE] = Mode.REST
    after[FilterLayout.LAST_SEEN] = time
    after[FilterLayout.POSE] = pose
    whole = np.zeros((12, 12))
    whole[:6, :6] = covariance
    after[FilterLayout.COVARIANCE] = whole.ravel()
    return after


def _learn_scatter(after: Array, before: Array, whitened: Array) -> None:
    """Note in a filter how far measurements scatter, from a whitened innovation (6,).

    Its squared length is 6 on average where the scatter is what it is taken for. What moves may also turn aside: it
    teaches that measurements scatter more, never that they scatter less.
    """
    count = min(before[FilterLayout.NOISE_COUNT] + 1, OBJECT_FILTER.noise_images[1])
    ratio = 1 + ((whitened @ whitened) / 6 - 1) / count
    if before[FilterLayout.MODE] == Mode.REST or ratio > 1:
        after[FilterLayout.NOISE_SCALE] = np.clip(before[FilterLayout.NOISE_SCALE] * ratio, *TUNING.noise_scales)
        after[FilterLayout.NOISE_COUNT] = count


def _watch_rest(after: Array, covariance: Array, noise: Array, whitened: Array) -> Array:
    """At rest: does the mean of the innovations say that it moves slowly? Returns the covariance to go on with."""
    mean = TUNING.trend_memory * after[FilterLayout.MEAN] + (1 - TUNING.trend_memory) * whitened
    after[FilterLayout.MEAN] = mean
    if mean @ mean * _AVERAGING <= TUNING.trend_gate:
        return covariance
    after[FilterLayout.MODE] = Mode.MOVING
    after[FilterLayout.MEAN] = 0.0
    after[FilterLayout.CALM] = -TUNING.calm_images  # the mean velocity has to build up first
    covariance = covariance.copy()
    covariance[:6, :6] += noise
    covariance[VELOCITY_INDEX, VELOCITY_INDEX] = _SLOW_START
    return covariance


def _watch_motion(after: Array, covariance: Array, tuning: FilterSettings, scatter: Array | float = 0.0) -> Array:
    """Moving: has the mean velocity been small for long enough to rest? Returns the covariance to go on with.

    `scatter` (6,) is what measurements alone make of the mean velocity of a thing at rest, a standard deviation.
    """
    mean = (
        TUNING.velocity_memory * after[FilterLayout.MEAN] + (1 - TUNING.velocity_memory) * after[FilterLayout.VELOCITY]
    )
    after[FilterLayout.MEAN] = mean
    slow = np.linalg.norm(mean[:3]) < tuning.slow[0] and np.linalg.norm(mean[3:]) < tuning.slow[1]
    slow = slow or bool(np.all(np.abs(mean) < TUNING.significant * scatter))
    after[FilterLayout.CALM] = after[FilterLayout.CALM] + 1 if slow else 0.0
    if after[FilterLayout.CALM] < TUNING.calm_images:
        return covariance
    after[FilterLayout.MODE] = Mode.REST
    after[FilterLayout.VELOCITY] = 0.0
    after[FilterLayout.MEAN] = 0.0
    rested = np.zeros((12, 12))
    rested[:6, :6] = covariance[:6, :6]
    return rested


def _surprised(
    filter_: Array, time: float, pose: Array, noise: Array, tuning: FilterSettings, symmetric_about_z: bool
) -> Array:
    """Take in a measurement beyond the gate: remember it, or restart on it where the one remembered agrees."""
    after = filter_.copy()
    after[FilterLayout.REJECTED] += 1
    after[FilterLayout.REMEMBERED_TIME] = time
    after[FilterLayout.REMEMBERED_POSE] = pose
    before, elapsed = filter_[FilterLayout.REMEMBERED_POSE], time - filter_[FilterLayout.REMEMBERED_TIME]
    since_seen = filter_[FilterLayout.REMEMBERED_TIME] - filter_[FilterLayout.LAST_SEEN]
    longest = max(TUNING.agreement_time, TUNING.agreement_share * since_seen)
    if filter_[FilterLayout.REMEMBERED_TIME] < 0 or elapsed > longest:
        after[FilterLayout.REJECTED] = 1.0
        return after
    if symmetric_about_z:
        pose = np.concatenate([rotations.fold_about_z(pose[:4], before[:4]), pose[4:]])
    velocity = pose_difference(pose, before) / elapsed
    at_before = propagate(filter_[None], float(filter_[FilterLayout.REMEMBERED_TIME]), tuning).poses[0]
    at_now = propagate(filter_[None], time, tuning).poses[0]
    jumps = np.array([pose_difference(before, at_before), pose_difference(pose, at_now)])
    scaled = solve_triangular(np.linalg.cholesky(noise), jumps.T, lower=True)
    lengths = np.linalg.norm(scaled, axis=0)
    agree = scaled[:, 0] @ scaled[:, 1] >= 0.5 * lengths[0] * lengths[1] and _possible(velocity)
    if not agree:
        after[FilterLayout.REJECTED] = 1.0
        return after
    needed = 2 if _possible(jumps[0] / since_seen) else TUNING.reacquire_images
    if after[FilterLayout.REJECTED] < needed:
        return after

    after = at_rest(time, pose, noise)
    learnt = slice(FilterLayout.NOISE_SCALE, FilterLayout.NOISE_COUNT + 1)
    after[learnt] = filter_[learnt]
    after[FilterLayout.MODE] = Mode.MOVING
    after[FilterLayout.VELOCITY] = velocity
    after[FilterLayout.MEAN] = velocity
    covariance = np.zeros((12, 12))
    covariance[:6, :6] = noise
    covariance[:6, 6:] = covariance[6:, :6] = noise / elapsed
    covariance[6:, 6:] = 2 * noise / elapsed**2 + np.diag(tuning.acceleration_density * elapsed)
    after[FilterLayout.COVARIANCE] = covariance.ravel()
    return after


def _possible(velocity: Array) -> bool:
    return bool(np.linalg.norm(velocity[:3]) <= TUNING.fastest_turn and np.linalg.norm(velocity[3:]) <= TUNING.fastest)


def _whitened(innovation: Array, covariance: Array) -> Array:
    return np.asarray(solve_triangular(np.linalg.cholesky(covariance), innovation, lower=True))


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2
