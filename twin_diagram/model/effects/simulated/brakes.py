"""Dry friction of changing level in a simulator, worked out from step to step.

A brake on the sum w of some speeds gives f = clip(held + β m w / h, ± level) against the motion: what held the joints
in the last steps, and what would stop the speed that is left, with m the least inertia that w meets (dampers and the
motors' controllers, which the plant's step solves for, add to it: D h + K h²). What is held follows
with a smaller gain γ: at rest w obeys z² − (2 − β r) z + 1 − (β − γ) r = 0, with r = m / (the inertia that w meets)
≤ 1, whose roots lie within the unit circle up to r = 3; several brakes may share an inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.simulated.realisation import Realisation
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand within what the roots above allow."""

    beta: float = 0.7
    """Share of the speed that is left which a step takes away; beyond 1 a joint would be thrown back."""

    gamma: float = 0.3
    """Share of it that is carried on to the next step: less than `beta`, so that what holds a joint settles."""

    poses: int = 12
    """Random poses over which the least inertia is looked for."""


TUNING = Tuning()


class Brakes:
    """The brakes of an arm's effects.

    Attributes:
        count: of them; one number of state each.
    """

    def __init__(self, plant: MultibodyPlant, arm: Arm, effects: Sequence[Realisation[Effect]]) -> None:
        """Take them from a finalized plant in which the effects are realised."""
        found = [(brake, each.effect) for each in effects for brake in each.marked_brakes()]
        self._brakes = [brake for brake, _ in found]
        self._effects = [effect for _, effect in found]
        self.count = len(found)
        if not found:
            return
        joints = [plant.get_joint(index) for index in arm.joint_indices]
        self._velocity = np.array([plant.num_positions() + joint.velocity_start() for joint in joints])
        n = len(joints)
        self._along = np.zeros((self.count, n))
        for k, brake in enumerate(self._brakes):
            self._along[k, [arm.joints.index(name) for name in brake.joints]] = 1.0
        self._members = [[arm.joints.index(name) for name in brake.joints] for brake in self._brakes]
        self._gain = self._least_inertia(plant, arm) / plant.time_step()

    def _least_inertia(self, plant: MultibodyPlant, arm: Arm) -> Array:
        context = plant.CreateDefaultContext()
        start = [plant.get_joint(index).velocity_start() for index in arm.joint_indices]
        q = plant.GetPositions(context).copy()
        places = [plant.get_joint(index).position_start() for index in arm.joint_indices]
        generator = np.random.default_rng(0)
        least = np.full(self.count, np.inf)
        h = plant.time_step()
        implicit = np.zeros(plant.num_velocities())
        for place, joint, index in zip(start, arm.joint_indices, arm.actuator_indices, strict=True):
            motor = plant.get_joint_actuator(index)
            implicit[place] = h * float(plant.get_joint(joint).default_damping_vector()[0])
            if motor.has_controller():
                gains = motor.get_controller_gains()
                implicit[place] += h * gains.d + h * h * gains.p
        for _ in range(TUNING.poses):
            q[places] = generator.uniform(-np.pi, np.pi, len(places))
            plant.SetPositions(context, q)
            mass = plant.CalcMassMatrix(context) + np.diag(implicit)
            block = np.linalg.inv(mass)[np.ix_(start, start)]
            least = np.minimum(least, 1.0 / np.einsum("ki,ij,kj->k", self._along, block, self._along))
        return least

    def rows(self, actuators: Sequence[str]) -> list[tuple[int, int]]:
        """Return which of some actuators belong to which brake."""
        owner = {f"{name}_{brake.name}": k for k, brake in enumerate(self._brakes) for name in brake.joints}
        return [(row, owner[name]) for row, name in enumerate(actuators) if name in owner]

    def torque(self, state: Array, held: Array, tau: Array, time: float) -> Array:
        """Return what each brake gives to each of its joints now.

        Args:
            state: of the plant.
            held: this part of the drive's state.
            tau: (n,) what the motors gave in the last step [N·m].
            time: [s].
        """
        if not self.count:
            return held
        speed = self._along @ state[self._velocity]
        damping = np.array([brake.damping for brake in self._brakes])
        return -(self._bounded(held + TUNING.beta * self._gain * speed, tau, time) + damping * speed * self._on(time))

    def held(self, state: Array, held: Array, tau: Array, time: float) -> Array:
        """Return what it holds with in the next step."""
        return self._bounded(held + TUNING.gamma * self._gain * (self._along @ state[self._velocity]), tau, time)

    def _on(self, time: float) -> Array:
        return np.array([float(effect.when.active(np.array(time))) for effect in self._effects])

    def _bounded(self, friction: Array, tau: Array, time: float) -> Array:
        on = self._on(time)
        levels = np.array([brake.level(tau[m]) for brake, m in zip(self._brakes, self._members, strict=True)])
        return np.asarray(np.clip(friction, -on * levels[:, 1], on * levels[:, 0]))
