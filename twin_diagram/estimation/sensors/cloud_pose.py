"""A pose from a cloud of points, of lidar or depth camera, by ICP with noise per point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import cKDTree

from twin_diagram.errors import TwinError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.sensors.body_pose import BodyPose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.rotations import exp


@dataclass(frozen=True)
class Tuning:
    """How points are aligned: chosen by hand; the median is a quantile of χ².

    `tests/estimation/sensors` shows poses beside what is claimed of them.
    """

    fewest: int = 12
    """Points with a partner that make a pose."""

    settled: float = 1e-3
    """Steps of less than this share of `search` end the search."""

    median: float = 0.4549
    """Of the square of a normal variate."""

    search: tuple[float, ...] = (0.2, 0.03)
    """How far the search goes from where it began where the points say nothing [rad], [m]; a deviation."""

    nothing: tuple[float, ...] = (1.0, 0.3)
    """Deviation that is claimed where they say nothing [rad], [m]: an order above what is unknown of an arm's link."""

    iterations: int = 10
    """Of ICP at most: what has not settled by then gets the scatter of its last steps as noise."""

    strange: float = 3.0
    """Times the noise that is told; points that lie farther off are of something else."""


TUNING = Tuning()


class CloudError(TwinError):
    """A cloud that gives no pose: too few points, or none near the model."""


@dataclass(frozen=True)
class PointNoise:
    """What is known of how a sensor's points err.

    Attributes:
        std_0: deviation of a point that is near [m].
        growth: of a point's deviation with distance squared [1/m].
        floor_p: error that all points share [m].
        floor_r: likewise, of the orientation [rad].
    """

    std_0: float = 0.001
    growth: float = 0.002
    floor_p: float = 0.0005
    floor_r: float = 0.002


@dataclass(frozen=True)
class Partners:
    """What points (K,) were found to have met.

    Attributes:
        near: which have a partner (K,).
        index: of the surface's points (K,).
        doubt: along the sensor's ray, of what else it may have been (K,) [m].
    """

    near: np.ndarray
    index: np.ndarray
    doubt: Array


@dataclass(frozen=True)
class CloudFit:
    """Where ICP ended.

    Attributes:
        R_WO: rotation (3, 3).
        p_WM: of the surface's middle M (3,) [m].
        information: (6, 6) that the points give of a rotation about M and a translation, in W.
        scatter: (6, 6) of the last steps where it did not settle, else zero.
    """

    R_WO: Array
    p_WM: Array
    information: Array
    scatter: Array


class DepthCloud(BodyPose):
    """The pose of a frame on the arm from measured points, aligned with known points of its surface.

    `align` turns a cloud into z and R for `Ekf.update`:

        z, R = depth.align(points_W, p_WS, q)
        ekf.update(depth, z, t, R)

    A point at distance r from the sensor has variance
    std_0² + (growth r²)² along its surface's normal (section 3.3, lidar, whose k · distance² is taken as a deviation).

    R is how the squared error curves against how it depends on the points (Censi, "An accurate closed-form estimate of
    ICP's covariance", ICRA 2007), which with gaps weighted by their variance is the inverse of their information. Its
    levers are the surface's own points, not those measured: noise in a lever would seem to tell a turn of what is
    round. Where gaps are larger than their noise, R grows by that ratio; a search that does not settle adds the
    scatter of its steps. Where the points say nothing (a cylinder's turn about its axis), z stays with the pose
    predicted and R has `nothing`², so that the filter does not take its own prediction for a measurement.
    `floor_p`² and `floor_r`², which averaging does not remove since points share their calibration, are added.

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
        noise: PointNoise = PointNoise(),
        reach: float = 0.03,
        name: str = "depth",
    ) -> None:
        """Make the sensor.

        Args:
            terms: the arm.
            body: the link or frame B that O is fixed to.
            surface: (M, 3) points of the surface in O [m].
            normals: (M, 3) outward, of length 1.
            X_BO: pose of O on B; B's own frame where None.
            noise: of the points.
            reach: a point farther than this from the surface is not of it [m].
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
            CloudError: points and normals do not fit.
        """
        super().__init__(terms, body, X_BO=X_BO, std_p=noise.floor_p, std_r=noise.floor_r, name=name)
        surface, normals = np.asarray(surface, dtype=float), np.asarray(normals, dtype=float)
        if surface.ndim != 2 or surface.shape[1] != 3 or surface.shape != normals.shape or len(surface) < TUNING.fewest:
            raise CloudError(f"{name}: surface {surface.shape} and normals {normals.shape}: both must be (M, 3)")
        self._surface, self._normals = surface, normals
        self._tree = cKDTree(surface)
        self._middle = 0.5 * (surface.min(axis=0) + surface.max(axis=0))
        self._points, self.reach = noise, reach

    def variance(self, range_: Array) -> Array:
        """Return the variance of points at distances (K,) [m²]."""
        return np.asarray(self._points.std_0**2 + (self._points.growth * range_**2) ** 2)

    def align(self, points: Array, sensor_origin: Array, q: Array) -> tuple[Array, Array]:
        """Align a cloud, from the pose that q predicts.

        Args:
            points: (K, 3) in W [m]; those that are not finite are left out.
            sensor_origin: (3,) of the sensor in W [m].
            q: (n,) joint angles to start from [rad].

        Returns:
            z (7,) and R (6, 6) for `Ekf.update`.

        Raises:
            CloudError: fewer than `fewest` points near the surface, points that are not of it, or a search that went
                astray.
        """
        points = np.asarray(points, dtype=float)
        points = points[np.all(np.isfinite(points), axis=1)]
        return self._claim(self._fit(points, np.asarray(sensor_origin), *self.frame.pose(q), self._tree))

    def _fit(self, points: Array, origin: Array, R_WO: Array, p_WO: Array, known: object) -> CloudFit:
        """ICP from a pose, by points (K, 3) in W; `known` is handed on to `_partners`."""
        held, bounds = np.repeat(np.array(TUNING.search) ** -2.0, 3), np.repeat(TUNING.search, 3)
        p_WM = p_WO + R_WO @ self._middle
        moved: Array = np.zeros(6)
        path: list[Array] = []
        away = points - origin
        range_ = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        variance, rays = self.variance(range_), away / range_[:, None]
        for _ in range(TUNING.iterations):
            p_WO = p_WM - R_WO @ self._middle
            met = self._partners((points - p_WO) @ R_WO, (origin - p_WO) @ R_WO, known)
            near, index = met.near, met.index[met.near]
            if len(index) < TUNING.fewest:
                raise CloudError(f"{self.name}: {len(index)} points lie near the surface; {TUNING.fewest} make a pose")
            n_W = self._normals[index] @ R_WO.T
            arm = (self._surface[index] - self._middle) @ R_WO.T
            gap = np.einsum("ij,ij->i", n_W, points[near] - p_WM - arm)
            J = np.hstack([np.cross(arm, n_W), n_W])
            square = self._square(variance[near], np.einsum("ij,ij->i", n_W, rays[near]), met.doubt[near])
            # Cauchy's weight: what is not of the surface must not pull.
            weight = 1.0 / (square + gap**2 / 9.0)
            information = (J * weight[:, None]).T @ J
            change = np.linalg.solve(information + np.diag(held), J.T @ (weight * gap) - held * moved)
            moved = moved + change
            R_WO, p_WM = RotationMatrix(Quaternion(exp(change[:3]))).matrix() @ R_WO, p_WM + change[3:]
            path.append(moved)
            if np.all(np.abs(change) < TUNING.settled * bounds):
                break
        if np.any(np.abs(moved) > 3.0 * bounds):
            turn, way = (float(np.linalg.norm(part)) for part in (moved[:3], moved[3:]))
            raise CloudError(f"{self.name}: the search went astray, by {way:.3f} m and {turn:.2f} rad: begin nearer")
        ratio = float(np.median(gap**2 / square)) / TUNING.median
        if ratio > TUNING.strange**2:
            off = np.sqrt(ratio)
            raise CloudError(f"{self.name}: the points lie {off:.1f} times their noise off: they are of something else")
        steps = np.array(path[len(path) // 2 :])
        scatter = (
            np.zeros((6, 6)) if len(path) < TUNING.iterations else (steps - moved).T @ (steps - moved) / len(steps)
        )
        return CloudFit(R_WO, p_WM, information / max(1.0, ratio), scatter)

    def _claim(self, fit: CloudFit) -> tuple[Array, Array]:
        """Return the pose (7,) and R (6, 6) of O: a turn about M also moves O."""
        R_M = np.linalg.inv(fit.information + np.diag(np.repeat(np.array(TUNING.nothing) ** -2.0, 3))) + fit.scatter
        arm = fit.R_WO @ self._middle
        A = np.eye(6)
        A[3:, :3] = np.cross(arm, np.eye(3)).T
        z = np.concatenate([RotationMatrix(fit.R_WO).ToQuaternion().wxyz(), fit.p_WM - arm])
        return z, A @ R_M @ A.T + self._noise

    def _square(self, variance: Array, slant: Array, doubt: Array) -> Array:
        """Return expected squares of gaps (K,) [m²] of points with a variance, met at n · ray = slant (K,)."""
        return variance

    def _partners(self, points: Array, origin: Array, known: object) -> Partners:
        """Return what points (K, 3) in O, seen from an origin (3,), are of."""
        distance, index = self._tree.query(points, distance_upper_bound=self.reach)
        return Partners(np.isfinite(distance), index, np.zeros(len(points)))
