"""Forces from outside, in a simulator, and those that bear what a link does not carry yet, or no more.

A plant cannot take up a mass during a run. The mass is therefore there from the begin, and while the effect is not,
a force at its place gives what gravity and the link's acceleration ask for: −m (g − a). The acceleration is that of the
step before. With M the inertia that the link itself shows there, the plant's step gives (M + m) aₖ = f + m aₖ₋₁, which
is stable for any masses, and off by what the acceleration changes in one step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.links import link_of
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.environment import ExternalForce
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.simulated.bodies import carrying_body
from twin_diagram.signals.arrays import Array


def pushing(effects: Sequence[Effect]) -> bool:
    """Return whether any of the effects needs a `Push`."""
    return any(isinstance(effect, ExternalForce) or _comes_or_goes(effect) for effect in effects)


def _comes_or_goes(effect: Effect) -> bool:
    return isinstance(effect, Payload) and effect.when.timed


class Push(LeafSystem):
    """Pushes links by the wrenches of effects, from their onsets to their ends, and bears payloads before and after.

    .. pydrake_system::

        name: Push
        input_ports:
        - state
        output_ports:
        - spatial_forces

    `state` of the plant. No latency but for the acceleration of what is borne, which is the last step's. State: the
    velocities (3 each) in W of the payloads that come or go, one step ago [m/s], and whether there was one.
    """

    def __init__(self, plant: MultibodyPlant, arm: Arm, effects: Sequence[Effect]) -> None:
        """Build it for a finalized plant."""
        super().__init__()
        self._plant, self._step = plant, plant.time_step()
        self._pushes = []
        for effect in effects:
            if not isinstance(effect, ExternalForce):
                continue
            force = ExternallyAppliedSpatialForce()
            force.body_index = link_of(plant, arm, effect.links[0]).index()
            wrench: Any = effect.value("wrench")
            force.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
            force.p_BoBq_B = cast(Any, effect.value("point"))
            self._pushes.append((effect, force))
        self._borne = [effect for effect in effects if isinstance(effect, Payload) and _comes_or_goes(effect)]
        self._carriers = [carrying_body(plant, arm, effect) for effect in self._borne]
        self._weights = [plant.is_gravity_enabled(body.model_instance()) for body in self._carriers]
        self._scratch = plant.CreateDefaultContext()  # overwritten before each use
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        needs = {self.time_ticket()}
        if self._borne:
            self.DeclareDiscreteState(3 * len(self._borne) + 1)
            self.DeclarePeriodicDiscreteUpdateEvent(self._step, 0.0, self._remember)
            needs |= {self._state.ticket(), self.xd_ticket()}
        self.DeclareAbstractOutputPort(
            "spatial_forces", lambda: Value([ExternallyAppliedSpatialForce()]), self._calc, needs
        )

    def _calc(self, context: Context, output: Any) -> None:
        time = np.array(context.get_time())
        forces = [force for effect, force in self._pushes if effect.when.active(time)]
        borne = [k for k, effect in enumerate(self._borne) if not effect.when.active(time)]
        if borne:
            held = np.asarray(context.get_discrete_state_vector().value())
            velocity = self._velocities(context)
            before = held[:-1].reshape(-1, 3) if held[-1] else velocity
            acceleration = (velocity - before) / self._step
            forces += [self._bearing(k, acceleration[k]) for k in borne]
        output.set_value(forces)

    def _bearing(self, k: int, acceleration: Array) -> ExternallyAppliedSpatialForce:
        """Return the force at a payload's place that spares its link the payload."""
        gravity = self._plant.gravity_field().gravity_vector() if self._weights[k] else np.zeros(3)
        effect, force = self._borne[k], ExternallyAppliedSpatialForce()
        force.body_index = self._carriers[k].index()
        force.p_BoBq_B = cast(Any, effect.value("com"))
        needed: Any = float(effect.value("mass")[0]) * (acceleration - gravity)
        force.F_Bq_W = SpatialForce(tau=np.zeros(3), f=needed)
        return force

    def _velocities(self, context: Context) -> Array:
        """Return (k, 3) velocities in W of the payloads that come or go [m/s]."""
        self._plant.SetPositionsAndVelocities(self._scratch, self._state.Eval(context))
        result = np.empty((len(self._borne), 3))
        for k, (effect, body) in enumerate(zip(self._borne, self._carriers, strict=True)):
            V_WB = body.EvalSpatialVelocityInWorld(self._scratch)
            p_BoBq_W = body.EvalPoseInWorld(self._scratch).rotation().multiply(cast(Any, effect.value("com")))
            result[k] = V_WB.translational() + np.cross(V_WB.rotational(), p_BoBq_W)
        return result

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        values.set_value(cast(Any, np.append(self._velocities(context).ravel(), 1.0)))
