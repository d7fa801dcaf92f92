"""Compiled loops: which parts of an arm are near what.

NumPy would build tables of all pairs; a loop looks at a pair only as far as it may still be the nearest. Numba compiles
at the first call and keeps the result on disk. Nothing here is summed in another order from run to run.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled, compiled_in_place


class Solids(NamedTuple):
    """Tables of B bodies' convex solids, S in all, P of them polytopes with F faces and E edges in all.

    Attributes:
        centre, radius: (B, 3), (B,) of a ball about each body.
        body_middle, body_half: (B, 3) of a box about each body, along its axes.
        first: (B + 1,) the number of each body's first solid.
        kind: (S,) 0: box, 1: ball, 2: drum, 3: polytope.
        middle, half: (S, 3) of a box about each solid.
        R: (S, 3, 3) that box's axes.
        axis: (S, 3) of drums.
        polytope: (S,) which polytope each is.
        first_face, first_edge: (P + 1,)
        planes: (F, 4) outward normals and offsets.
        first_side: (F + 1,)
        sides: (·, 4) of the planes through a face's edges, outward normals and offsets.
        edges: (E, 7) start, span and one over the square of its length.
    """

    centre: Array
    radius: Array
    body_middle: Array
    body_half: Array
    first: Ints
    kind: Ints
    middle: Array
    half: Array
    R: Array
    axis: Array
    polytope: Ints
    first_face: Ints
    first_edge: Ints
    planes: Array
    first_side: Ints
    sides: Array
    edges: Array


class PlacedBalls(NamedTuple):
    """An arm as S balls in G parts.

    Attributes:
        centres: (N, S, 3) in W [m].
        radii: (S,)
        members: (S,) the balls part by part.
        first: (G + 1,) where in `members` each part begins.
        middles: (N, G, 3) of balls about each part [m].
        reaches: (G,) the radii of these.
        key: (G,) which of K kinds of nearest pairs each part is for.
        kinds: K.
        counted: (S, B') bool: whether a ball counts against a body; against those beyond B' each does.
    """

    centres: Array
    radii: Array
    members: Ints
    first: Ints
    middles: Array
    reaches: Array
    key: Ints
    kinds: int
    counted: Array


@compiled
def near_itself(balls: PlacedBalls, parts: Ints, first: Ints, pairs: Ints, reach: float) -> tuple[Array, Ints]:
    """Return, for each pair of parts, the distance of its nearest pair of balls within reach, and which that is.

    Args:
        balls: the arm.
        parts: (Q, 2) pairs of its parts.
        first: (Q + 1,) the number of each one's first pair of balls.
        pairs: (·, 2) pairs of balls.
        reach: [m]

    Returns:
        (N, Q) distances, infinite beyond reach, and (N, Q) indices into `pairs`.
    """
    centres, middles, radii, reaches = balls.centres, balls.middles, balls.radii, balls.reaches
    count = len(centres)
    best, which = np.full((count, len(parts)), np.inf), np.zeros((count, len(parts)), np.int64)
    for row in range(count):
        for k in range(len(parts)):
            a, b = parts[k, 0], parts[k, 1]
            x = middles[row, a, 0] - middles[row, b, 0]
            y = middles[row, a, 1] - middles[row, b, 1]
            z = middles[row, a, 2] - middles[row, b, 2]
            far = reach + reaches[a] + reaches[b]
            if far < 0.0 or x * x + y * y + z * z >= far * far:
                continue
            near = reach
            for at in range(first[k], first[k + 1]):
                i, j = pairs[at, 0], pairs[at, 1]
                x = centres[row, i, 0] - centres[row, j, 0]
                y = centres[row, i, 1] - centres[row, j, 1]
                z = centres[row, i, 2] - centres[row, j, 2]
                d = np.sqrt(x * x + y * y + z * z) - radii[i] - radii[j]
                if d < near:
                    near = best[row, k] = d
                    which[row, k] = at
    return best, which


@compiled
def never_below(balls: PlacedBalls, solids: Solids, X_WO: Array, grown: Array, present: Array, reach: float) -> Array:
    """Return (N, B, G) what the distances of parts to bodies are never below, infinite beyond reach [m].

    Arguments are those of `near_bodies`.
    """
    count, bodies, parts = len(balls.centres), len(present), len(balls.reaches)
    result = np.full((count, bodies, parts), np.inf)
    for row in range(count):
        for b in range(bodies):
            if not present[b]:
                continue
            for g in range(parts):
                size = balls.reaches[g] + grown[b, row]
                bound = _to_body(solids, b, X_WO[b, row], balls.middles[row, g]) - size
                if bound < reach:
                    result[row, b, g] = bound
    return result


@compiled
def near_bodies(
    balls: PlacedBalls, solids: Solids, X_WO: Array, grown: Array, present: Array, reach: Array
) -> tuple[Array, Ints, Array]:
    """Return the nearest pair of a ball and a solid within reach, for each kind of parts and each body.

    Args:
        balls: the arm, in N configurations.
        solids: of B bodies.
        X_WO: (B, N, 4, 4) where they are.
        grown: (B, N) by how much they are taken to be larger [m].
        present: (B,) bool.
        reach: (N, B) [m]

    Returns:
        (N, B, K) distances [m], infinite beyond reach; (N, B, K) the balls; (N, B, K, 3) unit normals, away from the
        body, in its frame.
    """
    count, bodies = len(balls.centres), len(present)
    best = np.full((count, bodies, balls.kinds), np.inf)
    which = np.zeros((count, bodies, balls.kinds), np.int64)
    normals = np.zeros((count, bodies, balls.kinds, 3))
    room = (np.empty(4), np.empty(4))
    _find_near(balls, solids, X_WO, grown, present, reach, room, (best, which, normals))
    return best, which, normals


@compiled_in_place
def _find_near(
    balls: PlacedBalls,
    solids: Solids,
    X_WO: Array,
    grown: Array,
    present: Array,
    reach: Array,
    room: tuple[Array, Array],
    result: tuple[Array, Ints, Array],
) -> None:
    """Write what `near_bodies` returns where something is within reach; `room`, twice (4,), is written over."""
    best, which, normals = result
    bodies, parts = len(present), len(balls.reaches)
    slack, found = 1e-9, room[0]
    for row in range(len(balls.centres)):
        for b in range(bodies):
            if not present[b]:
                continue
            X, more = X_WO[b, row], grown[b, row]
            m = solids.centre[b]
            mx = X[0, 0] * m[0] + X[0, 1] * m[1] + X[0, 2] * m[2] + X[0, 3]
            my = X[1, 0] * m[0] + X[1, 1] * m[1] + X[1, 2] * m[2] + X[1, 3]
            mz = X[2, 0] * m[0] + X[2, 1] * m[1] + X[2, 2] * m[2] + X[2, 3]
            for g in range(parts):
                k = balls.key[g]
                near = min(reach[row, b], best[row, b, k])
                p = balls.middles[row, g]
                x, y, z = p[0] - mx, p[1] - my, p[2] - mz
                size = balls.reaches[g] + more
                wide = solids.radius[b] + size + near + slack
                if wide <= 0.0 or x * x + y * y + z * z >= wide * wide:
                    continue
                if _to_body(solids, b, X, p) - size > near + slack:
                    continue
                for at in range(balls.first[g], balls.first[g + 1]):
                    s = balls.members[at]
                    if b < balls.counted.shape[1] and not balls.counted[s, b]:
                        continue
                    size = balls.radii[s] + more
                    before = near
                    near = _look(solids, b, X, balls.centres[row, s], size, near, room)
                    if near < before:
                        best[row, b, k], which[row, b, k] = near, s
                        for i in range(3):
                            normals[row, b, k, i] = found[1 + i]


@compiled_in_place
def _to_body(solids: Solids, b: int, X: Array, p: Array) -> float:
    """Return what the distance of a point of W to a body is never below: that to a box about it."""
    x, y, z = p[0] - X[0, 3], p[1] - X[1, 3], p[2] - X[2, 3]
    m, h = solids.body_middle[b], solids.body_half[b]
    return _to_box(
        X[0, 0] * x + X[1, 0] * y + X[2, 0] * z - m[0],
        X[0, 1] * x + X[1, 1] * y + X[2, 1] * z - m[1],
        X[0, 2] * x + X[1, 2] * y + X[2, 2] * z - m[2],
        h,
    )


@compiled_in_place
def _look(solids: Solids, b: int, X: Array, p: Array, size: float, near: float, room: tuple[Array, Array]) -> float:
    """Return the distance of a ball from a body where it is below `near`, else that; fills in `room[0][1:]`."""
    slack, found, trial = 1e-9, room[0], room[1]
    if _to_body(solids, b, X, p) - size > near + slack:
        return near
    x, y, z = p[0] - X[0, 3], p[1] - X[1, 3], p[2] - X[2, 3]
    px = X[0, 0] * x + X[1, 0] * y + X[2, 0] * z
    py = X[0, 1] * x + X[1, 1] * y + X[2, 1] * z
    pz = X[0, 2] * x + X[1, 2] * y + X[2, 2] * z
    for solid in range(solids.first[b], solids.first[b + 1]):
        m, h, R = solids.middle[solid], solids.half[solid], solids.R[solid]
        x, y, z = px - m[0], py - m[1], pz - m[2]
        bx = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
        by = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
        bz = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        if _to_box(bx, by, bz, h) - size > near + slack:
            continue
        kind = solids.kind[solid]
        if kind == 0:
            _box(bx, by, bz, h, R, trial)
        elif kind == 1:
            _ball(x, y, z, h[0], trial)
        elif kind == 2:
            _drum(x, y, z, solids.axis[solid], h[0], h[2], trial)
        elif not _polytope(px, py, pz, solids, solids.polytope[solid], near + size, trial):
            continue
        if trial[0] - size < near:
            near = trial[0] - size
            for i in range(4):
                found[i] = trial[i]
    return near


@compiled_in_place
def _to_box(x: float, y: float, z: float, half: Array) -> float:
    """Return the signed distance of a point in a box's axes, from its middle."""
    x, y, z = abs(x) - half[0], abs(y) - half[1], abs(z) - half[2]
    deepest = max(x, max(y, z))
    if deepest <= 0.0:
        return deepest
    x, y, z = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    return np.sqrt(x * x + y * y + z * z)


@compiled_in_place
def _box(x: float, y: float, z: float, half: Array, R: Array, found: Array) -> None:
    """Fill in distance and outward normal of a point in a box's axes."""
    ex, ey, ez = abs(x) - half[0], abs(y) - half[1], abs(z) - half[2]
    sx, sy, sz = max(ex, 0.0), max(ey, 0.0), max(ez, 0.0)
    d = np.sqrt(sx * sx + sy * sy + sz * sz)
    if d > 1e-12:
        sx, sy, sz = sx / d, sy / d, sz / d
    else:
        sx, sy, sz = 0.0, 0.0, 0.0
        if ex >= ey and ex >= ez:
            d, sx = ex, 1.0
        elif ey >= ez:
            d, sy = ey, 1.0
        else:
            d, sz = ez, 1.0
    if x < 0.0:
        sx = -sx
    if y < 0.0:
        sy = -sy
    if z < 0.0:
        sz = -sz
    found[0] = d
    for i in range(3):
        found[1 + i] = R[i, 0] * sx + R[i, 1] * sy + R[i, 2] * sz


@compiled_in_place
def _ball(x: float, y: float, z: float, size: float, found: Array) -> None:
    d = np.sqrt(x * x + y * y + z * z)
    found[0] = d - size
    if d > 1e-12:
        found[1], found[2], found[3] = x / d, y / d, z / d
    else:
        found[1], found[2], found[3] = 0.0, 0.0, 1.0


@compiled_in_place
def _drum(x: float, y: float, z: float, axis: Array, size: float, half: float, found: Array) -> None:
    height = x * axis[0] + y * axis[1] + z * axis[2]
    x, y, z = x - height * axis[0], y - height * axis[1], z - height * axis[2]
    radius = np.sqrt(x * x + y * y + z * z)
    beside, beyond = radius - size, abs(height) - half
    out, up = max(beside, 0.0), max(beyond, 0.0)
    d = np.sqrt(out * out + up * up)
    if d > 1e-12:
        out, up = out / d, up / d
    elif beside >= beyond:
        d, out, up = beside, 1.0, 0.0
    else:
        d, out, up = beyond, 0.0, 1.0
    if height < 0.0:
        up = -up
    out = out / max(radius, 1e-12)
    found[0] = d
    found[1], found[2], found[3] = out * x + up * axis[0], out * y + up * axis[1], out * z + up * axis[2]


@compiled_in_place
def _polytope(x: float, y: float, z: float, solids: Solids, which: int, below: float, found: Array) -> bool:
    """Fill in distance and outward normal of a point; False where the distance is `below` or more.

    Outside, the nearest point lies inside a face, or else on an edge; inside, the nearest face is that whose plane is.
    """
    first, last, planes = solids.first_face[which], solids.first_face[which + 1], solids.planes
    top, d = first, -np.inf
    for f in range(first, last):
        h = planes[f, 0] * x + planes[f, 1] * y + planes[f, 2] * z + planes[f, 3]
        if h > d:
            top, d = f, h
            if d >= below:
                return False
    if d <= 0.0 or _above(x, y, z, solids, top):
        found[0], found[1], found[2], found[3] = d, planes[top, 0], planes[top, 1], planes[top, 2]
        return True
    square = np.inf
    edges = solids.edges
    for e in range(solids.first_edge[which], solids.first_edge[which + 1]):
        u, v, w = x - edges[e, 0], y - edges[e, 1], z - edges[e, 2]
        share = (u * edges[e, 3] + v * edges[e, 4] + w * edges[e, 5]) * edges[e, 6]
        share = min(max(share, 0.0), 1.0)
        u, v, w = u - share * edges[e, 3], v - share * edges[e, 4], w - share * edges[e, 5]
        s = u * u + v * v + w * w
        if s < square:
            square = s
            found[1], found[2], found[3] = u, v, w
    d = np.sqrt(square)
    long = max(d, 1e-12)
    found[0], found[1], found[2], found[3] = d, found[1] / long, found[2] / long, found[3] / long
    # A face counts where the point is above it, within its sides and nearer to its plane than to any edge.
    for f in range(first, last):
        h = planes[f, 0] * x + planes[f, 1] * y + planes[f, 2] * z + planes[f, 3]
        if 0.0 < h < found[0] and _above(x, y, z, solids, f):
            found[0], found[1], found[2], found[3] = h, planes[f, 0], planes[f, 1], planes[f, 2]
    return True


@compiled_in_place
def _above(x: float, y: float, z: float, solids: Solids, face: int) -> bool:
    """Return whether a point lies within the sides of a face."""
    sides = solids.sides
    for k in range(solids.first_side[face], solids.first_side[face + 1]):
        if sides[k, 0] * x + sides[k, 1] * y + sides[k, 2] * z > sides[k, 3]:
            return False
    return True


def starts(counts: Any) -> Ints:
    """Return (C + 1,) where each of C groups of so many begins, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(np.asarray(counts, dtype=np.int64))]).astype(np.int64)
