"""Whether poses of a gripper are grasps, and if not, why; and how often they are when the object lies a little off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.grasps import cost, slab_kernels
from twin_diagram.planning.grasps.closing import (
    TUNING as CLOSING,
)
from twin_diagram.planning.grasps.closing import (
    Closing,
    close,
    drawn_back,
    finger_stop,
    heights,
    rim_depth,
    slab_half,
    table_stop,
)
from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.slab import Flags, Slab, factors
from twin_diagram.planning.grasps.target import GraspTarget
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout

REASONS: Final = (
    "",
    "nothing between the fingers",
    "too wide",
    "too thin",
    "in collision",
    "into the table",
    "met beside the pads",
    "outside of the friction cone",
    "both contacts hidden",
    "too heavy",
)
"""Why a pose is no grasp, by its code; 0: it is one."""
_CODE: Final = {reason: code for code, reason in enumerate(REASONS)}
"""The codes of `REASONS`."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    retreat: float = 0.10
    """Length of the straight approach, of which table and mesh keep clear [m]."""

    overlap: float = 0.25
    """Patches whose centres are aside by so much of a pad's width still overlap, so that a line through both holds."""

    shown: float = 0.25
    """A contact is no guess where a camera saw some of that side within so much of a pad's width: round sides are seen
    to where they turn away, which is where pads meet them."""


TUNING = Tuning()


@dataclass(frozen=True)
class Judged:
    """K poses, looked at.

    Attributes:
        R: (K, 3, 3) axes in O, as columns.
        p: (K, 3) origins in O [m].
        code: (K,) index into `REASONS`.
        closing: what they hold.
        seen: (K, 2) contacts that the cloud shows.
        terms: (K,) of the cost, by name; of poses that are no grasps they mean nothing.
    """

    R: Array
    p: Array
    code: npt.NDArray[np.int64]
    closing: Closing
    seen: Flags
    terms: dict[str, Array]

    @property
    def score(self) -> Array:
        """(K,) the sum of the terms, infinite where a pose is no grasp; lower is better."""
        return np.where(self.code == 0, np.sum(list(self.terms.values()), axis=0), np.inf)


@dataclass(frozen=True)
class Ahead:
    """What K poses of the open gripper have before them.

    Attributes:
        slab: points near the closing plane, as far ahead as the fingers can come.
        palm: (K,) how far the palm can be pushed on [m].
        margin: by which fingers and palm are taken wider across the closing axis [m].
    """

    slab: Slab
    palm: Array
    margin: float


def view(target: GraspTarget, gripper: Gripper, R: Array, p: Array, margin: float, aside: float = 0.0) -> Ahead:
    """Look along the approach of K poses.

    Args:
        target: the object.
        gripper: opened all the way.
        R: (K, 3, 3) axes in O.
        p: (K, 3) origins in O [m].
        margin: as of `Ahead`: the cloud has gaps.
        aside: by how much poses may still be moved along y [m].
    """
    left, right = factors(target.points, R, p)
    half, (x, y, _) = slab_half(gripper, margin), gripper.palm_size
    palm = x / 2 + margin, y / 2 + margin + aside, CLOSING.gap, gripper.palm_front
    # The fingers come no further than the palm lets them.
    ahead = gripper.finger_front + 2 * CLOSING.gap
    stop, pose, point, q = slab_kernels.before(one_layout(left), one_layout(right), half, palm, ahead)
    return Ahead(Slab(len(R), pose, point, cast(Array, q)), cast(Array, stop), margin)


def judge(target: GraspTarget, gripper: Gripper, R: Array, p: Array) -> Judged:
    """Judge K poses, R (K, 3, 3) and p (K, 3) [m], of the open gripper in O as they are: none is moved."""
    seen = view(target, gripper, R, p, 0.0)
    return settle(target, gripper, R, p, seen, np.zeros(len(R)), np.zeros(len(R)))


def settle(
    target: GraspTarget,
    gripper: Gripper,
    R: Array,
    p: Array,
    ahead: Ahead,
    offset: Array,
    depth: Array | None = None,
) -> Judged:
    """Move K poses along y and z, close there, and judge what they hold.

    Args:
        target: the object.
        gripper: opened all the way.
        R: (K, 3, 3) axes in O.
        p: (K, 3) origins in O, before they are moved [m].
        ahead: what they have before them.
        offset: (K,) along y [m].
        depth: (K,) along z [m]; None: until right before the gripper touches something, as ten Pas et al. do.
    """
    slab, others = ahead.slab, target.others
    other = others.among(slab)
    stop = np.minimum(ahead.palm, finger_stop(slab, gripper, ahead.margin, offset, other))
    p = p + offset[:, None] * R[:, :, 1]
    over, rising = np.full(len(R), np.inf), np.zeros(len(R))
    if others.table is not None:
        rising = R[:, :, 2] @ others.table[:3]
        over = table_stop(gripper, R, p, others.table, TUNING.retreat)
    code = np.zeros(len(R), dtype=np.int64)
    pushed = depth is None
    if depth is None:
        depth = np.minimum(stop, over)
        code[np.isposinf(depth)] = _CODE["nothing between the fingers"]
        code[np.isneginf(depth)] = _CODE["into the table"]
        depth = np.where(np.isfinite(depth), depth, 0.0)
        if target.viewpoint is None:  # else its far end is not seen
            back = drawn_back(slab, gripper, offset, depth, other)
            depth = np.where(rising > 1e-9, depth, back)  # drawn back from below, it would be in the table
    else:  # may be in touch already: the gap is for poses that are found here
        code[over < depth - CLOSING.gap] = _CODE["into the table"]
        code[stop < depth - CLOSING.gap] = _CODE["in collision"]
    closing = close(slab, target.normals, R, gripper, offset, depth, other)
    if pushed and target.viewpoint is None:
        first = closing.roots_first & (rising <= 1e-9)  # what rises is let out into the table
        depth, closing = _before_the_roots(slab, target.normals, R, gripper, offset, depth, other, closing, first)
    p = p + depth[:, None] * R[:, :, 2]
    found, seen = _held(target, gripper, R, p, closing)
    code = np.where(code > 0, code, found)
    empty = code == _CODE["nothing between the fingers"]
    code[empty & _wider(slab.most(slab.q[1]), slab.least(slab.q[1]), gripper)] = _CODE["too wide"]
    room = np.full(len(R), np.inf)
    if others.table is not None:
        room = heights(gripper, R, p, others.table)
    return Judged(R, p, code, closing, seen, cost.terms(target, gripper, R, p, closing, room, seen))


def _before_the_roots(
    slab: Slab,
    normals: Array,
    R: Array,
    gripper: Gripper,
    offset: Array,
    depth: Array,
    other: Flags,
    closing: Closing,
    first: Flags,
) -> tuple[Array, Closing]:
    """Return depths (K,), and what is held, where what would meet the fingers behind the pads (`first`) is let out.

    The wall of a bowl or a tray, pushed in as far as it goes, leans against the fingers' roots; its rim can be held.
    """
    if not first.any():
        return depth, closing
    kept = first[slab.pose]
    part, others = slab.where(kept), other[kept]
    depth = np.where(first, rim_depth(part, gripper, offset, depth, others), depth)
    return depth, closing.or_else(close(part, normals, R, gripper, offset, depth, others), first)


def _wider(most: Array, least: Array, gripper: Gripper) -> Flags:
    """Return whether what lies in the closing plane is wider than the fingers open."""
    return np.isfinite(most) & (most - least > gripper.opening_most - 2 * CLOSING.beside)


def _held(
    target: GraspTarget, gripper: Gripper, R: Array, p: Array, closing: Closing
) -> tuple[npt.NDArray[np.int64], Flags]:
    """Return why (K,) what is between the fingers is not held, 0 where it is, and which contacts (K, 2) are seen.

    A contact holds by friction where the outward normal leans no more than the friction cone from the closing axis,
    and a line through both patches does not either. A side that faces away from the camera was not seen: there
    nothing is claimed, but a finger must have room for more than what is seen.
    """
    cone = 1.0 / np.hypot(1.0, gripper.friction)
    seen = closing.align >= cone
    hidden = np.zeros_like(seen)
    room = np.ones(len(R), dtype=bool)
    contacts = p[:, None] + np.einsum("kij,ksj->ksi", R, closing.contact)
    outward = R[:, None, :, 1] * np.array([[[1.0], [-1.0]]])
    if target.viewpoint is not None:
        away = np.einsum("ksi,ksi->ks", outward, target.viewpoint - contacts) < 0
        hidden = away & ~seen
        sides = (gripper.opening_most - closing.width)[:, None] / 2
        sides = sides - closing.middle[:, None] * np.array([1.0, -1.0])
        room = (~hidden | (sides >= CLOSING.hidden_room)).all(axis=1)
    span = closing.contact[:, 0] - closing.contact[:, 1]
    lean = (
        np.hypot(span[:, 0], span[:, 2]) <= gripper.friction * np.abs(span[:, 1]) + TUNING.overlap * gripper.pad_width
    )
    lean |= hidden.any(axis=1)
    code = np.zeros(len(R), dtype=np.int64)
    weight = 0.0 if target.mass is None else target.mass * cost.GRAVITY
    for reason, wrong in (
        ("too heavy", np.full(len(R), weight > 2 * gripper.friction * gripper.force)),
        ("both contacts hidden", hidden.all(axis=1)),
        ("outside of the friction cone", ~(seen | hidden).all(axis=1) | ~lean),
        ("met beside the pads", closing.roots_first),
        ("too wide", (closing.width > gripper.opening_most - 2 * CLOSING.beside) | ~room),
        ("too thin", closing.width < gripper.opening_least),
        ("nothing between the fingers", closing.count == 0),
    ):
        code[wrong] = _CODE[reason]
    near = TUNING.shown * gripper.pad_width
    shown = target.shown(contacts.reshape(-1, 3), outward.reshape(-1, 3), near, cone)
    return code, seen & shown.reshape(seen.shape)


def success_over_poses(
    target: GraspTarget, gripper: Gripper, R: Array, p: Array, covariance: Array, pose: Array, samples: int, seed: int
) -> Array:
    """Return the share (K,) of samples of the object's pose in which grasps that hold at its mean succeed.

    Table and other things stay where they are, and so does the hand: what keeps clear of them at the mean always does.

    Args:
        target: the object.
        gripper: opened all the way.
        R: (K, 3, 3) axes of the grasps in O.
        p: (K, 3) their origins in O [m].
        covariance: (6, 6) of X_WO, rotation [rad] then translation [m]: a left perturbation in W about O's origin.
        pose: X_WO (7,) as (qw, qx, qy, qz, px, py, pz).
        samples: how many; the same for all grasps, in pairs of opposite signs.
        seed: of the draws.
    """
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    half = np.random.default_rng(seed).standard_normal(((samples + 1) // 2, 6)) @ root.T
    drawn = np.concatenate([half, -half])[:samples]
    R_WO = rotations.matrix(rotations.normalized(pose[:4]))
    # X_O'G = X_WO'⁻¹ X_WG with R_WO' = Exp(φ) R_WO: as seen from O, the gripper turns and moves the other way.
    turn = np.einsum("ij,sjk->sik", R_WO.T, rotations.matrix(rotations.exp(-drawn[:, :3])))
    placed = np.einsum("sij,jl,klm->skim", turn, R_WO, R)
    origins = np.einsum("sij,skj->ski", turn, (p @ R_WO.T)[None] - drawn[:, None, 3:])
    alone = replace(target, points=target.points[: target.own], normals=target.normals[: target.own], table=None)
    found = judge(alone, gripper, placed.reshape(-1, 3, 3), origins.reshape(-1, 3))
    return np.asarray((found.code == 0).reshape(len(drawn), len(R)).mean(axis=0))
