"""What the motors must give along a motion, with the model's effects and the payload as learned; and what they may."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex

from twin_diagram.errors import ModelError
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.chain import Chain, drawn_range, point_jacobian
from twin_diagram.signals.arrays import Array

PAYLOAD: Final = ("payload.mass", "payload.moment_x", "payload.moment_y", "payload.moment_z")
"""Names of the parameters of a payload: mass [kg] and first moment [kg·m] in the last link's frame."""


@dataclass(frozen=True)
class Tuning:
    """How torque becomes a limit; chosen by hand unless it says otherwise."""

    step: float = 1e-4
    """Over which a payload's Jacobian is followed, for what its speed alone costs [s]: errors of 1e-4 of that."""

    least_mass: float = 1e-3
    """Lighter than this nothing is carried [kg]: filters start from there."""

    samples: int = 128
    """Configurations at which rest and inertia are looked at, for what torque leaves for acceleration."""

    quickest: float = 0.1
    """No joint reaches its speed sooner than this, whatever its torque [s]: knots of a plan lie as far apart."""

    beyond: float = 1e-3
    """Torque beyond its limit may grow by this [N·m]: no more than a solver's noise."""

    arrives: float = 0.1
    """Of a torque limit so much at the least is taken to be left for motion, where weight takes up the rest."""


TUNING = Tuning()


@dataclass(frozen=True)
class LearnedPayload:
    """Where among learned parameters a payload stands; nowhere where `index` is empty."""

    index: tuple[int, ...]

    @staticmethod
    def among(names: Sequence[str]) -> LearnedPayload:
        """Return it for parameters of these names, in order; a unit in brackets after a name does not count."""
        plain = [name.split(" ")[0] for name in names]
        return LearnedPayload(tuple(plain.index(name) for name in PAYLOAD) if set(PAYLOAD) <= set(plain) else ())

    def of(self, parameters: Array | None) -> Array:
        """Return the payload (4,) of parameters (p,), see `PAYLOAD`; zeros where there is none, or it is no number."""
        payload = np.full(1, np.nan) if parameters is None or not self.index else parameters[list(self.index)]
        return payload if np.isfinite(payload).all() else np.zeros(len(PAYLOAD))


@dataclass(frozen=True)
class ArmTorque:
    """An arm's dynamics as they are known now.

    Attributes:
        model: with effects.
        chain: the arm's kinematics; None: nothing is told of what it carries.
        payload: (4,) mass [kg] and first moment m·c [kg·m] in the last link's frame, beyond the model.
    """

    model: Model
    chain: Chain | None
    payload: Array

    def mass_and_load(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return mass matrices (K, n, n) and torques without acceleration (K, n) at positions and velocities (K, n).

        The torque of a motion is M a + load. The payload counts as a point at its centre of mass.
        """
        model = self.model
        true = model.true_position(q)
        # A few samples one by one cost the plant less than all at once.
        M, load = np.array([model.calls.mass(x) for x in true]), model.law.joint_load(true, v, np.zeros_like(q))
        mass = float(self.payload[0])
        if self.chain is not None and np.isfinite(self.payload).all() and mass > TUNING.least_mass:
            J, Jv = self._payload_jacobian(self.chain, q, v)
            M = M + mass * np.einsum("kni,kmi->knm", J, J)
            load = load + mass * np.einsum("kni,ki->kn", J, Jv - self.chain.gravity_W)
        return M, load

    def _payload_jacobian(self, chain: Chain, q: Array, v: Array) -> tuple[Array, Array]:
        """Return (K, n, 3) how the payload's centre moves with the joints, and (K, 3) its acceleration at steady v."""
        count = len(q)
        both = chain.place(np.concatenate([q, q + TUNING.step * v]))
        X_WL = both.X_WL[:, -1]
        p_W = X_WL[:, :3, :3] @ (self.payload[1:] / self.payload[0]) + X_WL[:, :3, 3]
        last, rows = np.full(2 * count, chain.size), np.arange(2 * count)
        J = point_jacobian(both, p_W, last, rows, chain.prismatic)
        change = (J[count:] - J[:count]) / TUNING.step
        return J[:count], np.einsum("kni,kn->ki", change, v)


def chain_of(model: Model) -> Chain | None:
    """Return the kinematics of a serial arm; None of another one, of whose load nothing is told."""
    try:
        return Chain.from_plant(model.plant, model.arm.joint_indices, model.arm.tool_frame)
    except ModelError:
        return None


@dataclass(frozen=True)
class TorqueBounds:
    """Bounds on what motors give at K knots: |M a + load| <= allowed.

    Attributes:
        arm: whose motors.
        mass: (K, n, n)
        load: (K, n) torque without acceleration.
        allowed: (K, n)
    """

    arm: ArmTorque
    mass: Array
    load: Array
    allowed: Array

    def about(self, q: Array, v: Array) -> TorqueBounds:
        """Return the same bounds linearised about a motion's positions and velocities (K, n)."""
        mass, load = self.arm.mass_and_load(q, v)
        return TorqueBounds(self.arm, mass, load, np.maximum(self.allowed, np.abs(load) + TUNING.beyond))


def torque_bounds(arm: ArmTorque, q: Array, v: Array, a: Array, limit: Array) -> TorqueBounds:
    """Return bounds that the motion that they are linearised about keeps.

    What that motion, or rest, already takes beyond the limit cannot be asked for less of at once.

    Args:
        arm: as it is known now.
        q: (K, n) positions [rad].
        v: (K, n) velocities.
        a: (K, n) accelerations.
        limit: (n,) [N·m]
    """
    mass, load = arm.mass_and_load(q, v)
    taken = np.abs(np.einsum("kij,kj->ki", mass, a) + load)
    return TorqueBounds(arm, mass, load, np.maximum(limit, np.maximum(taken, np.abs(load)) + TUNING.beyond))


def acceleration_limit(model: Model, velocity: Array, torque_share: float) -> Array:
    """Return (n,) what each joint may be accelerated by: as described, or else what its torque allows [rad/s²].

    Of torque it is what is left beside weight and friction over the joint's own inertia, in the worst of many
    configurations; the torques of a plan are bounded beside that.

    Args:
        model: with effort limits, or infinite ones.
        velocity: (n,) the speeds that are used [rad/s]; none is reached sooner than `Tuning.quickest`.
        torque_share: of effort limits that is used.
    """
    q = np.random.default_rng(0).uniform(*drawn_range(model.lower, model.upper), (TUNING.samples, len(velocity)))
    M, load = model.law.mass_and_load(q, np.zeros_like(q), np.zeros_like(q))
    allowed = torque_share * np.where(model.effort_limit > 0.0, model.effort_limit, np.inf)
    left = np.maximum(allowed - np.abs(load), TUNING.arrives * allowed)
    by_torque = (left / np.diagonal(M, axis1=1, axis2=2)).min(axis=0)
    described = described_acceleration(model.plant, model.arm.joint_indices)
    result: Array = np.minimum(np.minimum(by_torque, described), velocity / TUNING.quickest)
    return result


def described_acceleration(plant: MultibodyPlant, joints: Sequence[JointIndex]) -> Array:
    """Return (n,) the joints' limits on acceleration in a description, infinite where it says nothing."""
    upper = np.array([float(plant.get_joint(index).acceleration_upper_limits()[0]) for index in joints])
    lower = np.array([float(plant.get_joint(index).acceleration_lower_limits()[0]) for index in joints])
    result: Array = np.minimum(np.where(upper > 0.0, upper, np.inf), np.where(lower < 0.0, -lower, np.inf))
    return result
