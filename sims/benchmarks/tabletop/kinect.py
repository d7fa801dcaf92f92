"""The published Kinect clouds as images of a camera above the table that is found in them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from tabletop.casting import o3d
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.planes import Plane, Told, find_plane
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario import Perception

FOCAL = 525.0
"""Of the Kinect's published clouds [pixel]; x / z of every point says so."""


def sigma(z: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the standard deviation of a Kinect's depth [m]."""
    return np.asarray(0.0012 + 0.0019 * (np.asarray(z, dtype=float) - 0.4) ** 2)


@dataclass(frozen=True)
class Scene:
    """One cloud.

    Attributes:
        name: of the file.
        rgb: (480, 640, 3)
        depth: (480, 640) [m], 0 where there is none.
        truth: (480, 640) 0: no depth, 1 to 9: table, from 20 on: things; parts that are disjoint in the image differ.
        plane: the table, in the camera's frame.
    """

    name: str
    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    truth: npt.NDArray[np.int64]
    plane: Plane

    @staticmethod
    def read(file: Path) -> Scene:
        """Read a cloud and find its table; nothing is told of it."""
        cloud = o3d.t.io.read_point_cloud(str(file))
        depth = np.nan_to_num(cloud.point.positions.numpy()[:, 2]).reshape(480, 640).astype(np.float32)
        rgb = cloud.point.colors.numpy().reshape(480, 640, 3)
        truth = cloud.point.label.numpy().reshape(480, 640).astype(np.int64)
        plane = find_plane(depth, Pinhole(640, 480, FOCAL, np.eye(3), np.zeros(3)).rays(), np.zeros(3), sigma, Told())
        if plane is None:
            raise SystemExit(f"{file}: no table found")
        return Scene(file.stem, rgb, depth, truth, plane)

    def table_off(self) -> float:
        """Return the RMS distance of the table's labelled points from the plane that was found [m]."""
        points = self.depth[..., None] * Pinhole(640, 480, FOCAL, np.eye(3), np.zeros(3)).rays()
        on = (self.truth >= 1) & (self.truth < 10)
        return float(np.sqrt(np.mean(self.plane.height(points[on]) ** 2)))

    def segmented(self, params: Perception) -> Segments:
        """Take the image apart in a frame on the table."""
        x = np.cross([0.0, 0.0, 1.0], self.plane.normal)
        x /= np.linalg.norm(x)
        R_WC = np.stack([x, np.cross(self.plane.normal, x), self.plane.normal])
        view = Pinhole(640, 480, FOCAL, R_WC, -R_WC @ (self.plane.offset * self.plane.normal))
        return segment(self.rgb, self.depth, 0.0, Grid.of(view, params.stride), params)

    def scores(self, found: Segments) -> dict[int, float]:
        """Return each thing's best intersection over union, among pixels that have a label."""
        label = found.label_image
        truth = self.truth[:: found.stride, :: found.stride]
        result = {}
        for thing in np.unique(truth[truth >= 20]):
            on = truth == thing
            rivals = np.unique(label[on & (label >= 0)])
            union = [np.sum(on | ((label == k) & (truth > 0))) for k in rivals]
            both = [np.sum(on & (label == k)) for k in rivals]
            result[int(thing)] = max((float(b / u) for b, u in zip(both, union, strict=True)), default=0.0)
        return result


def touching(scene: Scene) -> set[int]:
    """Return the things within 5 pixels of which another one shows."""
    close = set()
    things = [int(k) for k in np.unique(scene.truth[scene.truth >= 20])]
    for thing in things:
        around = cv2.dilate((scene.truth == thing).astype(np.uint8), np.ones((11, 11), np.uint8)) > 0
        if ((scene.truth >= 20) & (scene.truth != thing) & around).any():
            close.add(thing)
    return close
