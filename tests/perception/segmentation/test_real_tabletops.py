"""Real Kinect images of a table: nobody tells where it is; published labels score the result and do nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.planes import Told, find_plane
from twin_diagram.perception.segmentation.segmentation import Grid, segment


def kinect_sigma(z: np.ndarray) -> np.ndarray:
    """What is told of the Kinect's depth [m]."""
    return np.asarray(0.0012 + 0.0019 * (z - 0.4) ** 2)


@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("learn/learn5", 0.95),
        ("test/test1", 0.95),
        ("test/test5", 0.8),  # of the box behind, a seam is seen above and beside the one in front
        ("test/test18", 0.93),
        ("test/test26", 0.93),
        ("test/test33", 0.8),  # a mug is parted into its outside and its inside
        ("test/test40", 0.93),
    ],
)
def test_real_tabletops(data_dir: Path, name: str, least: float) -> None:
    """Also of things that touch and stand on one another."""
    file = data_dir / "kinect_tabletop" / f"{name}.pcd"
    if not file.is_file():
        pytest.skip(f"no {file}")
    from twin_diagram.native import load_libusb

    load_libusb()
    o3d = pytest.importorskip("open3d")
    cloud = o3d.t.io.read_point_cloud(str(file))
    points = cloud.point.positions.numpy().astype(float)
    colours = cloud.point.colors.numpy().reshape(480, 640, 3)
    depth = np.nan_to_num(points[:, 2]).reshape(480, 640).astype(np.float32)
    somewhere = Pinhole(640, 480, 525.0, np.eye(3), np.zeros(3))
    plane = find_plane(depth, somewhere.rays(), np.zeros(3), kinect_sigma, Told())
    assert plane is not None

    truth = cloud.point.label.numpy().reshape(480, 640)[::2, ::2].astype(int)
    height = plane.height(points.reshape(480, 640, 3)[::2, ::2])
    assert np.abs(np.median(height[truth == 1])) < 1e-3
    assert np.percentile(np.abs(height[truth == 1]), 95) < 8e-3

    x = np.cross([0.0, 0.0, 1.0], plane.normal)
    x /= np.linalg.norm(x)
    R_WC = np.stack([x, np.cross(plane.normal, x), plane.normal])
    view = Pinhole(640, 480, 525.0, R_WC, -R_WC @ (plane.offset * plane.normal))
    params = scenario.Perception(workspace=[[-1.5, -1.5, -0.02], [1.5, 1.5, 0.6]])
    found = segment(colours, depth, 0.0, Grid.of(view, 2), params)
    assert found.planes and abs(found.table[2]) < 2e-3

    label = found.label_image
    on_object, claimed = truth >= 20, label >= 0
    assert (on_object & claimed).sum() / on_object.sum() > 0.97
    assert (on_object & claimed).sum() / (claimed & (truth > 0)).sum() > 0.99
    scores = []
    for thing in np.unique(truth[on_object]):
        on = truth == thing
        scores.append(
            max((on & (label == k)).sum() / (on | ((label == k) & (truth > 0))).sum() for k in range(found.count))
        )
    assert np.mean(scores) > least
