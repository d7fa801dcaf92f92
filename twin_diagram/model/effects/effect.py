"""What every effect is: named parameters and a smooth torque law."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from twin_diagram.model.effects.parameter import Parameter, ParameterKind
from twin_diagram.model.effects.rigid_change import RigidChange
from twin_diagram.model.effects.timing import ALWAYS, Interval
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.signals.arrays import Array


class Effect:
    """One named physical phenomenon that the given model lacks: smooth laws, vectorised over N samples.

    Subclasses override `torque`, or what becomes of the logged torque (`applied`, `logged`, `delay`), or what encoders
    mean (`true_position`, `measured_position`). A law that depends on acceleration must also be a `change` of the rigid
    model (`folds`), for integrators to know. No law knows of time: `Model` asks it only while `when` holds.

    Attributes:
        joints, links: that it sits on.
        parameters: values, by the keys of `kinds`.
        when: when it acts.
        given: whether the arm's own description states it, so that it is no addition to it.
        prismatic: which of its joints are, as far as it was told (`on_arm`); words depend on it, no law does.
    """

    name: ClassVar[str] = ""
    """In the catalogue."""
    kinds: ClassVar[Mapping[str, ParameterKind]] = {}
    """The parameters, by their exact keys."""
    per_joint: ClassVar[bool] = True
    """Whether parameters hold a value per joint."""
    folds: ClassVar[bool] = False
    """Whether `change` holds all of its torque, which is then not added a second time."""
    dry: ClassVar[bool] = False
    """Whether its torque is dry friction, of which `friction_level` tells the bound."""
    even: ClassVar[bool] = False
    """Whether `friction_level` is the same whatever the motion and the torque."""
    last: ClassVar[bool] = False
    """Whether its torque comes beside what the motor gives, so that `applied` counts it after all others."""
    motor_side: ClassVar[bool] = False
    """Whether `torque` acts on the motor's side of an elastic gear."""

    def __init__(
        self, joints: Iterable[str] = (), links: Iterable[str] = (), parameters: Mapping[str, Parameter] | None = None
    ) -> None:
        """Take parameters as they are; `make` checks them."""
        self.joints, self.links = tuple(joints), tuple(links)
        self.parameters = dict(parameters or {})
        self.when: Interval = ALWAYS
        self.given = False
        self.prismatic: frozenset[str] = frozenset()

    def check(self) -> None:
        """Raise ModelError where the parameters do not fit together."""

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """Return what the motors must give in addition, joint side: (N, n) [N·m].

        Args:
            bodies: of the arm that it sits on.
            q: (N, n) positions [rad].
            v: (N, n) velocities [rad/s].
            a: (N, n) accelerations [rad/s²].
            tau: (N, n) torque that the joints transmit [N·m].
        """
        return np.zeros_like(q)

    def friction_level(self, bodies: ArmBodies, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Return the largest friction torque against positive and against negative motion, each (N, n) ≥ 0 [N·m].

        Here `tau` (N, n) is what the motors give, friction included.
        """
        return np.zeros_like(q), np.zeros_like(q)

    def change(self, links: DescribedLinks) -> RigidChange:
        """Return its part in the rigid model."""
        return RigidChange()

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """Return the torque (…, n) that reaches the joints of an arm when `tau` is logged."""
        return tau

    def logged(self, joints: Sequence[str], tau: Array) -> Array:
        """Return the inverse of `applied`."""
        return tau

    @property
    def delay(self) -> float:
        """Return how much later the logged torque reaches the joints [s]."""
        return 0.0

    @property
    def loses(self) -> bool:
        """Return whether `applied` forgets so much of what is logged that `logged` cannot tell it."""
        return False

    def true_position(self, joints: Sequence[str], q: Array) -> Array:
        """Return the positions (…, n) of an arm's joints when `q` is measured."""
        return q

    def measured_position(self, joints: Sequence[str], q: Array) -> Array:
        """Return the inverse of `true_position`."""
        return q

    def value(self, key: str) -> Array:
        """Return a parameter's value."""
        return self.parameters[key].value

    def columns(self, joints: Sequence[str]) -> npt.NDArray[np.int64]:
        """Return its joints' columns in the arrays of an arm."""
        return np.array([joints.index(joint) for joint in self.joints], dtype=np.int64)

    def spread(self, joints: Sequence[str], values: Array) -> Array:
        """Return a value per joint of this effect as (n,), zero on the arm's other joints."""
        result = np.zeros(len(joints))
        result[self.columns(joints)] = values
        return result

    def on_arm(self, prismatic: Collection[str]) -> Effect:
        """Return the same, told which of an arm's joints are prismatic; itself where that is nothing new."""
        own = frozenset(prismatic) & frozenset(self.joints)
        result = self if own == self.prismatic else copy.copy(self)
        result.prismatic = own
        return result

    def unit(self, key: str, joint: str = "") -> str:
        """Return a parameter's unit on one of its joints."""
        return self.kinds[key].unit_on(joint in self.prismatic)

    @property
    def onset(self) -> float | None:
        """Return when it starts (`Interval.onset`)."""
        return self.when.onset

    @property
    def end(self) -> float | None:
        """Return when it ends (`Interval.end`)."""
        return self.when.end

    def __repr__(self) -> str:
        values = ", ".join(f"{key}={parameter.value.tolist()}" for key, parameter in self.parameters.items())
        return f"{type(self).__name__}({', '.join(self.joints or self.links)}: {values})"
