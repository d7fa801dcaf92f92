"""Joint goals for a tool pose: many starts of damped Gauss–Newton at once, and what comes out distinct."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram.planning.collision.chain import Chain, drawn_range
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class IkTuning:
    """How inverse kinematics searches."""

    starts: int = 96
    """Searches, half of them near the present configuration."""
    iterations: int = 60
    """Steps of each search; at `step` each, they cross any joint's range."""
    damping: float = 1e-3
    """Added to J Jᵀ [m², rad²]: keeps steps finite where the arm is stretched out."""
    step: float = 0.4
    """Longest step of any joint per iteration [rad]."""
    position_tolerance: float = 1e-5
    """What a solution may be off by [m]: far below what an arm keeps."""
    rotation_tolerance: float = 1e-4
    """The same for rotation [rad]."""
    distinct: float = 0.3
    """Solutions that differ by less than this in every joint are one [rad]."""
    limit_margin: float = 0.05
    """Kept from the joints' limits [rad]."""


NEARBY_DAMPING: Final = 1e-6
"""Of `nearby`, added to J Jᵀ [m², rad²]: goals are close, and so are solutions."""


def pose_error(X_WT: Array, X_WG: Array) -> Array:
    """Return what turns and moves T (N, 4, 4) into G (4, 4): (N, 6) rotation vector [rad] and translation [m], in W."""
    turn = X_WG[:3, :3] @ X_WT[:, :3, :3].transpose(0, 2, 1)
    return np.concatenate([Rotation.from_matrix(turn).as_rotvec(), X_WG[:3, 3] - X_WT[:, :3, 3]], axis=1)


def solve(
    chain: Chain,
    X_WG: Array,
    near: Array,
    lower: Array,
    upper: Array,
    rng: np.random.Generator,
    tuning: IkTuning | None = None,
) -> Array:
    """Return the configurations that put the tool at a pose, within the joints' limits.

    Half of the searches start near `near`, at growing distances, the others anywhere.

    Args:
        chain: the arm.
        X_WG: (4, 4) the tool's goal.
        near: (n,) where to look first.
        lower: (n,) limits [rad], may be infinite.
        upper: (n,) likewise.
        rng: draws the starts.
        tuning: None for the defaults.

    Returns:
        (G, n) distinct solutions, the nearest to `near` first; G may be zero.
    """
    from twin_diagram.planning.paths import inverse_kernels  # compiled; not with every import

    tuning = tuning or IkTuning()
    n, half = chain.size, tuning.starts // 2
    margin = np.minimum(tuning.limit_margin, 0.1 * (upper - lower))
    low, high = lower + margin, upper - margin
    spread = np.linspace(0.0, 1.5, half)[:, None] * rng.standard_normal((half, n))
    anywhere = rng.uniform(*drawn_range(low, high), (tuning.starts - half, n))
    q = np.clip(np.concatenate([near + spread, anywhere]), low, high)
    X_LT, X_WG, low, high = (np.ascontiguousarray(part, dtype=float) for part in (chain.X_LT, X_WG, low, high))
    q, error = inverse_kernels.search(
        q, chain.constant, chain.sine, chain.cosine, chain.linear, chain.axes_P, chain.origins_P, chain.prismatic,
        X_LT, X_WG, low, high, tuning.iterations, tuning.damping, tuning.step,
    )  # fmt: skip
    good = (np.linalg.norm(error[:, :3], axis=1) < tuning.rotation_tolerance) & (
        np.linalg.norm(error[:, 3:], axis=1) < tuning.position_tolerance
    )
    q = q[good]
    q = q[np.argsort(np.linalg.norm(q - near, axis=1), kind="stable")]
    distinct: list[Array] = []
    for candidate in q:
        if all(np.abs(candidate - other).max() >= tuning.distinct for other in distinct):
            distinct.append(candidate)
    return np.array(distinct).reshape(-1, n)


def nearby(chain: Chain, X_WG: Array, near: Array, lower: Array, upper: Array, iterations: int) -> tuple[Array, Array]:
    """Return the configuration (n,) next to another that puts the tool at a pose close by, and its error there (6,).

    Args:
        chain: the arm.
        X_WG: (4, 4) the tool's goal.
        near: (n,) where it begins; of all that reach the goal it goes to the one with the shortest steps.
        lower: (n,) limits; joints at one take no part in steps beyond it.
        upper: (n,) likewise.
        iterations: steps at the most.
    """
    from twin_diagram.planning.paths import inverse_kernels  # compiled; not with every import

    X_LT, X_WG, low, high = (np.ascontiguousarray(part, dtype=float) for part in (chain.X_LT, X_WG, lower, upper))
    q, error = inverse_kernels.search(
        np.array([near], dtype=float), chain.constant, chain.sine, chain.cosine, chain.linear, chain.axes_P,
        chain.origins_P, chain.prismatic, X_LT, X_WG, low, high, iterations, NEARBY_DAMPING, np.inf,
    )  # fmt: skip
    return q[0], error[0]


def damped_step(J: Array, error: Array, damping: Array) -> Array:
    """Return (N, n) the steps of damped least squares that take away errors (N, 6), with Jacobians (N, 6, n)."""
    gram = J @ J.transpose(0, 2, 1) + damping
    result: Array = (J.transpose(0, 2, 1) @ np.linalg.solve(gram, error[..., None]))[..., 0]
    return result
