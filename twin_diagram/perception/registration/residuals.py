"""Residuals of coloured registration, for one pose or for many at once.

Each step looks up, for the model points that are visible from the present pose, what the image shows at their pixels,
and minimises by Gauss-Newton over a left perturbation (rotation, translation) in W about the object's origin

    sum of  w_g [n · (y - x)]² / σ_g²  +  λ/(1-λ) · w_c |I(u) - g(n) c|² / σ_c²

(the point-to-plane distance of the depth point y seen at the pixel of model point x with normal n; and the difference
of image and model colour, as in Park, Zhou, Koltun: Colored Point Cloud Registration Revisited, ICCV 2017), with Tukey
weights. The brightness g(n) = a + b · n is fitted along, because light and shade are the scene's and not the object's.
The opposite direction is added with `unexplained`: points of the image that no model point explains pull the model
towards them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.colour_shift import ColourShift, ShiftEvidence
from twin_diagram.perception.registration.data_association import FINE, Looked, Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.rotation import components_last, dot, log, screw, skew
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Noise and cuts of the residuals, chosen by hand.

    They set the weights of depth and colour against each other and, with `registration.Tuning`, the covariance claimed:
    `tests/perception/registration` holds that against the true scatter, `sims/closed_loop.py --seeds 20`
    shows the errors.
    """

    model_noise: float = 0.0007
    """Standard deviation of the model's surface [m]."""

    colour_noise: float = 0.05
    """Standard deviation of colour (of 1) by sampling and blur."""

    deepest: float = 2.0
    """Along the line of sight, pairs farther apart than this many reaches are cut."""

    steeper: float = 4.0
    """The image's colours may be this many times steeper, squared, than the model's, which are blurred."""

    colour_cut: float = 0.30
    """A colour farther off than this is another thing's."""


TUNING = Tuning()


def tukey(residual: Array, cut: float | Array) -> Array:
    """Return Tukey's weights: 1 at no residual, 0 from `cut` on."""
    left = np.maximum(1.0 - (residual / cut) ** 2, 0.0)
    return np.asarray(left * left)


def brightness(found: Array, colour: Array, n: Array, weight: Array) -> Array:
    """Fit the brightness g(n) = a + b · n of each point (B, P): g · colour is nearest to what was found."""
    rows = np.ones((4, *n.shape[:2]))
    rows[1:] = n.transpose(2, 0, 1)
    feature = components_last(rows)
    energy = dot(colour, colour) * weight
    match = dot(colour, found) * weight
    normal = (feature * energy[..., None]).transpose(0, 2, 1) @ feature
    total = energy.sum(axis=1)[:, None, None] + 1e-6
    normal += total * _EVEN
    right = feature.transpose(0, 2, 1) @ match[..., None]
    gain = (feature @ np.linalg.solve(normal, right))[..., 0]
    return np.asarray(np.minimum(np.maximum(gain, 0.1), 2.0))


_EVEN: Final = np.diag([1e-6, 0.02, 0.02, 0.02])
"""What holds the brightness the same from all sides, for the colours' whole energy."""


@dataclass(frozen=True)
class Normal:
    """Normal equations: `H` (B, 6, 6), `b` (B, 6), minimised by the step x with H x = b."""

    H: Array
    b: Array


def depth_pairs(looked: Looked, frame: Frame, reach: float) -> tuple[Array, Array, Array]:
    """Return Jacobians (B, P, 6), weights (B, P) and noise (B, P) [m] of the point-to-plane distances looked up."""
    depth_noise = frame.camera.depth_noise(looked.z)
    variance = (depth_noise * np.maximum(looked.facing, 0.2)) ** 2 + TUNING.model_noise**2
    w = tukey(looked.distance, reach) * _near(looked, reach) / variance
    return -screw(looked.r, looked.n), w, np.sqrt(variance)


def _near(looked: Looked, reach: float) -> npt.NDArray[np.bool_]:
    return np.asarray(looked.matched & (np.abs(looked.deeper) < TUNING.deepest * reach))


def linearise(looked: Looked, frame: Frame, level: int, reach: float, colour_share: float) -> tuple[Normal, Array]:
    """Return the normal equations of geometry and colour at the poses looked up, and the distances' noise (B, P)."""
    J, w, sigma = depth_pairs(looked, frame, reach)
    weighted = (J * w[..., None]).transpose(0, 2, 1)
    H = weighted @ J
    b = -(weighted @ looked.distance[..., None])[..., 0]
    if colour_share > 0:
        colours = colour_terms(looked, frame, level, reach, colour_share).without_shift(frame.shift)
        H, b = H + colours.H, b + colours.b
    return Normal(H, b), sigma


@dataclass(frozen=True)
class ColourNormal:
    """Normal equations of the colours, of pose and shift.

    Attributes:
        H: (B, 6, 6) of the pose.
        b: (B, 6).
        cross: (B, 6, 2) between pose and shift.
        H_shift: (B, 2, 2) of the shift [1/px²].
        b_shift: (B, 2).
    """

    H: Array
    b: Array
    cross: Array
    H_shift: Array
    b_shift: Array

    def without_shift(self, shift: ColourShift) -> Normal:
        """Return what is left to the pose, with the shift known as well as `shift` says."""
        if shift.certain:
            return Normal(self.H, self.b)
        tied = np.linalg.solve(self.H_shift + shift.information, self.cross.transpose(0, 2, 1))
        return Normal(self.H - self.cross @ tied, self.b - np.einsum("bsp,bs->bp", tied, self.b_shift))

    def evidence(self, H_else: Array, shift: ColourShift) -> ShiftEvidence:
        """Return what the first pose's colours say of the shift beside what else tells its pose.

        Args:
            H_else: (6, 6) what tells the pose beside colours.
            shift: as known when the pose was found, where all normal equations of the pose vanish.
        """
        back = np.linalg.solve(self.H[0] + H_else, self.cross[0])
        held = np.linalg.solve(self.H_shift[0] + shift.information, self.b_shift[0])
        information = self.H_shift[0] - self.cross[0].T @ back
        return ShiftEvidence(0.5 * (information + information.T), self.b_shift[0] - back.T @ (self.cross[0] @ held))


def colour_terms(looked: Looked, frame: Frame, level: int, reach: float, colour_share: float) -> ColourNormal:
    """Return the normal equations of the colours.

    Derivatives no larger than the image's own noise makes them tell nothing, nor does what is beyond the model's
    texture: light changes at creases, too.
    """
    found, du, dv = frame.colour_at(looked.u, looked.v, level)
    on = (_near(looked, reach) & (looked.facing > 0.25)).astype(float) * looked.facing
    on = on * (np.abs(looked.distance) < max(0.5 * reach, 0.006))
    gain = brightness(found, looked.colour, looked.n, on)
    expected = np.minimum(looked.colour * gain[..., None], 1.0)
    difference = found - expected
    size = np.sqrt(dot(difference, difference))
    w = on * tukey(size, TUNING.colour_cut if level == FINE else 1.5 * TUNING.colour_cut)
    uu, uv, vv = dot(du, du), dot(du, dv), dot(dv, dv)
    camera = frame.camera
    told = TUNING.steeper * looked.texture * (looked.z / camera.fx) ** 2
    steep = np.maximum(uu + vv, 1e-12)
    w = w * np.minimum(np.maximum(np.minimum(steep - frame.colour_slopes[level], told) / steep, 0.0), 1.0)
    cu, cv = camera.centre
    right, down, ahead = camera.R_WC.T[..., None, None]
    a_u, a_v = (
        components_last((way - ((at - middle) / focal) * ahead) * (focal / looked.z))
        for way, at, middle, focal in ((right, looked.u, cu, camera.fx), (down, looked.v, cv, camera.fy))
    )
    A_u, A_v = screw(looked.r, a_u), screw(looked.r, a_v)
    uu, uv, vv = ((part * w)[..., None] for part in (uu, uv, vv))
    ru, rv = ((dot(x, difference) * w)[..., None] for x in (du, dv))
    left_u = A_u * uu + A_v * uv
    left_v = A_u * uv + A_v * vv
    H = left_u.transpose(0, 2, 1) @ A_u + left_v.transpose(0, 2, 1) @ A_v
    factor = colour_share / max(1.0 - colour_share, 1e-3) / TUNING.colour_noise**2
    cross_terms = np.stack([left_u.sum(axis=1), left_v.sum(axis=1)], axis=2)
    a, b, c = (part.sum(axis=(1, 2)) for part in (uu, uv, vv))
    return ColourNormal(
        factor * H,
        -factor * (A_u.transpose(0, 2, 1) @ ru + A_v.transpose(0, 2, 1) @ rv)[..., 0],
        factor * cross_terms,
        factor * np.stack([np.stack([a, b], axis=1), np.stack([b, c], axis=1)], axis=2),
        -factor * np.stack([ru.sum(axis=(1, 2)), rv.sum(axis=(1, 2))], axis=1),
    )


def toward(poses: Poses, goal: Poses, information: Array) -> Normal:
    """Return the normal equations of a prior: `information` (6,) about the poses `goal`."""
    miss = np.concatenate([log(goal.R @ poses.R.transpose(0, 2, 1)), goal.p - poses.p], axis=1)
    return Normal(np.broadcast_to(np.diag(information), (len(miss), 6, 6)), miss * information)


@dataclass(frozen=True)
class OppositePairs:
    """Image points paired with their nearest model points.

    Attributes:
        seen: (N, 3) the image's points in W [m].
        J: (N, 6) of their distance to the model's surface.
        w: (N,) weights.
        n: (N, 3) the model's normals in W.
        H: (6, 6) normal equations, sliding included.
        b: (6,).
    """

    seen: Array
    J: Array
    w: Array
    n: Array
    H: Array
    b: Array


def unexplained(model: ModelCloud, points_W: Array, poses: Poses, p_WC: Array, reach: float, share: float) -> Normal:
    """Return the normal equations of `opposite_pairs`."""
    pairs = opposite_pairs(model, points_W, poses, p_WC, reach, share)
    return Normal(pairs.H[None], pairs.b[None])


def opposite_pairs(
    model: ModelCloud, points_W: Array, poses: Poses, p_WC: Array, reach: float, share: float = 0.1
) -> OppositePairs:
    """Return the opposite direction, for one pose: image points to their nearest model points.

    Point-to-plane, and with weight `share` point-to-point; a point-to-point distance within the model's own spacing is
    none. A point whose nearest model point faces away from the camera is left out: it is the other side of a thin wall.

    Args:
        model: the object.
        points_W: (N, 3) points that should be the object's.
        poses: one pose.
        p_WC: where the camera is.
        reach: pairs farther apart are cut [m].
        share: weight of the point-to-point part.
    """
    R, p = poses.R[0], poses.p[0]
    local = (points_W - p) @ R
    distance, index = model.tree.query(local, distance_upper_bound=reach, workers=1)
    good = np.isfinite(distance)
    good = np.flatnonzero(np.isfinite(distance))
    point, normal = model.points[index[good]], model.normals[index[good]]
    front = dot(normal, (p_WC - p) @ R - point) > 0.0
    good = good[front]
    r, n = ((R @ part[front].T).T for part in (point, normal))
    seen = points_W[good]
    apart = seen - p - r
    along = dot(apart, n)
    tangent = apart - along[:, None] * n
    slide = np.sqrt(dot(tangent, tangent))
    w = tukey(distance[good], reach) / (2.0 * TUNING.model_noise) ** 2
    J = -screw(r, n)
    weighted = (J * w[:, None]).T
    H = weighted @ J
    b = -weighted @ along
    # Where there is nothing to pull, nothing must hold either.
    far = np.flatnonzero(slide > model.spacing)
    if far.size:
        pull = tangent[far] * (1.0 - model.spacing / slide[far])[:, None]
        H_far, b_far = point_pull(r[far], pull, share * w[far])
        H, b = H + H_far, b + b_far
    return OppositePairs(seen, J, w, n, H, b)


def point_pull(r: Array, pull: Array, w: Array) -> tuple[Array, Array]:
    """Return the normal equations (6, 6), (6,) that move points r (N, 3) about the origin by `pull` (N, 3) each.

    A turn a and a shift s move r by a x r + s, whose derivative is [-skew(r), I].
    """
    weighted = r * w[:, None]
    spread, lever = weighted.T @ r, skew(weighted.sum(axis=0))
    H = np.empty((6, 6))
    H[:3, :3] = np.trace(spread) * np.eye(3) - spread
    H[:3, 3:], H[3:, :3] = lever, lever.T
    H[3:, 3:] = w.sum() * np.eye(3)
    return H, w @ screw(r, pull)
