"""Parts what stands on a plane into things: cut where depth steps and where surfaces meet in a hollow edge.

Seen from outside, a convex thing has no hollow edges; where two things touch, there is one. So faces of one box stay
together, and a box on a box comes apart. Everything is done on the image's own grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS

Mask = npt.NDArray[np.bool_]
DepthImage = npt.NDArray[np.float32]
Labels = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Tuning:
    """Constants of the cuts, chosen by hand on ray-cast scenes and one real Kinect image (mOSD's `learn/learn5`).

    `sims/benchmarks/kinect_tabletop.py` shows them on more real images, `tests/perception/segmentation/test_parting.py`
    on ray-cast stacks.
    """

    hollow_angle: float = 0.45
    """An edge is hollow where the surface turns by more than this towards the camera [rad]."""

    hollow_sigmas: float = 6.0
    """The turn is looked at over so many standard deviations of depth, or `least_arm` if that is more."""

    least_arm: int = 3
    """How far to both sides of a pixel the turn is measured, at the least [pixel of the working grid]."""

    largest_arm: int = 8
    """And at the most [pixel]: things smaller than two of it are not parted."""

    steepest: float = 5.0
    """Where depth changes this many times faster than the image's plane goes, it is a step and no slope."""

    hollow_share: float = 0.5
    """Share of the border of two parts that must be hollow, so that they stay two."""

    slope_share: float = 0.4
    """Of a step, what the next one must be for the two to be a slope."""

    slope_gaps: float = 2.5
    """Times the gap: steeper ones are steps, whatever is beside them."""

    core: int = 3
    """Parts that hang together by less than this many pixels come apart."""

    speck: int = 16
    """What is so many times smaller than a thing, and has no core, is noise: a bottle's neck is a sixth of one."""

    speck_gaps: float = 2.5
    """Times the gap that a part too small for a thing is off what it belongs to: a neck stands 2 to 3 cm before the
    shoulders that are seen behind it."""


TUNING = Tuning()


def arm_length(sigma: float, pitch: float) -> int:
    """Return over how many pixels a surface's turn can be measured.

    Args:
        sigma: standard deviation of depth there [m].
        pitch: distance between neighbouring pixels' points, seen square on [m].
    """
    return int(np.clip(np.ceil(TUNING.hollow_sigmas * sigma / pitch), TUNING.least_arm, TUNING.largest_arm))


def _where(mask: Mask) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Rows and columns of a mask's pixels: several times faster than NumPy's own for two dimensions."""
    row, column = np.divmod(np.flatnonzero(mask), mask.shape[1])
    return row, column


def hollow(depth: DepthImage, pitch: float, arm: int, where: Mask | None = None) -> tuple[Mask, Mask]:
    """Find where the surface turns towards the camera: hollow edges, and the far side of small steps.

    For three pixels in a row, the turn of the line through their points is measured in four directions.

    Args:
        depth: (h, w) [m], 0 where there is none.
        pitch: distance between neighbouring rays at depth 1 m [m].
        arm: how far apart the three pixels are [pixel].
        where: (h, w), the pixels that are looked at; None: all.

    Returns:
        (h, w) each, a band about as wide as `arm` on both sides of an edge: turns along rows, turns along columns;
        slanting ones are in both.
    """
    along_rows, along_columns = np.zeros(depth.shape, dtype=bool), np.zeros(depth.shape, dtype=bool)
    count = cv2.blur((depth > 0).astype(np.float32), (3, 3), borderType=cv2.BORDER_CONSTANT)
    smooth = cv2.blur(depth, (3, 3), borderType=cv2.BORDER_CONSTANT) / np.maximum(count, np.float32(0.1))
    smooth[count < 0.5] = 0.0
    row, column = _where(depth > 0 if where is None else where)
    framed = cv2.copyMakeBorder(smooth, arm, arm, arm, arm, cv2.BORDER_CONSTANT, value=0.0)
    width = framed.shape[1]
    at, flat = (row + arm) * width + column + arm, framed.ravel()
    middle = flat[at]
    slant = max(1, round(arm * 0.7))
    rows, columns = np.zeros(len(at), dtype=bool), np.zeros(len(at), dtype=bool)
    limit = np.float32(TUNING.steepest**2)
    for down, right in ((0, arm), (arm, 0), (slant, slant), (slant, -slant)):
        span = np.float32(pitch * np.hypot(down, right))
        away = down * width + right
        before, after = flat[at - away], flat[at + away]
        # With the middle's ray as axis, points are (-span, 1) · before, (0, 1) · middle, (span, 1) · after.
        turn = middle * (before + after) - 2.0 * before * after
        across_before, across_after = (span * before) ** 2, (span * after) ** 2
        along_before, along_after = (middle - before) ** 2, (middle - after) ** 2
        sine = np.float32(np.sin(TUNING.hollow_angle) / span) ** 2
        turns = (
            (turn > 0)
            & (turn * turn > sine * (across_before + along_before) * (across_after + along_after))
            & (along_before < limit * across_before)
            & (along_after < limit * across_after)
            & (middle > 0)
        )
        if right:
            rows |= turns
        if down:
            columns |= turns
    along_rows[row, column], along_columns[row, column] = rows, columns
    return along_rows, along_columns


def far_sides(depth: DepthImage, gap: float) -> Mask:
    """Return the pixels behind a step in depth of more than `gap` [m] to one of their four neighbours.

    A step beside another of its kind is a slope, as of a face seen nearly edge on, unless it is far too steep.
    """
    result = np.zeros(depth.shape, dtype=bool)
    there = depth > 0
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        step = depth[second] - depth[first]
        both = there[first] & there[second]
        across = np.abs(step) > gap
        if not across.any():
            continue
        row, column = _where(across & both)
        here = step[row, column]
        alike = np.zeros(len(here), dtype=bool)
        for way in (-1, 1):
            r = row if step.shape[1] < depth.shape[1] else np.clip(row + way, 0, step.shape[0] - 1)
            c = column if step.shape[0] < depth.shape[0] else np.clip(column + way, 0, step.shape[1] - 1)
            other = np.where((r != row) | (c != column), step[r, c], np.float32(0.0))
            alike |= (other * here > TUNING.slope_share * here * here) & both[r, c]
        slope = alike & (np.abs(here) < TUNING.slope_gaps * gap)
        both[row[slope], column[slope]] = False
        result[second] |= both & (step > gap)
        result[first] |= both & (step < -gap)
    return result


def numbered(mask: Mask, smallest: int, connectivity: int = 4) -> tuple[Labels, int]:
    """Number the connected parts of a mask that have at least `smallest` pixels.

    Returns:
        (h, w) numbers from 0, -1 elsewhere; how many parts there are.
    """
    if not mask.any():
        return np.full(mask.shape, -1, dtype=np.int32), 0
    count, part = cv2.connectedComponents(np.ascontiguousarray(mask).view(np.uint8), connectivity=connectivity)
    # Counted among the mask's pixels alone: most of an image is empty.
    large = np.bincount(part[mask], minlength=count) >= smallest
    number = np.full(count, -1, dtype=np.int32)
    number[large] = np.arange(int(large.sum()), dtype=np.int32)
    return np.asarray(number[part], dtype=np.int32), int(large.sum())


def grown(label: Labels, into: Mask, rounds: int) -> Labels:
    """Let parts grow by a pixel a round, over edges of pixels only, into what is free."""
    # OpenCV's largest-of-neighbours; 0 is nobody's.
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.uint8)
    current = (label + 1).astype(np.uint8 if label.max(initial=-1) < 255 else np.uint16)
    free = into & (current == 0)
    for _ in range(rounds):
        np.copyto(current, cv2.dilate(current, cross), where=free)
        free &= current == 0
    return current.astype(np.int32) - 1


def joined(label: Labels, count: int, whole: Mask, hollow_edges: tuple[Mask, Mask]) -> Labels:
    """Join parts that meet where nothing is hollow: noise had cut them.

    Args:
        label: (h, w) numbers from 0, -1 elsewhere.
        count: how many parts there are.
        whole: (h, w), pixels over whose edges parts meet.
        hollow_edges: turns along rows and along columns, as of `hollow`.

    Returns:
        (h, w) numbers below `count`, not all of which occur.
    """
    first, second, turns = [], [], []
    before, after = slice(None, -1), slice(1, None)
    for turn, a, b in (
        (hollow_edges[0], (slice(None), before), (slice(None), after)),
        (hollow_edges[1], (before, slice(None)), (after, slice(None))),
    ):
        meet = _where((label[a] != label[b]) & (label[a] >= 0) & (label[b] >= 0) & whole[a] & whole[b])
        first.append(label[a][meet])
        second.append(label[b][meet])
        turns.append(turn[a][meet] | turn[b][meet])
    i, j, turn = np.concatenate(first), np.concatenate(second), np.concatenate(turns)
    if not len(i):
        return label
    key = np.minimum(i, j).astype(np.int64) * count + np.maximum(i, j)
    pairs, inverse = np.unique(key, return_inverse=True)
    share = np.bincount(inverse, weights=turn) / np.bincount(inverse)
    root = np.arange(count + 1, dtype=np.int32)
    root[count] = -1
    for pair in pairs[share < TUNING.hollow_share]:
        one, other = root[pair // count], root[pair % count]
        root[root == max(one, other)] = min(one, other)
    return np.asarray(root[label], dtype=np.int32)


def specks_joined(label: Labels, count: int, depth: DepthImage, gap: float, smallest: int) -> Labels:
    """Give parts that are too small for a thing to the thing that they border on most: bottles' necks, mugs' handles.

    Args:
        label: (h, w) numbers from 0, -1 elsewhere, also on the far sides of steps.
        count: how many parts there are.
        depth: (h, w) [m].
        gap: pixels that are farther apart in depth are no neighbours [m].
        smallest: pixels that make a thing.

    Returns:
        (h, w) numbers below `count`, not all of which occur.
    """
    small = np.bincount(label[label >= 0], minlength=count) < smallest
    if not small.any() or small.all():
        return label
    specks, things = [], []
    for away in (1, 2):  # the far side of a step lies between
        before, after = slice(None, -away), slice(away, None)
        for a, b in (((slice(None), before), (slice(None), after)), ((before, slice(None)), (after, slice(None)))):
            at = _where((label[a] >= 0) & (label[b] >= 0) & (label[a] != label[b]))
            near = np.abs(depth[b][at] - depth[a][at]) <= gap
            i, j = label[a][at][near], label[b][at][near]
            specks += [i, j]
            things += [j, i]
    speck, thing = np.concatenate(specks), np.concatenate(things)
    kept = small[speck] & ~small[thing]
    pairs, shared = np.unique(speck[kept].astype(np.int64) * count + thing[kept], return_counts=True)
    pairs = pairs[np.argsort(shared, kind="stable")]
    root = np.arange(count + 1, dtype=np.int32)
    root[count] = -1
    root[pairs // count] = pairs % count  # of a speck's, the last stays: the longest border
    return np.asarray(root[label], dtype=np.int32)


def part(
    depth: DepthImage, standing: Mask, pitch: float, sigma: float, gap: float, smallest: int
) -> tuple[Labels, int]:
    """Part what stands into things.

    Args:
        depth: (h, w) [m], 0 where there is none.
        standing: (h, w), the pixels that take part.
        pitch: distance between neighbouring rays at depth 1 m [m].
        sigma: standard deviation of depth about what stands [m].
        gap: points of neighbours farther apart in depth than this are two things' [m].
        smallest: pixels that make a thing.

    Returns:
        (h, w) numbers from 0, -1 where nothing stands (or a speck); how many things there are.
    """
    label = np.full(depth.shape, -1, dtype=np.int32)
    rows, columns = np.flatnonzero(standing.any(axis=1)), np.flatnonzero(standing.any(axis=0))
    if not len(rows):
        return label, 0
    typical = float(np.median(depth[standing]))
    arm = arm_length(sigma, pitch * typical)
    margin = 2 * arm
    window = (
        slice(max(0, int(rows[0]) - margin), int(rows[-1]) + margin + 1),
        slice(max(0, int(columns[0]) - margin), int(columns[-1]) + margin + 1),
    )
    z, there = depth[window], standing[window]
    behind = far_sides(z, gap) & there
    whole = there & ~behind
    along_rows, along_columns = hollow(z, pitch, arm, whole)
    core = whole & ~(along_rows | along_columns)
    core = cv2.erode(core.astype(np.uint8), np.ones((TUNING.core, TUNING.core), np.uint8)) > 0
    parts, count = numbered(core, max(1, smallest // 4))
    parts = grown(parts, whole, arm + TUNING.core)
    # What has no core at all is a thing of its own if it is large enough, or else part of what it touches.
    rest, more = numbered(whole & (parts < 0), max(1, smallest // TUNING.speck))
    if more:
        parts = np.where(rest >= 0, rest + count, parts)
    parts = joined(parts, count + more, whole, (along_rows, along_columns))
    parts = specks_joined(parts, count + more, z, TUNING.speck_gaps * gap, smallest)
    parts = grown(parts, there, 2)
    parts, count = _in_order(parts, count + more, smallest)
    label[window] = parts
    return label, count


def _in_order(label: Labels, count: int, smallest: int) -> tuple[Labels, int]:
    """Number parts of at least `smallest` pixels anew, by their first pixel; others become -1."""
    flat = label.ravel()
    taken = np.flatnonzero(flat >= 0)
    if not len(taken):
        return label, 0
    size = np.bincount(flat[taken], minlength=count)
    first = np.full(count, flat.size, dtype=np.int64)
    first[flat[taken][::-1]] = taken[::-1]
    order = [int(k) for k in np.argsort(first, kind="stable") if size[k] >= smallest]
    number = np.full(count + 1, -1, dtype=np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    return np.asarray(number[label], dtype=np.int32), len(order)


def follow_nearest(label: Labels, z: DepthImage, depth: DepthImage, standing: Mask, gap: float) -> Labels:
    """Label every pixel by the pixels of every second row and column about it.

    Args:
        label: (h, w) at every second pixel.
        z: (h, w) depth there [m].
        depth: (H, W) [m]
        standing: (H, W), pixels that may get a label at all.
        gap: a pixel is not labelled by one farther off in depth [m].

    Returns:
        (H, W)
    """
    result = np.full(depth.shape, SEGMENTS.background, dtype=np.int32)
    at = np.flatnonzero(standing)
    row, column = np.divmod(at, depth.shape[1])
    here = depth.ravel()[at]
    nearest = (row >> 1) * label.shape[1] + (column >> 1)
    found = label.ravel()[nearest]
    wrong = np.flatnonzero((found == SEGMENTS.background) | (np.abs(z.ravel()[nearest] - here) > gap))
    row, column, here = row[wrong], column[wrong], here[wrong]
    best = np.full(len(wrong), gap, dtype=np.float32)
    instead = np.full(len(wrong), SEGMENTS.background, dtype=np.int32)
    height, width = label.shape
    for down in (0, 1):
        for right in (0, 1):
            r, c = np.minimum((row >> 1) + down, height - 1), np.minimum((column >> 1) + right, width - 1)
            away = np.abs(z[r, c] - here)
            better = (away < best) & (label[r, c] != SEGMENTS.background)
            best = np.where(better, away, best)
            instead = np.where(better, label[r, c], instead)
    found[wrong] = instead
    result.ravel()[at] = found
    return result
