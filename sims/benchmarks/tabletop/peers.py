"""Open3D's plane and clusters on the same pixels, and how labels are scored."""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt

from tabletop.casting import o3d
from twin_diagram.perception.segmentation.segmentation import Grid
from twin_diagram.scenario import Perception


def ransac_and_dbscan(
    depth: npt.NDArray[np.float32], grid: Grid, params: Perception
) -> tuple[npt.NDArray[np.int64], int, float]:
    """Return labels (H, W), how many things, and milliseconds of processor time of Open3D's pipeline.

    The cloud is made and cut to the workspace before the clock starts.
    """
    points = grid.camera.p_WC + depth[..., None].astype(float) * grid.rays
    low, high = np.asarray(params.workspace, dtype=float)
    inside = (depth > 0) & ((points > low) & (points < high)).all(axis=2)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[inside]))
    o3d.utility.random.seed(1)
    start = time.process_time()
    _, on_plane = cloud.segment_plane(
        distance_threshold=max(0.006, params.table_clearance), ransac_n=3, num_iterations=100
    )
    rest = cloud.select_by_index(on_plane, invert=True)
    label = np.asarray(rest.cluster_dbscan(eps=params.cluster_gap, min_points=10), dtype=np.int64)
    size = np.bincount(label[label >= 0], minlength=1)
    number = np.where(size >= params.smallest, np.cumsum(size >= params.smallest) - 1, -1)
    spent = 1e3 * (time.process_time() - start)
    off_plane = np.ones(len(points[inside]), dtype=bool)
    off_plane[on_plane] = False
    flat = np.full(len(off_plane), -1, dtype=np.int64)
    flat[off_plane] = np.where(label >= 0, number[np.maximum(label, 0)], -1)
    result = np.full(depth.shape, -1, dtype=np.int64)
    result[inside] = flat
    return result, int((size >= params.smallest).sum()), spent


def intersection_over_union(label: npt.NDArray[np.integer], owner: npt.NDArray[np.integer]) -> float:
    """Return the mean over things (owner ≥ 0) of the best label's intersection over union."""
    scores = []
    for thing in np.unique(owner[owner >= 0]):
        on = owner == thing
        rivals = np.unique(label[on & (label >= 0)])
        scores.append(max((np.sum(on & (label == k)) / np.sum(on | (label == k)) for k in rivals), default=0.0))
    return float(np.mean(scores))
