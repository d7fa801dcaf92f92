"""Which points lie near shapes."""

from __future__ import annotations

import numpy as np

from twin_diagram.perception.segmentation.robot_kernels import SPHERE, RobotShapes, mark_near


def test_points_lie_near_balls_that_a_sphere_with_the_margin_holds() -> None:
    rng = np.random.default_rng(0)
    points, centres, radii = rng.normal(size=(200, 3)), rng.normal(size=(5, 3)), rng.uniform(0.2, 1.0, 5)
    sizes = np.column_stack([radii, np.zeros((5, 2))])
    shapes = RobotShapes(np.full(5, SPHERE), sizes, np.zeros((0, 4)), np.zeros(6, dtype=np.int64))
    places, near = (np.broadcast_to(np.eye(3), (5, 3, 3)).copy(), centres), np.zeros(200, dtype=bool)
    distance = np.linalg.norm(points[None] - centres[:, None], axis=-1) - radii[:, None]
    for margin in (0.0, 0.1, 0.5):
        mark_near(points, (*places, radii + margin), shapes, margin, near)
        np.testing.assert_array_equal(near, (distance < margin).any(axis=0))
    mark_near(points, (*places, np.zeros(5)), shapes, 0.5, near)
    assert not near.any()
