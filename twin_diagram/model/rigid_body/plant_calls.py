"""Calls into a plant, one sample at a time, for one of the arms that it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces
from pydrake.systems.framework import Context

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.signals.arrays import Array


class PlantCalls:
    """Shares a scratch context among its calls: one thread at a time. Positions (n,) are true ones.

    Attributes:
        position_index, velocity_index: (n,) of the arm's joints in the plant's q and v.
    """

    def __init__(self, plant: MultibodyPlant, context: Context, arm: Arm) -> None:
        """Take a context whose parameters hold; its state is overwritten."""
        joints = [plant.get_joint(index) for index in arm.joint_indices]
        self.position_index = np.array([joint.position_start() for joint in joints])
        self.velocity_index = np.array([joint.velocity_start() for joint in joints])
        self._plant, self._context = plant, context
        self._forces = MultibodyForces(plant)
        self._world = plant.world_frame()
        self._tool = plant.get_frame(arm.tool_frame)
        # Typed loosely: Drake's stubs and NumPy's do not agree on what an array is.
        self._q: Any = plant.GetPositions(context).copy()
        self._now = b""
        self._v: Any = np.zeros(plant.num_velocities())
        self._a: Any = np.zeros(plant.num_velocities())
        self._origin: Any = np.zeros(3)
        self._block = np.ix_(self.velocity_index, self.velocity_index)

    def mass(self, q: Array) -> Array:
        """Return (n, n) mass matrix [kg·m²]."""
        self._at(q)
        mass: Array = self._plant.CalcMassMatrix(self._context)[self._block]
        return mass

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return (n,) torques of the rigid bodies, with what the context's parameters hold [N·m]."""
        plant, context = self._plant, self._context
        self._v[self.velocity_index] = v
        self._a[self.velocity_index] = a
        self._at(q)
        plant.SetVelocities(context, self._v)
        plant.CalcForceElementsContribution(context, self._forces)
        result: Array = plant.CalcInverseDynamics(context, self._a, self._forces)[self.velocity_index]
        return result

    def tool_pose(self, q: Array) -> RigidTransform:
        """Return X_WT of the tool frame."""
        self._at(q)
        return self._tool.CalcPoseInWorld(self._context)

    def tool_jacobian(self, q: Array) -> Array:
        """Return (6, n): angular over linear velocity of the tool frame in W, per joint velocity."""
        self._at(q)
        jacobian: Array = self._plant.CalcJacobianSpatialVelocity(
            self._context, JacobianWrtVariable.kV, self._tool, self._origin, self._world, self._world
        )[:, self.velocity_index]
        return jacobian

    def _at(self, q: Array) -> None:
        self._q[self.position_index] = q
        now = self._q.tobytes()
        if now != self._now:  # the plant forgets all that it has worked out, even where nothing is new
            self._plant.SetPositions(self._context, self._q)
            self._now = now
