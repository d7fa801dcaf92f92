"""Where a frame on the arm is and how it moves, with the derivatives that sensors on it need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame, JacobianWrtVariable

from twin_diagram.errors import ModelError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.signals.arrays import Array

_CROSS: Final = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]], [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]], float
)
"""(3, 3, 3): a × b is _CROSS_ijk a_j b_k."""


@dataclass(frozen=True)
class LinkMotion:
    """A frame F on the arm at one moment; all in W.

    Attributes:
        R_WF: (3, 3).
        p_WF: (3,) [m].
        J_w, J_v: (3, n) Jacobians of its angular velocity and of its origin's velocity.
        omega: (3,) [rad/s].
        velocity: (3,) [m/s].
        bias_alpha, bias_a: (3,) angular and linear acceleration at v̇ = 0.
    """

    R_WF: Array
    p_WF: Array
    J_w: Array
    J_v: Array
    omega: Array
    velocity: Array
    bias_alpha: Array
    bias_a: Array


class LinkFrame:
    """A frame F fixed on one of the arm's links; all positions q (n,) are as measured, encoders' offsets included.

    Attributes:
        terms: the arm.
        X_BF: its pose on the link B.
    """

    def __init__(self, terms: ArmTerms, body: str | Frame, X_BF: RigidTransform | None = None) -> None:
        """Find the link.

        Args:
            terms: the arm.
            body: name of a link or of any frame of the plant, or a frame itself.
            X_BF: pose of F on it; the link's own frame where None.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        self.terms = terms
        plant = terms.plant
        if not isinstance(body, str):
            self._frame = body
        elif plant.HasFrameNamed(body):
            self._frame = plant.GetFrameByName(body)
        elif plant.HasBodyNamed(body):
            self._frame = plant.GetBodyByName(body).body_frame()
        else:
            raise ModelError(f"no link or frame {body!r} in the plant")
        self.X_BF = RigidTransform() if X_BF is None else X_BF
        self._R_BF = self.X_BF.rotation().matrix()
        self._p_BF: Any = self.X_BF.translation()
        self._world = plant.world_frame()

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Return R_WF (3, 3), p_WF (3,) at q (n,)."""
        context = self.terms.at(self.terms.true_position(q), 0.0)
        X_WB = self._frame.CalcPoseInWorld(context)
        R_WB = X_WB.rotation().matrix()
        return R_WB @ self._R_BF, X_WB.translation() + R_WB @ self._p_BF

    def jacobian(self, q: Array) -> tuple[Array, Array, Array]:
        """Return R_WF (3, 3), p_WF (3,) and J (6, n), rotation first, of F's origin, in W, at q (n,)."""
        context, plant = self.terms.at(self.terms.true_position(q), 0.0), self.terms.plant
        J: Array = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, self._frame, self._p_BF, self._world, self._world
        )[:, self.terms.velocity_index]
        X_WB = self._frame.CalcPoseInWorld(context)
        R_WB = X_WB.rotation().matrix()
        return R_WB @ self._R_BF, X_WB.translation() + R_WB @ self._p_BF, J

    def motion(self, q: Array, v: Array) -> LinkMotion:
        """Return all of it at q, v, each (n,)."""
        context, plant = self.terms.at(self.terms.true_position(q), v), self.terms.plant
        J: Array = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, self._frame, self._p_BF, self._world, self._world
        )[:, self.terms.velocity_index]
        bias = plant.CalcBiasSpatialAcceleration(
            context, JacobianWrtVariable.kV, self._frame, self._p_BF, self._world, self._world
        )
        X_WB = self._frame.CalcPoseInWorld(context)
        R_WB = X_WB.rotation().matrix()
        moving = J @ v
        return LinkMotion(
            R_WF=R_WB @ self._R_BF,
            p_WF=X_WB.translation() + R_WB @ self._p_BF,
            J_w=J[:3],
            J_v=J[3:],
            omega=moving[:3],
            velocity=moving[3:],
            bias_alpha=np.asarray(bias.rotational()),
            bias_a=np.asarray(bias.translational()),
        )


def turned_rate(motion: LinkMotion, v: Array) -> Array:
    """Return ∂ω/∂q (3, n): joint i turns the axes of all joints after it, hence ∂ω/∂q_i = w_i × (ω − ω_i).

    w_i is the axis of joint i (a column of J_w), ω_i the angular velocity of the link that it moves.
    """
    upto = np.cumsum(motion.J_w * v, axis=1)
    return np.asarray(np.cross(motion.J_w, motion.omega[:, None] - upto, axis=0))


def turned_acceleration(motion: LinkMotion, v: Array, a: Array) -> tuple[Array, Array]:
    """Return ∂v̇_F/∂q and ∂v̇_F/∂v (3, n) of F's origin, whose acceleration is Σ J_k a_k + Σ H_km v_k v_m.

    J is J_v. A joint turns what those after it move: H_km = ∂J_k/∂q_m = w_i × J_j with i the earlier of k and m and j
    the later one; the joints come one after the other.

    Args:
        motion: of the frame.
        v: (n,) speeds of the joints.
        a: (n,) their accelerations.
    """
    w, J, n = motion.J_w, motion.J_v, len(v)
    crossed = np.asarray((_CROSS.transpose(0, 2, 1).reshape(9, 3) @ w).reshape(3, 3, n).transpose(0, 2, 1))  # w_i ×
    earlier = np.tri(n, k=-1).T  # row before column
    pairs, turned = crossed @ J, crossed @ w * earlier
    upper = pairs * earlier
    H = upper + upper.transpose(0, 2, 1) + pairs * np.eye(n)
    # Of Σ_{i<=j} w_i × J_j v_i v_j, those of two joints twice: what turns w_i, and what turns J_j.
    w, J = w * v, J * v
    outer, inner = v * (2.0 * J @ earlier.T + J), v * (2.0 * w @ earlier + w)
    both = (turned @ outer.T).transpose(0, 2, 1) + (inner @ H).transpose(1, 0, 2)
    return H @ a + _CROSS.reshape(3, 9) @ both.reshape(9, n), 2.0 * H @ v
