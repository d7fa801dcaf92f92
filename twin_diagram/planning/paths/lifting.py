"""Straight up: joint angles with the tool so much higher, and how much higher others have it."""

from __future__ import annotations

import numpy as np

from twin_diagram.planning.collision.chain import Chain
from twin_diagram.signals.arrays import Array


def lifted(chain: Chain, q: Array, height: float, limits: tuple[Array, Array], steps: int) -> Array:
    """Return joint angles (n,) near `q` with the tool so much higher [m].

    Args:
        chain: the arm's.
        q: (n,) [rad or m].
        height: [m].
        limits: (n,) each, lowest and highest [rad or m].
        steps: of Gauss and Newton.
    """
    placement = chain.place(q[None])
    goal = chain.tool(placement)[0, :3, 3] + height * _up(chain)
    for _ in range(steps):
        J = chain.tool_jacobian(placement)[0, 3:]
        off = goal - chain.tool(placement)[0, :3, 3]
        q = np.clip(q + J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), off), *limits)
        placement = chain.place(q[None])
    return q


def higher(chain: Chain, q: Array, other: Array) -> float:
    """Return by how much the tool is higher at joint angles `other` (n,) than at `q` (n,) [m]."""
    here, there = chain.tool(chain.place(np.stack([q, other])))[:, :3, 3]
    return float((there - here) @ _up(chain))


def _up(chain: Chain) -> Array:
    """Return the unit vector (3,) against gravity in W; zeros without gravity."""
    return -chain.gravity_W / max(float(np.linalg.norm(chain.gravity_W)), 1e-9)
