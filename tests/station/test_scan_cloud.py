"""Along which beams a lidar's ranges lie, and the cloud that they make."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.perception import PointCloud

from twin_diagram.scenario import Lidar
from twin_diagram.station.scan_cloud import ScanCloud, beams


def test_beams_fan_out_from_top_left_to_bottom_right_over_the_angles_told() -> None:
    ways = beams(Lidar(columns=5, rows=3, width=0.8, height=0.4))
    assert ways.shape == (15, 3)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0)
    elevation = np.arcsin(ways[:, 2]).reshape(3, 5)
    azimuth = np.arctan2(ways[:, 1], ways[:, 0]).reshape(3, 5)
    np.testing.assert_allclose(elevation, np.tile([[0.2], [0.0], [-0.2]], (1, 5)), atol=1e-12)
    np.testing.assert_allclose(azimuth, np.tile([0.4, 0.2, 0.0, -0.2, -0.4], (3, 1)), atol=1e-12)


@pytest.mark.parametrize("none", [(), (0, 4, 5)])
def test_the_cloud_is_of_the_beams_that_met_something(none: tuple[int, ...]) -> None:
    lidar = Lidar(columns=3, rows=2, width=0.6, height=0.3)
    system = ScanCloud(lidar)
    ranges = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 1e-3])
    ranges[list(none)] = 0.0
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, ranges)
    cloud = system.get_output_port().Eval(context)
    assert isinstance(cloud, PointCloud)
    wanted = [r * way for r, way in zip(ranges, beams(lidar), strict=True) if r]
    np.testing.assert_allclose(cloud.xyzs().T, wanted, atol=1e-6)
