"""What a motion of the arm asks of motors and grip and tells of the object, with its slopes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.estimation.weighing.held import Held
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.mass_properties import about_centre
from twin_diagram.model.rigid_body.rigid_tree import Carried, transform_inertia
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    step: float = 1e-6
    """Of finite differences [rad], [rad/s], [rad/s²]: what follows from them is smooth and of the order of one."""


TUNING = Tuning()


@dataclass(frozen=True)
class Asked:
    """At each sample: torques per parameter Y (N, m, 10), torque (N, m) and wrench on the object in G (N, 6)."""

    Y: Array
    torque: Array
    wrench: Array


@dataclass(frozen=True)
class CarriedMotion:
    """An arm with an object in its hand.

    Attributes:
        model: the arm.
        held: where the object is.
        parameters: (10,) of the object, as far as known, in O.
        X_OG: of the frame in which the grip's forces are told.
        others: (n,) positions of all joints; those that do not move the object stay there.
    """

    model: Model
    held: Held
    parameters: Array
    X_OG: RigidTransform
    others: Array

    def asked(self, q: Array, v: Array, a: Array) -> Asked:
        """Return what a motion (N, m) of the joints that move the object asks and tells."""
        rows, tree = self.held.rows, self.model.tree
        full = np.tile(self.others, (len(q), 1))
        full[:, rows] = q
        rates = np.zeros_like(full), np.zeros_like(full)
        rates[0][:, rows], rates[1][:, rows] = v, a
        told = tree.carried(full, *rates, self.held.body)
        Y = told.regressor[:, rows] @ self._into_M
        return Asked(Y, told.torque[:, rows] + Y @ self.parameters, self._wrench(told))

    @cached_property
    def _into_M(self) -> Array:
        return transform_inertia(self.held.X_MO)

    def _wrench(self, told: Carried) -> Array:
        """Return force over moment (N, 6) about G, in G, that the hand gives the object: Newton and Euler."""
        w, alpha, a_M = (np.einsum("nab,na->nb", told.R_WM, x) for x in told.motion)  # in M
        X_MO, mass_and_more = self.held.X_MO, about_centre(self.parameters)
        mass, centre, inertia = mass_and_more
        R_MO = X_MO.rotation().matrix()
        p_MC = X_MO.translation() + R_MO @ centre
        I_M = R_MO @ inertia @ R_MO.T
        force = mass * (a_M + np.cross(alpha, p_MC) + np.cross(w, np.cross(w, p_MC)))
        moment = alpha @ I_M + np.cross(w, w @ I_M)
        X_MG = X_MO @ self.X_OG
        moment = moment + np.cross(p_MC - X_MG.translation(), force)
        R_MG = X_MG.rotation().matrix()
        return np.hstack([force @ R_MG, moment @ R_MG])

    def with_slopes(self, q: Array, v: Array, a: Array) -> tuple[Asked, Asked]:
        """Return what is asked, and its derivatives: the same with a leading axis (3m) for q, v and a of each joint."""
        samples, m = q.shape
        state = np.hstack([q, v, a])
        moved = np.tile(state, (3 * m + 1, 1, 1))
        for k in range(3 * m):
            moved[k + 1, :, k] += TUNING.step
        flat = moved.reshape(-1, 3 * m)
        every = self.asked(flat[:, :m], flat[:, m : 2 * m], flat[:, 2 * m :])
        parts = [x.reshape(3 * m + 1, samples, *x.shape[1:]) for x in (every.Y, every.torque, every.wrench)]
        return Asked(*(x[0] for x in parts)), Asked(*((x[1:] - x[0]) / TUNING.step for x in parts))
