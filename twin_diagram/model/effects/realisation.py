"""What effects change in a rigid model, and the actuators by which a discrete plant realises them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from twin_diagram.signals.arrays import Array


@dataclass
class RigidChange:
    """What an effect changes in the rigid model itself, so that plain dynamics already hold it.

    Attributes:
        inertia: (10,) per link name, as in `rigid_tree.RigidTree`, but about the link's own frame.
        rotor: reflected inertia per joint name [kg·m²].
        damping: per joint name [N·m·s/rad].
    """

    inertia: dict[str, Array] = field(default_factory=dict)
    rotor: dict[str, float] = field(default_factory=dict)
    damping: dict[str, float] = field(default_factory=dict)


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

    `model.effects.simulated.add_to_plant.Drive` works it out step by step: it carries the torque that held the joints
    in the last step, adds what would stop the speed that is left, and cuts the sum at the level.

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
