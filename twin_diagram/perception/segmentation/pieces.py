"""Convex pieces of an unknown thing, seen from one side: what is hidden is taken for solid.

The policy: whatever is seen of a thing reaches straight down to what it stands on. Where its surface bends down before
it goes out of sight, as a ball's does and a lid's does not, it goes on away from the camera three times as far as it
has come down, and a thing is no less deep than half its width. Things are taken for their own mirror images, as boxes,
cans and bottles are: a profile along the sight goes on behind as its front would if it were as deep as can be without
being seen (a roof's ridge hides as much as it shows, a lid that is seen whole hides nothing), and so does the outline
from above (a bottle's neck hides the far side of its shoulder). But nothing goes on beyond its shadow, for there the
camera sees that nothing is. A wrong guess costs the arm room, not a collision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the guess, set by `sims/benchmarks/unknown_pieces.py`: volume inside, volume of the pieces."""

    slabs: tuple[int, ...] = (1, 2, 4, 8)
    """Into how many slabs, side by side, a thing is cut: as many as a slot of the collision checker holds at most."""

    worth: float = 0.8
    """More slabs are worth it where they leave less than this share of the volume."""

    bend: float = 3.0
    """How far a surface that bends down goes on behind, over how far it has come down."""

    depth_share: float = 0.5
    """A thing is at least this share of its width deep."""

    strips: int = 16
    """Into how many strips a thing is cut side by side, each of which goes on behind on its own."""

    least_slope: float = 0.3
    """Sight lines less steep than this are taken to be this steep: 2 mm of height would be more than 1 cm of depth."""

    shown: float = 1.0
    """Share of a strip that a mirror may show outside of the shadow, which noise does [%]."""

    edge: float = 96.0
    """Points over which the sight lines pass that are higher than this share of all make the far edge [%]."""

    least_depth: float = 0.02
    """And this deep [m]."""

    padding: float = 0.002
    """Pieces reach beyond the points by this [m]: half of what lies between two pixels."""

    clipped: float = 0.4
    """Points beyond this share of each coordinate, on either side, are noise and flying pixels [%]."""

    foot: float = 0.015
    """A thing stands on a lid if its lowest points are no higher above it [m]."""

    fewest: int = 8
    """Points of a slab that make a piece."""


TUNING = Tuning()


def floor_below(points_W: Array, planes: Sequence[Plane]) -> Plane:
    """Return which of the planes (the table first) a thing stands on: the highest that its lowest points are near.

    Args:
        points_W: (N, 3) of the thing.
        planes: the table, and lids; see `Segments.planes`.
    """
    lowest = [float(np.percentile(plane.height(points_W), 1.0)) for plane in planes]
    beneath = [k for k in range(1, len(planes)) if abs(lowest[k]) < TUNING.foot]
    return planes[min(beneath, key=lambda k: lowest[k], default=0)]


def convex_pieces(points_W: Array, p_WC: Array, floor: Plane) -> list[Array]:
    """Return convex pieces of the thing that points show from one side; see the module for what is assumed.

    Args:
        points_W: (N, 3) of its visible surface.
        p_WC: (3,) the camera's place.
        floor: what it stands on.

    Returns:
        Vertices (V, 3) in W of at most eight pieces, which overlap a little; none where there are hardly any points.
    """
    if len(points_W) < TUNING.fewest:
        return []
    frame, seen, slope = _away_from_camera(points_W, p_WC, floor)
    low, high = np.percentile(seen, [TUNING.clipped, 100.0 - TUNING.clipped], axis=0)
    seen = np.clip(seen, low, high)
    solid = _grown(seen, slope)
    best: list[Array] = []
    volume = np.inf
    for count in TUNING.slabs:
        hulls = [hull for hull in (_hull(part) for part in _slabs(solid, count)) if hull is not None]
        total = sum(hull.volume for hull in hulls)
        if hulls and total < TUNING.worth * volume:
            best, volume = [_padded(hull) for hull in hulls], total
    foot = points_W.mean(axis=0)
    foot = foot - floor.height(foot) * floor.normal
    return [piece @ frame + foot for piece in best]


def _away_from_camera(points_W: Array, p_WC: Array, floor: Plane) -> tuple[Array, Array, float]:
    """Axes (3, 3) in W: level away from the camera, level to the side, up; points along them; the sight's slope."""
    middle = points_W.mean(axis=0)
    sight = middle - p_WC
    level = sight - (sight @ floor.normal) * floor.normal
    if np.linalg.norm(level) < 1e-3 * np.linalg.norm(sight):
        level = np.linalg.svd(floor.normal[None])[2][1]
    slope = max(0.0, -float(sight @ floor.normal)) / max(float(np.linalg.norm(level)), 1e-9)
    away = level / np.linalg.norm(level)
    frame = np.stack([away, np.cross(floor.normal, away), floor.normal])
    foot = middle - floor.height(middle) * floor.normal
    return frame, (points_W - foot) @ frame.T, slope


def _grown(seen: Array, slope: float) -> Array:
    """Add to points (along sight, to the side, up) what is hidden behind and below them."""
    width = float(np.ptp(seen[:, 1]))
    count = TUNING.strips
    strip = np.minimum(((seen[:, 1] - seen[:, 1].min()) / max(width, 1e-6) * count).astype(np.int64), count - 1)
    # Sight lines that pass over all else: what is beyond them is hidden.
    over = seen[:, 2] + slope * seen[:, 0]
    taken = [int(k) for k in np.unique(strip)]
    strips = {k: seen[strip == k] for k in taken}
    rims = {}
    for k in taken:
        mine = over[strip == k]
        rims[k] = strips[k][mine >= _at_share(mine, TUNING.edge)]
    middles = {k: np.median(rim, axis=0) for k, rim in rims.items()}
    end = _mirrored(strips, middles, slope)
    parts = [seen]
    for k in taken:
        own, far, middle = strips[k], rims[k], middles[k]
        reach = TUNING.bend * max(0.0, float(own[:, 2].max() - middle[2]))
        reach = max(reach, max(TUNING.depth_share * width, TUNING.least_depth) - float(np.ptp(own[:, 0])))
        reach = max(reach, end[k] - float(middle[0]))
        # Behind a sight line is the shadow: a point may be no higher than the line that passes over the far edge.
        reach = min(reach, float(middle[2]) / max(slope, 1e-3))
        if reach > 0.0:
            behind = far + [reach, 0.0, 0.0]
            behind[:, 2] -= slope * reach
            parts.append(behind)
    solid = np.concatenate(parts)
    solid[:, 2] = np.maximum(solid[:, 2], 0.0)
    return np.concatenate([solid, solid * [1.0, 1.0, 0.0]])


def _at_share(values: Array, share: float) -> float:
    """Return what a share of values (N,) is below [%], between two of them: `np.percentile` of few takes its time."""
    place = 0.01 * share * (len(values) - 1)
    k = int(place)
    after = min(k + 1, len(values) - 1)
    part = np.partition(values, (k, after))
    return float(part[k] + (place - k) * (part[after] - part[k]))


def _mirrored(strips: dict[int, Array], middles: dict[int, Array], slope: float) -> dict[int, float]:
    """Return how far away each strip ends if profiles and outline are their own mirror images [m].

    Args:
        strips: points (along sight, to the side, up) by number, side by side.
        middles: (3,) of those of these over which the sight lines pass.
        slope: of the sight lines.
    """
    near, end = {}, {}
    for k, own in strips.items():
        near[k] = float(own[:, 0].min())
        rim = middles[k]
        # As far off as a mirror may stand so that what it shows of the strip lies in the shadow.
        mirror = (rim[2] - own[:, 2]) / (2.0 * max(slope, TUNING.least_slope)) + (rim[0] + own[:, 0]) / 2.0
        end[k] = 2.0 * _at_share(mirror, TUNING.shown) - near[k]
    across = {k: TUNING.strips - 1 - k for k in strips if TUNING.strips - 1 - k in strips}
    if not across:
        return end
    middle = float(np.median([(near[k] + end[other]) / 2.0 for k, other in across.items()]))
    return {k: max(far, 2.0 * middle - near[across[k]]) if k in across else far for k, far in end.items()}


def _slabs(solid: Array, count: int) -> list[Array]:
    """Cut points into slabs side by side that overlap by twice the padding."""
    edges = np.linspace(solid[:, 1].min(), solid[:, 1].max(), count + 1)
    reach = 2.0 * TUNING.padding if count > 1 else 0.0
    inside = [(solid[:, 1] >= a - reach) & (solid[:, 1] <= b + reach) for a, b in pairwise(edges)]
    return [solid[mask] for mask in inside if np.count_nonzero(mask) >= TUNING.fewest]


def _hull(points: Array) -> ConvexHull | None:
    try:
        return ConvexHull(points)
    except QhullError:  # flat: no volume, no obstacle that padding would not cover
        return None


def _padded(hull: ConvexHull) -> npt.NDArray[np.float64]:
    """Corners of a hull, each moved outwards."""
    corners = hull.points[hull.vertices]
    out = corners - corners.mean(axis=0)
    corners = corners + TUNING.padding * out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    corners[:, 2] = np.maximum(corners[:, 2], 0.0)
    return np.asarray(corners)
