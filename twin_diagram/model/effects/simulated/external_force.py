"""Forces from outside, in a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import Context, LeafSystem

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.environment import ExternalForce


class Push(LeafSystem):
    """Pushes links by the wrenches of effects, from their onsets to their ends. No latency.

    .. pydrake_system::

        name: Push
        output_ports:
        - spatial_forces
    """

    def __init__(self, plant: MultibodyPlant, arm: Arm, effects: Sequence[ExternalForce]) -> None:
        """Build it for a finalized plant."""
        super().__init__()
        instance = plant.get_body(arm.base).model_instance()
        self._pushes = []
        for effect in effects:
            force = ExternallyAppliedSpatialForce()
            force.body_index = plant.GetBodyByName(effect.links[0], instance).index()
            wrench: Any = effect.value("wrench")
            force.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
            force.p_BoBq_B = np.zeros(3)
            self._pushes.append((effect, force))

        def calc(context: Context, output: Any) -> None:
            time = np.array(context.get_time())
            output.set_value([force for effect, force in self._pushes if effect.when.active(time)])

        self.DeclareAbstractOutputPort(
            "spatial_forces", lambda: Value([ExternallyAppliedSpatialForce()]), calc, {self.time_ticket()}
        )
