"""Which solid points become, and the bounds that a search for the nearest one relies on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.planning.collision.convex_solids import Ball, Box, Drum, Polytope, bounding_box, solid_of
from twin_diagram.signals.arrays import Array

R = Rotation.random(random_state=3).as_matrix()
P = np.array([0.3, -0.2, 0.5])


def prism(sides: int, radius: float = 0.1, height: float = 0.3) -> Array:
    angle = 2 * np.pi * (np.arange(sides) + 0.3) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    points = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-height / 2, height / 2)])
    return np.asarray(points @ R.T + P)


def test_prisms_of_twelve_sides_or_more_are_drums() -> None:
    for sides, kind in ((11, Polytope), (12, Drum), (40, Drum)):
        assert isinstance(solid_of(prism(sides)), kind)
    drum = solid_of(prism(16))
    assert isinstance(drum, Drum)
    np.testing.assert_allclose([drum.size, drum.half], [0.1, 0.15])
    np.testing.assert_allclose(drum.centre, P)
    assert abs(drum.axis @ R[:, 2]) == pytest.approx(1.0)


def test_what_is_no_prism_is_its_hull() -> None:
    points = prism(16)
    spoke = (points - P) @ R
    for changed in (
        spoke * [1.0001, 1.0, 1.0],  # an oval
        spoke + np.where(spoke[:, 2:] > 0, [0, 0, 1e-6], 0.0) * (np.arange(32) % 2)[:, None],  # an uneven top
        np.vstack([spoke[:15], spoke[16:31]]),  # a side is missing
        np.vstack([spoke, [[0, 0, 0.5], [0, 0, -0.5]]]),  # a double cone
    ):
        assert isinstance(solid_of(changed @ R.T + P), Polytope)
    turned = spoke.copy()
    turned[[3, 19]] = turned[[3, 19]] @ Rotation.from_rotvec([0, 0, 2e-3]).as_matrix().T
    assert isinstance(solid_of(turned), Polytope)


@pytest.mark.parametrize("half", [(0.1, 0.1, 0.1), (0.02, 0.03, 0.5), (0.3, 0.02, 0.02), (0.05, 0.06, 0.07)])
def test_eight_corners_of_a_box_are_a_box(half: tuple[float, float, float]) -> None:
    """The third edge may be longer than the diagonal of the other two."""
    box = Box(np.array(half), R, P)
    for seed in range(4):
        found = solid_of(np.random.default_rng(seed).permutation(box.vertices))
        assert isinstance(found, Box)
        np.testing.assert_allclose(np.sort(found.half), np.sort(half))
        np.testing.assert_allclose(found.p_GB, P)
        distance, _ = found.distance(box.vertices)
        np.testing.assert_allclose(distance, 0.0, atol=1e-9)
    sheared = (box.vertices - P) @ R + 0.1 * ((box.vertices - P) @ R)[:, [1, 2, 0]] * [1, 0, 0]
    assert isinstance(solid_of(sheared), Polytope)
    cut = box.vertices.copy()
    cut[5] += 0.2 * (P - cut[5])
    assert isinstance(solid_of(cut), Polytope)


def every() -> list[Array]:
    return [prism(5), prism(8, 0.2, 0.02), Box(np.array([0.1, 0.2, 0.05]), R, P).vertices,
            P + 0.1 * np.random.default_rng(0).standard_normal((15, 3))]  # fmt: skip


@pytest.mark.parametrize("number", range(4))
def test_a_polytopes_distance_is_that_of_its_triangles(number: int) -> None:
    from scipy.spatial import ConvexHull

    points = every()[number]
    solid, hull = Polytope(points), ConvexHull(points)
    p = P + 0.4 * np.random.default_rng(1).standard_normal((300, 3))
    p = np.vstack([p, points.mean(axis=0), points[:5], points[hull.simplices[:4]].mean(axis=1)])
    distance, normal = solid.distance(p)
    depth = (p @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    inside = depth <= 0.0
    np.testing.assert_allclose(distance[inside], depth[inside], atol=1e-12)
    nearest = np.full(len(p), np.inf)
    for a, b, c in points[hull.simplices]:
        # Nearest of a triangle: its plane where the foot lies within, else its edges.
        n = np.cross(b - a, c - a)
        n /= np.linalg.norm(n)
        foot = p - ((p - a) @ n)[:, None] * n
        within = np.all([np.cross(y - x, foot - x) @ n >= -1e-12 for x, y in ((a, b), (b, c), (c, a))], axis=0)
        nearest = np.where(within, np.minimum(nearest, np.abs((p - a) @ n)), nearest)
        for x, y in ((a, b), (b, c), (c, a)):
            share = np.clip((p - x) @ (y - x) / ((y - x) @ (y - x)), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(p - x - share[:, None] * (y - x), axis=1))
    np.testing.assert_allclose(distance[~inside], nearest[~inside], atol=1e-7)
    away = distance > 1e-6
    assert away.sum() > 100
    np.testing.assert_allclose(solid.distance(p[away] - distance[away, None] * normal[away])[0], 0.0, atol=1e-7)
    centre, radius = solid.ball
    assert radius == pytest.approx(np.linalg.norm(points - centre, axis=1).max())
    np.testing.assert_allclose(centre, (points.min(axis=0) + points.max(axis=0)) / 2)
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose([solid.box.p_GB - solid.box.half, solid.box.p_GB + solid.box.half], [low, high])


def test_bounds_are_as_close_as_their_shapes_are_cheap() -> None:
    p = P + 0.5 * np.random.default_rng(2).standard_normal((200, 3))
    box, drum, ball = Box(np.array([0.1, 0.2, 0.05]), R, P), Drum(P, R[:, 0], 0.1, 0.05), Ball(P, 0.2)
    assert box.box is box
    for solid, half in ((drum, [0.1, 0.1, 0.05]), (ball, [0.2, 0.2, 0.2])):
        np.testing.assert_allclose(solid.box.half, half)
        np.testing.assert_allclose(solid.box.R_GB @ solid.box.R_GB.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(solid.box.p_GB, P)
        # Nowhere is it nearer than its box, and from a way along the box's axes it is as near.
        assert (solid.distance(p)[0] >= solid.box.distance(p)[0] - 1e-12).all()
        ahead = P + solid.box.R_GB.T * 0.5
        np.testing.assert_allclose(solid.distance(ahead)[0], 0.5 - np.array(half), atol=1e-12)
    np.testing.assert_allclose([box.ball[1], drum.ball[1], ball.ball[1]], [np.sqrt(0.0525), np.hypot(0.1, 0.05), 0.2])
    found = bounding_box(np.array([[0.0, 1, 2], [1, 3, 2.5], [0.5, -1, 0]]))
    np.testing.assert_allclose([found.half, found.p_GB], [[0.5, 2, 1.25], [0.5, 1, 1.25]])
    assert len(np.unique(np.round(box.vertices, 9), axis=0)) == 8


def test_inside_a_box_or_drum_the_nearest_side_is_the_way_out() -> None:
    box = Box(np.array([0.1, 0.2, 0.05]), R, P)
    for axis, sign, depth in ((0, 1, 0.01), (1, -1, 0.02), (2, -1, 0.005), (2, 1, 0.01)):
        local = np.zeros(3)
        local[axis] = sign * (box.half[axis] - depth)
        distance, normal = box.distance((P + R @ local)[None])
        assert distance[0] == pytest.approx(-depth)
        np.testing.assert_allclose(normal[0], sign * R[:, axis], atol=1e-9)
    drum = Drum(P, R[:, 2], 0.1, 0.05)
    for local, depth, out in (([0.09, 0, 0.01], 0.01, [1, 0, 0]), ([0, 0.02, -0.045], 0.005, [0, 0, -1])):
        distance, normal = drum.distance((P + R @ local)[None])
        assert distance[0] == pytest.approx(-depth)
        np.testing.assert_allclose(normal[0], R @ out, atol=1e-9)
    distance, normal = drum.distance((P + R @ [0.1 + 0.03, 0, 0.05 + 0.04])[None])
    assert distance[0] == pytest.approx(0.05)
    np.testing.assert_allclose(normal[0], R @ [0.6, 0, 0.8], atol=1e-9)
    distance, normal = Ball(P, 0.2).distance(P[None])
    assert distance[0] == pytest.approx(-0.2)
    np.testing.assert_allclose(normal, [[0, 0, 1.0]])


def test_where_side_and_end_are_equally_near_there_is_one_way_out() -> None:
    drum = Drum(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.25, 0.25)
    distance, normal = drum.distance(np.array([[0.125, 0.0, 0.125]]))
    assert distance[0] == -0.125 and np.linalg.norm(normal[0]) == 1.0
