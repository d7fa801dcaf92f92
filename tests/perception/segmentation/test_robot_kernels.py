"""Which points lie within spheres."""

from __future__ import annotations

import numpy as np

from twin_diagram.perception.segmentation.robot_kernels import within_spheres


def test_points_lie_within_spheres() -> None:
    rng = np.random.default_rng(0)
    points, centres, radii = rng.normal(size=(200, 3)), rng.normal(size=(5, 3)), rng.uniform(0.2, 1.5, 5)
    distance = np.linalg.norm(points[None] - centres[:, None], axis=-1)
    np.testing.assert_array_equal(within_spheres(points, centres, radii), distance < radii[:, None])
    edge = within_spheres(np.array([[1.0, 0.0, 0.0], [0.999999, 0.0, 0.0]]), np.zeros((1, 3)), np.ones(1))
    assert edge.tolist() == [[False, True]]
