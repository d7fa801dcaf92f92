"""The torque that carries a payload: what the motors must give against its weight."""

from __future__ import annotations

import numpy as np

from twin_diagram.planning.collision.chain import Chain
from twin_diagram.signals.arrays import Array


def gravity_regressor(chain: Chain, q: Array) -> Array:
    """Return what the motors give per unit of payload, (n, 4): mass [kg], first moment m·c [kg·m] in the last link.

    A mass m at c pulls with m g at p = p_WL + R_WL c. Joint j with axis a through o must give −g · (a × m (p − o)), or
    −m g · a where it slides.

    Args:
        chain: the arm.
        q: (n,) positions [rad].
    """
    placement = chain.place(q[None])
    X_WL = placement.X_WL[0, -1]
    axes, origins = placement.axes_W[0], placement.origins_W[0]
    # g · (a × r) = (g × a) · r
    x, y, z = chain.gravity_W
    lever = axes @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    turning = np.empty((chain.size, 4))
    turning[:, 0] = np.einsum("ni,ni->n", lever, X_WL[:3, 3] - origins)
    turning[:, 1:] = lever @ X_WL[:3, :3]
    if chain.prismatic.any():
        sliding = np.column_stack([axes @ chain.gravity_W, np.zeros((chain.size, 3))])
        turning = np.where(chain.prismatic[:, None], sliding, turning)
    return -turning
