"""A pose from a cloud of points, of lidar or depth camera, by ICP with noise per point."""

from __future__ import annotations

from typing import Final

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import cKDTree

from twin_diagram.errors import TwinError
from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.quaternions import exp
from twin_diagram.estimation.sensors.body_pose import BodyPose
from twin_diagram.signals import Array

FEWEST: Final = 12
"""Points with a partner that make a pose."""


class CloudError(TwinError):
    """A cloud that gives no pose: too few points, or none near the model."""


class DepthCloud(BodyPose):
    """The pose of a frame on the arm from measured points, aligned with known points of its surface.

    `align` turns a cloud into z and R for `Ekf.update`:

        z, R = depth.align(points_W, p_WS, q)
        ekf.update(depth, z, t, R)

    A point at distance r from the sensor has variance
    std_0² + (growth r²)² along its surface's normal (section 3.3, lidar, whose k · distance² is taken as a deviation);
    R is that of the weighted fit, plus `floor`², which averaging does not remove: points share their calibration.

    Attributes:
        reach: a point farther than this from the surface is not of it [m].
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str,
        surface: Array,
        normals: Array,
        *,
        X_BO: RigidTransform | None = None,
        std_0: float = 0.001,
        growth: float = 0.002,
        floor_p: float = 0.0005,
        floor_r: float = 0.002,
        reach: float = 0.03,
        iterations: int = 10,
        name: str = "depth",
    ) -> None:
        """Makes the sensor.

        Args:
            terms: the arm.
            body: the link or frame B that O is fixed to.
            surface: (M, 3) points of the surface in O [m].
            normals: (M, 3) outward, of length 1.
            X_BO: pose of O on B; B's own frame where None.
            std_0: of a point that is near [m].
            growth: of a point's deviation with distance squared [1/m].
            floor_p: error that all points share [m].
            floor_r: likewise, of the orientation [rad].
            reach: a point farther than this from the surface is not of it [m].
            iterations: of ICP at most.
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
            CloudError: points and normals do not fit.
        """
        super().__init__(terms, body, X_BO=X_BO, std_p=floor_p, std_r=floor_r, name=name)
        surface, normals = np.asarray(surface, dtype=float), np.asarray(normals, dtype=float)
        if surface.ndim != 2 or surface.shape[1] != 3 or surface.shape != normals.shape or len(surface) < FEWEST:
            raise CloudError(f"{name}: surface {surface.shape} and normals {normals.shape}: both must be (M, 3)")
        self._surface, self._normals = surface, normals
        self._tree = cKDTree(surface)
        self._std_0, self._growth, self.reach, self._iterations = std_0, growth, reach, iterations

    def variance(self, range_: Array) -> Array:
        """Of points at distances (K,) [m²]."""
        return np.asarray(self._std_0**2 + (self._growth * range_**2) ** 2)

    def align(self, points: Array, sensor_origin: Array, q: Array) -> tuple[Array, Array]:
        """Aligns a cloud, from the pose that q predicts.

        Args:
            points: (K, 3) in W [m]; those that are not finite are left out.
            sensor_origin: (3,) of the sensor in W [m].
            q: (n,) joint angles to start from [rad].

        Returns:
            z (7,) and R (6, 6) for `Ekf.update`.

        Raises:
            CloudError: fewer than `FEWEST` points near the surface, or a fit that they do not determine.
        """
        points = np.asarray(points, dtype=float)
        points = points[np.all(np.isfinite(points), axis=1)]
        R_WO, p_WO = self.frame.pose(q)
        range_ = np.linalg.norm(points - sensor_origin, axis=1)
        weight_of = 1.0 / self.variance(range_)
        information = np.zeros((6, 6))
        for step in range(self._iterations):
            near, index = self._partners((points - p_WO) @ R_WO, (sensor_origin - p_WO) @ R_WO)
            if near.sum() < FEWEST:
                raise CloudError(f"{self.name}: {int(near.sum())} points lie near the surface; {FEWEST} make a pose")
            n_W = self._normals[index[near]] @ R_WO.T
            arm = points[near] - p_WO
            gap = np.einsum("ij,ij->i", n_W, arm - self._surface[index[near]] @ R_WO.T)
            J = np.hstack([np.cross(arm, n_W), n_W])
            # Cauchy's weight: what is not of the surface must not pull.
            weight = weight_of[near] / (1.0 + gap**2 * weight_of[near] / 9.0)
            information = (J * weight[:, None]).T @ J
            if np.linalg.cond(information) > 1e12:
                raise CloudError(f"{self.name}: the points do not determine the pose")
            change = np.linalg.solve(information, J.T @ (weight * gap))
            R_WO, p_WO = RotationMatrix(Quaternion(exp(change[:3]))).matrix() @ R_WO, p_WO + change[3:]
            if step > 0 and np.linalg.norm(change[3:]) < 1e-6 and np.linalg.norm(change[:3]) < 1e-6:
                break
        return np.concatenate([RotationMatrix(R_WO).ToQuaternion().wxyz(), p_WO]), np.linalg.inv(
            information
        ) + self._noise

    def _partners(self, points: Array, origin: Array) -> tuple[np.ndarray, np.ndarray]:
        """Which points (K, 3) in O are of the surface (K,), and the surface's point for each (K,); seen from origin."""
        distance, index = self._tree.query(points, distance_upper_bound=self.reach)
        return np.isfinite(distance), index


BESIDE: Final = 0.01
"""A beam that passes a point of the surface by less than this met it [m]."""
ALONG: Final = 0.1
"""Weight of distance along the beam beside distance across it, where several surfaces lie behind each other."""


class Lidar(DepthCloud):
    """A `DepthCloud` with a lidar's figures: 1 cm near, growing with distance squared (section 3.3).

    So much noise is as large as the link, and the nearest point of its surface is often not the one that was met; but a
    lidar errs along its beam and hardly across it. So a point's partner is what its beam meets of the side that faces
    the lidar.
    """

    def __init__(
        self, terms: ArmTerms, body: str, surface: Array, normals: Array, *, name: str = "lidar", **tuning: float
    ) -> None:
        """As `DepthCloud`, whose arguments `tuning` overrides."""
        figures: dict[str, float] = {"std_0": 0.01, "growth": 0.005, "reach": 0.06, **tuning}
        super().__init__(terms, body, surface, normals, name=name, **figures)  # type: ignore[arg-type]

    def _partners(self, points: Array, origin: Array) -> tuple[np.ndarray, np.ndarray]:
        away = self._surface - origin
        facing = np.flatnonzero(np.einsum("ij,ij->i", self._normals, away) < 0.0)
        if not len(facing):
            return np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=int)
        middle = float(np.median(np.linalg.norm(away[facing], axis=1)))
        distance, index = cKDTree(_beams(away[facing], middle)).query(
            _beams(points - origin, middle), distance_upper_bound=float(np.hypot(BESIDE, ALONG * self.reach))
        )
        near = np.isfinite(distance)
        index = facing[np.minimum(index, len(facing) - 1)]
        near &= np.abs(np.linalg.norm(points - origin, axis=1) - np.linalg.norm(away[index], axis=1)) < self.reach
        return near, index


def _beams(away: Array, middle: float) -> Array:
    """(K, 4) where beams pass at a distance from the lidar, and how far along them a point (K, 3) lies [m]."""
    range_ = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    return np.hstack([away * (middle / range_), ALONG * range_])
