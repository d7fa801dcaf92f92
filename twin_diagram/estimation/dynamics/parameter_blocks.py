"""What a filter may learn, one block for each kind of effect.

A new block subclasses `ParameterBlock` and joins `BLOCKS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.model.effects.actuation import TorqueBias, TorqueConstant
from twin_diagram.model.effects.friction import CoulombFriction, ViscousFriction
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.scenario import Filter
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Priors and bounds of what is learnt, as wide as data sheets and friction models are wrong: chosen by hand.

    `make hrt-tables` shows how fast and how well parameters are learnt from them.
    """

    heaviest: float = 10.0
    """A payload's mass lies between 0 and this [kg]."""

    friction_share: float = 0.3
    """Prior of a friction's error, as a share of what the model has, besides a small share of the effort limit."""

    together: float = 0.5
    """Correlation of the changes of the joints' friction, where it changes at once."""

    health_std: float = 0.02
    """Prior of a torque constant's error: a data sheet's tolerance."""

    healthiest: float = 1.0
    """No torque constant is more than this above its data sheet's."""

    smoothing_speed: float = 1e-3
    """Speed over which learned dry friction changes sign [rad/s]."""


TUNING = Tuning()


class ParameterBlock(ABC):
    """A group of parameters that belong together.

    Attributes:
        name: as in the catalogue of effects.
        mean: (p,) prior.
        covariance: (p, p) prior.
        scale: (p,) size of a change that matters; the standard deviation of the prior.
        of_sliding: whether it acts on joints that slide alone.
    """

    name: ClassVar[str]
    of_sliding: ClassVar[bool] = False
    mean: Array
    covariance: Array

    @abstractmethod
    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        """Work out the prior of an arm's parameters, by the filter's tuning."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.mean)

    @property
    def scale(self) -> Array:
        """(p,) standard deviation of the prior."""
        return np.sqrt(np.diag(self.covariance))

    @abstractmethod
    def labels(self, joints: Sequence[str]) -> list[str]:
        """Return (p,) names with units, for tables and plots."""

    @abstractmethod
    def regressor(self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """Return Y (n, p): what the motors must give, beyond the τ measured, per unit of each parameter.

        Args:
            terms: the arm.
            q: (n,) [rad].
            v: (n,) [rad/s].
            a: (n,) [rad/s²].
            tau: (n,) motor torque as measured [N·m].
        """

    @abstractmethod
    def clip(self, theta: Array) -> None:
        """Move the parameters (p,) into their bounds, in place."""

    @property
    def opening(self) -> Array:
        """(p, p) covariance after an abrupt change, which may leave the prior's usual range."""
        return self.covariance

    def groups(self) -> list[slice]:
        """Return the parameters that change together."""
        return [slice(0, self.size)]

    def push(self, theta: Array, tau: Array) -> Array | float:
        """Return the torque (n,) that it adds to the motors', of which τ is measured [N·m]."""
        return 0.0

    def viscous(self, theta: Array) -> Array | float:
        """Return what it adds to the joints' viscous friction (n,) [N·m·s/rad]."""
        return 0.0

    def dry(self, theta: Array) -> Array | float:
        """Return what it adds to the level of the joints' dry friction (n,) [N·m]."""
        return 0.0


class PayloadBlock(ParameterBlock):
    """What the last link carries: mass m [kg] and first moment m·c [kg·m] about its origin, in its frame.

    The prior says: mass 0 ± mass_std, centre at the tool frame ± com_std. With m and c apart independent that gives
    m·c the second moments mass_std² (t tᵀ + com_std² I) and mass_std² t with m, t being the tool frame's origin.
    """

    name = Payload.name

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        self._tool = terms.tool.copy()
        direction = np.concatenate([[1.0], self._tool])
        self.mean = np.zeros(4)
        self.covariance = params.mass_std**2 * (
            np.outer(direction, direction) + np.diag([0.0, 1.0, 1.0, 1.0]) * params.com_std**2
        )
        self._reach = 5.0 * params.com_std
        self._slack = 0.1 * params.mass_std

    def labels(self, joints: Sequence[str]) -> list[str]:  # noqa: D102
        return [f"{self.name}.mass [kg]", *(f"{self.name}.moment_{axis} [kg·m]" for axis in "xyz")]

    def regressor(self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array) -> Array:  # noqa: D102
        return terms.payload_regressor(q, v, a)

    def clip(self, theta: Array) -> None:
        """Keep 0 ≤ m ≤ 10 kg, the centre within 5 com_std of the tool frame (with slack while m is next to nothing)."""
        mass = min(max(float(theta[0]), 0.0), TUNING.heaviest)
        theta[0] = mass
        offset = theta[1:4] - mass * self._tool
        distance = float(np.linalg.norm(offset))
        allowed = self._reach * max(mass, self._slack)
        if distance > allowed:
            theta[1:4] = mass * self._tool + offset * (allowed / distance)


class JointBlock(ParameterBlock):
    """One parameter per joint, within ± `bound` of the model's own."""

    bound: Array
    unit: ClassVar[str]
    """Of a revolute joint."""

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        self.prismatic = terms.prismatic

    def labels(self, joints: Sequence[str]) -> list[str]:  # noqa: D102
        both = zip(joints, self.prismatic, strict=True)
        return [f"{self.name}.{joint} [{units.on_joint(self.unit, bool(kind))}]" for joint, kind in both]

    def groups(self) -> list[slice]:  # noqa: D102
        return [slice(i, i + 1) for i in range(self.size)]

    def clip(self, theta: Array) -> None:  # noqa: D102
        np.clip(theta, -self.bound, self.bound, out=theta)


class TorqueBiasBlock(JointBlock):
    """Torque applied beyond what is measured, per joint; positive drives the joint forward."""

    name = TorqueBias.name
    unit = "N·m"

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        super().__init__(terms, params)
        self.mean = np.zeros(terms.n)
        self.covariance = np.diag((0.02 * terms.effort_limit) ** 2)
        self.bound = 0.2 * terms.effort_limit

    def regressor(self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array) -> Array:  # noqa: D102
        return -np.eye(terms.n)

    def push(self, theta: Array, tau: Array) -> Array | float:  # noqa: D102
        return theta


class JointFriction(JointBlock):
    """Friction beyond the model's, per joint; friction in all is never negative.

    Oil or heat change all joints at once, and an abrupt change may take it all: of joints that rest while others tell
    of it, as much is expected as `together` says. Which way friction pushes a joint that rests nobody knows, and a
    speed that is mostly noise would teach a false level, and surely.
    """

    of_sliding = True
    _level: Array
    """(n,) what the model has."""

    def _about(self, level: Array, effort_limit: Array) -> None:
        self._level = level
        self.mean = np.zeros(len(level))
        self.covariance = np.diag((0.005 * effort_limit) ** 2 + (TUNING.friction_share * level) ** 2)
        self.bound = np.maximum(0.1 * effort_limit, 2.0 * level)

    def groups(self) -> list[slice]:  # noqa: D102
        return [slice(0, self.size)]

    def clip(self, theta: Array) -> None:  # noqa: D102
        np.clip(theta, np.maximum(-self.bound, -self._level), self.bound, out=theta)

    @property
    def opening(self) -> Array:  # noqa: D102
        together: Array = np.asarray(np.outer(TUNING.together * self._level, self._level), dtype=float)
        together.flat[:: len(together) + 1] = np.maximum(self.covariance.diagonal(), self._level**2)
        return together


class ViscousFrictionBlock(JointFriction):
    """Damping beyond the model's, per joint."""

    name = ViscousFriction.name
    unit = "N·m·s/rad"

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        super().__init__(terms, params)
        self._about(terms.damping, terms.effort_limit)

    def regressor(self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array) -> Array:  # noqa: D102
        return np.diag(v)

    def viscous(self, theta: Array) -> Array | float:  # noqa: D102
        return theta


class CoulombFrictionBlock(JointFriction):
    """Coulomb friction beyond the model's, per joint."""

    name = CoulombFriction.name
    unit = "N·m"

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        super().__init__(terms, params)
        zero = np.zeros(terms.n)
        forward, backward = terms.dry(zero, zero, zero)
        self._about(0.5 * (forward + backward), terms.effort_limit)

    def regressor(self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array) -> Array:  # noqa: D102
        return np.diag(v / np.sqrt(v * v + TUNING.smoothing_speed**2))

    def dry(self, theta: Array) -> Array | float:  # noqa: D102
        return theta


class TorqueConstantBlock(JointBlock):
    """Health of the motors: torque applied over torque measured, less 1, per joint; −1 is a motor that is dead."""

    name = TorqueConstant.name
    unit = "1"

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        super().__init__(terms, params)
        self.mean = np.zeros(terms.n)
        self.covariance = np.eye(terms.n) * TUNING.health_std**2
        self.bound = np.full(terms.n, TUNING.healthiest)

    @property
    def opening(self) -> Array:
        """A motor may have lost all."""
        return np.eye(len(self.mean)) * 0.5**2

    def regressor(self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array) -> Array:  # noqa: D102
        return np.diag(-tau)

    def clip(self, theta: Array) -> None:  # noqa: D102
        np.clip(theta, -1.0, self.bound, out=theta)

    def push(self, theta: Array, tau: Array) -> Array | float:  # noqa: D102
        return np.asarray(theta * tau)


BLOCKS: Final[dict[str, type[ParameterBlock]]] = {
    block.name: block
    for block in (PayloadBlock, TorqueBiasBlock, ViscousFrictionBlock, CoulombFrictionBlock, TorqueConstantBlock)
}
"""By the name that `Filter.parameters` uses."""
