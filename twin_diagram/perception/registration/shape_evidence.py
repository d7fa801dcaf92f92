"""Tells by shape alone whether what is seen is an object, or another of nearly its shape.

The outline in the image, the surfaces in depth and the plane it stands on say by how much the thing seen would have to
be stretched along each of the model's axes. Another thing has any sizes, the object its own: the ratio of both
likelihoods is the evidence, and what the sizes do not explain of outline and surface speaks against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.assessment import residual_excess
from twin_diagram.perception.registration.colour_sizes import colour_sizes, own_edges
from twin_diagram.perception.registration.data_association import Looked, Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.outline import height_above, moves, outline, own_points
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import tukey
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on rendered sequences of grey and repainted things before a D435, whose truth is known."""

    edge: float = 0.65
    """Deviation of an edge [cells of the grid]: it jitters by 0.8 pixels, and cells are whole."""

    share: float = 4.0
    """So many cells of an outline err as one."""

    bias: tuple[float, float] = (-0.4, 0.5)
    """How far outside the model's outline the image's lies, mean and deviation [cells]: rims are left out."""

    votes: float = 20.0
    """So many model points err as one before a camera whose noise is correlated."""

    cut: float = 0.02
    """A surface farther off than this is another [m]."""

    rests: float = 0.004
    """Deviation of the lowest point's height above the table [m], and up to three times as much it rests there."""

    loose: tuple[float, float] = (0.2, 0.03)
    """What is known of the pose beside [rad], [m]."""

    scale: float = 0.012
    """Sizes are told no better than this [of 1]: the camera's calibration and the model's own error."""

    others: float = 0.25
    """Spread of other things' sizes [of 1] that could be taken for this one's at first sight."""


TUNING = Tuning()


@dataclass(frozen=True)
class ShapeEvidence:
    """What shape says of a thing seen at a pose.

    Attributes:
        stretch: (3,) by how much larger it is along O's axes than the model [of 1].
        spread: (3, 3) covariance of that.
        outside: share of its image that lies outside of the model's outline.
        missed: share of the model's outline that shows something else, where nothing hides it.
        explained: share of its points that are near the model's surface.
        excess: by which factor depth errs more than the data sheet says.
        odds: logarithm of the ratio of likelihoods: the object's, beside any other thing of such a shape.
    """

    stretch: Array
    spread: Array
    outside: float
    missed: float
    explained: float
    excess: float
    odds: float


def shape_evidence(
    model: ModelCloud, frame: Frame, segments: Segments, one: RegisteredPose, colours: float = 0.0
) -> ShapeEvidence | None:
    """Return what shape says of a pose registered in an image; None where no outline of it is in view.

    Args:
        model: the object.
        frame: the image.
        segments: the same, taken apart.
        one: the pose.
        colours: from 0 to 1, by how much they speak for it: so much less count edges of what may be joined to it.
    """
    near, own = own_points(model, segments, one)
    seen = outline(model, frame, segments, one, own)
    if seen is None:
        return None
    looked = look(model, frame, Poses(one.R[None], one.p[None]), model.views.shape[1], FINE)
    # Ten numbers: a turn, a shift, the stretches, and how far the image's outline lies outside everywhere.
    H, b = np.diag(np.repeat([*np.square(TUNING.loose), 1.0, TUNING.bias[1] ** 2], [3, 3, 3, 1]) ** -1.0), np.zeros(10)
    b[9] = TUNING.bias[0] * TUNING.bias[1] ** -2.0
    J, off, weight = _surface(looked, frame, one)
    H[:9, :9] += (J * weight[:, None]).T @ J
    b[:9] += J.T @ (weight * off)
    row, height = _standing(model, frame, one)
    if abs(height) < 3.0 * TUNING.rests:
        H[:9, :9] += np.outer(row, row) / TUNING.rests**2
        b[:9] -= row * height / TUNING.rests**2
    H_colours, b_colours = colour_sizes(looked, frame, one, TUNING.cut)
    H[:9, :9] += H_colours
    b[:9] += b_colours
    joined = colours * ~own_edges(seen, H, b, TUNING.edge, TUNING.share)
    w = (1.0 - joined) / (TUNING.edge**2 * TUNING.share)
    H += (seen.J * w[:, None]).T @ seen.J
    b += seen.J.T @ (w * seen.apart)
    both = np.linalg.inv(H)
    stretch, spread = (both @ b)[6:9], both[6:9, 6:9] + TUNING.scale**2 * np.eye(3)
    shown = float(np.count_nonzero(near & own)) / max(float(np.count_nonzero(own)), 1.0)
    excess = residual_excess(looked, frame)
    return ShapeEvidence(stretch, spread, seen.outside, seen.missed, shown, excess, odds_of(stretch, spread))


def odds_of(stretch: Array, spread: Array) -> float:
    """Return how much likelier a stretch (3,) of covariance (3, 3) is of the object than of other things [nat]."""
    wide = spread + TUNING.others**2 * np.eye(3)
    own = -0.5 * (stretch @ np.linalg.solve(spread, stretch) + np.linalg.slogdet(spread)[1])
    other = -0.5 * (stretch @ np.linalg.solve(wide, stretch) + np.linalg.slogdet(wide)[1])
    return float(own - other)


def _surface(looked: Looked, frame: Frame, one: RegisteredPose) -> tuple[Array, Array, Array]:
    """Return Jacobians (P, 9) of the surface seen, how far it is from the model (P,) [m], and weights (P,)."""
    on = looked.matched[0] & looked.counted[0] & (np.abs(looked.distance[0]) < TUNING.cut)
    sigma = np.hypot(frame.camera.depth_noise(looked.z[0][on]), RESIDUALS.model_noise)
    off = looked.distance[0][on]
    weight = tukey(off, TUNING.cut) / (sigma**2 * TUNING.votes)
    return moves(looked.n[0][on], looked.r[0][on], one.R), off, weight


def _standing(model: ModelCloud, frame: Frame, one: RegisteredPose) -> tuple[Array, float]:
    """Return the Jacobian (9,) of the lowest point's height above the table, and that height [m]."""
    points = model.points @ one.R.T + one.p
    height = height_above(frame.table, points)
    k = int(np.argmin(height))
    up = np.array([-frame.table[0], -frame.table[1], 1.0])
    return moves(up[None], (points[k] - one.p)[None], one.R)[0], float(height[k])
