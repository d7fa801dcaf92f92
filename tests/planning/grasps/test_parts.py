"""The parts of the search, each against a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from tests.planning.grasps.brute_force import box_triangles, collides, cylinder_triangles, dense_points
from twin_diagram.planning.grasps import PANDA_HAND, WSG50, Gripper, estimated_normals, propose, target_of
from twin_diagram.planning.grasps.closing import TUNING as CLOSING
from twin_diagram.planning.grasps.closing import heights, slab_half, table_stop
from twin_diagram.planning.grasps.cost import antipodal_cost, weight_torque
from twin_diagram.planning.grasps.judging import REASONS, judge, settle, success_over_poses, view
from twin_diagram.planning.grasps.search import _neighbours
from twin_diagram.planning.grasps.slab import in_frames, slab_of
from twin_diagram.planning.grasps.surface_frames import darboux_frames, edge_frames
from twin_diagram.planning.grasps.target import GraspTarget
from twin_diagram.planning.grasps.triangles import laid_out, meets_triangles, surface_cloud
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])[None]
"""Axes of a gripper from above that closes along x."""


def box_target(x: float, y: float, z: float, count: int = 6000, **told: object) -> GraspTarget:
    return target_of(*surface_cloud(box_triangles(x, y, z), count, 0), **told)  # type: ignore[arg-type]


def pushed(target: GraspTarget, gripper: Gripper, R: Array, p: Array, offset: float = 0.0) -> tuple[str, Array]:
    found = settle(target, gripper, R, p, view(target, gripper, R, p, 0.0), np.array([offset]))
    return REASONS[found.code[0]], found.p[0]


# Frames.


def test_darboux_frames_of_a_cylinder_look_inwards_and_close_around_it() -> None:
    points, normals = surface_cloud(cylinder_triangles(0.03, 0.2, 256), 4000, 0)
    chosen = np.flatnonzero(np.abs(points[:, 2]) < 0.07)[:50]
    R = darboux_frames(points, normals, chosen)
    assert R.transpose(0, 2, 1) @ R == pytest.approx(np.tile(np.eye(3), (50, 1, 1)), abs=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[:, :, 2] == pytest.approx(-normals[chosen])
    assert (np.abs(R[:, 2, 0]) > np.cos(np.deg2rad(12.0))).all()  # x along the axis, where nothing curves
    assert (np.abs(R[:, 2, 1]) < np.sin(np.deg2rad(12.0))).all()


def test_estimated_normals_are_a_spheres_and_face_the_camera() -> None:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((3000, 3))
    points *= 0.05 / np.linalg.norm(points, axis=1, keepdims=True)
    viewpoint = np.array([0.0, 0.3, 0.4])
    normals = estimated_normals(points, viewpoint)
    outward = points / 0.05
    assert (np.abs(np.einsum("ni,ni->n", normals, outward)) > 0.98).all()
    assert (np.einsum("ni,ni->n", normals, viewpoint - points) >= 0).all()


# What lies before a gripper.


def test_points_in_frames_and_their_slab() -> None:
    rng = np.random.default_rng(1)
    points, p = rng.uniform(-0.1, 0.1, (200, 3)), rng.uniform(-0.1, 0.1, (4, 3))
    R = rotations.matrix(rotations.exp(rng.standard_normal((4, 3))))
    q = in_frames(points, R, p)
    exact = np.einsum("kni,kij->kjn", points[None] - p[:, None], R)
    assert q == pytest.approx(exact, abs=2e-7)
    kept = np.abs(q[:, 0]) < 0.02
    kept[2] = False
    slab = slab_of(q, kept)
    assert [(int(a), int(b)) for a, b in zip(slab.pose, slab.point, strict=True)] == [
        (int(a), int(b)) for a, b in np.argwhere(kept)
    ]
    assert slab.q == pytest.approx(exact.transpose(1, 0, 2)[:, kept], abs=2e-7)
    least = [exact[k, 2][kept[k]].min() if kept[k].any() else np.inf for k in range(4)]
    assert slab.least(slab.q[2]) == pytest.approx(np.array(least), abs=2e-7)
    assert slab.most(slab.q[2])[2] == -np.inf
    half = slab.where(slab.q[1] > 0)
    assert len(half.pose) == int((kept & (q[:, 1] > 0)).sum())
    assert (half.q[1] > 0).all()


def test_what_a_view_shows_is_what_a_table_of_all_points_in_all_frames_says() -> None:
    rng = np.random.default_rng(2)
    target = target_of(rng.uniform(-0.15, 0.15, (3000, 3)), rng.standard_normal((3000, 3)))
    R, p = rotations.matrix(rotations.exp(rng.standard_normal((40, 3)))), rng.uniform(-0.4, 0.4, (40, 3))
    ahead = view(target, WSG50, R, p, 0.001, 0.01)
    x, y, z = in_frames(target.points, R, p).transpose(1, 0, 2)
    below = (np.abs(x) <= WSG50.palm_size[0] / 2 + 0.001) & (np.abs(y) <= WSG50.palm_size[1] / 2 + 0.011)
    palm = np.where(below, z, np.inf).min(axis=1) - CLOSING.gap - WSG50.palm_front
    assert 0 < np.isinf(palm).sum() < 40
    assert ahead.palm == pytest.approx(palm, abs=1e-6)
    near = np.abs(x) <= slab_half(WSG50, 0.001)
    near &= z <= np.maximum(palm, 0.0)[:, None] + WSG50.finger_front + 2 * CLOSING.gap
    assert np.array_equal(np.stack([ahead.slab.pose, ahead.slab.point], axis=1), np.argwhere(near))
    assert ahead.slab.q == pytest.approx(np.stack([x[near], y[near], z[near]]), abs=1e-6)


def test_the_palm_stops_a_gap_before_a_box_between_the_fingers() -> None:
    reason, p = pushed(box_target(0.05, 0.08, 0.16), PANDA_HAND, DOWN, np.array([[0.0, 0, 0.1]]))
    assert reason == ""
    # z of G points down: the palm's face, behind G, is above it.
    assert p == pytest.approx([0, 0, 0.08 + CLOSING.gap + PANDA_HAND.palm_front], abs=1e-6)


@pytest.mark.parametrize("gripper", [PANDA_HAND, WSG50], ids=lambda one: one.name)
def test_fingers_stop_a_gap_before_a_box_that_is_too_wide(gripper: Gripper) -> None:
    width = gripper.opening_most + 0.01
    reason, p = pushed(box_target(width, 0.08, 0.16, 20000), gripper, DOWN, np.array([[0.0, 0, 0.2]]))
    assert reason == "too wide"
    assert p[2] - gripper.finger_front == pytest.approx(0.08 + CLOSING.gap, abs=1e-6)


def test_roots_of_fingers_stop_before_a_flange_that_the_tips_pass() -> None:
    # A slab between the fingers, and beside it a rim that only the thick roots would meet.
    points, normals = surface_cloud(box_triangles(0.04, 0.05, 0.30), 6000, 0)
    x = WSG50.opening_most / 2 + 0.5 * (WSG50.finger_thickness + WSG50.root_thickness)
    rim = np.stack(np.meshgrid([-x, x], np.linspace(-0.01, 0.01, 9), [0.0]), axis=-1).reshape(-1, 3)
    up = np.concatenate([normals, np.tile([[0, 0, 1.0]], (len(rim), 1))])
    low = np.concatenate([points - [0, 0, 0.2], rim])  # the slab's top at -0.05: the palm is not what stops
    _, at = pushed(target_of(low, up), WSG50, DOWN, np.array([[0.0, 0, 0.3]]))
    assert at[2] - WSG50.root_front == pytest.approx(CLOSING.gap, abs=1e-6)


@pytest.mark.parametrize(
    ("aside", "across", "front"),
    [
        (0.0, 0.0, PANDA_HAND.finger_front),
        (0.0555, 0.0, PANDA_HAND.finger_front),
        (0.0565, 0.0, PANDA_HAND.root_front),
        (0.0675, 0.0, PANDA_HAND.root_front),
        (0.0685, 0.0, PANDA_HAND.palm_front),
        (0.065, 0.0100, PANDA_HAND.root_front),
        (0.065, 0.0110, PANDA_HAND.palm_front),
        (0.050, 0.0100, PANDA_HAND.finger_front),
        (0.050, 0.0110, PANDA_HAND.palm_front),
        (0.1035, 0.0, PANDA_HAND.palm_front),
        (0.090, 0.0235, PANDA_HAND.palm_front),
        (0.1045, 0.0, None),
        (0.090, 0.0245, None),
    ],
)
def test_each_part_of_the_hand_stops_before_a_point_of_another_thing(
    aside: float, across: float, front: float | None
) -> None:
    for sign in (1.0, -1.0):
        point = np.array([[sign * aside, sign * across, 0.2]])
        _, p = pushed(box_target(0.05, 0.08, 0.16, surroundings=point), PANDA_HAND, DOWN, np.array([[0.0, 0, 0.4]]))
        stop = 0.08 + PANDA_HAND.palm_front if front is None else 0.2 + front
        assert p[2] == pytest.approx(stop + CLOSING.gap, abs=1e-6)


def plates(left_z: tuple[float, float], right_z: tuple[float, float], back: float = 0.0) -> GraspTarget:
    """Two upright plates at x = ∓0.02; half of the right one's points stand `back` and lean by 37°."""
    rng = np.random.default_rng(6)
    y = rng.uniform(-0.01, 0.01, 2000)
    left = np.stack([np.full(2000, -0.02), y, rng.uniform(*left_z, 2000)], axis=1)
    right = np.stack([np.full(2000, 0.02), y, rng.uniform(*right_z, 2000)], axis=1)
    normals = np.repeat([[-1.0, 0, 0], [1.0, 0, 0]], 2000, axis=0)
    if back:
        right[::2, 0] -= back
        normals[2000::2] = [0.8, 0.6, 0.0]
    return target_of(np.concatenate([left, right]), normals)


def test_a_pad_touches_what_is_as_far_behind_the_first_point_as_it_gives_way() -> None:
    at = np.array([[0.0, 0.0, 0.0]])
    near, far = (judge(plates((-0.005, 0.005), (-0.005, 0.005), back), PANDA_HAND, DOWN, at) for back in (0.001, 0.004))
    assert near.closing.align[0] == pytest.approx([(1 + 0.8 * 0.8) / 1.8, 1.0], abs=0.01)
    assert far.closing.align[0] == pytest.approx([1.0, 1.0], abs=1e-6)


def test_a_line_through_both_contacts_lies_in_the_cones() -> None:
    at = np.array([[0.0, 0.0, 0.0]])
    most = WSG50.friction * 0.04 + 0.25 * WSG50.pad_width
    for apart, reason in ((most - 0.002, ""), (most + 0.002, "outside of the friction cone")):
        target = plates((0.0, 0.001), (apart, apart + 0.001))
        assert REASONS[judge(target, WSG50, DOWN, at).code[0]] == reason


def test_beyond_a_side_that_is_hidden_a_finger_has_room() -> None:
    points, normals = surface_cloud(box_triangles(0.05, 0.08, 0.16), 20000, 0)
    shown = (normals[:, 0] > 0.5) | (normals[:, 2] > 0.5)
    target = target_of(points[shown], normals[shown], viewpoint=np.array([0.5, 0.0, 0.3]))
    for room, reason in ((0.012, ""), (0.008, "too wide")):
        at = np.array([[WSG50.opening_most / 2 - 0.025 - room, 0.0, 0.06]])
        found = judge(target, WSG50, DOWN, at)
        assert REASONS[found.code[0]] == reason
        assert found.seen[0].tolist() == [True, False]


def test_the_search_around_a_pose_turns_to_the_normals_about_what_is_held() -> None:
    turn = rotations.matrix(rotations.exp(np.array([0.0, 0.0, 0.15])))
    found = judge(box_target(0.05, 0.08, 0.16, 20000), PANDA_HAND, turn[None] @ DOWN, np.array([[0.004, 0.01, 0.06]]))
    assert found.code[0] == 0
    R, p = _neighbours(box_target(0.05, 0.08, 0.16), found, 1.0)
    assert np.abs(R[0, :2, 0, 1]) == pytest.approx(1.0, abs=1e-3)  # square to the sides now
    assert R[0, 2] == pytest.approx(found.R[0])
    held = found.closing.contact[0].mean(axis=0) * [0, 0, 1]
    middle = p[0, 0] + R[0, 0] @ held
    assert middle[0] == pytest.approx(0.0, abs=1e-3)  # between the sides
    assert middle[2] == pytest.approx((found.p[0] + found.R[0] @ held)[2], abs=1e-3)
    assert p[0, 2, 2] == pytest.approx(0.06, abs=1e-6)
    nods = [np.rad2deg(np.arccos(np.clip(R[0, 0, :, 2] @ R[0, k, :, 2], -1, 1))) for k in range(3, 7)]
    assert nods == pytest.approx([20.0, 20.0, 40.0, 40.0])


def test_spacing_is_that_of_points_on_the_box_around() -> None:
    x, y, z = 0.05, 0.08, 0.16
    area = 2 * (x * y + y * z + z * x)
    assert box_target(x, y, z, 4000).spacing == pytest.approx(np.sqrt(area / 4000), rel=1e-3)
    thin = box_target(x, y, z, 4000, surroundings=np.ones((8, 3))).thinned(1000)
    assert (thin.own, len(thin.points)) == (1000, 1002)
    assert thin.spacing == pytest.approx(np.sqrt(area / 1000), rel=0.02)


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ((0.0, 0.0, 0.08), ""),
        ((0.3, 0.0, 0.08), "nothing between the fingers"),
        ((0.03, 0.0, 0.08), "in collision"),
        ((0.0, 0.0, 0.03), "in collision"),
        ((0.0, 0.0515, 0.08), "nothing between the fingers"),
    ],
)
def test_poses_are_judged_as_they_are(place: tuple[float, float, float], reason: str) -> None:
    found = judge(box_target(0.05, 0.08, 0.16), PANDA_HAND, DOWN, np.array([place]))
    assert REASONS[found.code[0]] == reason
    assert found.p[0] == pytest.approx(place)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 24.0, 29.0, 40.0])
def test_contacts_hold_within_the_friction_cone(degrees: float) -> None:
    # A wedge: its side leans by so much from the closing plane, the other one is square.
    tan = np.tan(np.deg2rad(degrees))
    rng = np.random.default_rng(2)
    y, z = rng.uniform(-0.03, 0.03, (2, 4000))
    left = np.stack([np.full(4000, -0.02), y, z], axis=1)
    right = np.stack([0.02 - tan * y, y, z], axis=1)
    normal = np.array([1.0, tan, 0.0]) / np.hypot(1.0, tan)
    target = target_of(np.concatenate([left, right]), np.repeat([[-1.0, 0, 0], normal], 4000, axis=0))
    found = judge(target, PANDA_HAND, DOWN, np.array([[0.0, 0.0, 0.03]]))
    assert found.closing.align[0] == pytest.approx([np.cos(np.deg2rad(degrees)), 1.0], abs=1e-3)
    holds = degrees <= np.rad2deg(np.arctan(PANDA_HAND.friction))
    assert (found.code[0] == 0) == holds
    assert holds or REASONS[found.code[0]] == "outside of the friction cone"


def test_contacts_and_width_of_a_box() -> None:
    found = judge(box_target(0.05, 0.08, 0.16, 30000), PANDA_HAND, DOWN, np.array([[0.004, 0.0, 0.05]]))
    closing = found.closing
    assert closing.width[0] == pytest.approx(0.05, abs=1e-6)
    assert closing.middle[0] == pytest.approx(-0.004, abs=1e-6)  # the box is at less y than the gripper's middle
    assert closing.contact[0, :, 1] == pytest.approx([0.021, -0.029], abs=1e-6)
    assert closing.contact[0, :, 0] == pytest.approx(0.0, abs=1e-3)
    middle = (PANDA_HAND.pad_front + PANDA_HAND.pad_back) / 2
    assert closing.contact[0, :, 2] == pytest.approx(middle, abs=1e-3)
    assert closing.normal[0] == pytest.approx(np.array([[0, 1, 0], [0, -1, 0]]), abs=1e-6)
    assert not closing.roots_first[0]


def test_what_meets_the_roots_before_the_pads_is_no_grasp() -> None:
    # Wider by 4 mm on each side above the pads, where the roots stand 2.3 mm back.
    points, normals = surface_cloud(box_triangles(0.04, 0.08, 0.10), 9000, 0)
    head, up = surface_cloud(box_triangles(0.048, 0.08, 0.016), 6000, 1)
    at = np.array([[0.0, 0.0, 0.020]])
    for lift, reason in ((0.0, "met beside the pads"), (-0.2, "")):
        moved = head + [0, 0, 0.020 - PANDA_HAND.pad_back + 0.009 + lift]
        target = target_of(np.concatenate([points, moved]), np.concatenate([normals, up]))
        assert REASONS[judge(target, PANDA_HAND, DOWN, at).code[0]] in ((reason, "in collision") if lift else (reason,))


# The cost.


def test_alignment_with_the_closing_axis_lowers_the_cost() -> None:
    shares = np.expm1(np.cos(np.deg2rad([0.0, 10.0, 45.0, 90.0])) ** 2) / np.expm1(1.0)
    cost = antipodal_cost(shares)
    assert (np.diff(cost) > 0).all()
    assert cost[[0, -1]] == pytest.approx([0.0, 1.0])


def test_a_square_box_costs_less_than_a_turned_one_in_the_whole_chain() -> None:
    found = []
    for degrees in (0.0, 8.0, 16.0):
        turn = rotations.matrix(rotations.exp(np.array([0.0, 0.0, np.deg2rad(degrees)])))
        found.append(judge(box_target(0.05, 0.08, 0.16), PANDA_HAND, turn[None] @ DOWN, np.array([[0.0, 0, 0.05]])))
    cost = [float(one.terms["antipodal"][0]) for one in found]
    assert cost[0] < cost[1] < cost[2]
    n = np.cos(np.deg2rad(16.0)) ** 2
    assert cost[2] == pytest.approx(1 - np.expm1(n) / np.expm1(1.0), abs=0.01)


def test_neither_density_nor_the_rest_of_the_object_changes_the_cost() -> None:
    at = np.array([[0.0, 0.0, 0.05]])
    turn = rotations.matrix(rotations.exp(np.array([0.0, 0.0, 0.15])))[None] @ DOWN
    points, normals = surface_cloud(box_triangles(0.05, 0.08, 0.16), 40000, 0)
    rest, other = surface_cloud(box_triangles(0.05, 0.08, 0.30), 30000, 1)
    below = rest - [0, 0, 0.25]
    clouds = [
        (points, normals),
        (points[::4], normals[::4]),
        (np.concatenate([points, below]), np.concatenate([normals, other])),
    ]
    cost = [float(judge(target_of(*one), PANDA_HAND, turn, at).terms["antipodal"][0]) for one in clouds]
    assert cost[0] > 0.01
    assert cost[1] == pytest.approx(cost[0], rel=0.02)
    assert cost[2] == pytest.approx(cost[0], rel=1e-9)


def test_what_closing_pushes_aside_costs_by_the_way() -> None:
    at = np.array([[x, 0.0, 0.05] for x in (0.0, 0.005, -0.010)])
    found = judge(box_target(0.05, 0.08, 0.16), PANDA_HAND, np.repeat(DOWN, 3, axis=0), at)
    assert found.terms["push"] == pytest.approx([0.0, 0.1, 0.2], abs=1e-4)
    sides = (PANDA_HAND.opening_most - 0.05) / 2 - np.array([0.0, 0.005, 0.010])
    assert found.terms["clearance"] == pytest.approx(0.3 * np.maximum(1 - sides / 0.010, 0.0), abs=1e-4)
    assert found.terms["width"] == pytest.approx(0.15 * 0.05 / PANDA_HAND.opening_most)


def test_contacts_off_the_pads_middles_cost_by_the_square() -> None:
    # Held by the front half of the pads' width, and in their middle along z.
    shift = PANDA_HAND.pad_width / 2
    at = np.array([[0.0, 0.04, 0.05], [0.0, 0.04 - 2 * shift, 0.05]])
    found = judge(box_target(0.05, 0.08, 0.16, 60000), PANDA_HAND, np.repeat(DOWN, 2, axis=0), at)
    assert found.terms["off_pad"] == pytest.approx([0.2 * 0.5**2, 0.0], abs=0.004)


def test_torque_of_weight_is_lever_times_weight_by_what_two_pads_hold() -> None:
    held = np.array([[0.0, 0.0, 0.0]])
    pad = 2.0 / 3.0 * np.sqrt(PANDA_HAND.pad_length * PANDA_HAND.pad_width / np.pi)
    holds = 2 * PANDA_HAND.friction * PANDA_HAND.force * pad
    centre = np.array([0.03, 0.04, 0.0])
    R = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])[None].transpose(0, 2, 1)  # y of G along z of O
    assert R[0, :, 1] == pytest.approx([0, 0, 1])

    def share(**told: object) -> float:
        return float(weight_torque(box_target(0.1, 0.1, 0.1, **told), PANDA_HAND, R, held)[0])  # type: ignore[arg-type]

    assert share(mass=0.5, centre=centre) == pytest.approx(0.5 * 9.81 * 0.05 / holds)
    # Of a weight along -x only the part of the lever along y counts; along the closing axis none does.
    assert share(mass=0.5, centre=centre, up=[2.0, 0, 0]) == pytest.approx(0.5 * 9.81 * 0.04 / holds)
    assert share(mass=0.5, centre=centre, up=[0, 0, 1.0]) == pytest.approx(0.0)
    assert share(mass=0.5, centre=[0, 0, 0.05]) == pytest.approx(0.0)
    assert share(centre=centre) == 0.0
    assert share(mass=0.5) == 0.0


# The table.


def test_height_over_a_table_is_that_of_the_lowest_corner() -> None:
    rng = np.random.default_rng(3)
    R = rotations.matrix(rotations.exp(rng.standard_normal((20, 3))))
    p = rng.uniform(-0.2, 0.2, (20, 3))
    normal = np.array([0.6, 0.0, 0.8])
    table = np.array([*normal, -0.1])
    low, high = WSG50.boxes()
    corners = np.array([np.where([i & 4, i & 2, i & 1], high, low) for i in range(8)]).reshape(-1, 3)
    placed = np.einsum("kij,cj->kci", R, corners) + p[:, None]
    lowest = (placed @ normal).min(axis=1) + 0.1
    assert heights(WSG50, R, p, table) == pytest.approx(lowest)
    stop = table_stop(WSG50, R, p, table, 0.1)
    down = R[:, :, 2] @ normal < 0
    moved = p + np.where(np.isfinite(stop), stop, 0.0)[:, None] * R[:, :, 2]
    assert heights(WSG50, R[down], moved[down], table) == pytest.approx(CLOSING.gap)
    begin = heights(WSG50, R[~down], p[~down] - 0.1 * R[~down][:, :, 2], table)
    assert (np.isneginf(stop[~down]) == (begin < CLOSING.gap)).all()
    assert np.isposinf(stop[~down][begin >= CLOSING.gap]).all()


# Boxes and triangles.


def test_boxes_meet_triangles_as_brute_force_says() -> None:
    triangles = cylinder_triangles(0.03, 0.12, 24)
    points = dense_points(triangles, 0.002)
    rng = np.random.default_rng(4)
    R = rotations.matrix(rotations.exp(rng.standard_normal((60, 3)) * 2))
    p = rng.uniform(-0.12, 0.12, (60, 3))
    met = meets_triangles(laid_out(triangles), R, p, *PANDA_HAND.boxes())
    slow = np.array([collides(triangles, points, PANDA_HAND, *one) for one in zip(R, p, strict=True)])
    assert 5 < slow.sum() < 55
    assert not (slow & ~met).any()
    assert (met & ~slow).sum() <= 2  # what a grid of 2 mm does not see


def test_an_edge_beside_a_box_does_not_meet_it() -> None:
    # Only an axis that is a product of edges parts these two.
    triangle = np.array([[[1.2, 0.0, -1.0], [0.0, 1.2, 1.0], [1.4, 1.4, 0.0]]]) * 1.0
    box = (np.array([[-0.5, -0.5, -0.5]]), np.array([[0.5, 0.5, 0.5]]))
    one = (np.eye(3)[None], np.zeros((1, 3)))
    assert not meets_triangles(laid_out(triangle), *one, *box)[0]
    assert meets_triangles(laid_out(triangle - [0.3, 0.3, 0.0]), *one, *box)[0]


def test_a_surface_cloud_is_even_and_on_the_surface() -> None:
    points, normals = surface_cloud(box_triangles(0.1, 0.2, 0.4), 5600, 5)
    faces = {0: 0.4 * 0.2, 1: 0.4 * 0.1, 2: 0.2 * 0.1}
    total = sum(faces.values())
    for axis, area in faces.items():
        on = np.abs(normals[:, axis]) > 0.5
        assert on.mean() == pytest.approx(area / total, abs=0.01)
        assert np.abs(points[on][:, axis]) == pytest.approx((0.05, 0.1, 0.2)[axis])
        assert np.sign(points[on][:, axis]) == pytest.approx(normals[on][:, axis])
        assert points[on].mean(axis=0) == pytest.approx(0.0, abs=0.012)


# The object's pose is not certain.


def test_success_over_samples_is_that_of_a_normal_distribution() -> None:
    target = box_target(0.05, 0.08, 0.16)
    R, p = DOWN, np.array([[0.0, 0.0, 0.05]])
    none = np.zeros((6, 6))
    X_WO = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5), 1.0, 2.0, 3.0])  # x of O along y of W
    one = np.array([1.0, 0, 0, 0, 0, 0, 0])
    aside = p + [[0.0, 0.02, 0.0]]  # along the box, however it is turned in W
    turned = np.array([np.cos(np.pi / 6), 0, 0, np.sin(np.pi / 6), 1.0, 2.0, 3.0])
    assert success_over_poses(target, PANDA_HAND, R, aside, none, turned, 10, 0) == pytest.approx(1.0)
    room = (PANDA_HAND.opening_most - 0.05) / 2 - CLOSING.beside
    for pose, axis, other in ((one, 3, 4), (X_WO, 4, 3)):
        doubt = none.copy()
        doubt[axis, axis] = room**2  # along the closing axis: one sigma of room
        share = success_over_poses(target, PANDA_HAND, R, p, doubt, pose, 2000, 1)
        assert share[0] == pytest.approx(0.683, abs=0.03)
        doubt = none.copy()
        doubt[other, other] = 0.01**2  # along the box: it is 8 cm wide there
        assert success_over_poses(target, PANDA_HAND, R, p, doubt, pose, 200, 1)[0] > 0.97
    # Turns are about O's origin, however far O is from W's; about the closing axis they matter little.
    doubt = none.copy()
    doubt[1, 1] = 0.1**2
    assert success_over_poses(target, PANDA_HAND, R, p, doubt, X_WO, 200, 2)[0] > 0.97
    # About z a box that is turned by more than the friction cone is lost.
    doubt = none.copy()
    doubt[2, 2] = np.arctan(PANDA_HAND.friction) ** 2
    assert success_over_poses(target, PANDA_HAND, R, p, doubt, X_WO, 1000, 2)[0] == pytest.approx(0.5, abs=0.2)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_turn_and_shift_of_the_object_go_together(yaw: float) -> None:
    # A box that turns about the grasp's own place stays between the pads; one that turns the other way about leaves.
    target, p = box_target(0.05, 0.16, 0.08), np.array([[0.0, 0.06, 0.01]])
    X_WO = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2), 1.0, 2.0, 3.0])
    R_WO = rotations.matrix(X_WO[:4])
    for sign, likely in ((1.0, True), (-1.0, False)):
        way = np.zeros(6)
        way[2] = 0.17
        way[3:] = -sign * np.cross(way[:3], R_WO @ p[0])
        share = success_over_poses(target, PANDA_HAND, DOWN, p, np.outer(way, way), X_WO, 400, 3)[0]
        assert share > 0.85 if likely else share < 0.7


def test_a_tables_normal_may_have_any_length() -> None:
    table = np.array([0.0, 0.6, 0.8, -0.05])
    told = box_target(0.05, 0.05, 0.05, table=4.0 * table)
    assert told.table is not None and told.up is not None
    np.testing.assert_allclose(told.table, table)
    np.testing.assert_allclose(told.up, table[:3])


def test_table_and_other_things_stay_where_they_are_when_the_object_lies_a_little_off() -> None:
    half = 0.018
    cloud = surface_cloud(box_triangles(0.04, 0.04, 2 * half), 2000, 0)
    beside = np.array([[0.0, PANDA_HAND.opening_most / 2 + PANDA_HAND.finger_thickness + 0.003, -half]])
    target = target_of(*cloud, table=np.array([0.0, 0.0, 1.0, -half]), surroundings=beside)
    p = np.array([[0.0, 0.0, PANDA_HAND.finger_front - half + 0.001]])  # the tips are 1 mm over the table
    assert judge(target, PANDA_HAND, DOWN, p).code[0] == 0
    doubt, one = np.diag([0.01, 0.01, 0.01, 0.003, 0.003, 0.003]) ** 2, np.array([1.0, 0, 0, 0, 0, 0, 0])
    assert success_over_poses(target, PANDA_HAND, DOWN, p, doubt, one, 200, 1)[0] == 1.0


def test_a_cloud_and_the_list_it_gives_agree_in_what_is_left_out() -> None:
    found = propose(*surface_cloud(box_triangles(0.05, 0.08, 0.16), 2000, 0), PANDA_HAND, count=3)
    assert set(found.reasons) <= {*REASONS[1:], "out of reach"}
    assert all(count > 0 for count in found.reasons.values())


def test_many_triangles_are_met_as_few_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells leave out what is far: with and without them the answers are the same."""
    triangles = cylinder_triangles(0.03, 0.11)
    low, high = PANDA_HAND.boxes(retreat=0.1)
    rng = np.random.default_rng(3)
    R = np.array([rotations.matrix(rotations.normalized(q)) for q in rng.normal(size=(60, 4))])
    p = rng.uniform(-0.12, 0.12, (60, 3))
    whole = meets_triangles(laid_out(triangles), R, p, low, high)
    monkeypatch.setattr("twin_diagram.planning.grasps.triangles.CELLS", 27)
    assert len(triangles) > 27 and 10 < whole.sum() < 50
    np.testing.assert_array_equal(meets_triangles(laid_out(triangles), R, p, low, high), whole)


def test_over_an_edge_the_gripper_comes_from_outside_and_closes_on_the_face() -> None:
    """Of a plate: points near its border know which way leads inwards, those in its middle that no edge is near."""
    target = box_target(0.2, 0.2, 0.004)
    top = np.flatnonzero(target.normals[:, 2] > 0.9)
    out = np.abs(target.points[top, 0])
    border = top[(out > 0.096) & (np.abs(target.points[top, 1]) < 0.08)]
    middle = top[(np.abs(target.points[top, :2]) < 0.06).all(axis=1)]
    frames, near = edge_frames(target.points, target.normals, np.concatenate([border, middle]))
    inwards = -np.sign(target.points[border, 0])
    assert np.mean(frames[: len(border), 0, 2] * inwards) > 0.8  # a random cloud's neighbours are not even
    np.testing.assert_allclose(np.abs(frames[: len(border), 2, 1]), 1.0, atol=1e-9)
    assert np.median(near[: len(border)]) > 2 * np.median(near[len(border) :])
