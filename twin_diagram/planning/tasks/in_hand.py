"""Where what is held lies in the hand, as images go on to show it: a small filter on SE(3). Pure functions.

Pose X_TO is that at closing, then moved by two perturbations (φ, δp) in T: by how much it was told wrong then, which
stays, and by how much it has moved since, which walks. An image shows both, and besides what the camera's calibration
is off by here (the same errors also shifted what was told at closing, so that most of it cancels), and the object left
behind by as much as it moves in the time by which depth is late. Time and errors are states, too.

What moves in the hand at once is no walk: innovations that lean one way for some images let go of where it was.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from itertools import accumulate, pairwise
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import SIZE as ERRORS
from twin_diagram.signals.calibration_error import pose_shifts
from twin_diagram.signals.layouts import NEVER, POSE_SIZE
from twin_diagram.signals.pose_vectors import compose


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand on eight runs of two objects."""

    squeezed: tuple[float, float] = (0.02, 0.001)
    """Fingers that close turn and shift what is between them by so much [rad], [m] …"""

    centred: float = 0.001
    """… but put it in their middle this well [m]."""

    late: float = 0.03
    """Depth is late by so much [s]: half of a frame that takes 67 ms …"""

    later: float = 0.005
    """… which changes by this, as other sides come into sight [√s]."""

    walk: tuple[float, float] = (0.01, 0.001)
    """What is held creeps by so much in the hand [rad/√s], [m/√s]: contact simulation showed 0.5 mm/s."""

    floor: tuple[float, float] = (0.006, 0.0006)
    """Each image is off by this beside what it claims [rad], [m] …"""

    swept: tuple[float, float] = (0.15, 0.006)
    """… and by this for each m/s of the object, for colour is on time where depth is late [rad·s/m], [s]."""

    gate: float = 24.0
    """Largest squared Mahalanobis distance of an innovation that is used: χ² of 6, probability 0.9995."""

    leaning: float = 24.0
    """The same of the running mean of innovations, which is looked at after each image."""

    memory: float = 0.7
    """Weight of the past in that mean, per image."""

    longest: float = 4.0
    """No innovation counts for more than so many standard deviations in that mean: one alone says nothing."""

    free: tuple[float, float] = (0.5, 0.03)
    """What slips may be so far from where it was [rad], [m]."""


TUNING = Tuning()

_WRONG: Final = slice(0, 6)
"""In the state: how wrong it was told at closing, (φ, δp) in T."""
_MOVED: Final = slice(6, 12)
"""How far it has moved since."""
_CAMERA: Final = slice(12, 12 + ERRORS)
"""The calibration's errors beyond those that were taken out at closing."""
_LATE: Final = slice(12 + ERRORS, 15 + ERRORS)
"""By how much the object is shown late along the axes of W [s]: depth is late, colour is not."""
STATES: Final = 15 + ERRORS
"""Of the filter."""


@dataclass(frozen=True)
class Eye:
    """The camera, as far as calibration goes.

    Attributes:
        p_WC: (3) where it is told to be [m].
        R_WC: (3, 3)
        focal: (2) lengths [px].
        errors: (10) of its calibration that are taken out of what it shows, see `signals.calibration_error`.
        covariance: (10, 10) of what is left of them.
    """

    p_WC: Array
    R_WC: Array
    focal: tuple[float, float]
    errors: Array
    covariance: Array


class HeldImage(NamedTuple):
    """What an image shows of what is held, and what the hand did at that time."""

    time: float
    """[s]"""
    X_WO: Array
    """(7) as measured."""
    covariance: Array
    """(6, 6) of it, as of `layouts.PoseMeasurement`."""
    X_WT: Array
    """(7) the tool."""
    V_WT: Array
    """(6) its velocity: angular [rad/s], then that of its origin [m/s]."""


@dataclass(frozen=True)
class InHand:
    """What is known of where an object lies in the hand.

    Attributes:
        closed: (7) X_TO as told when the fingers had closed.
        taken_out: (10) the calibration's errors that were taken out then.
        mean: (STATES,)
        covariance: (STATES, STATES)
        image: time of the newest image [s]; `NEVER`: nothing is held, nor was.
        leaning: (6) running mean of whitened innovations.
        told: (6) how far it had moved when a slip was last told, (φ, δp) in T.
        before: (6) how far it had moved in the image before.
        away: images running in which it was elsewhere than told.
        slips: how many were told.
    """

    closed: Array = field(default_factory=lambda: np.array([1.0, 0, 0, 0, 0, 0, 0]))
    taken_out: Array = field(default_factory=lambda: np.zeros(ERRORS))
    mean: Array = field(default_factory=lambda: np.zeros(STATES))
    covariance: Array = field(default_factory=lambda: np.zeros((STATES, STATES)))
    image: float = NEVER
    leaning: Array = field(default_factory=lambda: np.zeros(6))
    told: Array = field(default_factory=lambda: np.zeros(6))
    before: Array = field(default_factory=lambda: np.zeros(6))
    away: int = 0
    slips: int = 0

    @property
    def X_TO(self) -> Array:
        """(7) where it lies now."""
        return _perturbed(self.closed, self.mean[_WRONG] + self.mean[_MOVED])

    @property
    def pose_covariance(self) -> Array:
        """(6, 6) of X_TO: a left perturbation in T about the object's origin."""
        P = self.covariance
        cross = P[_WRONG, _MOVED]
        return np.asarray(P[_WRONG, _WRONG] + P[_MOVED, _MOVED] + cross + cross.T)

    @property
    def change(self) -> tuple[Array, Array]:
        """(6) how far it has moved in the hand since closing, (φ, δp) in T, and its covariance (6, 6)."""
        return self.mean[_MOVED], self.covariance[_MOVED, _MOVED]

    def pack(self) -> Array:
        """Return it as a vector of `IN_HAND_SIZE`."""
        return np.concatenate([np.atleast_1d(getattr(self, each.name)).ravel() for each in fields(self)], dtype=float)

    @staticmethod
    def unpack(vector: Array) -> InHand:
        """Return the inverse of `pack`; copies."""
        copy = np.array(vector)
        parts = (copy[part] for part in _PARTS)
        closed, taken_out, mean, covariance, image, leaning, told, before, away, slips = parts
        return InHand(
            closed, taken_out, mean, covariance.reshape(STATES, STATES), float(image[0]), leaning, told, before,
            int(away[0]), int(slips[0]),
        )  # fmt: skip


_SIZES: Final = (POSE_SIZE, ERRORS, STATES, STATES**2, 1, 6, 6, 6, 1, 1)
"""Of the fields of a packed `InHand`, in their order."""
_PARTS: Final = tuple(slice(*ends) for ends in pairwise((0, *accumulate(_SIZES))))
"""Where they stand."""
IN_HAND_SIZE: Final = sum(_SIZES)
"""Numbers of a packed `InHand`."""


def closed_on(closed: Array, covariance: Array, X_WT: Array, eye: Eye | None, now: float) -> InHand:
    """Return what is known once the fingers have closed.

    Args:
        closed: (7) X_TO, with the object in the middle between the fingers.
        covariance: (6, 6) of it before they had put it there: a left perturbation in T.
        X_WT: (7) the tool.
        eye: that saw it; None: nothing is told of its calibration.
        now: [s]; older images are none of it.
    """
    P = np.zeros((STATES, STATES))
    P[_WRONG, _WRONG] = covariance
    P[_LATE, _LATE] = TUNING.late**2 * np.eye(3)
    if eye is not None:
        # What the camera is off by is in what it showed; the rest of that is what the pose alone is off by.
        along = -_calibration_columns(compose(X_WT, closed), X_WT, eye)
        shared = along @ eye.covariance @ along.T
        P[_CAMERA, _CAMERA] = eye.covariance
        P[_WRONG, _CAMERA] = along @ eye.covariance
        P[_CAMERA, _WRONG] = P[_WRONG, _CAMERA].T
        values, axes = np.linalg.eigh(covariance - shared)
        P[_WRONG, _WRONG] = shared + (axes * np.maximum(values, 0.0)) @ axes.T
    # Fingers push what is between them into their middle: there it is no matter where it was seen.
    squeezed, y = _six(TUNING.squeezed) ** 2, _WRONG.start + 4
    P[y], P[:, y], squeezed[4] = 0.0, 0.0, TUNING.centred**2
    P[_WRONG, _WRONG] += np.diag(squeezed)
    taken_out = np.zeros(ERRORS) if eye is None else eye.errors
    return InHand(closed.copy(), taken_out.copy(), np.zeros(STATES), P, now)


def after_image(known: InHand, shown: HeldImage, eye: Eye | None, symmetric: bool = False) -> InHand:
    """Return what is known after an image; `known` itself where the image is no newer.

    Args:
        known: before.
        shown: by the image.
        eye: that took it.
        symmetric: the object looks the same however it is turned about its own z axis.
    """
    if not shown.time > known.image:
        return known
    P = known.covariance.copy()
    P[_MOVED, _MOVED] += (shown.time - known.image) * np.diag(_six(TUNING.walk) ** 2)
    P[_LATE, _LATE] += (shown.time - known.image) * TUNING.later**2 * np.eye(3)
    known = replace(known, covariance=P, image=shown.time, before=known.mean[_MOVED].copy())
    H, innovation, noise = _observed(known, shown, eye, symmetric)
    S = H @ P @ H.T + noise
    whitened = solve_triangular(np.linalg.cholesky((S + S.T) / 2), innovation, lower=True)
    length = float(np.linalg.norm(whitened))
    counted = whitened * min(1.0, TUNING.longest / max(length, 1e-12))
    leaning = TUNING.memory * known.leaning + (1 - TUNING.memory) * counted
    # Variance of the running mean of unit white noise is (1 - λ)/(1 + λ).
    slips = leaning @ leaning * (1 + TUNING.memory) / (1 - TUNING.memory) > TUNING.leaning
    if slips:
        leaning = np.zeros(6)
        P[_MOVED, _MOVED] += np.diag(_six(TUNING.free) ** 2)
        S = H @ P @ H.T + noise
    known = replace(known, leaning=leaning)
    if length**2 > TUNING.gate and not slips:
        return known
    gain = np.linalg.solve(S, H @ P).T
    left = np.eye(STATES) - gain @ H
    P = left @ P @ left.T + gain @ noise @ gain.T
    return replace(known, mean=known.mean + gain @ innovation, covariance=(P + P.T) / 2)


def _observed(known: InHand, shown: HeldImage, eye: Eye | None, symmetric: bool) -> tuple[Array, Array, Array]:
    """Return what an image tells: (6, STATES) of the state, the innovation (6), and its noise (6, 6); in T."""
    X_WT, believed = shown.X_WT, known.X_TO
    R_TW = rotations.matrix(X_WT[:4]).T
    both = np.kron(np.eye(2), R_TW)
    q = rotations.multiply(rotations.conjugate(X_WT[:4]), shown.X_WO[:4])
    if symmetric:
        q = rotations.fold_about_z(q, believed[:4])
    p = R_TW @ (shown.X_WO[4:] - X_WT[4:])
    H = np.zeros((6, STATES))
    H[:, _WRONG] = H[:, _MOVED] = np.eye(6)
    # By as much as it moves meanwhile the object is shown behind.
    turning, arm = shown.V_WT[:3], shown.X_WO[4:] - X_WT[4:]
    v_W = shown.V_WT[3:] + np.cross(turning, arm)
    H[3:, _LATE] = -R_TW * v_W
    seen = np.concatenate([rotations.difference(rotations.normalized(q), believed[:4]), p - believed[4:]])
    told = H[:, _LATE] @ known.mean[_LATE]
    if eye is not None:
        H[:, _CAMERA] = _calibration_columns(shown.X_WO, X_WT, eye)
        told = told + H[:, _CAMERA] @ (known.mean[_CAMERA] - (eye.errors - known.taken_out))
    speeds = np.repeat([float(np.linalg.norm(turning)), 0.0], 3) * TUNING.late
    swept = float(np.linalg.norm(v_W)) * _six(TUNING.swept)
    noise = both @ shown.covariance @ both.T + np.diag(_six(TUNING.floor) ** 2 + swept**2 + speeds**2)
    return H, seen - told, noise


def _calibration_columns(X_WO: Array, X_WT: Array, eye: Eye) -> Array:
    """Return (6, 10): how an object is shown turned and shifted in T by errors of the calibration."""
    R_TW = rotations.matrix(X_WT[:4]).T
    p_CO = (X_WO[4:] - eye.p_WC) @ eye.R_WC
    return np.asarray(np.kron(np.eye(2), R_TW) @ pose_shifts(p_CO[None], eye.R_WC, *eye.focal)[0])


def _perturbed(X_TO: Array, by: Array) -> Array:
    """Return a pose (7) with a left perturbation (φ, δp) applied."""
    q = rotations.normalized(rotations.multiply(rotations.exp(by[:3]), X_TO[:4]))
    return np.concatenate([q, X_TO[4:] + by[3:]])


def _six(pair: tuple[float, float]) -> Array:
    """Return (6,) of a figure for rotation and one for translation."""
    return np.repeat(pair, 3)
