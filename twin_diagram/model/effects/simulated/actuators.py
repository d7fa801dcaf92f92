"""What is constant about actuators of a plant, and what they give in a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex

from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.simulated.realisation import Fitting, Realisation
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Actuators:
    """What is constant about some actuators of a plant, in one order."""

    position: npt.NDArray[np.int64]
    velocity: npt.NDArray[np.int64]
    stiffness: Array
    damping: Array
    limit: Array
    torque: Array
    rest: Array
    controlled: npt.NDArray[np.bool_]
    law: list[Callable[[float, float], float] | None]
    effect: list[Effect | None]

    @staticmethod
    def of(
        plant: MultibodyPlant, indices: Sequence[JointActuatorIndex], effects: Sequence[Realisation[Effect]] = ()
    ) -> Actuators:
        """Read them off a finalized plant; `effects` are those whose fittings may be among them."""
        fittings = {fitting.name: (fitting, each.effect) for each in effects for fitting in each.marked_fittings()}
        actuators = [plant.get_joint_actuator(index) for index in indices]
        found = [fittings.get(actuator.name(), (Fitting("", ""), None)) for actuator in actuators]
        extra = [fitting for fitting, _ in found]
        gains = [actuator.get_controller_gains() if actuator.has_controller() else None for actuator in actuators]
        return Actuators(
            position=np.array([actuator.joint().position_start() for actuator in actuators], dtype=int),
            velocity=np.array(
                [plant.num_positions() + actuator.joint().velocity_start() for actuator in actuators], dtype=int
            ),
            stiffness=np.array([gain.p if gain else 0.0 for gain in gains]),
            damping=np.array([gain.d if gain else 0.0 for gain in gains]),
            # The plant holds controlled actuators alone within their limit.
            limit=np.array([a.effort_limit() if a.has_controller() else np.inf for a in actuators]),
            torque=np.array([fitting.torque for fitting in extra]),
            rest=np.array([fitting.rest for fitting in extra]),
            controlled=np.array([actuator.has_controller() for actuator in actuators], dtype=bool),
            law=[_law(fitting) for fitting in extra],
            effect=[effect for _, effect in found],
        )

    def together(self) -> Array:
        """Return (k, k) hands what actuators without a controller push on one joint to the last of them.

        Of several such actuators on a joint, a plant heeds the last one alone.
        """
        result = np.eye(len(self.velocity))
        for k in np.flatnonzero(~self.controlled):
            same = np.flatnonzero(~self.controlled & (self.velocity == self.velocity[k]))
            result[:, k] = 0.0
            result[same[-1], k] = 1.0
        return result

    def given(self, state: Array, command: Array) -> Array:
        """Return the torque of a step with `command` (torque, position, velocity) that ended in `state`."""
        torque, position, velocity = command
        free = torque - self.stiffness * (state[self.position] - position)
        free -= self.damping * (state[self.velocity] - velocity)
        return np.minimum(np.maximum(free, -self.limit), self.limit)  # np.clip takes three times as long

    def pushes(self, state: Array, time: float) -> Array:
        """Return what the fittings among them give explicitly in a state (x,) of the plant."""
        result = self.torque.copy()
        for k, law in enumerate(self.law):
            if law is not None:
                result[k] += law(float(state[self.position[k]]), float(state[self.velocity[k]]))
        for k, effect in enumerate(self.effect):
            if effect is not None and effect.when.timed and not effect.when.active(np.array(time)):
                result[k] = 0.0
        return result


def _law(fitting: Fitting) -> Callable[[float, float], float] | None:
    of_angle, of_speed = fitting.curve, fitting.speed_curve
    if of_angle is None and of_speed is None:
        return None

    def law(q: float, v: float) -> float:
        return (of_angle(q) if of_angle else 0.0) + (of_speed(v) if of_speed else 0.0)

    return law
