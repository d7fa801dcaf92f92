"""What an image shows in the place of each model point, worked out point by point."""

from __future__ import annotations

import numpy as np
import pytest

from tests.registration_bench import FOCAL, HEIGHT, TABLE, WIDTH, frame, model, poses, turn, view
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.point_kernels import COARSE, FINE


@pytest.mark.parametrize(("count", "level"), [(40, FINE), (33, COARSE), (12, FINE)])
def test_each_point_is_paired_with_what_stands_at_its_pixel(count: int, level: int) -> None:
    cloud, image, camera, at = model(), frame(), view(), poses()
    looked = look(cloud, image, at, count, level)
    kinds = {"seen": 0, "near": 0, "matched": 0, "robot": 0, "uncounted": 0, "tabled": 0, "turned": 0}
    for b in range(4):
        R, p = at.R[b], at.p[b]
        to_camera = R.T @ (camera.p_WC - p)
        which = max(range(6), key=lambda k: cloud.directions[k] @ to_camera)
        for i in range(count):
            k = cloud.views[which, i]
            r, n = R @ cloud.points[k], R @ cloud.normals[k]
            x = p + r
            x_C = camera.R_WC.T @ (x - camera.p_WC)
            u = FOCAL * x_C[0] / x_C[2] + (WIDTH - 1) / 2
            v = FOCAL * x_C[1] / x_C[2] + (HEIGHT - 1) / 2
            column, row = round(u), round(v)
            depth = float(image.depth[row, column])
            ray = np.array([(column - (WIDTH - 1) / 2) / FOCAL, (row - (HEIGHT - 1) / 2) / FOCAL, 1.0])
            y = camera.p_WC + camera.R_WC @ ray * depth
            sight = (camera.p_WC - x) / np.linalg.norm(camera.p_WC - x)
            counted = i < cloud.view_counts[which]
            robot = bool(image.robot[row, column])
            seen = depth > 0.0 and not robot and counted and n @ sight > 0.1
            height_y = y[2] - TABLE @ [y[0], y[1], 1.0]
            height_x = x[2] - TABLE @ [x[0], x[1], 1.0]
            # Within 6 mm of the table's top the image shows the table, but to a point that is as low: 12 mm.
            tabled = abs(height_y) < 0.006 and height_x > 0.012
            normal = image.normals[round(v / 2), round(u / 2)].astype(float)
            turned = normal.any() and n @ normal <= 0.5
            wanted = {"seen": seen, "near": seen and not tabled, "robot": robot and counted, "counted": counted}
            wanted["matched"] = wanted["near"] and not turned
            for name, value in wanted.items():
                assert getattr(looked, name)[b, i] == value, (name, b, i)
            np.testing.assert_allclose(looked.r[b, i], r, atol=1e-12)
            np.testing.assert_allclose(looked.n[b, i], n, atol=1e-12)
            np.testing.assert_allclose(looked.colour[b, i], cloud.colours[level][k])
            found = [looked.u[b, i], looked.v[b, i], looked.z[b, i], looked.facing[b, i]]
            np.testing.assert_allclose(found, [u, v, x_C[2], n @ sight], atol=1e-9)
            assert looked.deeper[b, i] == pytest.approx(depth - x_C[2], abs=1e-9)
            if depth > 0.0:
                assert looked.distance[b, i] == pytest.approx(n @ (y - x), abs=1e-9)
            for name in ("seen", "near", "matched", "robot"):
                kinds[name] += wanted[name]
            kinds["uncounted"] += not counted
            kinds["tabled"] += seen and tabled
            kinds["turned"] += wanted["near"] and turned
    if count == 40:
        assert all(kinds.values()), f"the image is to show all kinds: {kinds}"


def test_what_is_the_table_and_what_faces_elsewhere_ends_where_it_is_said_to() -> None:
    """Of one point, both sides of each threshold: 6 mm and 12 mm above the table, 60° between normals."""
    from dataclasses import replace

    cloud, image, camera = model(), frame(), view()
    one = replace(cloud, points=np.zeros((120, 3)), normals=np.tile([0.0, 0.0, 1.0], (120, 1)))
    flat = replace(image, table=np.zeros(3), robot=np.zeros_like(image.robot))

    def looked(height: float, shown: float, tilt: float = 0.0) -> tuple[bool, bool]:
        """A point at a height on the optical axis, where the image shows another height."""
        ahead = camera.R_WC[:, 2]
        p = camera.p_WC + ahead * (height - camera.p_WC[2]) / ahead[2]
        depth = np.full_like(image.depth, (shown - camera.p_WC[2]) / ahead[2])
        normals = np.tile(turn(0.0, tilt, 0.0) @ [0.0, 0.0, 1.0], (*image.normals.shape[:2], 1)).astype(np.float32)
        found = look(one, replace(flat, depth=depth, normals=normals), Poses(np.eye(3)[None], p[None]), 1, FINE)
        return bool(found.near[0, 0]), bool(found.matched[0, 0])

    # Pixels are some 5 mm apart, so the heights shown are those at the nearest pixel; the middle lies half a pixel off.
    assert looked(0.030, 0.012)[0] and not looked(0.030, 0.001)[0]
    assert looked(0.0113, 0.001)[0] and not looked(0.0127, 0.001)[0]
    assert looked(0.05, 0.05, np.radians(59.0))[1] and not looked(0.05, 0.05, np.radians(61.0))[1]


def test_poses_are_selected_and_moved() -> None:
    at = poses()
    np.testing.assert_array_equal(at[np.array([2, 0])].p, at.p[[2, 0]])
    step = np.array([[0.0, 0.0, 0.3, 0.1, 0.2, 0.3]] * 4)
    moved = at.moved(step)
    np.testing.assert_allclose(moved.p, at.p + [0.1, 0.2, 0.3])
    np.testing.assert_allclose(moved.R, turn(0.0, 0.0, 0.3) @ at.R, atol=1e-12)
