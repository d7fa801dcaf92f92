"""Friction in a plant: the joints' own dampers, actuators that hold a joint, and brakes of changing level."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.friction import TUNING as FRICTION
from twin_diagram.model.effects.friction import CoulombFriction, ViscousFriction, smooth_sign
from twin_diagram.model.effects.friction_stribeck_load import CoupledFriction, LoadDependentFriction, StribeckFriction
from twin_diagram.model.effects.simulated.realisation import Brake, Fitting, Realisation, realises
from twin_diagram.signals.arrays import Array

DAMPED = 0.45
"""Slope of the damper that stands for friction's rise, over the rise by its speed: a little more than half of the
law's steepest, 0.86, which is where any step is short enough."""


@realises(ViscousFriction)
class Dampers(Realisation[ViscousFriction]):
    """The joints' own dampers, or explicit ones."""

    def fittings(self) -> list[Fitting]:
        """Return explicit dampers where it starts or ends during a run."""
        if not self.effect.when.timed:
            return []

        def law(damping: float) -> Callable[[float], float]:
            return lambda v: -damping * v

        return [
            Fitting(f"{joint}_{self.effect.name}", joint, speed_curve=law(float(damping)))
            for joint, damping in zip(self.effect.joints, self.effect.value("damping"), strict=True)
        ]

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Raise the joints' damping, which a discrete plant integrates implicitly."""
        if self.effect.when.timed:
            super().before_finalize(plant, arm)
            return
        for name, damping in zip(self.effect.joints, self.effect.value("damping"), strict=True):
            joint = plant.get_joint(arm.joint_indices[arm.joints.index(name)])
            joint.set_default_damping_vector(joint.default_damping_vector() + damping)


@realises(CoulombFriction)
class HeldJoints(Realisation[CoulombFriction]):
    """Actuators that hold a joint at rest, up to the level of its dry friction."""

    def brakes(self) -> list[Brake]:
        """Return brakes that start or end during a run; a plant's own are there for good."""
        if not self.effect.when.timed:
            return []

        return [
            Brake(self.effect.name, (joint,), _constant(float(ahead), float(back)))
            for joint, ahead, back in zip(self.effect.joints, *self.effect.levels(), strict=True)
        ]

    def fittings(self) -> list[Fitting]:
        """Return a brake per joint; where the directions differ, a constant torque shifts it."""
        result: list[Fitting] = []
        if self.effect.when.timed:
            return result
        for joint, forward, backward in zip(self.effect.joints, *self.effect.levels(), strict=True):
            level, shift = 0.5 * (forward + backward), 0.5 * (forward - backward)
            if level > 0.0:
                result.append(Fitting(f"{joint}_{self.effect.name}", joint, limit=level, damping=FRICTION.hold))
            if shift != 0.0:
                result.append(Fitting(f"{joint}_{self.effect.name}_shift", joint, torque=-shift))
        return result


def _constant(forward: float, backward: float | None = None) -> Callable[[Array], tuple[float, float]]:
    levels = (forward, forward if backward is None else backward)
    return lambda _: levels


@realises(StribeckFriction)
class HeldAndPushedJoints(Realisation[StribeckFriction]):
    """A brake of the level at rest, and a push that takes off what is too much at speed.

    The push vanishes at rest, so that the joint sticks as it should, and is never more than the brake. Where friction
    rises with speed instead, a damper that gives no more than the rise is beside the brake, and the push makes the
    difference to the law: of the law's steepest slope the damper, which the plant solves for, has half and more, so
    that no step is too long. One that starts or ends during a run has a brake of the higher level.
    """

    def brakes(self) -> list[Brake]:
        """Return those of the higher level where it starts or ends during a run; a plant's own are there for good."""
        if not self.effect.when.timed:
            return []
        levels = zip(self.effect.joints, self.effect.value("coulomb"), self.effect.value("static"), strict=True)
        return [
            Brake(self.effect.name, (joint,), _constant(float(max(c, s)))) for joint, c, s in levels if max(c, s) > 0.0
        ]

    def fittings(self) -> list[Fitting]:
        """Return them for each joint that has any."""
        result = []
        values = (self.effect.value(key).tolist() for key in ("coulomb", "static", "stribeck_velocity"))
        for joint, coulomb, static, speed in zip(self.effect.joints, *values, strict=True):
            name, timed = f"{joint}_{self.effect.name}", self.effect.when.timed
            level = max(coulomb, static) if timed else static
            rise = max(coulomb - level, 0.0)
            if level > 0.0 and not timed:
                result.append(Fitting(name, joint, limit=level, damping=FRICTION.hold))
            if rise > 0.0:
                result.append(Fitting(f"{name}_rise", joint, limit=rise, damping=DAMPED * rise / speed))
            if level + rise > 0.0:
                result.append(Fitting(f"{name}_push", joint, speed_curve=_push(coulomb, static, speed, level, rise)))
        return result


def _push(coulomb: float, static: float, speed: float, level: float, rise: float) -> Callable[[float], float]:
    """Return what a brake of a level and a damper up to a rise give beyond Stribeck's law [N·m], by speed [rad/s]."""

    def push(v: float) -> float:
        law = coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2))
        return float((level - law) * smooth_sign(np.array(v)) + np.clip(DAMPED * rise / speed * v, -rise, rise))

    return push


@realises(LoadDependentFriction)
class LoadedBrakes(Realisation[LoadDependentFriction]):
    """A brake per joint, its level after the motor's torque."""

    def brakes(self) -> list[Brake]:
        """Return one per joint."""
        coefficients = zip(self.effect.joints, self.effect.value("coefficient"), strict=True)
        return [Brake(self.effect.name, (joint,), _levels_under_load(float(c))) for joint, c in coefficients]


def _levels_under_load(c: float) -> Callable[[Array], tuple[float, float]]:
    def level(tau: Array) -> tuple[float, float]:
        with_motor, against_motor = c * abs(tau[0]) / (1.0 + c), c * abs(tau[0]) / (1.0 - c)
        return (with_motor, against_motor) if tau[0] >= 0.0 else (against_motor, with_motor)

    return level


@realises(CoupledFriction)
class CoupledBrake(Realisation[CoupledFriction]):
    """A brake on the sum of the joints' speeds."""

    def brakes(self) -> list[Brake]:
        """Return one."""
        level, damping = float(self.effect.value("torque")[0]), float(self.effect.value("damping")[0])
        return [Brake(self.effect.name, self.effect.joints, _constant(level), damping)]
