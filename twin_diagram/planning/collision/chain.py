"""Forward kinematics of a serial arm for many configurations at once, on plain arrays.

Drake's plant gives one configuration per call; a planner asks for hundreds. The constants are read off the plant once.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FrameIndex, JointIndex, PrismaticJoint, RevoluteJoint

from twin_diagram.errors import ModelError
from twin_diagram.model.description import joint_tree
from twin_diagram.signals.arrays import Array, Ints


def drawn_range(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return finite limits (n,) within the joints' own from which configurations are drawn: ±π, m where they slide.

    Where a joint's own lie beyond that they are those within π of its least.
    """
    beyond = np.maximum(lower, -np.pi) > np.minimum(upper, np.pi)
    middle = np.where(beyond, np.clip(0.0, lower, upper), 0.0)
    return np.maximum(lower, middle - np.pi), np.minimum(upper, middle + np.pi)


def _no_chain(joint: str, runs: Sequence[Sequence[str]]) -> str:
    """Return what is wrong where a joint does not follow the one before it, with what could be named instead."""
    first, *others = [run for run in runs if len(run) > 1] or [[]]
    names = f" {shlex.join(first)}" if first else ""
    also = ", ".join(f"{run[0]} to {run[-1]}" for run in others[:3])
    return (
        f"joint {joint!r} does not follow the joint before it: the arm must be a serial chain; name those of one, "
        f"from its base (--joints{names}; twin.arm.joints and world.arm.joints of a scenario)"
        + (f"; others are {also}" if also else "")
    )


@dataclass(frozen=True)
class Placement:
    """Where the arm's links are in some configurations; N configurations, n joints.

    Attributes:
        X_WL: (N, n + 1, 4, 4) poses: entry 0 is the world (what stands still), entry k the child link of joint k.
        axes_W: (N, n, 3) the joints' axes.
        origins_W: (N, n, 3) a point on each axis.
    """

    X_WL: Array
    axes_W: Array
    origins_W: Array


@dataclass(frozen=True)
class Chain:
    """The constants of a serial arm: each joint's transform is M0 + sin(q) M1 + cos(q) M2 + q M3.

    Attributes:
        constant, sine, cosine, linear: (n, 4, 4), those matrices: link k in link k - 1.
        axes_P: (n, 3) the joints' axes in the preceding link's frame.
        origins_P: (n, 3) the joints' origins in the preceding link's frame.
        prismatic: (n,) bool.
        X_LT: (4, 4) the tool frame in the last link.
        gravity_W: (3,) [m/s²].
    """

    constant: Array
    sine: Array
    cosine: Array
    linear: Array
    axes_P: Array
    origins_P: Array
    prismatic: npt.NDArray[np.bool_]
    X_LT: Array
    gravity_W: Array

    @property
    def size(self) -> int:
        """Number of joints, n."""
        return len(self.prismatic)

    @staticmethod
    def from_plant(plant: MultibodyPlant, joints: Sequence[JointIndex], tool_frame: FrameIndex) -> Chain:
        """Read a finalized plant whose base is welded to the world.

        Args:
            plant: the arm, with or without a gripper.
            joints: the arm's joints, base to tip.
            tool_frame: a frame that moves with the last joint and no other.

        Raises:
            ModelError: a joint is neither revolute nor prismatic, the joints are no serial chain, or the tool is
                elsewhere.
        """
        context = plant.CreateDefaultContext()
        q = plant.GetPositions(context).copy()  # joints outside the arm stand as described
        q[[plant.get_joint(index).position_start() for index in joints]] = 0.0
        plant.SetPositions(context, q)
        n = len(joints)
        constant, sine, cosine, linear = np.zeros((4, n, 4, 4))
        axes, origins, prismatic = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, dtype=bool)
        depth = depths(plant, joints)
        X_WP = identity = np.eye(4)
        for k, index in enumerate(joints):
            joint = plant.get_joint(index)
            name = joint.name()
            if depth[int(joint.child_body().index())] != k + 1 or depth[int(joint.parent_body().index())] != k:
                raise ModelError(_no_chain(name, joint_tree.unbranched(plant, joints)))
            X_WF = joint.frame_on_parent().CalcPoseInWorld(context).GetAsMatrix4()
            X_WL = plant.EvalBodyPoseInWorld(context, joint.child_body()).GetAsMatrix4()
            X_PF = np.linalg.solve(X_WP, X_WF)
            X_FL = np.linalg.solve(X_WF, X_WL)
            if isinstance(joint, RevoluteJoint):
                axis = joint.revolute_axis()
                K = np.zeros((4, 4))
                K[:3, :3] = np.cross(axis, np.eye(3)).T
                # Rodrigues: R = I + sin K + (1 − cos) K².
                constant[k] = X_PF @ (identity + K @ K) @ X_FL
                sine[k] = X_PF @ K @ X_FL
                cosine[k] = -X_PF @ K @ K @ X_FL
            elif isinstance(joint, PrismaticJoint):
                axis = joint.translation_axis()
                shift = np.zeros((4, 4))
                shift[:3, 3] = axis
                constant[k] = X_PF @ X_FL
                linear[k] = X_PF @ shift @ X_FL
                prismatic[k] = True
            else:
                raise ModelError(
                    f"joint {name!r} is {joint.type_name()}; the planner knows revolute and prismatic joints"
                )
            axes[k], origins[k] = X_PF[:3, :3] @ axis, X_PF[:3, 3]
            X_WP = X_WL
        tool = plant.get_frame(tool_frame)
        if depth[int(tool.body().index())] != n:
            raise ModelError(f"frame {tool.name()!r} does not move with all of the arm's joints")
        X_LT = np.linalg.solve(X_WP, tool.CalcPoseInWorld(context).GetAsMatrix4())
        gravity = np.array(plant.gravity_field().gravity_vector())
        return Chain(constant, sine, cosine, linear, axes, origins, prismatic, X_LT, gravity)

    def place(self, q: Array) -> Placement:
        """Place the links in configurations `q`, (N, n) [rad or m]."""
        from twin_diagram.planning.collision import arm_kernels  # compiled; not with every import

        arrays = self.constant, self.sine, self.cosine, self.linear, self.axes_P, self.origins_P
        return Placement(*arm_kernels.place(np.ascontiguousarray(q, dtype=float), *arrays))

    def tool(self, placement: Placement) -> Array:
        """Return X_WT, (N, 4, 4)."""
        return placement.X_WL[:, -1] @ self.X_LT

    def tool_jacobian(self, placement: Placement) -> Array:
        """Return the jacobian of the tool frame, (N, 6, n): angular above linear, in W."""
        p_WT = self.tool(placement)[:, :3, 3]
        turning = np.where(self.prismatic[:, None], 0.0, placement.axes_W)
        linear = point_jacobian(placement, p_WT, np.full(len(p_WT), self.size), np.arange(len(p_WT)), self.prismatic)
        return np.concatenate([turning.transpose(0, 2, 1), linear.transpose(0, 2, 1)], axis=1)


def point_jacobian(placement: Placement, p_W: Array, link: Ints, row: Ints, prismatic: npt.NDArray[np.bool_]) -> Array:
    """Return how fast points that are fixed to links move with the joints.

    Args:
        placement: of N configurations.
        p_W: (M, 3) the points [m].
        link: (M,) ints: the link each moves with, 0..n.
        row: (M,) ints: the configuration each belongs to.
        prismatic: (n,) bool.

    Returns:
        (M, n, 3) velocities in W per unit of joint speed.
    """
    axes, origins = placement.axes_W[row], placement.origins_W[row]
    arms = p_W[:, None, :] - origins
    x, y, z = arms[..., 0], arms[..., 1], arms[..., 2]
    ax, ay, az = axes[..., 0], axes[..., 1], axes[..., 2]
    result = np.empty(axes.shape)
    result[..., 0], result[..., 1], result[..., 2] = ay * z - az * y, az * x - ax * z, ax * y - ay * x
    if prismatic.any():
        result[:, prismatic] = axes[:, prismatic]
    result[np.arange(axes.shape[1])[None, :] >= link[:, None]] = 0.0
    return result


def depths(plant: MultibodyPlant, joints: Sequence[JointIndex]) -> Ints:
    """Return how many of the arm's joints carry each body of the plant, by the body's index."""
    depth = np.zeros(plant.num_bodies(), dtype=int)
    for index in joints:
        for body in plant.GetBodiesKinematicallyAffectedBy([index]):
            depth[int(body)] += 1
    return depth
