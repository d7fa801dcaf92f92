"""Estimates how far a camera is from its calibration, from surfaces whose places are known: the arm's and the table's.

A point that the camera shows should lie on a known plane: the tangent plane of the arm's surface near by, or the
table's top. By the errors e of the calibration (`signals.calibration_error`) it is shown aside by J e, so its distance
from the plane is n · J e and noise. Gauss-Newton over e, beginning at what the data sheet promises, which is also its
prior; the points are told anew by the camera as corrected before each step. Tukey's weights let go of what lies far
off, so the steps may come to rest at more than one place: they are begun at several, and the likeliest end counts.
Known is the camera's pose (6) and the scale of depth; the rest is carried along, so that what it leaves open is in the
covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.perception.calibration_kernels import distances, normal_equations, scatter, seen_at
from twin_diagram.perception.depth_noise import excess_of
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import SIZE, CalibrationError
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants of the estimate, with their units and what set them."""

    steps: int = 6
    """Of Gauss-Newton at most: errors of a degree are gone after three."""

    settled: float = 0.02
    """A step of so few standard deviations of the estimate ends it: each is a fifth to a tenth of the one before."""

    same: float = 0.3
    """Steps that come so near to where others ended, in standard deviations, go there, too, and are given up: of a
    tabletop's arm that is after the second, and places of rest are two standard deviations from each other."""

    cut: float = 4.0
    """Residuals beyond so many standard deviations are another thing's (Tukey's weights end there)."""

    width: float = 640.0
    """Figures in pixels are those of images so wide [px]."""

    patch: float = 50.0
    """Pixels of one frame that err together: three fifths of the variance of a Gaussian's area, σ = 2.5 px: 4πσ²."""

    lasting: float = 850.0
    """The same of noise that stays from frame to frame: three tenths of the variance, σ = 15 px."""

    cell: float = 53.0
    """Side of a square of such an area [px]: what is seen in one square in several frames errs alike in all of them."""

    least: float = 1e-5
    """No point's distance from a surface is taken to be known better [m]."""

    first_doubt: float = 0.02
    """How far points may be aside before the first step [m]: 5 mm and half a degree at 2 m."""

    aside: float = 3.0
    """Other beginnings lie so many standard deviations to both sides along what is known least: wrong places of rest
    were two to three of them away."""


TUNING = Tuning()

Nearest = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class KnownSurface:
    """Points that one frame shows of a surface whose place is known.

    Attributes:
        pixels: (N, 2) columns and rows [px].
        depth: (N,) as delivered, in metres.
        nearest: from points (N, 3) in W to the nearest ones of the surface and its normals there, (N, 3) each in W.
        place_std: error of the surface's place that all points share [m]: of the arm's encoders, of the table's height.
        stride: every n-th pixel in each direction was taken; neighbours err together.
        frame: number of the image; several surfaces may be of one.
        body: number of what has the surface, the same in all frames.
    """

    pixels: Array
    depth: Array
    nearest: Nearest
    place_std: float = 0.0
    stride: int = 1
    frame: int = 0
    body: int = 0


@dataclass(frozen=True)
class CalibrationEstimate:
    """What was found.

    Attributes:
        errors: (10,) of the calibration: true less told; see `signals.calibration_error`.
        covariance: (10, 10) of the errors.
        points: how many were used.
    """

    errors: Array
    covariance: Array
    points: int

    def corrected(self, camera: Pinhole) -> tuple[Pinhole, float]:
        """Return the camera as it should be, and what its depth is to be multiplied by."""
        return corrected(camera, self.errors)


def corrected(camera: Pinhole, errors: Array) -> tuple[Pinhole, float]:
    """Return a camera with errors (10,) taken out of its pose and its lens, and the factor on its depth."""
    lens = camera.optics
    zoom = 1.0 + errors[7]
    mended = replace(lens, fx=lens.fx * zoom, fy=lens.fy * zoom, cx=lens.cx + errors[8], cy=lens.cy + errors[9])
    angle = float(np.linalg.norm(errors[:3]))
    R = _rotation(errors[:3], angle) @ camera.R_WC
    moved = replace(camera, focal=0.5 * (mended.fx + mended.fy), R_WC=R, p_WC=camera.p_WC + errors[3:6], lens=mended)
    return moved, 1.0 / (1.0 + float(errors[6]))


def calibrate(
    surfaces: Sequence[KnownSurface], camera: Pinhole, told: CalibrationError, before: Array | None = None
) -> CalibrationEstimate:
    """Estimate the errors of a camera's calibration.

    Args:
        surfaces: what some frames show of arm and table; the more places and directions, the better.
        camera: as it was told, of depth, without distortion.
        told: what the data sheet says of the errors: the prior.
        before: (10,) errors as estimated from fewer frames, where the steps begin; None: at none.

    Returns:
        Errors and covariance; with nothing seen, none and the prior's.
    """
    prior = np.maximum(told.variances, 1e-16)
    together = pixels_together(surfaces, camera.width)

    def likely(end: tuple[Array, Array]) -> float:
        return _cost(surfaces, together, corrected(camera, end[0]), end[0], prior)

    start, doubt = (np.zeros(SIZE), TUNING.first_doubt) if before is None else (before, 0.0)
    first = _gauss_newton(surfaces, together, camera, prior, start, doubt)
    assert first is not None
    ends = [first]
    if surfaces:
        best, information = first
        step = TUNING.aside * _least_known(information, prior)
        others = (_gauss_newton(surfaces, together, camera, prior, best + s * step, 0.0, best) for s in (1.0, -1.0))
        ends += [end for end in others if end is not None]
    errors, information = first if len(ends) == 1 else min(ends, key=likely)
    covariance = np.linalg.inv(information)
    return CalibrationEstimate(errors, 0.5 * (covariance + covariance.T), sum(len(s.depth) for s in surfaces))


def _gauss_newton(
    surfaces: Sequence[KnownSurface],
    together: Sequence[Array],
    camera: Pinhole,
    prior: Array,
    start: Array,
    doubt: float,
    known: Array | None = None,
) -> tuple[Array, Array] | None:
    """Return errors (10,) where the steps from `start` come to rest, and the information (10, 10) there.

    Args:
        surfaces: seen.
        together: for each, (N,) pixels that err together.
        camera: as told.
        prior: (10,) variances of the errors.
        start: (10,)
        doubt: how far points may be aside before the first step [m].
        known: (10,) where others came to rest; None is returned where these do so there, too.
    """
    errors, information = start, np.diag(1.0 / prior)
    for k in range(TUNING.steps):
        H, b = np.diag(1.0 / prior), -errors / prior
        view = corrected(camera, errors)
        for surface, alike in zip(surfaces, together, strict=True):
            A, right = _normal_equations(surface, view, alike, doubt if k == 0 else 0.0)
            H, b = H + A, b + right
        step = np.asarray(np.linalg.solve(H, b), dtype=float)
        errors, information = errors + step, H
        if known is not None and _apart(errors, known, H) < TUNING.same:
            return None
        if _apart(step, np.zeros(SIZE), H) < TUNING.settled:
            break
    return errors, information


def _apart(first: Array, second: Array, information: Array) -> float:
    """Return how far errors (10,) are from others, in standard deviations of the estimate."""
    return float(np.sqrt(max(float((first - second) @ information @ (first - second)), 0.0)))


def _least_known(information: Array, prior: Array) -> Array:
    """Return one standard deviation (10,) along what the images tell least of, beside what was known before."""
    scale = np.sqrt(prior)
    values, ways = np.linalg.eigh(information[:6, :6] * scale[:6, None] * scale[:6])
    found = np.zeros(SIZE)
    found[:6] = ways[:, 0] * scale[:6] / np.sqrt(values[0])
    return found


def _cost(
    surfaces: Sequence[KnownSurface],
    together: Sequence[Array],
    view: tuple[Pinhole, float],
    errors: Array,
    prior: Array,
) -> float:
    """Return the negative logarithm of how likely errors (10,) are, but for a constant: Tukey's loss and the prior."""
    cost = 0.5 * float(np.sum(errors**2 / prior))
    for surface, alike in zip(surfaces, together, strict=True):
        if not len(surface.depth):
            continue
        seen = _residuals(surface, view)
        spread = np.hypot(seen.sigma, surface.place_std)
        weight = _weights(seen, spread, surface, alike)
        shift = 0.0
        if surface.place_std > 0.0:
            shift = float(weight @ seen.distance) / (weight.sum() + surface.place_std**-2)
            cost += 0.5 * (shift / surface.place_std) ** 2
        far = np.minimum(((seen.distance - shift) / (TUNING.cut * spread)) ** 2, 1.0)
        loss = TUNING.cut**2 / 6.0 * (spread / seen.sigma) ** 2 * (1.0 - (1.0 - far) ** 3)
        cost += float(np.sum(loss / _worth(surface, alike)))
    return cost


def pixels_together(surfaces: Sequence[KnownSurface], width: int) -> list[Array]:
    """Return for each surface's points (N,) how many pixels of all frames are worth one.

    Noise that lasts is the same in all frames: more of them average it away only where they show something elsewhere.

    Args:
        surfaces: of all frames.
        width: of the images [px].
    """
    scale = width / TUNING.width
    cells = [np.floor(surface.pixels / (TUNING.cell * scale)).astype(np.int64) for surface in surfaces]
    keys = [
        np.unique((surface.body * 1000 + cell[:, 1]) * 1000 + cell[:, 0], return_inverse=True)
        for surface, cell in zip(surfaces, cells, strict=True)
    ]
    seen_in: dict[int, set[int]] = {}
    for surface, (there, _) in zip(surfaces, keys, strict=True):
        for key in there:
            seen_in.setdefault(int(key), set()).add(surface.frame)
    return [
        scale**2 * (TUNING.patch + TUNING.lasting * np.array([len(seen_in[int(key)]) for key in there])[number])
        for there, number in keys
    ]


def _normal_equations(
    surface: KnownSurface, corrected_view: tuple[Pinhole, float], together: Array, doubt: float
) -> tuple[Array, Array]:
    """Return H (10, 10) and b (10,) of one frame's points of one surface.

    Args:
        surface: seen.
        corrected_view: the camera as believed so far, and the factor on its depth.
        together: (N,) pixels that err together.
        doubt: how far points may be aside still [m].
    """
    if not len(surface.depth):
        return np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    camera, seen = corrected_view[0], _residuals(surface, corrected_view)
    weight = _weights(seen, np.hypot(seen.sigma, surface.place_std + doubt), surface, together)
    H, b, along, total, pull = normal_equations(
        seen.points_C, seen.normals, seen.distance, weight, one_layout(camera.R_WC), camera.fx, camera.fy
    )
    if surface.place_std > 0.0:
        # One number more that all points share, the surface's place, is eliminated.
        total += surface.place_std**-2
        H, b = H - np.outer(along, along) / total, b - along * pull / total
    return H, b


@dataclass(frozen=True)
class _Residuals:
    """Distances (N,) of points from a known surface [m], their noise (N,) [m], the points in C, the normals in W."""

    distance: Array
    sigma: Array
    points_C: Array
    normals: Array


def _residuals(surface: KnownSurface, corrected_view: tuple[Pinhole, float]) -> _Residuals:
    """Return how far off a surface the camera as believed shows its points."""
    view, factor = corrected_view
    z, lens = surface.depth * factor, np.array([view.fx, view.fy, *view.centre])
    R_WC, p_WC, noise = one_layout(view.R_WC), one_layout(view.p_WC), view.depth_noise
    points_C, points_W = seen_at(one_layout(surface.pixels), z, lens, R_WC, p_WC)
    places, normals = (one_layout(found) for found in surface.nearest(points_W))
    told = (noise.floor, noise.growth, noise.start)
    distance, sigma = distances(points_W, places, normals, p_WC, z, told, TUNING.least)
    return _Residuals(distance, sigma * excess_of(scatter(distance, sigma), len(distance)), points_C, normals)


def _worth(surface: KnownSurface, together: Array) -> Array:
    """Return how many points (N,) share one vote."""
    return np.maximum(1.0, together / surface.stride**2)


def _weights(seen: _Residuals, spread: Array, surface: KnownSurface, together: Array) -> Array:
    """Return Tukey's weights (N,) [1/m²], of points that may be aside by `spread` (N,) [m]."""
    weight = np.maximum(1.0 - (seen.distance / (TUNING.cut * spread)) ** 2, 0.0) ** 2
    return np.asarray(weight / (seen.sigma**2 * _worth(surface, together)))


def _rotation(turn: Array, angle: float) -> Array:
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = turn / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)
