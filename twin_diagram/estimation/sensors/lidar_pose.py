"""A pose from a lidar's points: which surface each beam meets, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, cast

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.sensors.cloud_pose import TUNING as CLOUD_POSE
from twin_diagram.estimation.sensors.cloud_pose import CloudError, DepthCloud, Partners, PointNoise
from twin_diagram.signals.arrays import Array

Points = tuple[Array, Array]
"""Points (M, 3) [m] and outward normals (M, 3)."""


@dataclass(frozen=True)
class Tuning:
    """What a beam may have met, from the spacing of the links' points: chosen by hand.

    `tests/twin/arm_sensing` shows poses beside what is claimed of them.
    """

    spread: float = 0.004
    """How far across a beam the point of the surface lies that stands for what it met: the points' own spacing [m]."""

    own: float = 0.01
    """A beam that passes the link by less than this meets it [m]."""

    other: float = 0.015
    """A beam that passes another link by less than this may meet that one: one and a half times its points' spacing
    [m]."""

    astray: float = 0.03
    """A beam that passes the link by more than this has no partner, wherever the search leads [m]."""

    beside: float = 0.006
    """Of two points that lie as closely beside each other, seen from the lidar, the first may hide the second [m]."""

    behind: float = 0.005
    """How far below the surface at the first the second must lie [m]; for points of two links, behind it: twice
    that."""

    steepest: float = 0.05
    """A beam that meets a surface at a smaller cosine than this is taken to meet it at this one."""

    candidates: int = 4
    """Points of the surface that a beam may have met."""


TUNING = Tuning()


LIDAR_NOISE: Final = PointNoise(std_0=0.01, growth=0.005)
"""A lidar's own figures, section 3.3: 1 cm near [m], growing with distance squared [1/m]."""


class LidarPose(DepthCloud):
    """A `DepthCloud` with a lidar's figures: 1 cm near, growing with distance squared (section 3.3).

    So much noise is as large as the link, and the nearest point of its surface is often not the one that was met; but a
    lidar errs along its beam and hardly across it. So what a beam met is told by its direction alone: a choice by
    range would keep those points whose errors please. By its range a point is left out only where that lies farther
    from the one expected than three deviations and `reach`, to either side. The gap's expected square is

        (σ n·d)² + s² + (δ n·d)²

    of the noise σ along the beam d, the surface's points' spacing s, and half the range δ of where along the beam the
    surface is met at the few nearest of its points: where these lie on different faces, which one was met is in doubt.
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str,
        surface: Array,
        normals: Array,
        *,
        noise: PointNoise = LIDAR_NOISE,
        reach: float = 0.02,
        name: str = "lidar",
    ) -> None:
        """Make the sensor: as `DepthCloud`, with other figures."""
        super().__init__(terms, body, surface, normals, noise=noise, reach=reach, name=name)

    def align(self, points: Array, sensor_origin: Array, q: Array, others: Points | None = None) -> tuple[Array, Array]:
        """Align a cloud, from the pose that q predicts.

        Args:
            points: (K, 3) in W [m]; those that are not finite are left out.
            sensor_origin: (3,) of the lidar in W [m].
            q: (n,) joint angles to start from [rad].
            others: points and normals in W of what else may be met: where it hides the link, or stands
                beside it, beams are left out. Spaced by a centimetre or less.

        Returns:
            z (7,) and R (6, 6) for `Ekf.update`.

        Raises:
            CloudError: fewer than `fewest` points of the surface, points that are not of it, or a search that went
                astray.
        """
        points, origin = np.asarray(points, dtype=float), np.asarray(sensor_origin, dtype=float)
        points = points[np.all(np.isfinite(points), axis=1)]
        R_WO, p_WO = self.frame.pose(q)
        seat = (origin - p_WO) @ R_WO
        shown = np.flatnonzero(visible(self._surface, self._normals, seat))
        if others is not None and len(shown):
            beside = ((others[0] - p_WO) @ R_WO, others[1] @ R_WO)
            free, own = apart(self._surface[shown], beside, (points - p_WO) @ R_WO, seat)
            shown, points = shown[free], points[own]
        if len(shown) < CLOUD_POSE.fewest:
            raise CloudError(
                f"{self.name}: of the link, {len(shown)} points of the surface can be met; {CLOUD_POSE.fewest} do"
            )
        return self._claim(self._fit(points, origin, R_WO, p_WO, shown))

    def _square(self, variance: Array, slant: Array, doubt: Array) -> Array:
        return np.asarray((variance + doubt**2) * slant**2 + TUNING.spread**2)

    def _partners(self, points: Array, origin: Array, known: object) -> Partners:
        shown = cast(np.ndarray, known)
        ways, far = _beams(self._surface[shown] - origin)
        beams, range_ = _beams(points - origin)
        passes, nearest = cKDTree(ways).query(beams, k=min(TUNING.candidates, len(shown)))
        candidates = shown[nearest]
        normals = self._normals[candidates]
        slant = np.minimum(np.einsum("ikj,ij->ik", normals, beams), -TUNING.steepest)
        meets = np.einsum("ikj,ikj->ik", normals, self._surface[candidates] - origin) / slant
        expected = far[nearest[:, 0]]
        fits = np.abs(range_ - expected) < self.reach + 3.0 * np.sqrt(self.variance(range_))
        near = fits & (passes[:, 0] * expected < TUNING.astray)
        return Partners(near, candidates[:, 0], 0.5 * np.ptp(meets, axis=1))


def visible(points: Array, normals: Array, origin: Array) -> np.ndarray:
    """Return which points (M, 3) of a surface are seen from an origin (3,): they face it, and no other hides them."""
    away = points - origin
    seen = np.asarray(np.einsum("ij,ij->i", normals, away) < 0.0)
    facing = np.flatnonzero(seen)
    if not len(facing):
        return seen
    ways, far = _beams(away[facing])
    pairs = cKDTree(ways).query_pairs(TUNING.beside / float(np.median(far)), output_type="ndarray")
    turned = (far[pairs[:, 0]] > far[pairs[:, 1]]).astype(int)
    rows = np.arange(len(pairs))
    first, second = facing[pairs[rows, turned]], facing[pairs[rows, 1 - turned]]
    below = np.einsum("ij,ij->i", normals[first], points[first] - points[second])
    seen[second[below > TUNING.behind]] = False
    return seen


def apart(surface: Array, others: Points, points: Array, origin: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return what of a link can be met beside others, and which points are surely of it, all in one frame.

    Args:
        surface: (M, 3) points of the link that face the lidar and do not hide each other.
        others: points and normals of the others.
        points: (K, 3) measured.
        origin: (3,) of the lidar.

    Returns:
        Which of the surface's points no other hides (M,), and which beams of the points meet the link and pass
        the others (K,).
    """
    own, beams = _beams(surface - origin), _beams(points - origin)[0]
    away = others[0] - origin
    middle = float(np.median(own[1]))
    axis = own[0].mean(axis=0)
    cone = np.linalg.norm(own[0] - axis, axis=1).max() + 2.0 * TUNING.other / middle
    other = _beams(away[np.einsum("ij,ij->i", others[1], away) < 0.0])
    inside = np.linalg.norm(other[0] - axis, axis=1) < cone
    other = other[0][inside], other[1][inside]
    free = ~_hidden(own, other, TUNING.other / middle)
    if not free.any():
        return free, np.zeros(len(points), dtype=bool)
    met = np.asarray(cKDTree(own[0][free]).query(beams)[0] < TUNING.own / middle)
    beside = other[0][~_hidden(other, own, 2.0 * TUNING.spread / middle)]
    if len(beside):
        met &= cKDTree(beside).query(beams)[0] > TUNING.other / middle
    return free, met


def _hidden(these: Points, those: Points, angle: float) -> np.ndarray:
    """Return which of points in directions (M, 3) at distances (M,) lie behind others."""
    if not len(these[0]) or not len(those[0]):
        return np.zeros(len(these[0]), dtype=bool)
    k = min(TUNING.candidates, len(those[0]))
    _, index = cKDTree(those[0]).query(these[0], k=k, distance_upper_bound=angle)
    nearest = np.append(those[1], np.inf)[index].reshape(len(these[0]), k).min(axis=1)
    return np.asarray(nearest < these[1] - 2.0 * TUNING.behind)


def _beams(away: Array) -> tuple[Array, Array]:
    """Directions (K, 3) and lengths (K,)."""
    range_ = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    return away / range_[:, None], range_
