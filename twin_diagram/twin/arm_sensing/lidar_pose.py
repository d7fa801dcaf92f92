"""A lidar as a sensor of the arm: where a link is, by the points that were measured of it. It needs no camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.sensors import LIDAR_NOISE, LidarPose, PointNoise
from twin_diagram.runtime.timing import timed
from twin_diagram.signals.arrays import Array
from twin_diagram.twin.arm_sensing.cloud_measurement import SIZE, feed, measured, near
from twin_diagram.twin.arm_sensing.link_surface import Points


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    most: int = 2000
    """Points that are aligned, about."""


TUNING = Tuning()


class ArmScan(LeafSystem):
    """Aligns a lidar's cloud with the known surface of a link.

    .. pydrake_system::

        name: ArmScan
        input_ports:
        - point_cloud
        - scan_time
        - arm_state
        output_ports:
        - measurement
        - measurement_time

    `point_cloud` (PointCloud with xyzs, m, in the lidar's frame S; points that are not finite are left out) is the
    newest scan, `scan_time` (1) when it was taken [s], negative before the first, `arm_state` x̂ = (q, v) now.
    `measurement` (43): X_WO of the link as quaternion wxyz and position [m], then R (36) row by row, of a rotation
    vector [rad] and a translation in W, both as of the scan; its noise grows with distance squared, see `LidarPose`.
    NaN where too little of the link was met. `measurement_time` (1) is `scan_time`. Computed when asked for: no state,
    no rate, no latency of its own. The scan is older than x̂, so the search begins at q - v·(t - scan_time); that the
    arm moves during a scan is not reckoned with.
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str,
        surface: Points,
        X_WS: RigidTransform,
        *,
        name: str = "lidar",
        others: Mapping[str, Points] | None = None,
        noise: PointNoise = LIDAR_NOISE,
    ) -> None:
        """Build the system.

        Args:
            terms: the arm's.
            body: the link.
            surface: points (M, 3) and outward normals (M, 3) of the link, in its own frame:
                `link_surface.link_surface`.
            X_WS: where the lidar stands.
            name: for messages.
            others: surfaces of the arm's other links, by their names: beams that may meet
                one of them are left out.
            noise: of the lidar's points.

        Raises:
            ModelError: there is no such link.
            CloudError: points and normals do not fit.
        """
        super().__init__()
        self._sensor = LidarPose(terms, body, surface[0], surface[1], name=name, noise=noise)
        self._R_WS, self._p_WS = X_WS.rotation().matrix(), X_WS.translation()
        self._middle = 0.5 * (surface[0].min(axis=0) + surface[0].max(axis=0))
        self._radius = float(np.linalg.norm(surface[0] - self._middle, axis=1).max()) + self._sensor.reach
        self._others = [(LinkFrame(terms, link), points) for link, points in (others or {}).items()]
        self._cloud = self.DeclareAbstractInputPort("point_cloud", Value(PointCloud(0)))
        self._time = self.DeclareVectorInputPort("scan_time", 1)
        self._arm = self.DeclareVectorInputPort("arm_state", 2 * terms.n)
        known = {self._cloud.ticket(), self._time.ticket(), self._arm.ticket(), self.time_ticket()}
        self.DeclareVectorOutputPort("measurement", SIZE, self._calc, prerequisites_of_calc=known)
        self.DeclareVectorOutputPort(
            "measurement_time", 1, self._calc_time, prerequisites_of_calc={self._time.ticket()}
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        ekf: AdaptiveEkf,
        sensor: str,
        body: str,
        surface: Points,
        X_WS: RigidTransform,
        others: Mapping[str, Points] | None = None,
        noise: PointNoise = LIDAR_NOISE,
    ) -> ArmScan:
        """Add one to a Diagram and give a filter its measurements; its first two inputs are left to connect.

        Args:
            builder: that holds the filter.
            ekf: with a sensor of kind `body_pose` on the same link.
            sensor: that one's name.
            body: the link.
            surface: of it, as for the constructor.
            X_WS: where the lidar stands.
            others: surfaces of the other links, as for the constructor.
            noise: of the lidar's points.
        """
        scan = builder.AddNamedSystem(
            f"{sensor}_scan", ArmScan(ekf.ekf.terms, body, surface, X_WS, name=sensor, others=others, noise=noise)
        )
        builder.Connect(ekf.GetOutputPort("arm_state"), scan.GetInputPort("arm_state"))
        feed(builder, scan.GetOutputPort("measurement"), ekf, sensor)
        builder.Connect(scan.GetOutputPort("measurement_time"), ekf.GetInputPort(f"{sensor}.time"))
        return scan

    @timed("ArmScan")
    def _calc(self, context: Context, output: BasicVector) -> None:
        def align(q: Array) -> tuple[Array, Array]:
            return self.align(cast(PointCloud, self._cloud.Eval(context)).xyzs().T, q)

        taken, state = float(cast(Array, self._time.Eval(context))[0]), cast(Array, self._arm.Eval(context))
        output.SetFromVector(cast(Any, measured(taken, context.get_time(), state, align)))

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Array, self._time.Eval(context)))

    def align(self, points: Array, q: Array) -> tuple[Array, Array]:
        """Return the pose z (7,) and R (6, 6) from points (K, 3) in S, beginning at q (n,).

        Raises:
            CloudError: too little of the link was met.
        """
        points = np.asarray(points, dtype=float)
        points_W = points[np.isfinite(points).all(axis=1)] @ self._R_WS.T + self._p_WS
        R_WO, p_WO = self._sensor.frame.pose(q)
        points_W = near(points_W, p_WO + R_WO @ self._middle, self._radius, TUNING.most)
        return self._sensor.align(points_W, self._p_WS, q, self._beside(q))

    def _beside(self, q: Array) -> Points | None:
        """Return the other links' surfaces in W."""
        if not self._others:
            return None
        poses = [frame.pose(q) for frame, _ in self._others]
        surfaces = [surface for _, surface in self._others]
        return (
            np.concatenate([points @ R.T + p for (R, p), (points, _) in zip(poses, surfaces, strict=True)]),
            np.concatenate([normals @ R.T for (R, _), (_, normals) in zip(poses, surfaces, strict=True)]),
        )
