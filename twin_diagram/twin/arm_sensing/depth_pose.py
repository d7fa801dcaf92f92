"""The twin's camera as a sensor of the arm: where a link is, by the points that are seen of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.sensors import DepthCloud, PointNoise
from twin_diagram.model.model import Model
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.pinhole import DepthImage, Pinhole, back_project
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario import Camera, SensorSpec, poses
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.signals.arrays import Array
from twin_diagram.twin.arm_sensing.cloud_measurement import SIZE, measured, near
from twin_diagram.twin.arm_sensing.link_surface import Points


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    reach: float = 0.01
    """A point farther than this from the surface is not of it, but of the next link or of the fingers [m]."""

    most: int = 1000
    """Points that are aligned, about."""

    floor: tuple[float, ...] = (0.001, 0.005)
    """Error that all points share, where the filter is not told: of calibration and shape [m], [rad]."""


TUNING = Tuning()


class ArmCloud(LeafSystem):
    """Aligns what a depth image shows of a link with the link's known surface.

    .. pydrake_system::

        name: ArmCloud
        input_ports:
        - depth_image
        - image_time
        - arm_state
        output_ports:
        - measurement

    `depth_image` (ImageDepth32F, m, 0 where there is none) is the newest of the twin's camera, `image_time` (1) its
    capture time [s], negative before the first, `arm_state` x̂ = (q, v) now. `measurement` (43): X_WO of the sensor's
    frame on the link as quaternion wxyz and position [m], then R (36) row by row, of a rotation vector [rad] and a
    translation in W, both as of the capture. NaN where too little is seen. Computed when asked for: no state, no rate,
    no latency of its own. The image is older than x̂, so the search begins at q - v·(t - image_time).
    """

    def __init__(self, model: Model, spec: SensorSpec, camera: Camera, surface: Points) -> None:
        """Build the system.

        Args:
            model: the twin's.
            spec: of the sensor: link, its frame there, and the errors that all points share.
            camera: the twin's calibration.
            surface: points (M, 3) and normals (M, 3) of the link, in its own frame.

        Raises:
            ModelError: there is no such link.
        """
        super().__init__()
        terms = ArmTerms.from_model(model)
        X_BO = poses.pose(spec.X_BS)
        R_OB = X_BO.rotation().matrix().T
        points, normals = ((surface[0] - X_BO.translation()) @ R_OB.T, surface[1] @ R_OB.T)
        floor_p, floor_r = spec.std or TUNING.floor
        self._sensor = DepthCloud(
            terms,
            spec.body,
            points,
            normals,
            X_BO=X_BO,
            noise=point_noise(camera, floor_p, floor_r),
            reach=TUNING.reach,
            name=spec.name,
        )
        self._camera = Pinhole.of_depth(camera)
        scale = 1.0 if camera.depth is None else camera.depth.scale
        self._rays = self._camera.rays() * scale
        self._middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        self._radius = float(np.linalg.norm(points - self._middle, axis=1).max()) + TUNING.reach
        n = terms.n
        self._depth = self.DeclareAbstractInputPort("depth_image", Value[ImageDepth32F]())
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self._arm = self.DeclareVectorInputPort("arm_state", 2 * n)
        known = {self._depth.ticket(), self._time.ticket(), self._arm.ticket(), self.time_ticket()}
        self.DeclareVectorOutputPort("measurement", SIZE, self._calc, prerequisites_of_calc=known)

    @timed("ArmCloud")
    def _calc(self, context: Context, output: BasicVector) -> None:
        def align(q: Array) -> tuple[Array, Array]:
            return self.align(cast(ImageDepth32F, self._depth.Eval(context)).data[..., 0], q)

        taken, state = float(cast(Array, self._time.Eval(context))[0]), cast(Array, self._arm.Eval(context))
        output.SetFromVector(cast(Any, measured(taken, context.get_time(), state, align)))

    def align(self, depth: DepthImage, q: Array) -> tuple[Array, Array]:
        """Return the pose z (7,) and R (6, 6) from a depth image (H, W), beginning at q (n,).

        Raises:
            CloudError: too little of the link is seen.
        """
        R_WO, p_WO = self._sensor.frame.pose(q)
        middle_W = p_WO + R_WO @ self._middle
        part = window(self._camera, middle_W, self._radius)
        seen = depth[part] > 0.0
        points = back_project(depth[part][seen], self._rays[part][seen], self._camera.p_WC)
        return self._sensor.align(near(points, middle_W, self._radius, TUNING.most), self._camera.p_WC, q)


def point_noise(camera: Camera, floor_p: float, floor_r: float) -> PointNoise:
    """Return how the points of a depth image err: as usual, or worse where the camera's data sheet says so.

    Args:
        camera: the twin's, with its data sheet.
        floor_p: error that all points share, but for the calibration's [m].
        floor_r: the same of orientation [rad].
    """
    sheet, usual, doubt = DepthSigma.of(camera.depth_noise), PointNoise(), calibration_error(camera)
    aside = (doubt.shift, 0.5 * sum(camera.depth_range) * doubt.turn, 0.5 * sum(camera.depth_range) * doubt.depth_scale)
    return PointNoise(
        std_0=max(usual.std_0, sheet.floor),
        growth=max(usual.growth, sheet.growth),
        floor_p=float(np.sqrt(floor_p**2 + np.square(aside).sum() / 3.0)) if any(aside) else floor_p,
        floor_r=float(np.hypot(floor_r, doubt.turn / np.sqrt(3.0))),
    )


def window(camera: Pinhole, middle_W: Array, radius: float) -> tuple[slice, slice]:
    """Return the rows and columns of an image that hold a ball about a point.

    Half a width is f · r / (depth − r) · √(1 + t²), with t the tangent of the angle that the point lies aside by.

    Args:
        camera: that sees it.
        middle_W: (3,) in W [m].
        radius: r [m].

    Returns:
        Empty where the ball is out of sight or reaches to the camera's plane.
    """
    u, v, away = (float(x) for x in camera.project(middle_W))
    if away <= radius:
        return slice(0, 0), slice(0, 0)
    reach, centre = radius / (away - radius), camera.centre
    across = reach * float(np.hypot(camera.fx, u - centre[0]))
    down = reach * float(np.hypot(camera.fy, v - centre[1]))
    rows = np.clip([v - down, v + down + 1.0], 0, camera.height).astype(int)
    columns = np.clip([u - across, u + across + 1.0], 0, camera.width).astype(int)
    return slice(*rows), slice(*columns)
