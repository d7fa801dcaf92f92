"""A pose from a cloud of points, of lidar or depth camera, by ICP with noise per point."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Fit:
    """Where ICP ended.

    Attributes:
        R_WO, p_WM: the pose; M is the surface's middle.
        information: (6, 6) of a rotation vector about M and a translation, in W.
        misfit: mean weighted square of the gaps; 1 where they are as large as the points' noise.
        count: of points that have a partner.
    """

    R_WO: Array
    p_WM: Array
    information: Array
    misfit: float
    count: int


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
        self._middle = 0.5 * (surface.min(axis=0) + surface.max(axis=0))
        self.wide_r, self.wide_p, self.free_r, self.free_p = 0.2, 0.03, 1.0, 0.3
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
        fit = self._fit(points, sensor_origin, R_WO, p_WO)
        return self._claim(fit)

    def _fit(self, points: Array, origin: Array, R0: Array, p0: Array) -> Fit:
        """ICP from one pose; about the surface's middle M."""
        R_WO, p_WM = R0, p0 + R0 @ self._middle
        range_ = np.linalg.norm(points - origin, axis=1)
        variance = self.variance(range_)
        held = np.repeat([self.wide_r**-2, self.wide_p**-2], 3)
        moved = np.zeros(6)
        for _ in range(self._iterations):
            p_WO = p_WM - R_WO @ self._middle
            near, index = self._partners((points - p_WO) @ R_WO, (origin - p_WO) @ R_WO)
            if near.sum() < FEWEST:
                raise CloudError(f"{self.name}: {int(near.sum())} points lie near the surface; {FEWEST} make a pose")
            n_W = self._normals[index[near]] @ R_WO.T
            arm = points[near] - p_WM
            gap = np.einsum("ij,ij->i", n_W, arm - (self._surface[index[near]] - self._middle) @ R_WO.T)
            J = np.hstack([np.cross(arm, n_W), n_W])
            along = np.einsum("ij,ij->i", n_W, points[near] - origin) / range_[near]
            weight_of = 1.0 / self._across(variance[near], along)
            # Cauchy's weight: what is not of the surface must not pull.
            weight = weight_of / (1.0 + gap**2 * weight_of / 9.0)
            information = (J * weight[:, None]).T @ J
            change = np.linalg.solve(information + np.diag(held), J.T @ (weight * gap) - held * moved)
            moved = moved + change
            R_WO, p_WM = RotationMatrix(Quaternion(exp(change[:3]))).matrix() @ R_WO, p_WM + change[3:]
            if np.linalg.norm(change[3:]) < 1e-5 and np.linalg.norm(change[:3]) < 1e-4:
                break
        misfit = float(np.sum(weight * gap**2)) / max(1, len(gap) - 6)
        return Fit(R_WO, p_WM, information, misfit, len(gap))

    def _across(self, variance: Array, along: Array) -> Array:
        """Variance of gaps (K,) along the normal [m²]."""
        return variance

    def _claim(self, fit: Fit) -> tuple[Array, Array]:
        bound = np.repeat([self.free_r**-2, self.free_p**-2], 3)
        R_M = max(1.0, fit.misfit) * np.linalg.inv(fit.information + np.diag(bound))
        arm = fit.R_WO @ self._middle
        A = np.eye(6)
        A[3:, :3] = [[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]]
        z = np.concatenate([RotationMatrix(fit.R_WO).ToQuaternion().wxyz(), fit.p_WM - arm])
        return z, A @ R_M @ A.T + self._noise

    def _partners(self, points: Array, origin: Array) -> tuple[np.ndarray, np.ndarray]:
        """Which points (K, 3) in O are of the surface (K,), and the surface's point for each (K,); seen from origin."""
        distance, index = self._tree.query(points, distance_upper_bound=self.reach)
        return np.isfinite(distance), index


BESIDE: Final = 0.01
"""A beam that passes a point of the surface by less than this met it [m]."""
STEP: Final = 0.02
"""A surface that lies behind another by more than this is hidden by it [m]."""
LATERAL: Final = 0.004


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
        self.beside, self.mask = 0.03, np.ones(len(surface), dtype=bool)

    def _across(self, variance: Array, along: Array) -> Array:
        return np.where(np.abs(along) > 0.35, variance, 1e6)

    def _partners(self, points: Array, origin: Array) -> tuple[np.ndarray, np.ndarray]:
        away = self._surface - origin
        facing = np.flatnonzero((np.einsum("ij,ij->i", self._normals, away) < 0.0) & self.mask)
        if len(facing) < FEWEST:
            return np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=int)
        far, range_ = np.linalg.norm(away[facing], axis=1), np.linalg.norm(points - origin, axis=1)
        lateral, index = first_met(away[facing] / far[:, None], far, (points - origin) / range_[:, None])
        middle = float(np.median(far))
        near = (lateral * middle < self.beside) & (
            np.abs(range_ - far[index]) < self.reach + 3.0 * np.sqrt(self.variance(range_))
        )
        return near, facing[index]


def first_met(ways: Array, far: Array, beams: Array) -> tuple[Array, np.ndarray]:
    """Which of points that lie along `ways` (M, 3) at distances `far` (M,) [m] beams (K, 3) from the same origin meet.

    Returns:
        Angles (K,) by which they pass it [rad], and its index (K,).
    """
    angle, index = cKDTree(ways).query(beams, k=min(6, len(ways)))
    # Of the few that a beam passes closely, those that lie behind another are hidden.
    hidden = far[index] > far[index].min(axis=1, keepdims=True) + STEP
    best = np.argmin(np.where(hidden, np.inf, angle), axis=1)
    rows = np.arange(len(beams))
    return angle[rows, best], index[rows, best]
