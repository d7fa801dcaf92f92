"""What lies flat is known for it, and the way of its raised side is that of a rigid body along floor and wall."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.planning.grasps import gripper_of
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.flat_things import TUNING, FlatThing, may_be_tipped, pushes_of, way_of
from twin_diagram.runs.learning.tipping import is_clear, tool_poses
from twin_diagram.signals.arrays import Array

LOW, HIGH = np.array([0.2, -0.2, 0.01]), np.array([0.5, 0.2, 0.12])
WSG = gripper_of("wsg50")


def upper_face(edges: tuple[float, float, float], R: Array, far: float, noise: float = 0.0005) -> SeenThing:
    """Return the upper face of a box on the floor, its highest x at `far`, as a camera above it sees it."""
    rng = np.random.default_rng(0)
    half = 0.5 * np.array(edges)
    own = np.column_stack([rng.uniform(-1.0, 1.0, (4000, 2)) * half[:2], np.full(4000, half[2])]) @ R.T
    corners = (np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * half) @ R.T
    place = np.array([far - own[:, 0].max(), 0.0, LOW[2] - corners[:, 2].min()])
    points = own + place + noise * rng.normal(size=own.shape) * [0.0, 0.0, 1.0]
    return SeenThing(points, np.tile(R[:, 2], (4000, 1)), np.zeros((4000, 2), dtype=np.int64), np.array([0.35, 0, 1]))


@pytest.mark.parametrize(("tilt", "turned"), [(0.0, 0.0), (0.25, 0.0), (0.0, 0.4)])
def test_a_flat_box_is_known_by_its_upper_face(tilt: float, turned: float) -> None:
    R = (Rotation.from_rotvec([0.0, 0.0, turned]) * Rotation.from_rotvec([0.0, tilt, 0.0])).as_matrix()
    pushes = pushes_of(upper_face((0.16, 0.21, 0.06), R, 0.45), LOW, HIGH)
    one = next(flat for flat in pushes if flat.along[0] > 0.5)
    assert one.tilt == pytest.approx(tilt, abs=0.01) and one.length == pytest.approx(0.16, abs=0.004)
    assert one.thickness == pytest.approx(0.06, abs=0.003) and one.far == pytest.approx(
        0.45, abs=0.003 if turned == 0.0 else 0.02
    )
    assert one.middle == pytest.approx(0.0, abs=0.005) and may_be_tipped(one, WSG, float(HIGH[2]))


def test_what_leans_askew_is_pushed_along_its_own_edge_into_a_corner() -> None:
    R = (Rotation.from_rotvec([0.0, 0.0, np.pi / 4]) * Rotation.from_rotvec([0.0, 0.5, 0.0])).as_matrix()
    pushes = pushes_of(upper_face((0.21, 0.16, 0.06), R, 0.45), LOW, HIGH)
    (one,) = (flat for flat in pushes if may_be_tipped(flat, WSG, float(HIGH[2])))
    assert one.along == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0], abs=0.02) and not one.to_wall
    assert one.tilt == pytest.approx(0.5, abs=0.02) and one.length == pytest.approx(0.21, abs=0.005)
    assert one.thickness == pytest.approx(0.06, abs=0.004)
    ends = [one.far * one.along + (one.middle + side) * one.across for side in (-0.08, 0.08)]
    at_wall = np.array(ends) + (one.wall - one.far) * one.along
    assert (HIGH[:2] - at_wall[:, :2]).min() == pytest.approx(0.0, abs=0.005), "one of its corners is at a wall"
    turned = Rotation.from_rotvec([0.0, 0.0, 0.3]).as_matrix()
    assert all(flat.to_wall for flat in pushes_of(upper_face((0.21, 0.16, 0.06), turned, 0.45), LOW, HIGH))


def test_what_is_not_flat_or_would_not_stand_out_over_the_walls_is_left() -> None:
    flat = np.eye(3)
    ball = np.random.default_rng(0).normal(size=(2000, 3))
    ball *= 0.08 / np.linalg.norm(ball, axis=1)[:, None]
    round_ = SeenThing(ball + [0.35, 0, 0.09], ball / 0.08, np.zeros((2000, 2), dtype=np.int64), np.zeros(3))
    assert pushes_of(round_, LOW, HIGH) == []
    for edges in ((0.16, 0.21, 0.01), (0.16, 0.21, 0.11), (0.1, 0.1, 0.05)):
        pushes = pushes_of(upper_face(edges, flat, 0.45), LOW, HIGH)
        assert not any(may_be_tipped(one, WSG, float(HIGH[2])) for one in pushes), edges


def test_its_side_goes_as_a_rigid_body_does_whose_edges_keep_to_floor_and_wall() -> None:
    flat = FlatThing(np.array([0.0, 1.0, 0.0]), -0.3, 0.0, 0.2, 0.2, 0.01, 0.16, 0.06, 0.1)
    there, raised = way_of(flat)
    assert there[0, 0] == pytest.approx(flat.near - TUNING.before) and there[-1] == pytest.approx(raised[0, :2])
    for s, z, tilt in raised:
        c, up = np.cos(tilt), np.sin(tilt)
        on_body = np.array([-flat.length, TUNING.height * flat.thickness])
        lower = np.array([s, z]) - [on_body[0] * c + on_body[1] * up, -on_body[0] * up + on_body[1] * c]
        upper = lower + flat.thickness * np.array([up, c])
        assert lower[1] == pytest.approx(flat.floor) and upper[0] == pytest.approx(flat.wall)
    assert np.abs(np.diff(raised[:, :2], axis=0)).max() < 1.5 * TUNING.step


def test_fingers_lie_flat_on_its_side_and_keep_clear_of_what_lies_beside() -> None:
    flat = FlatThing(np.array([0.0, 1.0, 0.0]), -0.35, 0.0, 0.2, 0.2, 0.01, 0.16, 0.06, 0.0)
    there, raised = way_of(flat)
    poses = tool_poses(flat, np.vstack([there, raised[:, :2]]), WSG)
    tip = poses[0][:3, 3] + WSG.finger_front * poses[0][:3, 2]
    assert tip[2] == pytest.approx(there[0, 1]) and tip[0] == pytest.approx(0.35)
    assert tip[1] == pytest.approx(flat.near - TUNING.before - 0.5 * WSG.finger_width)
    none = np.zeros((0, 3))
    assert is_clear(flat, poses, WSG, none, none)
    beside, low = np.array([[0.36, flat.near - 0.025, 0.06]]), np.array([[0.36, flat.near - 0.025, 0.02]])
    assert not is_clear(flat, poses, WSG, beside, beside) and is_clear(flat, poses, WSG, low, low)
    nearer = FlatThing(flat.along, flat.middle, -0.05, 0.15, 0.2, 0.01, 0.16, 0.06, 0.0)
    between = np.array([[0.35, 0.18, 0.03]])
    assert not is_clear(nearer, poses, WSG, none, between)
