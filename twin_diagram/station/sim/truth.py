"""What only a simulated station knows: true arm state, true object poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.model.effects import measured_position
from twin_diagram.signals.layouts import POSE_SIZE
from twin_diagram.station.sim.arm_plant import ArmPlant


class TrueState(LeafSystem):
    """Picks motors and arm joints out of the world plant's state.

    .. pydrake_system::

        name: TrueState
        input_ports:
        - plant_state
        output_ports:
        - motor_state
        - arm_state

    `motor_state` (2(n + g)): positions, then speeds of the arm's and the fingers' motors, as encoders without noise
    would read them; `arm_state` (2n): those of the arm's joints themselves. They differ by encoder offsets. No
    latency.
    """

    def __init__(self, plant: MultibodyPlant, arm: ArmPlant) -> None:
        """Build it for a finalized plant."""
        super().__init__()
        self._effects, self._joints = arm.effects, arm.arm.joints
        n = len(arm.joints)
        self._n = n
        self._all = _indices(plant, [*arm.joints, *arm.fingers])
        self._arm = _indices(plant, arm.joints)
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        ticket = {self._state.ticket()}
        self.DeclareVectorOutputPort("motor_state", len(self._all), self._calc_motors, ticket)
        self.DeclareVectorOutputPort("arm_state", len(self._arm), self._calc_arm, ticket)

    def _calc_motors(self, context: Context, output: BasicVector) -> None:
        state = self._state.Eval(context)[self._all]
        state[: self._n] = measured_position(self._effects, self._joints, state[: self._n])
        output.SetFromVector(state)

    def _calc_arm(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._state.Eval(context)[self._arm])


def _indices(plant: MultibodyPlant, joints: Sequence[Joint]) -> npt.NDArray[np.int64]:
    """Return where joints' positions, then their speeds stand in a plant's state."""
    nq = plant.num_positions()
    return np.array([j.position_start() for j in joints] + [nq + j.velocity_start() for j in joints], dtype=np.int64)


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
            # Drake's quaternion of a rotation matrix has qw >= 0.
            output.get_mutable_value()[POSE_SIZE * k : POSE_SIZE * (k + 1)] = np.concatenate(
                [X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation()]
            )
