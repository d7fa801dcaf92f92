"""What a registered pose is claimed to be worth: its covariance under noise that neighbouring pixels share.

At the pose found, the sum of J_i w_i e_i over all pairs vanishes, so that noise e moves it by H⁻¹ Σ J_i w_i e_i: its
covariance is H⁻¹ S H⁻¹, S = Σ_ij a_i a_jᵀ E[e_i e_j] with a_i = J_i w_i (Huber's sandwich). Where pairs err alike,
S exceeds H, most in those directions in which many pixels push the same way. A field of depth errors that is white
noise blurred by a Gaussian has S = Σ_x b(x) b(x)ᵀ, b being the a_i laid onto the image and blurred by the same
Gaussian: a few small images instead of all pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from twin_diagram.perception.depth_noise import TUNING as DEPTH
from twin_diagram.perception.registration.claim_kernels import lay, pulls
from twin_diagram.perception.registration.colour_shift import ShiftEvidence
from twin_diagram.perception.registration.data_association import Looked, Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import colour_factor, colour_terms, pair_rules
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants of what is claimed, with what set them."""

    cell: float = 2.0
    """Gaussians are laid on cells so many times smaller than they are."""

    beyond: tuple[float, float, float] = (0.0, 0.4, 0.6)
    """How errors that no sheet tells of are shared out: white, over patches, over waves. Real cameras' are 0.1, 0.6,
    0.3, but a fit takes part of the waves into the pose, where residuals do not show them."""

    colours_alike: float = 4.0
    """Neighbouring colours err alike: they count so many times less, …"""

    usual_share: float = 0.3
    """… where colours have this share beside depth. The more they weigh, the more of that is error: by its root,
    squared errors are 0.9 of what is claimed (by all of it 0.5, by nothing 1.6;
    `sims/benchmarks/registration_peers.py`, half hidden before a D415, trials 500 to 511)."""

    common: tuple[float, float] = (0.0005, 0.00005)
    """Errors that no noise explains, of the clouds' points for a surface: rotation [rad], translation [m]."""

    widest: tuple[float, float] = (1.0, 0.05)
    """Deviations where the image says nothing [rad], [m]."""


TUNING = Tuning()


def spread(a: Array, u: Array, v: Array, sigma: float) -> Array:
    """Return (k, k) the sum of a_i a_jᵀ times exp(-d_ij² / 4σ²), the correlation of white noise blurred by σ.

    Args:
        a: (N, k).
        u: (N,) where they are in the image [px].
        v: (N,).
        sigma: of the Gaussian [px]; 0: of white noise, which points within one pixel share.
    """
    cell = sigma / TUNING.cell if sigma > 0.0 else 1.0
    margin = 4 * int(np.ceil(TUNING.cell)) if sigma > 0.0 else 0
    # Six digits of a covariance are more than it is worth.
    laid, size = lay(one_layout(a), one_layout(u), one_layout(v), cell, margin)
    if sigma > 0.0:
        laid = cv2.GaussianBlur(laid, (0, 0), TUNING.cell)
    flat = laid.reshape(-1, a.shape[1])
    spread_out = np.asarray((flat.T @ flat) * np.outer(size, size))
    return spread_out / _blur_share() if sigma > 0.0 else spread_out


@cache
def _blur_share() -> float:
    """Return what is left at its own place of what two blurs of one cell leave."""
    kernel = cv2.getGaussianKernel(8 * int(TUNING.cell) + 1, TUNING.cell)[:, 0]
    return float((kernel**2).sum()) ** 2


def colours_alike(colour_share: float) -> float:
    """Return how many times less colours of a share count than their weight says, as they err alike."""
    return TUNING.colours_alike * float(np.sqrt(colour_factor(colour_share) / colour_factor(TUNING.usual_share)))


def claim(
    looked: Looked,
    frame: Frame,
    model: ModelCloud,
    pose: Poses,
    points_W: Array | None,
    reach: float,
    colour_share: float,
    excess: float,
) -> tuple[Array, ShiftEvidence | None]:
    """Return the covariance (6, 6) of one registered pose, and what its colours say of their shift beside depth.

    Rotation stands before translation, about the object's origin in W. What colours say counts as far as their shift is
    known; of a shift that is certain they say nothing.

    Args:
        looked: up at the pose.
        frame: the image.
        model: the object.
        pose: one.
        points_W: (N, 3) image points that were to be explained; None: none were.
        reach: pairs farther apart were cut [m].
        colour_share: weight of colours.
        excess: by which factor depth errs more than the data sheet says.
    """
    H, S = np.zeros((6, 6)), np.zeros((6, 6))
    a, u, v = pulls(
        looked.told[0],
        looked.flags[0],
        (one_layout(pose.R[0]), one_layout(pose.p[0])),
        np.empty((0, 3)) if points_W is None else one_layout(points_W),
        frame.view,
        frame.noise,
        model.cloud,
        (reach, RESIDUALS.deepest, RESIDUALS.model_noise),
        pair_rules(model.spacing),
        H,
    )
    if len(a):
        S = field_covariance(a, u, v, frame, excess)
    widest = np.diag(np.repeat(np.square(TUNING.widest), 3) ** -1.0)
    evidence = None
    if colour_share > 0.0:
        colours = colour_terms(looked, frame, FINE, reach, colour_share)
        if not frame.shift.certain:
            evidence = colours.evidence(H + widest, frame.shift)
        Hc = colours.without_shift(frame.shift).H[0]
        H, S = H + Hc, S + colours_alike(colour_share) * Hc
    inverse = np.linalg.inv(H + widest)
    result = inverse @ (S + widest) @ inverse
    return 0.5 * (result + result.T) + np.diag(np.repeat(np.square(TUNING.common), 3)), evidence


def field_covariance(a: Array, u: Array, v: Array, frame: Frame, excess: float) -> Array:
    """Return (k, k) the covariance of Σ a_i e_i, e being depth's error in units of what the sheet tells.

    Args:
        a: (N, k).
        u: (N,) where they are in the image [px].
        v: (N,).
        frame: the image.
        excess: by which factor depth errs more than its sheet says.
    """
    noise, scale = frame.camera.depth_noise, frame.camera.width / DEPTH.width
    told = (max(0.0, 1.0 - noise.correlated - noise.lasting), noise.correlated, noise.lasting)
    result = np.zeros((a.shape[1], a.shape[1]))
    for share, more, sigma in zip(told, TUNING.beyond, (0.0, DEPTH.patch, DEPTH.wave), strict=True):
        whole = share + more * max(0.0, excess**2 - 1.0)
        if whole > 0.0:
            result += whole * spread(a, u, v, scale * sigma)
    return result
