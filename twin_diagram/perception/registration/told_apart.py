"""Bounds what an image can tell of two poses by what differs in what it shows.

A box whose label faces away shows the same as one turned half about its front. What makes one of them likelier in an
image is an error then: of noise, of a registration by a fraction of a millimetre, of the model. Of many images one has
such an error that is large, and as waves in depth and the model's errors last, further images do not undo it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.alternatives import in_place, votes
from twin_diagram.perception.registration.colour_votes import missed, pixel_votes
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    nearest: int = 4
    """Of so many points of a cloud the one that fits best counts: near an edge the nearest is on the other face."""


TUNING = Tuning()


def most_told(model: ModelCloud, frame: Frame, poses: Poses, points: int) -> Array:
    """Return (B,) by how much an image is likelier at the first of poses than at each, if it shows the object there.

    Args:
        model: the object.
        frame: the image.
        poses: B of them, laid on one another exactly: what registration leaves differs by its errors, too.
        points: model points that are looked up, at most.
    """
    looked = look(model, frame, poses, points, FINE)
    weight = looked.facing * looked.counted * in_place(looked, frame)
    on = weight > 0.0
    told, own = np.zeros(len(poses.p)), weight[0][on[0]]
    if not len(own):
        return told
    sigma = float(np.hypot(np.median(frame.camera.depth_noise(looked.z[0][on[0]])), RESIDUALS.model_noise))
    shape_votes = float(looked.counted[0].sum()) / votes(looked, frame, model.spacing)
    colour_votes = pixel_votes(model, frame, looked, float(own.sum()))
    shown = [looked.r[k][on[k]] + poses.p[k] for k in range(len(told))]
    for k in range(1, len(told)):
        there = (shown[0] - poses.p[k]) @ poses.R[k]
        _, m = model.tree.query(there, workers=1)
        other, texture = model.colours[0][m], model.texture[m]
        colours = missed(looked.colour[0][on[0]] - other, other, texture) - missed(0.0 * other, other, texture)
        back = (shown[k] - poses.p[0]) @ poses.R[0]
        told[k] = colour_votes * float(own @ colours / own.sum())
        told[k] += shape_votes * (_beside(model, there, sigma) + _beside(model, back, sigma))
    return told


def _beside(model: ModelCloud, points: Array, sigma: float) -> float:
    """Return the mean cost of points (N, 3) in O that lie beside a model's surface; see `alternatives.costs` [nat]."""
    if not len(points):
        return 0.0
    _, m = model.tree.query(points, k=TUNING.nearest, workers=1)
    apart = points[:, None] - model.points[m]
    along = np.einsum("nki,nki->nk", apart, model.normals[m])
    slide = np.sqrt(np.maximum(np.einsum("nki,nki->nk", apart, apart) - along**2, 0.0))
    # A cloud leaves out what is between its points.
    beyond = np.maximum(slide - model.spacing, 0.0) / ALTERNATIVES.edge
    far = np.hypot(along / sigma, beyond).min(axis=1)
    return float(0.5 * np.square(np.minimum(far, ALTERNATIVES.cut)).mean())
