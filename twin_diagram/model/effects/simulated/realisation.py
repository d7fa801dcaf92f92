"""How a simulator's discrete plant realises an effect: the actuators beside the motors, and what the plant itself gets.

A class of effects without a `Realisation` of its own is not realised; `realises` registers one, and subclasses of the
effect inherit it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Generic, TypeVar

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.effect import Effect
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Fitting:
    """An actuator beside the motor, by which a discrete plant realises an effect implicitly.

    It gives −stiffness (q − rest) − damping v + torque + curve(q) + speed_curve(v), held within ±limit; the first two
    are solved for together with the step, so that they are stable at any step.

    Attributes:
        name: of the actuator.
        joint: that it drives.
        limit: largest torque [N·m].
        stiffness: [N·m/rad].
        damping: [N·m·s/rad].
        rest: [rad].
        torque: constant [N·m].
        curve: torque [N·m] for an angle [rad], explicit in time: keep its slope times step² below the joint's inertia.
        speed_curve: torque [N·m] for a speed [rad/s], explicit in time.
    """

    name: str
    joint: str
    limit: float = math.inf
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    torque: float = 0.0
    curve: Callable[[float], float] | None = None
    speed_curve: Callable[[float], float] | None = None


@dataclass(frozen=True)
class Brake:
    """Dry friction on a sum of joint speeds whose level changes while it runs, which no actuator of a plant can hold.

    `motor_drive.Drive` works it out step by step: it carries the torque that held the joints in the last step, adds
    what would stop the speed that is left, and cuts the sum at the level.

    Attributes:
        name: of its actuators, one per joint.
        joints: whose speeds are added; each gets the same torque.
        level: from the motors' torques of the last step (one per joint) to the levels against positive and against
            negative motion [N·m].
        damping: friction in proportion to the sum of the speeds [N·m·s/rad], explicit in time.
    """

    name: str
    joints: tuple[str, ...]
    level: Callable[[Array], tuple[float, float]]
    damping: float = 0.0


E_ = TypeVar("E_", bound=Effect, covariant=True)
"""The class of effects that a `Realisation` is for."""


class Realisation(Generic[E_]):
    """One effect in a plant.

    Attributes:
        effect: that is realised.
        mark: tells its actuators from those of its equals on the same joint.
    """

    replaces_joints: ClassVar[bool] = False
    """Whether `before_finalize` puts other joints in the place of the arm's."""
    changes_plant: ClassVar[bool] = False
    """Whether the plant holds it in what cannot change during a run, so that it can neither start nor end there."""

    def __init__(self, effect: E_, mark: str = "") -> None:
        """Take the effect; `realisations` finds marks for several."""
        self.effect = effect
        self.mark = mark

    def fittings(self) -> list[Fitting]:
        """Return the actuators that realise it."""
        return []

    def brakes(self) -> list[Brake]:
        """Return dry friction of changing level that `motor_drive.Drive` works out."""
        return []

    def marked_fittings(self) -> list[Fitting]:
        """Return `fittings` under names of their own in a plant."""
        return [replace(fitting, name=fitting.name + self.mark) for fitting in self.fittings()]

    def marked_brakes(self) -> list[Brake]:
        """Return `brakes` likewise."""
        return [replace(brake, name=brake.name + self.mark) for brake in self.brakes()]

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Change a discrete plant that is not finalized; the default adds actuators for `fittings` and `brakes`."""
        for brake in self.marked_brakes():
            for name in brake.joints:
                plant.AddJointActuator(
                    f"{name}_{brake.name}", plant.get_joint(arm.joint_indices[arm.joints.index(name)])
                )
        for fitting in self.marked_fittings():
            joint = plant.get_joint(arm.joint_indices[arm.joints.index(fitting.joint)])
            actuator = plant.AddJointActuator(fitting.name, joint, fitting.limit)
            if fitting.stiffness > 0.0 or fitting.damping > 0.0:
                actuator.set_controller_gains(PdControllerGains(p=fitting.stiffness, d=fitting.damping))

    def after_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Set what can only be set on a finalized plant."""


_REALISATIONS: dict[type[Effect], type[Realisation[Effect]]] = {Effect: Realisation}
"""Of each class of effects that has one."""

R_ = TypeVar("R_", bound=type[Realisation[Effect]])
"""The class that `realises` hands back as it got it."""


def realises(*kinds: type[Effect]) -> Callable[[R_], R_]:
    """Return a class decorator that makes a `Realisation` the one of some classes of effects."""

    def decorate(cls: R_) -> R_:
        for kind in kinds:
            _REALISATIONS[kind] = cls
        return cls

    return decorate


def realisation(effect: Effect) -> Realisation[Effect]:
    """Return how a plant realises an effect, after its class or the nearest base of it that has a realisation."""
    return next(_REALISATIONS[kind] for kind in type(effect).__mro__ if kind in _REALISATIONS)(effect)


def realisations(effects: Iterable[Effect]) -> tuple[Realisation[Effect], ...]:
    """Return how a plant realises each, with a mark on those whose actuators would bear a name twice."""
    taken: set[str] = set()
    result = tuple(map(realisation, effects))
    for each in result:
        names = {fitting.name for fitting in each.fittings()}
        names |= {f"{joint}_{brake.name}" for brake in each.brakes() for joint in brake.joints}
        count = 1
        while any(name + ("" if count == 1 else f"_{count}") in taken for name in names):
            count += 1
        if count > 1:
            each.mark = f"_{count}"
        taken |= {name + each.mark for name in names}
    return result
