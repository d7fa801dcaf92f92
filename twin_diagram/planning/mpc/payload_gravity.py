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
    from twin_diagram.planning.mpc import motion_kernels  # compiled; not with every import

    arrays = chain.constant, chain.sine, chain.cosine, chain.linear, chain.axes_P, chain.origins_P
    return motion_kernels.weight(np.ascontiguousarray(q, dtype=float), *arrays, chain.prismatic, chain.gravity_W)
