"""Rigid-body dynamics of many samples at once, in numpy.

A call into the plant costs some 10 µs a sample; logs and rollouts have 10⁴ to 10⁶. Joints outside the arm (fingers) are
rigid at their default positions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import SpatialInertia

from twin_diagram.model.rigid_body.kinematic_tree import Kinematics, KinematicTree, cross
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: results do not depend on them."""

    chunk: int = 1024
    """Samples worked on at a time, so that intermediate arrays stay in the cache, and need no fresh pages: with 4096
    mass matrices of seven joints take twice as long."""


TUNING = Tuning()


@dataclass(frozen=True)
class RigidTree(KinematicTree):
    """The arm as n bodies, body i moved by joint i: what forces its motions take. Attributes as of `KinematicTree`."""

    def bare(self, inertia: Array) -> RigidTree:
        """Return the same joints with other inertias and nothing else: no rotors, dampers or springs."""
        zero = np.zeros(self.n)
        return replace(self, inertia=inertia, rotor=zero, damping=zero, stiffness=zero, rest=zero)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return the joint torques (N, n) for motions q, v, a, each (N, n).

        M a + C v − g + rotors, dampers and springs.
        """
        result = np.empty_like(q)
        for part in _chunks(len(q)):
            motion = Kinematics.of(self, q[part].T)
            result[part] = motion.inverse_dynamics(v[part].T, a[part].T, self.gravity).T
        result += self.rotor * a + self.damping * v + self.stiffness * (q - self.rest)
        return result

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrices (N, n, n) with rotors at positions (N, n)."""
        result = np.empty((len(q), self.n, self.n))
        for part in _chunks(len(q)):
            result[part] = Kinematics.of(self, q[part].T).mass_matrix().transpose(2, 0, 1)
        result[:, np.arange(self.n), np.arange(self.n)] += self.rotor
        return result

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the mass matrices (N, n, n) and torques at zero acceleration (N, n), sharing the kinematics."""
        mass = np.empty((len(q), self.n, self.n))
        bias = np.empty_like(q)
        for part in _chunks(len(q)):
            motion = Kinematics.of(self, q[part].T)
            mass[part] = motion.mass_matrix().transpose(2, 0, 1)
            bias[part] = motion.inverse_dynamics(v[part].T, None, self.gravity).T
        mass[:, np.arange(self.n), np.arange(self.n)] += self.rotor
        bias += self.damping * v + self.stiffness * (q - self.rest)
        return mass, bias

    def pushed(self, q: Array, body: int, p: Array, force: Array, moment: Array) -> Array:
        """Return the joint torques (N, n) that a wrench gives.

        Args:
            q: (N, n) positions [rad].
            body: that is pushed; -1 (what stands still) gives none.
            p: (3,) where, in the body's frame M [m].
            force: (3,) in W [N].
            moment: (3,) in W [N·m].
        """
        result = np.zeros_like(q)
        if body < 0:
            return result
        for part in _chunks(len(q)):
            motion = Kinematics.of(self, q[part].T)
            point = np.einsum("abn,b->an", motion.R[:, :, body], p) + motion.p[:, body]
            about_origin = moment[:, None] + cross(point, np.broadcast_to(force[:, None], point.shape))
            torque = np.einsum("ajn,an->jn", motion.angular, about_origin) + np.einsum(
                "ajn,a->jn", motion.linear, force
            )
            result[part] = (torque * self.ancestors[body][:, None]).T
        return result

    def regressor(self, q: Array, v: Array, a: Array, body: int) -> Array:
        """Return the joint torques (N, n, 10) per unit of each inertial parameter of one body.

        In the order of `inertia`.

        Joint torques are linear in them (Atkeson, An and Hollerbach 1986).
        """
        result = np.empty((*q.shape, 10))
        for part in _chunks(len(q)):
            motion = Kinematics.of(self, q[part].T)
            result[part] = motion.regressor(v[part].T, a[part].T, self.gravity, body).transpose(2, 0, 1)
        return result

    def carried(self, q: Array, v: Array, a: Array, body: int) -> Carried:
        """Return what `inverse_dynamics` and `regressor` of a body do, and how that moves, by one way along the joints.

        Motions q, v, a are (N, n).
        """
        count = len(q)
        told = Carried(np.empty_like(q), np.empty((*q.shape, 10)), np.empty((count, 3, 3)), np.empty((3, count, 3)))
        for part in _chunks(count):
            placed = Kinematics.of(self, q[part].T)
            motion = placed.accelerations(v[part].T, a[part].T, self.gravity)
            told.torque[part] = placed.torques(motion).T
            told.regressor[part] = placed.shares(motion, body).transpose(2, 0, 1)
            told.R_WM[part] = placed.R[:, :, body].transpose(2, 0, 1)
            told.motion[:, part] = np.stack(motion)[:, :, body].transpose(0, 2, 1)
        told.torque[:] += self.rotor * a + self.damping * v + self.stiffness * (q - self.rest)
        return told


@dataclass(frozen=True)
class Carried:
    """What a motion of N samples asks of n joints, and how one body moves in it.

    Attributes:
        torque: (N, n) of the joints.
        regressor: (N, n, 10) of the body.
        R_WM: (N, 3, 3) of the body.
        motion: (3, N, 3) its angular velocity, angular acceleration, and acceleration of Mo less gravity, in W.
    """

    torque: Array
    regressor: Array
    R_WM: Array
    motion: Array


def _chunks(count: int) -> list[slice]:
    return [slice(start, start + TUNING.chunk) for start in range(0, count, TUNING.chunk)]


def inertia_vector(M_BBo: SpatialInertia, X_MB: RigidTransform) -> Array:
    """Return a body's ten inertial parameters in frame M from its inertia about Bo in B.

    In the order of `RigidTree.inertia`.
    """
    mass = M_BBo.get_mass()
    R: Any = X_MB.rotation().matrix()
    centre: Any = X_MB.translation() + R @ M_BBo.get_com() if mass > 0.0 else X_MB.translation()
    if mass == 0.0:
        return np.zeros(10)
    about_centre = M_BBo.Shift(M_BBo.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    tensor = R @ about_centre @ R.T + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], mass * centre, np.diag(tensor), [tensor[0, 1], tensor[0, 2], tensor[1, 2]]])


def transform_inertia(X_ML: RigidTransform) -> Array:
    """Return (10, 10): turns inertial parameters in frame L into those in frame M, linearly."""
    R: Any = X_ML.rotation().matrix()
    p: Any = X_ML.translation()
    result = np.zeros((10, 10))
    for k in range(10):
        unit = np.eye(10)[k]
        mass, h = unit[0], R @ unit[1:4]
        xx, yy, zz, xy, xz, yz = unit[4:]
        tensor = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
        s = 2.0 * h + mass * p
        tensor = tensor + p @ s * np.eye(3) - 0.5 * (np.outer(p, s) + np.outer(s, p))
        diagonal, others = np.diag(tensor), [tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        result[:, k] = np.concatenate([[mass], h + mass * p, diagonal, others])
    return result
