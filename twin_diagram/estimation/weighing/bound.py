"""The Cramér–Rao bound of an object's inertial parameters, from a motion and the noise of the torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.estimation.weighing.held import Held, WeighingError
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.mass_properties import about_centre, is_physical, six_of
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    slow: float = 0.02
    """Dry friction has turned round between minus and plus this [rad/s]: small beside what an excitation moves at."""

    least: float = 1e-12
    """Information below this share of the largest is none: rounding."""


TUNING = Tuning()


@dataclass(frozen=True)
class Bound:
    """What no unbiased estimate beats, or what one is told to be worth.

    Attributes:
        covariance: (10, 10) of the ten parameters in O.
        mass: standard error as a share of the mass.
        centre: (3,) standard errors along O's axes [m].
        moments: (3,) of the principal moments about the centre as shares of themselves, smallest moment first.
    """

    covariance: Array
    mass: float
    centre: Array
    moments: Array

    @staticmethod
    def of(covariance: Array, parameters: Array) -> Bound:
        """Return what a covariance (10, 10) of the ten parameters (10,) says."""
        error = np.sqrt(np.einsum("ki,ij,kj->k", wanted(parameters), covariance, wanted(parameters)))
        return Bound(covariance, float(error[0]), error[1:4], error[4:])


def wanted(parameters: Array) -> Array:
    """Return (7, 10): relative mass, centre (3) [m] and relative principal moments (3) per change of ten parameters."""
    mass, centre, inertia = about_centre(parameters)
    moments, axes = np.linalg.eigh(inertia)
    result = np.zeros((7, 10))
    result[0, 0] = 1.0 / mass
    result[1:4, 0] = -centre / mass
    result[1:4, 1:4] = np.eye(3) / mass
    # I_C = I_O − (h·h 1 − h hᵀ)/m with h = m c, along axis u: uᵀI_O u − (h·h − (u·h)²)/m.
    for k, u in enumerate(axes.T):
        along = u @ centre
        outer = np.outer(u, u)
        result[4 + k, 0] = centre @ centre - along**2
        result[4 + k, 1:4] = -2.0 * (centre - along * u)
        result[4 + k, 4:] = six_of(outer) * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
        result[4 + k] /= moments[k]
    return result


def friction_columns(v: Array) -> Array:
    """Return (N, 3, …) offset, viscous and dry friction per unit at velocities (N, …) [rad/s]."""
    return np.stack([np.ones_like(v), v, np.tanh(v / TUNING.slow)], axis=1)


def information(Y: Array, v: Array, noise: Array, prior: Array | None = None) -> Array:
    """Return (10, 10) Fisher information of the parameters with each joint's offset and frictions fitted along.

    Args:
        Y: (N, m, 10) torques per unit of each parameter.
        v: (N, m) velocities [rad/s].
        noise: (m,) standard deviation of a sample's torque [N·m].
        prior: (N, m, k) further torques per standard deviation of what is known beforehand, per joint; None: none.
    """
    result = np.zeros((10, 10))
    for j in range(Y.shape[1]):
        own = Y[:, j] / noise[j]
        beside = friction_columns(v[:, j])
        scale = np.maximum(np.linalg.norm(beside, axis=0), 1e-9)
        q, r = np.linalg.qr(beside / scale)
        kept = q[:, np.abs(np.diag(r)) > 1e-9]
        own = own - kept @ (kept.T @ own)
        result += own.T @ own
        if prior is not None:
            known = prior[:, j] / noise[j]
            known = known - kept @ (kept.T @ known)
            cross = known.T @ own
            result -= cross.T @ np.linalg.solve(np.eye(known.shape[1]) + known.T @ known, cross)
    return 0.5 * (result + result.T)


def crlb(
    model: Model,
    X_TO: RigidTransform,
    parameters: Array,
    motion: tuple[Array, Array, Array],
    noise: float | Array = 0.05,
    gain: float = 0.0,
) -> Bound:
    """Return the bound on an object's ten parameters from a true motion, with biases and frictions fitted along.

    Args:
        model: the arm.
        X_TO: the object's frame O in the tool frame.
        parameters: (10,) true ones in O.
        motion: true positions, velocities, accelerations (N, n), a row for each sample of the torques.
        noise: standard deviation of a sample's torque, one or (m,) for the joints that feel it [N·m].
        gain: standard deviation of what is left of the torques' gain errors; 0: gains are known.

    Raises:
        WeighingError: arrays of wrong shape or not finite, parameters of no body, or a motion that leaves some unknown.
    """
    q, v, a = (np.asarray(x, dtype=float) for x in motion)
    wrong = [x.shape for x in (q, v, a) if x.shape != (len(q), len(model.joints)) or not np.all(np.isfinite(x))]
    if wrong:
        raise WeighingError(f"motion: {wrong[0]} must be finite and (samples, {len(model.joints)} joints)")
    if np.shape(parameters) != (10,) or not is_physical(np.asarray(parameters)):
        raise WeighingError(f"parameters are not those of a body: {parameters}")
    held = Held.in_tool(model, X_TO)
    Y = held.regressor(model, q, v, a)
    known = None
    if gain > 0.0:
        torque = model.tree.inverse_dynamics(q, v, a)[:, held.rows] + Y @ parameters
        known = gain * torque[:, :, None]
    matrix = information(Y, v[:, held.rows], np.broadcast_to(noise, (len(held.rows),)), known)
    return Bound.of(inverse(matrix), np.asarray(parameters))


def inverse(matrix: Array) -> Array:
    """Return the inverse (10, 10) of information.

    Raises:
        WeighingError: it tells nothing of some direction.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if not np.all(np.isfinite(values)) or values[0] <= TUNING.least * values[-1]:
        raise WeighingError("the motion does not tell all ten inertial parameters: move more joints, and faster")
    part = vectors / scale[:, None] / np.sqrt(values)
    return part @ part.T
