"""Residuals of coloured registration, for one pose or for many at once.

Each step looks up, for the model points that are visible from the present pose, what the image shows at their pixels,
and minimises by Gauss-Newton over a left perturbation (rotation, translation) in W about the object's origin

    sum of  w_g [n · (y - x)]² / σ_g²  +  λ/(1-λ) · w_c |I(u) - g(n) c|² / σ_c²

(the point-to-plane distance of the depth point y seen at the pixel of model point x with normal n; and the difference
of image and model colour, as in Park, Zhou, Koltun: Colored Point Cloud Registration Revisited, ICCV 2017), with Tukey
weights. The brightness g(n) = a + b · n is fitted along, because light and shade are the scene's and not the object's.
The opposite direction is added with `cloud_kernels.opposite`: points of the image that no model point explains pull the
model towards them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.cloud_kernels import PairRules
from twin_diagram.perception.registration.colour_kernels import gains, sloped_colours
from twin_diagram.perception.registration.colour_shift import ColourShift, ShiftEvidence
from twin_diagram.perception.registration.data_association import Looked, Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.refinement_kernels import TermRules
from twin_diagram.perception.registration.residual_kernels import ColourSums, colour_normal, colour_weights
from twin_diagram.perception.registration.rotation import log, screw
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

    aside: float = 0.006
    """Colours of points within this of the surface count however short the reach [m]."""

    colour_cut: float = 0.30
    """A colour farther off than this is another thing's."""

    point_to_point: float = 0.1
    """Weight of point-to-point beside point-to-plane, where the image pulls on the model: a plane does not slide."""


TUNING = Tuning()


def tukey(residual: Array, cut: float | Array) -> Array:
    """Return Tukey's weights: 1 at no residual, 0 from `cut` on."""
    left = np.maximum(1.0 - (residual / cut) ** 2, 0.0)
    return np.asarray(left * left)


def brightness(found: Array, colour: Array, n: Array, weight: Array) -> Array:
    """Fit the brightness g(n) = a + b · n of each point (B, P): g · colour is nearest to what was found."""
    return gains(found, colour, n, weight, _EVEN)


_EVEN: Final = np.array([1e-6, 0.02, 0.02, 0.02])
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


class ColourNormal(ColourSums):
    """Normal equations of the colours, and what they say of the pose and of the shift."""

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


def term_rules(colour_share: float) -> TermRules:
    """Return the constants of depth's and colours' terms, by the colours' share in both."""
    t = TUNING
    return TermRules(t.deepest, t.model_noise, colour_factor(colour_share), t.colour_cut, t.steeper, t.aside, _EVEN)


def colour_factor(share: float) -> float:
    """Return what colours' squared differences count beside depth's, by their share in both."""
    return share / max(1.0 - share, 1e-3) / TUNING.colour_noise**2


def colour_terms(looked: Looked, frame: Frame, level: int, reach: float, colour_share: float) -> ColourNormal:
    """Return the normal equations of the colours.

    Derivatives no larger than the image's own noise makes them tell nothing, nor does what is beyond the model's
    texture: light changes at creases, too.
    """
    told, count = looked.told, len(looked.told)
    weight = colour_weights(told, looked.flags, (TUNING.deepest * reach, max(0.5 * reach, TUNING.aside)))
    found = sloped_colours(frame.colours[level], looked.u, looked.v, weight, frame.corner_of_colours())
    gain = brightness(found, looked.colour, looked.n, weight)
    cut = TUNING.colour_cut if level == FINE else 1.5 * TUNING.colour_cut
    cuts = (cut, TUNING.steeper, frame.colour_slopes[level])
    own = np.zeros((count, 6, 6)), np.zeros((count, 6))
    sums = ColourSums(*own, np.zeros((count, 6, 2)), np.zeros((count, 2, 2)), np.zeros((count, 2)))
    colour_normal(told, found, weight, gain, frame.view, cuts, sums)
    factor = colour_factor(colour_share)
    return ColourNormal(*(factor * part for part in sums))


def toward(poses: Poses, goal: Poses, information: Array) -> Normal:
    """Return the normal equations of a prior: `information` (6,) about the poses `goal`."""
    miss = np.concatenate([log(goal.R @ poses.R.transpose(0, 2, 1)), goal.p - poses.p], axis=1)
    return Normal(np.broadcast_to(np.diag(information), (len(miss), 6, 6)), miss * information)


def pair_rules(spacing: float) -> PairRules:
    """Return how image points are paired with a model's that lie some `spacing` [m] apart."""
    return PairRules(TUNING.point_to_point, 2.0 * TUNING.model_noise, spacing)
