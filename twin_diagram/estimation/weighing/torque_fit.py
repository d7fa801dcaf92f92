"""What torques tell of an object, with the arm's gains, offsets, frictions and noise found along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from pydrake.math import RigidTransform, RotationMatrix

from twin_diagram.estimation.weighing.coloured_noise import Colour
from twin_diagram.estimation.weighing.torque_data import COLUMNS, TorqueRun
from twin_diagram.model.rigid_body.rigid_tree import transform_inertia
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    rare: float = 2.5
    """White residuals beyond so many deviations count less, the farther the less: of Gaussian ones 1 % are."""


TUNING = Tuning()


@dataclass(frozen=True)
class ArmDoubt:
    """How far the arm may be from what its model says, as standard deviations.

    Attributes:
        gain: of each joint's torque, as a share.
        offset, viscous, dry, stribeck: of each joint [N·m], [N·m·s/rad], [N·m], [N·m].
        load: friction per torque transmitted.
        rotor: inertia on the motors' side [kg·m²].
        drift: of a joint's offset from one log to the next [N·m].
        delay: by which all torques are logged later than the motion that they belong to [s].
        lag: by which speeds are late in what torques have of them: in what moves in steps, half of one [s].
        hand: mass [kg], first moment [kg·m] and inertia [kg·m²] of the hand.
        pose: of the object in the hand: along [m] and about [rad] each axis; in each run of its own.
        mass: by what an object seems heavier or lighter than it is [kg].
        creep: by how much it moves in the hand from a run's begin to its end, along `LoadedRun.way` [m], [rad].
    """

    gain: float = 0.02
    offset: float = 5.0
    viscous: float = 5.0
    dry: float = 5.0
    stribeck: float = 0.2
    load: float = 0.002
    rotor: float = 1e-4
    drift: float = 0.01
    delay: float = 5e-3
    lag: float = 0.0
    hand: tuple[float, float, float] = (2e-3, 2e-4, 5e-6)
    pose: tuple[float, float] = (5e-4, 2e-3)
    mass: float = 0.0
    creep: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def of_side(torque_side: str) -> ArmDoubt:
        """Return what is usual where torques are measured: at the `motor`, or behind the gear at the `link`."""
        # In what moves in steps speeds are late by half a step, and friction is that of the next: damping times a step.
        doubt = ArmDoubt(rotor=2e-3, lag=2e-3)
        return replace(doubt, load=0.05, rotor=0.1) if torque_side == "motor" else doubt


@dataclass(frozen=True)
class TorqueFit:
    """A Gaussian likelihood of an object's ten parameters in O, −½ φᵀΛφ + ηᵀφ, all else integrated out.

    Attributes:
        matrix: (10, 10) Λ.
        vector: (10,) η.
        gain, gain_std: (m,) relative errors of the torques' gains: measured over true, less one.
        delay: by which torques are logged later than they were taken to be [s].
        beside: (m, len(COLUMNS)) what was found of each joint, in the order of `COLUMNS`.
        noise: (m,) standard deviation of the kept samples' residuals [N·m].
        colour: (m,) of each joint's residual.
    """

    matrix: Array
    vector: Array
    gain: Array
    gain_std: Array
    delay: float
    beside: Array
    noise: Array
    colour: tuple[Colour, ...]


def fit_torques(
    runs: Sequence[TorqueRun], doubt: ArmDoubt, parameters: Array, before: TorqueFit | None = None
) -> TorqueFit:
    """Return what logs tell, by one step of Gauss and Newton.

    Torques read (1 + γ)(arm + Y φ) + offset + frictions + noise, all of it linear but for γ φ: that product is
    linearised about the object's `parameters` (10,) in O and the gains of the fit `before`; so is the object's pose.
    The noise is that of the fit before, coloured as it was; white, of the size of the residual, the first time.
    """
    m = runs[0].torque.shape[1]
    layout = _Layout(m, len(runs), sum(run.held is not None for run in runs))
    gain = np.zeros(m) if before is None else before.gain
    designs = [_design(runs, k, gain, parameters, layout) for k in range(len(runs))]
    prior = layout.prior(doubt)
    if before is None:
        white = _solved(designs, [Colour.white(1.0)] * m, prior)
        colours = _colours(designs, white[2])
    else:
        colours = list(before.colour)
    x = _solved(designs, colours, prior)[2]
    colours = _colours(designs, x)
    matrix, vector, x = _solved(designs, colours, prior, x)
    nuisance = slice(0, layout.size - 10)
    inner = scipy.linalg.cho_factor(matrix[nuisance, nuisance])
    cross = matrix[nuisance, layout.size - 10 :]
    gone = scipy.linalg.cho_solve(inner, np.column_stack([cross, vector[nuisance]]))
    told = matrix[layout.size - 10 :, layout.size - 10 :] - cross.T @ gone[:, :10]
    # What is certain beforehand stands in it with 10²⁴: scaled, for no inverse spans that.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    covariance = np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True)
    std = scale * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    own = x[: layout.own * m].reshape(m, layout.own)
    told, right = doubted(0.5 * (told + told.T), vector[layout.size - 10 :] - cross.T @ gone[:, 10], doubt.mass)
    return TorqueFit(
        told,
        right,
        own[:, 0],
        std[: layout.own * m].reshape(m, layout.own)[:, 0],
        float(x[layout.delay]),
        own[:, 1:],
        np.array([colour.size for colour in colours]),
        tuple(colours),
    )


@dataclass(frozen=True)
class _Layout:
    """Where unknowns stand: per joint gain and `COLUMNS`; per log and joint drift; delay; lag; hand; poses; object.

    A pose has twelve: by how much it is off half-way, and from there to the end.
    """

    joints: int
    logs: int
    grasps: int

    @property
    def own(self) -> int:
        return 1 + len(COLUMNS)

    @property
    def drift(self) -> int:
        return self.own * self.joints

    @property
    def delay(self) -> int:
        return self.drift + self.logs * self.joints

    @property
    def lag(self) -> int:
        return self.delay + 1

    @property
    def hand(self) -> int:
        return self.lag + 1

    @property
    def pose(self) -> int:
        return self.hand + 10

    @property
    def size(self) -> int:
        return self.pose + 12 * self.grasps + 10

    def prior(self, doubt: ArmDoubt) -> Array:
        """Return (size,) information known beforehand; none of the object."""
        each = [doubt.gain, doubt.offset, doubt.viscous, doubt.dry, doubt.stribeck, doubt.load, doubt.rotor]
        mass, moment, inertia = doubt.hand
        std = [
            *each * self.joints,
            *[doubt.drift] * (self.logs * self.joints),
            doubt.delay,
            doubt.lag,
            *[mass, *[moment] * 3, *[inertia] * 6],
            *np.repeat([*doubt.pose, *(0.5 * way for way in doubt.creep)], 3).tolist() * self.grasps,
        ]
        return np.concatenate([1.0 / np.maximum(np.array(std), 1e-12) ** 2, np.zeros(10)])


def _design(runs: Sequence[TorqueRun], k: int, gain: Array, parameters: Array, layout: _Layout) -> tuple[Array, Array]:
    """Return (m, K, size) derivatives of a run's torques by all unknowns, and (m, K) torques, both linearised."""
    run = runs[k]
    samples, m = run.torque.shape
    A = np.zeros((m, samples, layout.size))
    rigid, lagging = run.arm, run.lagging
    if run.held is not None:
        to_hand = transform_inertia(run.held.X_MO)
        turned = to_hand @ by_pose(parameters)
        rigid = rigid + run.Y_hand @ (to_hand @ parameters)
        lagging = lagging + run.Y_lagging @ (to_hand @ parameters)
    for j in range(m):
        A[j, :, layout.own * j] = rigid[:, j]
        A[j, :, layout.own * j + 1 : layout.own * (j + 1)] = run.beside[:, j]
        A[j, :, layout.drift + k * m + j] = 1.0
        A[j, :, layout.delay] = run.late[:, j]
        A[j, :, layout.lag] = lagging[:, j]
        Y = (1.0 + gain[j]) * run.Y_hand[:, j]
        A[j, :, layout.hand : layout.pose] = Y
        if run.held is not None:
            grasp = sum(earlier.held is not None for earlier in runs[:k])
            off, first = Y @ turned, layout.pose + 12 * grasp
            A[j, :, first : first + 12] = np.hstack([off, run.way[:, None] * off])
            A[j, :, -10:] = Y @ to_hand
    # (1 + γ)(arm + Yφ) ≈ arm + γ (arm + Yφ₀) + (1 + γ₀) Yφ − γ₀ Yφ₀
    shift = gain * (rigid - run.arm)
    return A, (run.torque - run.arm + shift).T


def doubted(matrix: Array, vector: Array, mass: float) -> tuple[Array, Array]:
    """Return information (10, 10) and right side (10,) of parameters whose mass seems off by some [kg], too.

    By the inversion lemma, for others may not be told at all.
    """
    kept = np.eye(10)
    kept[:, 0] -= matrix[:, 0] * mass**2 / (1.0 + mass**2 * matrix[0, 0])
    told = kept @ matrix
    return 0.5 * (told + told.T), kept @ vector


def by_pose(parameters: Array) -> Array:
    """Return (10, 6): change of ten parameters in O where the object is moved along and turned about O's axes."""
    step = 1e-6
    result = np.zeros((10, 6))
    for k in range(6):
        moved = np.zeros(6)
        moved[k] = step
        turn = RotationMatrix(scipy.spatial.transform.Rotation.from_rotvec(moved[3:]).as_matrix())
        result[:, k] = (transform_inertia(RigidTransform(turn, moved[:3])) @ parameters - parameters) / step
    return result


def _solved(
    designs: Sequence[tuple[Array, Array]], colours: Sequence[Colour], prior: Array, near: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return normal matrix (size, size), right side (size,) and solution (size,).

    What is far off at the solution `near` (size,) counts less (a redescending M-estimate, Huber 1981, ch. 4).
    """
    matrix, vector = np.diag(prior), np.zeros(len(prior))
    for A, y in designs:
        for j, colour in enumerate(colours):
            white = colour.whitened(np.column_stack([A[j], y[j]]))
            if near is not None:
                off = np.abs(white[:, -1] - white[:, :-1] @ near)
                white *= np.minimum(1.0, TUNING.rare / np.maximum(off, 1e-12))[:, None]
            matrix += white[:, :-1].T @ white[:, :-1]
            vector += white[:, :-1].T @ white[:, -1]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix * np.outer(scale, scale)
    x = scale * np.linalg.lstsq(scaled + 1e-13 * np.eye(len(scaled)), scale * vector, rcond=None)[0]
    return matrix, vector, x


def _colours(designs: Sequence[tuple[Array, Array]], x: Array) -> list[Colour]:
    joints = designs[0][0].shape[0]
    return [Colour.of([y[j] - A[j] @ x for A, y in designs]) for j in range(joints)]
