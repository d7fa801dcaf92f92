"""What only a simulated station knows: true arm state, true object poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.signals import POSE_SIZE


class TrueState(LeafSystem):
    """Picks motors and arm joints out of the world plant's state.

    .. pydrake_system::

        name: TrueState
        input_ports:
        - plant_state
        output_ports:
        - motor_state
        - arm_state

    `motor_state` (2(n + g)) positions then speeds of arm and finger motors; `arm_state` (2n) those of the arm's joints. They
    differ where a joint is elastic. No latency.
    """

    def __init__(self, plant: MultibodyPlant, motors: Sequence[Joint], joints: Sequence[Joint]) -> None:
        """Builds it for a finalized plant; one joint for each motor, then one for each arm joint."""
        super().__init__()
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        for name, selected in (("motor_state", motors), ("arm_state", joints)):
            index = np.array(
                [j.position_start() for j in selected] + [plant.num_positions() + j.velocity_start() for j in selected]
            )

            def calc(context: Context, output: BasicVector, index: np.ndarray = index) -> None:
                output.SetFromVector(self._state.Eval(context)[index])

            self.DeclareVectorOutputPort(name, len(index), calc, prerequisites_of_calc={self._state.ticket()})


class TruePoses(LeafSystem):
    """Picks the objects' poses out of the world plant's body poses.

    .. pydrake_system::

        name: TruePoses
        input_ports:
        - body_poses
        output_ports:
        - object_poses

    `object_poses` (7K): X_WO of each object as (qw, qx, qy, qz, px, py, pz), qw >= 0. No latency.
    """

    def __init__(self, bodies: Sequence[BodyIndex]) -> None:
        """`bodies`: of the objects, in order."""
        super().__init__()
        self._bodies = [int(body) for body in bodies]
        self._poses = self.DeclareAbstractInputPort("body_poses", Value([RigidTransform()]))
        self.DeclareVectorOutputPort(
            "object_poses", POSE_SIZE * len(self._bodies), self._calc, prerequisites_of_calc={self._poses.ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        poses = self._poses.Eval(context)
        for k, body in enumerate(self._bodies):
            X_WO = poses[body]
            wxyz = X_WO.rotation().ToQuaternion().wxyz()
            output.get_mutable_value()[POSE_SIZE * k : POSE_SIZE * (k + 1)] = np.concatenate(
                [wxyz if wxyz[0] >= 0 else -wxyz, X_WO.translation()]
            )
