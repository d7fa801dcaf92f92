"""Bounds what an image can tell of a thing's name by what sets it apart from a plain body turned about an axis.

A mug seen from behind shows what a cylinder shows, in every image and however well it fits. What is in view of a thing
that is not round, and lies on a body that is, speaks for both alike; what lies beside that body speaks for the thing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.alternatives import votes
from twin_diagram.perception.registration.assessment import TUNING as ASSESSMENT
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import TUNING as MODELS
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.round_body import off_round_body


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    slack: float = 0.003
    """A point is in place within this and depth's noise [m], as `assessment.assess` has it: models err, too."""


TUNING = Tuning()


def most_of_name(model: ModelCloud, frame: Frame, pose: Poses, points: int) -> float:
    """Return by how much an image is likelier of an object than of a plain body that shows the same [nat].

    Infinite where nothing plain shows the same: the object is round itself, or its colours or its sides are not.

    Args:
        model: the object.
        frame: the image.
        pose: one, at which the image shows it.
        points: model points that are looked up, at most.
    """
    if model.is_round:
        return np.inf
    looked = look(model, frame, pose, points, FINE)
    # A cloud tells where a surface ends to half of its spacing.
    sigma = np.hypot(frame.camera.depth_noise(looked.z[0]), 0.5 * model.spacing)
    near = (looked.counted & looked.near & (np.abs(looked.deeper) < ASSESSMENT.same_surface))[0]
    on = near & (np.abs(looked.distance[0]) < TUNING.slack + ASSESSMENT.placed * sigma)
    colours = looked.colour[0][on & looked.painted[0]]
    if not on.any():
        return np.inf
    if len(colours) and np.linalg.norm(colours - colours.mean(axis=0), axis=1).mean() > MODELS.coloured:
        return np.inf
    beside = off_round_body(looked.r[0][on] @ pose.R[0], looked.n[0][on] @ pose.R[0])
    if beside is None:
        return np.inf
    cost = 0.5 * np.square(np.minimum(beside / sigma[on], ALTERNATIVES.cut))
    return float(cost.sum()) / votes(looked, frame, model.spacing)
