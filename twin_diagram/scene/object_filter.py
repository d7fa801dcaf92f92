"""What is known of where an object is, and how that goes on with time: pure functions on arrays.

A filter is a vector of `FILTER_SIZE` numbers (see `FilterLayout`); the error state is (φ, δp, δω, δv) in W, with
R = Exp(φ) R̂, p = p̂ + δp: the perturbation of `layouts.PoseMeasurement`. It lives at the capture time of the last
image used; `propagate` carries it to any later time, through latency, occlusion and a covered camera alike. A velocity
is trusted for `Tuning.coast` seconds, then the pose stays and only its covariance grows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from twin_diagram import scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus


@dataclass(frozen=True)
class Tuning:
    """Constants that no scenario sets, chosen by hand beside its `SceneUpdater`.

    `tests/scene` holds the covariances to the true scatter; `sims/closed_loop.py --seeds 20` shows the objects' errors.
    """

    coast: float = 0.25
    """How long an object is taken to go on with its velocity when unseen [s]: nearly four images at
    15 Hz, so that a few missed ones do not stop it."""

    correlation_time: float = 0.3
    """Of the acceleration of a moving object: makes a spectral density 2 σ² τ of its standard deviation [s]."""

    noise_images: tuple[float, float] = (1.0, 20.0)
    """The estimate of the measurements' true scatter: how many images its first value counts for, and its memory
    [images]."""

    first_noise_scale: float = 4.0
    """Variance of the scatter over the variance claimed, before anything was learnt [1]: twice the deviation, on the
    safe side."""

    unknown_variance: tuple[float, ...] = (np.pi**2 / 3,) * 3 + (1.0,) * 3
    """Variances of a pose of which nothing is known [rad², m²]: any rotation, a metre."""


TUNING = Tuning()

POSE_INDEX: Final = np.arange(6)
"""Of (φ, δp) in the error state."""
VELOCITY_INDEX: Final = np.arange(6, 12)
"""Of (δω, δv) in the error state."""


class Mode(IntEnum):
    """Which hypothesis holds."""

    NONE = 0
    REST = 1
    MOVING = 2


class FilterLayout:
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
"""Numbers of a filter, see `FilterLayout`."""

_NOTHING: Final = np.zeros((0, 6, 6))
"""Of covariances: not to be changed."""
_WORDS: Final = np.array(
    [ObjectStatus.UNSEEN, ObjectStatus.TRACKED, ObjectStatus.MOVING, ObjectStatus.STALE, ObjectStatus.LOST], dtype=float
)
"""For what was never seen, rests, moves, was not seen for a while, for long; not to be changed."""


@dataclass(frozen=True)
class FilterSettings:
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

    @cached_property
    def walks(self) -> Array:
        """(3, 6) growth of variances a second where a pose is stale, where it rests, and in all at most."""
        return np.stack([self.stale_walk, self.rest_walk, np.array(TUNING.unknown_variance)])

    @staticmethod
    def of(params: scenario.SceneUpdater) -> FilterSettings:
        """Return the settings that a scenario asks for."""

        def pair(rotation: float, position: float) -> Array:
            return np.array([rotation] * 3 + [position] * 3)

        return FilterSettings(
            stale_after=params.stale_after,
            lost_after=params.lost_after,
            acceleration_density=2
            * TUNING.correlation_time
            * pair(params.angular_acceleration_std, params.acceleration_std) ** 2,
            rest_walk=pair(params.rest_turn, params.rest_walk) ** 2,
            stale_walk=pair(params.stale_turn, params.stale_walk) ** 2,
            floor=pair(params.rotation_floor, params.position_floor) ** 2,
            slow=np.array([params.rest_spin, params.rest_speed]),
        )


class ObjectBelief(NamedTuple):
    """What K filters say at a time."""

    poses: Array
    """(K, 7)"""
    velocities: Array
    """(K, 6)"""
    covariances: Array
    """(K, 12, 12) of the error state."""


def initial_filters(count: int) -> Array:
    """Return (count, FILTER_SIZE): nothing seen yet; poses are the identity."""
    filters = np.zeros((count, FILTER_SIZE))
    filters[:, FilterLayout.LAST_SEEN] = NEVER
    filters[:, FilterLayout.REMEMBERED_TIME] = NEVER
    filters[:, FilterLayout.POSE.start] = 1.0
    filters[:, FilterLayout.REMEMBERED_POSE.start] = 1.0
    filters[:, FilterLayout.NOISE_SCALE] = TUNING.first_noise_scale
    filters[:, FilterLayout.NOISE_COUNT] = TUNING.noise_images[0]
    filters[:, FilterLayout.COVARIANCE].reshape(count, 12, 12)[:, POSE_INDEX, POSE_INDEX] = TUNING.unknown_variance
    return filters


def propagate(filters: Array, now: float, tuning: FilterSettings) -> ObjectBelief:
    """Carry filters (K, FILTER_SIZE) to a time, none of them changed.

    The uncertainty of the pose never shrinks with time, and stops growing when nothing is known any more.
    """
    from twin_diagram.scene import coasting_kernels  # compiled; not with every import

    modes = filters[:, FilterLayout.MODE].copy()
    ages = np.where(modes != Mode.NONE, np.maximum(now - filters[:, FilterLayout.LAST_SEEN], 0.0), 0.0)
    poses = filters[:, FilterLayout.POSE].copy()
    velocities = filters[:, FilterLayout.VELOCITY].copy()
    covariances: Array = filters[:, FilterLayout.COVARIANCE].reshape(len(filters), 12, 12).copy()
    # What the hypothesis of constant velocity, or of rest, makes of them.
    density, stale = tuning.acceleration_density, tuning.stale_after
    coasting_kernels.carry(poses, covariances, velocities, modes, ages, TUNING.coast, stale, density, tuning.walks)
    return ObjectBelief(poses, velocities, covariances)


def statuses(filters: Array, now: float, tuning: FilterSettings) -> Array:
    """Return (K,) `layouts.ObjectStatus` at a time."""
    from twin_diagram.scene import coasting_kernels  # compiled; not with every import

    modes, ages = filters[:, FilterLayout.MODE].copy(), now - filters[:, FilterLayout.LAST_SEEN]
    return coasting_kernels.statuses(modes, ages, tuning.stale_after, tuning.lost_after, _WORDS)


def pose_covariances(belief: ObjectBelief, axes_O: Array, tuning: FilterSettings, shared: Array | None = None) -> Array:
    """Return (K, 6, 6) of the poses, with what no averaging removes.

    Args:
        belief: of K objects.
        axes_O: (K, 3) axis of symmetry in O, zeros where there is none: nothing is known of the turn about it.
        tuning: gives the error that all measurements share.
        shared: (K, 6, 6) what the camera's calibration adds to that; None: nothing.
    """
    from twin_diagram.scene import coasting_kernels  # compiled; not with every import

    arrays = belief.covariances, belief.poses, axes_O, tuning.floor, _NOTHING if shared is None else shared
    P, poses, axes, floor, more = (np.ascontiguousarray(array, dtype=float) for array in arrays)
    return coasting_kernels.pose_covariances(P, poses, axes, floor, TUNING.unknown_variance[0], more)
