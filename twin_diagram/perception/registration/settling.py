"""Settles a registered pose among what else the image allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram import scenario
from twin_diagram.perception.registration.alternatives import (
    TUNING,
    PoseHypothesis,
    compare,
    distinct,
    profile,
    settled,
    widened,
)
from twin_diagram.perception.registration.data_association import FINE, Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class SettledPose:
    """A registered pose, its covariance with what the image leaves open, and the poses that it allows.

    Attributes:
        registration: the pose.
        hypotheses: itself first, then those apart from it, the likeliest first; their probabilities sum to 1.
        moved: whether it is another than was given.
    """

    registration: RegisteredPose
    hypotheses: tuple[PoseHypothesis, ...]
    moved: bool


def settle(
    model: ModelCloud,
    frame: Frame,
    candidates: Sequence[RegisteredPose],
    points_W: Array,
    params: scenario.Registration,
) -> SettledPose:
    """Weigh poses along what depth leaves open, go to the likeliest, and claim what the weights say.

    Args:
        model: the object.
        frame: the image.
        candidates: registered poses, of which the likeliest is gone on with.
        points_W: (N, 3) points that should be the object's.
        params: tuning.
    """
    chosen = 0
    if len(candidates) > 1:
        laid_at = Poses(np.stack([one.R for one in candidates]), np.stack([one.p for one in candidates]))
        chosen = int(np.argmin(compare(model, frame, laid_at, points_W)))
    result = candidates[chosen]
    for turn in range(TUNING.rounds + 1):
        pose = Poses(result.R[None], result.p[None])
        fine = look(model, frame, pose, params.model_points, FINE)
        laid = profile(model, frame, pose, points_W, fine, params.colour_weight)
        best = int(np.argmin(laid.cost))
        if turn == TUNING.rounds or laid.cost[best] > laid.cost[0] - TUNING.better:
            break
        result = register(model, frame, laid.poses.R[best], laid.poses.p[best], params, points_W=points_W)
    step, spread = settled(laid)
    after = pose.moved(step[None])
    wide = widened(result.covariance, spread)
    poses = distinct(laid, after, result.covariance, wide)
    moved = chosen > 0 or result is not candidates[0] or bool(np.any(step))
    return SettledPose(replace(result, R=after.R[0], p=after.p[0], covariance=wide), poses, moved)
