"""How one object's pose is followed through time: pure functions on arrays.

Two hypotheses about an object take turns. At *rest* its pose is constant (with a trace of random walk), so images
average: a still object does not jitter. *Moving*, it has constant velocity driven by white acceleration. What decides:

- a measurement within the gate updates the filter; at rest, the running mean of the whitened innovations is watched,
  and when it leaves its band (slow motion: each step within the noise, all steps the same way) the object moves;
- a measurement beyond the gate is not used but remembered. When the next one agrees with it, the object did move, and
  the filter restarts on the pair, with the velocity that the pair gives. A single outlier changes nothing. A jump that
  no object can make (a registration that flipped by half a turn) needs a longer run of agreeing measurements;
- when the mean velocity has been small for some images, the object rests.

The filter lives at the capture time of the last image used; `propagate` carries it to any later time, through latency,
occlusion and a covered camera alike. A velocity is trusted for `COAST` seconds, then the pose stays and only its
covariance grows.

A filter is a vector of `FILTER_SIZE` numbers (see `Slot`); the error state is (φ, δp, δω, δv) in W, with
R = Exp(φ) R̂, p = p̂ + δp: the perturbation of `signals.PoseMeasurement`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from twin_diagram import scenario
from twin_diagram.scene import rotations
from twin_diagram.signals import NEVER, Array, ObjectStatus, PoseMeasurement

COAST: Final = 0.25
"""How long an object is taken to go on with its velocity when unseen [s]."""
GATE: Final = 24.0
"""Largest squared Mahalanobis distance of an innovation that is used: χ² of 6, probability 0.9995."""
TREND_GATE: Final = 30.0
"""The same for the running mean of innovations, which is tested at every image."""
TREND_MEMORY: Final = 0.7
"""Weight of the past in the running mean of whitened innovations, per image."""
VELOCITY_MEMORY: Final = 0.75
"""Weight of the past in the running mean of velocities, per image."""
CALM_IMAGES: Final = 4
"""This many slow images in a row make a moving object rest."""
REACQUIRE_IMAGES: Final = 4
"""This many agreeing measurements make the filter believe a jump that no object can make."""
AGREEMENT_TIME: Final = 0.5
"""Two rejected measurements farther apart than this are not compared [s]."""
FASTEST: Final = 2.0
"""No object is faster [m/s]."""
FASTEST_TURN: Final = 10.0
"""No object turns faster [rad/s]."""
CORRELATION_TIME: Final = 0.3
"""Of the acceleration of a moving object: makes a spectral density 2 σ² τ of its standard deviation [s]."""
NOISE_IMAGES: Final = (1.0, 20.0)
"""The estimate of the measurements' true scatter: how many images its first value counts for, and its memory."""
NOISE_SCALES: Final = (0.02, 25.0)
"""Bounds of the true scatter's variance over the variance claimed."""
FIRST_NOISE_SCALE: Final = 4.0
"""Before anything was learnt."""
SCATTER_SHARE: Final = 0.3
"""No measurement scatters by less than this share of the floor, that is of the error which all measurements share."""
UNKNOWN_VARIANCE: Final = np.array([np.pi**2 / 3] * 3 + [1.0] * 3)
"""Variances of a pose of which nothing is known [rad², m²]: any rotation, a metre."""


class Mode(IntEnum):
    """Which hypothesis holds."""

    NONE = 0
    REST = 1
    MOVING = 2


class Slot:
    """Where a filter's numbers stand in its vector."""

    MODE = 0
    LAST_SEEN = 1
    POSE = slice(2, 9)
    VELOCITY = slice(9, 15)
    COVARIANCE = slice(15, 159)
    MEAN = slice(159, 165)
    """At rest: the running mean of whitened innovations; moving: of velocities."""
    CALM = 165
    REJECTED = 166
    REMEMBERED_TIME = 167
    REMEMBERED_POSE = slice(168, 175)
    NOISE_SCALE = 175
    """Variance of the measurements' scatter over the variance that they claim, as learnt at rest."""
    NOISE_COUNT = 176
    """How many images that was learnt from."""


FILTER_SIZE: Final = 177


@dataclass(frozen=True)
class Tuning:
    """A scenario's `SceneUpdater` as the filter uses it: variances, in the order (rotation, position)."""

    stale_after: float
    lost_after: float
    acceleration_density: Array
    """(6,) [rad²/s³, m²/s³]"""
    rest_walk: Array
    """(6,) [rad²/s, m²/s]"""
    stale_walk: Array
    """(6,) [rad²/s, m²/s]"""
    floor: Array
    """(6,) [rad², m²]"""
    slow: Array
    """(2,) [rad/s, m/s]"""

    @staticmethod
    def of(params: scenario.SceneUpdater) -> Tuning:
        """From a scenario's tuning."""

        def pair(rotation: float, position: float) -> Array:
            return np.array([rotation] * 3 + [position] * 3)

        return Tuning(
            stale_after=params.stale_after,
            lost_after=params.lost_after,
            acceleration_density=2
            * CORRELATION_TIME
            * pair(params.angular_acceleration_std, params.acceleration_std) ** 2,
            rest_walk=pair(params.rest_turn, params.rest_walk) ** 2,
            stale_walk=pair(params.stale_turn, params.stale_walk) ** 2,
            floor=pair(params.rotation_floor, params.position_floor) ** 2,
            slow=np.array([params.rest_spin, params.rest_speed]),
        )


class Belief(NamedTuple):
    """What K filters say at a time."""

    poses: Array
    """(K, 7)"""
    velocities: Array
    """(K, 6)"""
    covariances: Array
    """(K, 12, 12) of the error state."""


def initial_filters(count: int) -> Array:
    """(count, FILTER_SIZE): nothing seen yet; poses are the identity."""
    filters = np.zeros((count, FILTER_SIZE))
    filters[:, Slot.LAST_SEEN] = NEVER
    filters[:, Slot.REMEMBERED_TIME] = NEVER
    filters[:, Slot.POSE.start] = 1.0
    filters[:, Slot.REMEMBERED_POSE.start] = 1.0
    filters[:, Slot.NOISE_SCALE] = FIRST_NOISE_SCALE
    filters[:, Slot.NOISE_COUNT] = NOISE_IMAGES[0]
    filters[:, Slot.COVARIANCE].reshape(count, 12, 12)[:, _POSE_INDEX, _POSE_INDEX] = UNKNOWN_VARIANCE
    return filters


def propagate(filters: Array, now: float, tuning: Tuning) -> Belief:
    """Carries filters (K, FILTER_SIZE) to a time, none of them changed.

    The uncertainty of the pose never shrinks with time, and stops growing when nothing is known any more.
    """
    count = len(filters)
    seen = filters[:, Slot.MODE] != Mode.NONE
    moving = filters[:, Slot.MODE] == Mode.MOVING
    age = np.where(seen, np.maximum(now - filters[:, Slot.LAST_SEEN], 0.0), 0.0)
    coasted = np.where(moving, np.minimum(age, COAST), 0.0)
    poses = filters[:, Slot.POSE].copy()
    velocities = filters[:, Slot.VELOCITY].copy()
    covariances = filters[:, Slot.COVARIANCE].reshape(count, 12, 12).copy()

    # Where the hypothesis of constant velocity moves the pose: exact mean, covariance to first order.
    turn = rotations.exp(velocities[:, :3] * coasted[:, None])
    poses[:, :4] = rotations.multiply(turn, poses[:, :4])
    poses[:, 4:] += velocities[:, 3:] * coasted[:, None]
    transition = np.zeros((count, 12, 12))
    transition[:, _ALL, _ALL] = 1.0
    transition[:, :3, :3] = rotations.matrix(turn)
    transition[:, _POSE_INDEX, _VELOCITY_INDEX] = coasted[:, None]
    covariances = transition @ covariances @ transition.transpose(0, 2, 1)
    density = tuning.acceleration_density
    covariances[:, _POSE_INDEX, _POSE_INDEX] += coasted[:, None] ** 3 / 3 * density
    cross = coasted[:, None] ** 2 / 2 * density
    covariances[:, _POSE_INDEX, _VELOCITY_INDEX] += cross
    covariances[:, _VELOCITY_INDEX, _POSE_INDEX] += cross
    covariances[:, _VELOCITY_INDEX, _VELOCITY_INDEX] += coasted[:, None] * density

    # What nobody has looked at may have been moved, all the more where it was moving.
    unseen = np.maximum(age - np.where(moving, COAST, tuning.stale_after), 0.0)
    walk = tuning.stale_walk + np.where(moving[:, None], velocities**2, 0.0)
    grown = unseen[:, None] * walk + age[:, None] * np.where(moving[:, None], 0.0, tuning.rest_walk)
    covariances[:, _POSE_INDEX, _POSE_INDEX] += np.minimum(grown, UNKNOWN_VARIANCE)
    velocities[age > COAST] = 0.0
    return Belief(poses, velocities, covariances)


def statuses(filters: Array, now: float, tuning: Tuning) -> Array:
    """(K,) `signals.ObjectStatus` at a time."""
    mode = filters[:, Slot.MODE]
    age = now - filters[:, Slot.LAST_SEEN]
    status = np.where(mode == Mode.MOVING, float(ObjectStatus.MOVING), float(ObjectStatus.TRACKED))
    status = np.where(age > tuning.stale_after, float(ObjectStatus.STALE), status)
    status = np.where(age > tuning.lost_after, float(ObjectStatus.LOST), status)
    return np.where(mode == Mode.NONE, float(ObjectStatus.UNSEEN), status)


def pose_covariances(belief: Belief, axes_O: Array, tuning: Tuning) -> Array:
    """(K, 6, 6) of the poses, with what no averaging removes.

    Args:
        belief: of K objects.
        axes_O: (K, 3) axis of symmetry in O, zeros where there is none: nothing is known of the turn about it.
        tuning: gives the error that all measurements share.
    """
    covariances = belief.covariances[:, :6, :6].copy()
    covariances[:, _POSE_INDEX, _POSE_INDEX] += tuning.floor
    axes_W = (rotations.matrix(belief.poses[:, :4]) @ axes_O[:, :, None])[:, :, 0]
    covariances[:, :3, :3] += UNKNOWN_VARIANCE[0] * axes_W[:, :, None] * axes_W[:, None, :]
    return covariances


def usable(measurement: PoseMeasurement, last_seen: float, now: float) -> bool:
    """Whether a measurement is one: found, finite, a pose, newer than the last and not from the future."""
    if not (measurement.quality > 0 and last_seen < measurement.time <= now + 1e-9 and measurement.time >= 0):
        return False
    if not (np.isfinite(measurement.pose).all() and np.isfinite(measurement.covariance).all()):
        return False
    if abs(np.linalg.norm(measurement.pose[:4]) - 1) > 1e-3:
        return False
    return bool(np.linalg.eigvalsh(_symmetric(measurement.covariance))[0] > -1e-9)


def update(
    filter_: Array, measurement: PoseMeasurement, now: float, tuning: Tuning, symmetric_about_z: bool = False
) -> Array:
    """One object's filter after a measurement; the filter itself where the measurement is unusable.

    Args:
        filter_: (FILTER_SIZE,).
        measurement: of this object.
        now: the present time, at or after the capture [s].
        tuning: see `Tuning`.
        symmetric_about_z: the object looks the same however it is turned about its own z axis.
    """
    if not usable(measurement, float(filter_[Slot.LAST_SEEN]), now):
        return filter_
    time = measurement.time
    pose = np.concatenate([rotations.normalized(measurement.pose[:4]), measurement.pose[4:]])
    noise = filter_[Slot.NOISE_SCALE] * _symmetric(measurement.covariance) + np.diag(tuning.floor * SCATTER_SHARE**2)
    mode = filter_[Slot.MODE]
    if mode == Mode.NONE or time - filter_[Slot.LAST_SEEN] > tuning.lost_after:
        return _started(time, pose, noise)

    belief = propagate(filter_[None], time, tuning)
    predicted, velocity, covariance = belief.poses[0], belief.velocities[0], belief.covariances[0]
    if symmetric_about_z:
        pose[:4] = rotations.fold_about_z(pose[:4], predicted[:4])
    innovation = pose_difference(pose, predicted)
    factor = np.linalg.cholesky(_symmetric(covariance[:6, :6] + noise))
    whitened = solve_triangular(factor, innovation, lower=True)
    if whitened @ whitened > GATE:
        return _surprised(filter_, time, pose, noise, tuning, symmetric_about_z)

    gain_t = solve_triangular(factor, covariance[:6, :], lower=True)  # L⁻¹ H P, so that K ν = gain_tᵀ whitened
    correction = gain_t.T @ whitened
    covariance = covariance - gain_t.T @ gain_t
    after = filter_.copy()
    after[Slot.LAST_SEEN] = time
    after[Slot.POSE] = moved(predicted, correction[:6])
    after[Slot.VELOCITY] = velocity + correction[6:]
    after[Slot.REJECTED] = 0.0
    after[Slot.REMEMBERED_TIME] = NEVER
    if mode == Mode.REST:
        # The squared length of a whitened innovation is 6 on average where the scatter is what it is taken for.
        count = min(filter_[Slot.NOISE_COUNT] + 1, NOISE_IMAGES[1])
        ratio = 1 + ((whitened @ whitened) / 6 - 1) / count
        after[Slot.NOISE_SCALE] = np.clip(filter_[Slot.NOISE_SCALE] * ratio, *NOISE_SCALES)
        after[Slot.NOISE_COUNT] = count
        covariance = _watch_rest(after, covariance, noise, whitened)
    else:
        covariance = _watch_motion(after, covariance, tuning)
    after[Slot.COVARIANCE] = _symmetric(covariance).ravel()
    return after


def pose_difference(pose_b: Array, pose_a: Array) -> Array:
    """(6,) perturbation (φ, δp) that takes pose a to pose b."""
    return np.concatenate([rotations.difference(pose_b[:4], pose_a[:4]), pose_b[4:] - pose_a[4:]])


def moved(pose: Array, perturbation: Array) -> Array:
    """(7,) the pose with a perturbation (φ, δp) applied."""
    q = rotations.normalized(rotations.multiply(rotations.exp(perturbation[:3]), pose[:4]))
    return np.concatenate([q, pose[4:] + perturbation[3:]])


def _started(time: float, pose: Array, noise: Array) -> Array:
    """A filter on its first measurement, at rest."""
    after = initial_filters(1)[0]
    after[Slot.MODE] = Mode.REST
    after[Slot.LAST_SEEN] = time
    after[Slot.POSE] = pose
    covariance = np.zeros((12, 12))
    covariance[:6, :6] = noise
    after[Slot.COVARIANCE] = covariance.ravel()
    return after


def _watch_rest(after: Array, covariance: Array, noise: Array, whitened: Array) -> Array:
    """At rest: does the mean of the innovations say that it moves slowly? Returns the covariance to go on with."""
    mean = TREND_MEMORY * after[Slot.MEAN] + (1 - TREND_MEMORY) * whitened
    after[Slot.MEAN] = mean
    # Variance of the running mean of unit white noise is (1 − λ)/(1 + λ).
    if mean @ mean * (1 + TREND_MEMORY) / (1 - TREND_MEMORY) <= TREND_GATE:
        return covariance
    after[Slot.MODE] = Mode.MOVING
    after[Slot.MEAN] = 0.0
    after[Slot.CALM] = -CALM_IMAGES  # the mean velocity has to build up first
    covariance = covariance.copy()
    covariance[:6, :6] += noise
    covariance[_VELOCITY_INDEX, _VELOCITY_INDEX] = _SLOW_START
    return covariance


def _watch_motion(after: Array, covariance: Array, tuning: Tuning) -> Array:
    """Moving: has the mean velocity been small for long enough to rest? Returns the covariance to go on with."""
    mean = VELOCITY_MEMORY * after[Slot.MEAN] + (1 - VELOCITY_MEMORY) * after[Slot.VELOCITY]
    after[Slot.MEAN] = mean
    slow = np.linalg.norm(mean[:3]) < tuning.slow[0] and np.linalg.norm(mean[3:]) < tuning.slow[1]
    after[Slot.CALM] = after[Slot.CALM] + 1 if slow else 0.0
    if after[Slot.CALM] < CALM_IMAGES:
        return covariance
    after[Slot.MODE] = Mode.REST
    after[Slot.VELOCITY] = 0.0
    after[Slot.MEAN] = 0.0
    rested = np.zeros((12, 12))
    rested[:6, :6] = covariance[:6, :6]
    return rested


def _surprised(
    filter_: Array, time: float, pose: Array, noise: Array, tuning: Tuning, symmetric_about_z: bool
) -> Array:
    """A measurement beyond the gate: remember it, or restart on it where the one remembered agrees."""
    after = filter_.copy()
    after[Slot.REJECTED] += 1
    after[Slot.REMEMBERED_TIME] = time
    after[Slot.REMEMBERED_POSE] = pose
    before, elapsed = filter_[Slot.REMEMBERED_POSE], time - filter_[Slot.REMEMBERED_TIME]
    if filter_[Slot.REMEMBERED_TIME] < 0 or elapsed > AGREEMENT_TIME:
        after[Slot.REJECTED] = 1.0
        return after
    if symmetric_about_z:
        pose = np.concatenate([rotations.fold_about_z(pose[:4], before[:4]), pose[4:]])
    velocity = pose_difference(pose, before) / elapsed
    at_before = propagate(filter_[None], float(filter_[Slot.REMEMBERED_TIME]), tuning).poses[0]
    at_now = propagate(filter_[None], time, tuning).poses[0]
    jumps = np.array([pose_difference(before, at_before), pose_difference(pose, at_now)])
    scaled = solve_triangular(np.linalg.cholesky(noise), jumps.T, lower=True)
    lengths = np.linalg.norm(scaled, axis=0)
    agree = scaled[:, 0] @ scaled[:, 1] >= 0.5 * lengths[0] * lengths[1] and _possible(velocity)
    if not agree:
        after[Slot.REJECTED] = 1.0
        return after
    since_seen = filter_[Slot.REMEMBERED_TIME] - filter_[Slot.LAST_SEEN]
    needed = 2 if _possible(jumps[0] / since_seen) else REACQUIRE_IMAGES
    if after[Slot.REJECTED] < needed:
        return after

    after = _started(time, pose, noise)
    after[Slot.NOISE_SCALE : Slot.NOISE_COUNT + 1] = filter_[Slot.NOISE_SCALE : Slot.NOISE_COUNT + 1]
    after[Slot.MODE] = Mode.MOVING
    after[Slot.VELOCITY] = velocity
    after[Slot.MEAN] = velocity
    covariance = np.zeros((12, 12))
    covariance[:6, :6] = noise
    covariance[:6, 6:] = covariance[6:, :6] = noise / elapsed
    covariance[6:, 6:] = 2 * noise / elapsed**2 + np.diag(tuning.acceleration_density * elapsed)
    after[Slot.COVARIANCE] = covariance.ravel()
    return after


def _possible(velocity: Array) -> bool:
    return bool(np.linalg.norm(velocity[:3]) <= FASTEST_TURN and np.linalg.norm(velocity[3:]) <= FASTEST)


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2


_ALL = np.arange(12)
_POSE_INDEX = np.arange(6)
_VELOCITY_INDEX = np.arange(6, 12)
_SLOW_START = np.array([0.5**2] * 3 + [0.1**2] * 3)
