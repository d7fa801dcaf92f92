"""In which further grasp an object is shown: by its principal axes, one after the other, or by what a pair shows.

The two methods of the thesis behind *Scalable Real2Sim* (its 4.3). `pca`: grasps whose axis, about which the last joint
turns, lies along a principal axis of the object that no earlier one lay along. `pair`: what the fingers and the palm of
the earlier grasps hid is to be shown by the further one; what that would show is told by lines of sight from each
patch to where the camera will be about the hand, in the two of several tilts of the hand that show most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.planning.grasps import Grasps, Gripper
from twin_diagram.runs.learning.motion import pose
from twin_diagram.runs.learning.seen_map import TUNING as SEEN
from twin_diagram.runs.learning.seen_map import Flags, SeenMap, all_about, sights
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    alike: float = 0.01
    """Shares of the surface that differ by less are alike [1]: then the firmer grasp goes first."""

    aligned: float = 15.0
    """Angles between a grasp's and a principal axis that differ by less are alike [deg]."""

    turns: int = 2
    """Full turns in a further grasp."""

    apart: float = 10.0
    """Of the directions in which lines of sight are followed [deg]: the nearest one stands for a camera's."""

    steepest: float = 0.5
    """Least share of a further grasp's approach that goes downwards."""


TUNING = Tuning()


def cameras_about(p_WC: Array, tools: Sequence[Array], turn: float, count: int) -> Array:
    """Return where a camera will be (K, 3) in the tool's frame while the tool is turned before it [m].

    Args:
        p_WC: (3,) of the camera [m].
        tools: (4, 4) X_WT in the middle of each turn.
        turn: of the last joint to both sides [rad].
        count: pictures of a turn.
    """
    found = []
    for X_WT in tools:
        p = (p_WC - X_WT[:3, 3]) @ X_WT[:3, :3]
        angle = np.linspace(-turn, turn, count)
        c, s = np.cos(angle), np.sin(angle)
        found.append(np.stack([c * p[0] + s * p[1], c * p[1] - s * p[0], np.full(count, p[2])], axis=1))
    return np.concatenate(found)


def pictures_of(points: Array, normals: Array, open_: Flags, hand: Boxes, cameras_T: Array) -> Array:
    """Return in how many pictures of a display each patch would be seen (N,).

    Args:
        points: (N, 3) of patches in S [m].
        normals: (N, 3) outward.
        open_: (N, D) of `sights`: where the object itself hides nothing.
        hand: that holds it.
        cameras_T: (K, 3) where the camera will be in the hand's frame [m].
    """
    R, p = hand.X_ST[:3, :3], hand.X_ST[:3, 3]
    lines = (cameras_T @ R.T + p)[None] - points[:, None]
    distance = np.linalg.norm(lines, axis=2)
    lines /= distance[..., None]
    seen = np.einsum("nki,ni->nk", lines, normals) > np.cos(np.deg2rad(SEEN.slant))
    seen &= distance < SEEN.farthest
    nearest = (lines @ all_about(open_.shape[1]).T).argmax(axis=2)
    seen &= np.take_along_axis(open_, nearest, axis=1)
    for low, high in zip(hand.low, hand.high, strict=True):
        seen &= ~_meets((points - p) @ R, lines @ R, low, high)
    return np.asarray(seen.sum(axis=1))


def _meets(begin: Array, lines: Array, low: Array, high: Array) -> Flags:
    """Return which lines (N, K, 3) from points (N, 3) go through a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - begin)[:, None] / lines, (high - begin)[:, None] / lines
    enter = np.nanmax(np.minimum(one, other), axis=2)
    leave = np.nanmin(np.maximum(one, other), axis=2)
    return np.asarray(leave > np.maximum(enter, 0.0))


@dataclass(frozen=True)
class Lacking:
    """Patches that some pose would show and none did.

    Attributes:
        points: (N, 3) in S [m], with outward normals (N, 3).
        normals: of them.
        share: (N,) of the whole surface.
        frames: (N,) pictures that show each so far.
        open_: (N, D) of `sights`.
    """

    points: Array
    normals: Array
    share: Array
    frames: npt.NDArray[np.int64]
    open_: Flags

    @staticmethod
    def of(seen: SeenMap) -> Lacking:
        """Return them of a map."""
        missing = seen.missing
        points, normals = seen.points[missing], seen.normals[missing]
        whole = max(float(seen.area[seen.reachable | seen.seen].sum()), 1e-12)
        open_ = sights(seen.voxels, points, normals, SEEN.slant + TUNING.apart)
        return Lacking(points, normals, seen.area[missing] / whole, seen.frames[missing], open_)


def best_turns(lacking: Lacking, hand: Boxes, turns: Sequence[Array]) -> tuple[tuple[int, ...], float]:
    """Return which full turns before the camera show most of what is missing, and the share of the surface that is.

    Args:
        lacking: what is missing.
        hand: that holds the object.
        turns: (K, 3) each, of `cameras_about`; those that are usual first.
    """
    each = [pictures_of(lacking.points, lacking.normals, lacking.open_, hand, cameras_T) for cameras_T in turns]
    chosen = list(combinations(range(len(turns)), min(TUNING.turns, len(turns))))
    shown = np.array([lacking.share[lacking.frames + sum(each[k] for k in few) >= SEEN.frames].sum() for few in chosen])
    best = int(np.flatnonzero(shown >= shown.max() - TUNING.alike)[0])
    return chosen[best], float(shown[best])


def by_pair(
    grasps: Grasps, X_WS: Array, seen: SeenMap, gripper: Gripper, turns: Sequence[Array]
) -> tuple[list[int], Array]:
    """Return the numbers of grasps from above, those first that show most of what is missing, and what each shows (m,).

    Args:
        grasps: in W.
        X_WS: (4, 4) where the object stands.
        seen: what was seen of it, in S.
        gripper: that takes it.
        turns: of `best_turns`, from which each grasp has its best.
    """
    lacking, above, shown = Lacking.of(seen), _from_above(grasps), np.zeros(len(grasps))
    for k in above:
        shown[k] = best_turns(lacking, hand_in(grasps, int(k), X_WS, gripper), turns)[1]
    lacks = np.floor((shown[above].max(initial=0.0) - shown[above]) / TUNING.alike)
    return above[np.lexsort((grasps.score[above], lacks))].tolist(), shown


def by_axes(grasps: Grasps, X_WS: Array, points: Array, held: Sequence[Array]) -> list[int]:
    """Return the numbers of grasps from above, those first that lie along a principal axis as no earlier one does.

    Args:
        grasps: in W.
        X_WS: (4, 4) where the object stands.
        points: (N, 3) of its cloud in S [m].
        held: (4, 4) tool poses X_ST of earlier grasps.
    """
    axes = np.linalg.eigh(np.cov(points.T))[1]
    used = {int(np.abs(X[:3, 2] @ axes).argmax()) for X in held}
    left = [k for k in range(3) if k not in used] or [0, 1, 2]
    above = _from_above(grasps)
    along = np.abs(grasps.approach[above] @ X_WS[:3, :3] @ axes[:, left]).max(axis=1, initial=0.0)
    off = np.floor(np.rad2deg(np.arccos(np.clip(along, 0.0, 1.0))) / TUNING.aligned)
    return [int(k) for k in above[np.lexsort((grasps.score[above], off))]]


def hand_in(grasps: Grasps, k: int, X_WS: Array, gripper: Gripper) -> Boxes:
    """Return the hand's boxes in a grasp, in the object's S."""
    X_WT = pose(grasps.R[k], grasps.poses[k, 4:])
    return Boxes(np.asarray(np.linalg.solve(X_WS, X_WT)), *gripper.boxes(float(grasps.width[k])))


def _from_above(grasps: Grasps) -> npt.NDArray[np.intp]:
    return np.flatnonzero(-grasps.approach[:, 2] >= TUNING.steepest)
