"""Points in W from a depth image, and the pinhole camera that links the two."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform

from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.normal_kernels import points_with_normals
from twin_diagram.scenario import Camera
from twin_diagram.scenario.lenses import colour_lens, depth_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout
from twin_diagram.signals.lens import Lens, unit_rays

DepthImage = npt.NDArray[np.float32]
ColourImage = npt.NDArray[np.uint8]

JUMP: Final = 0.02
"""Over a jump in depth the difference of neighbours belongs to no surface [m], if it is 2.2 of their distances, too:
pixels of far or small images lie farther apart than this."""


@dataclass(frozen=True)
class Pinhole:
    """A calibrated camera: its size [pixel], focal length [pixel], X_WC, and what its data sheet says of depth.

    Pixel (u, v) has its centre at (u, v); so the image's centre is at ((width - 1) / 2, (height - 1) / 2), which is the
    principal point where no `lens` says another.

    Attributes:
        width, height: of its images [px].
        focal: focal length [px]; the mean of fx and fy where there is a `lens`.
        R_WC, p_WC: (3, 3), (3,) its optical frame C (X right, Y down, Z forward) in W.
        lens: fx, fy, cx, cy and distortion; None: square pixels about the image's centre.
        depth_noise: standard deviation of depth, a function of depth.
    """

    width: int
    height: int
    focal: float
    R_WC: Array
    p_WC: Array
    lens: Lens | None = None
    depth_noise: DepthSigma = field(default_factory=DepthSigma)

    @staticmethod
    def from_scenario(camera: Camera) -> Pinhole:
        """Return the camera as the twin was told of it: that of the colours.

        Raises:
            ScenarioError: intrinsics or a data sheet that cannot be.
        """
        return Pinhole.behind(colour_lens(camera), pose(camera.X_WC), DepthSigma.of(camera.depth_noise))

    @staticmethod
    def of_depth(camera: Camera) -> Pinhole:
        """Return the camera that takes the depth images, as the twin was told of it; see `from_scenario`."""
        if camera.depth is None:
            return Pinhole.from_scenario(camera)
        X_WD = pose(camera.X_WC) @ pose(camera.depth.X_DC).inverse()
        return Pinhole.behind(depth_lens(camera), X_WD, DepthSigma.of(camera.depth_noise))

    @staticmethod
    def behind(lens: Lens, X_WC: RigidTransform, depth_noise: DepthSigma | None = None) -> Pinhole:
        """Return the camera behind a lens, at X_WC."""
        plain = Lens.centred(lens.width, lens.height, lens.fx)
        return Pinhole(
            lens.width,
            lens.height,
            0.5 * (lens.fx + lens.fy),
            X_WC.rotation().matrix().copy(),
            X_WC.translation().copy(),
            None if lens == plain else lens,
            depth_noise or DepthSigma(),
        )

    @property
    def straight(self) -> Pinhole:
        """The camera that takes the same pictures without distortion."""
        return replace(self, lens=self.optics.straight) if self.optics.distortion else self

    @cached_property
    def optics(self) -> Lens:
        """Its lens, told or plain."""
        return self.lens or Lens.centred(self.width, self.height, self.focal)

    @property
    def X_WC(self) -> RigidTransform:
        """Pose of the optical frame C (X right, Y down, Z forward) in W."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.R_WC, self.p_WC
        return RigidTransform(matrix)

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point (u, v) [pixel]."""
        return self.optics.centre

    @property
    def fx(self) -> float:
        """Focal length in x [pixel]."""
        return self.optics.fx

    @property
    def fy(self) -> float:
        """Focal length in y [pixel]."""
        return self.optics.fy

    def rays(self, stride: int = 1) -> Array:
        """Return (h, w, 3): the vector in W from the camera to the point at depth 1 m, for every `stride`-th pixel."""
        return np.asarray(np.ascontiguousarray(unit_rays(self.optics)[::stride, ::stride]) @ self.R_WC.T)

    def project(self, points_W: Array) -> tuple[Array, Array, Array]:
        """Return the pixel coordinates u, v and the depth of points (..., 3)."""
        x, y, depth = np.moveaxis((points_W - self.p_WC) @ self.R_WC, -1, 0)
        lens = self.optics
        z = np.maximum(depth, 1e-6)
        if lens.distortion:
            u, v = lens.pixel(x / z, y / z)
        else:
            u, v = x * (lens.fx / z) + lens.cx, y * (lens.fy / z) + lens.cy
        return u, v, depth


def back_project(depth: DepthImage, rays: Array, p_WC: Array) -> Array:
    """Return the points (h, w, 3) in W of a depth image whose pixels look along `rays`; p_WC without depth."""
    return p_WC + depth[..., None].astype(float) * rays


def surface_at(
    depth: DepthImage, rays: Array, at: tuple[npt.NDArray[np.int64], ...], p_WC: Array
) -> tuple[Array, Array]:
    """Return the points of a depth image at some pixels, and the surface's normals there, towards the camera.

    Args:
        depth: (h, w) [m], 0 where there is none.
        rays: (h, w, 3) along which pixels look, as of `Pinhole.rays`.
        at: row and column indices (N,) of pixels with depth.
        p_WC: the camera's place.

    Returns:
        Points (N, 3) in W and unit normals (N, 3): of differences over two pixels to either side; the direction to the
        camera where neighbours lack depth or lie across an edge.
    """
    row, column = (np.ascontiguousarray(one, dtype=np.int64) for one in at)
    points, normals = np.empty((len(row), 3)), np.empty((len(row), 3))
    image, ways = np.asarray(depth, dtype=np.float32), np.asarray(rays, dtype=float)
    where = one_layout(np.asarray(p_WC, dtype=float))
    points_with_normals(one_layout(image), one_layout(ways), row, column, where, JUMP, points, normals)
    return points, normals
