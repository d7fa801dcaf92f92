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
from twin_diagram.perception.registration.colour_votes import colour_costs
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.rotation import exp, log
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
    *,
    turns: bool = False,
) -> SettledPose:
    """Weigh poses along what depth leaves open, go to the likeliest, and claim what the weights say.

    Args:
        model: the object.
        frame: the image.
        candidates: registered poses, of which the likeliest is gone on with.
        points_W: (N, 3) points that should be the object's.
        params: tuning.
        turns: nothing is known of the pose beforehand, so that what it may be mistaken for is tried, too.
    """
    rivals = [*candidates, *(turned(model, frame, candidates[0], points_W, params) if turns else [])]
    cost = np.zeros(1)
    if len(rivals) > 1:
        cost = compare(model, frame, _poses(rivals), points_W, FINE)
        cost = cost + colour_costs(model, frame, _poses(rivals), params.model_points)
    chosen = int(np.argmin(cost))
    result = rivals[chosen]
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
    if np.any(step):
        # A mean of two valleys, or along several directions at once, may be where nothing is likely.
        both = Poses(np.concatenate([pose.R, after.R]), np.concatenate([pose.p, after.p]))
        there = compare(model, frame, both, points_W)
        if there[1] > there[0]:
            step, after, spread = np.zeros(6), pose, spread + np.outer(step, step)
    wide = widened(result.covariance, spread)
    poses = distinct(laid, after, result.covariance, wide)
    if len(rivals) > 1:
        poses = beside(poses, rivals, cost)
    shown = replace(result, R=after.R[0], p=after.p[0], covariance=wide)
    first = likeliest(poses)
    if first > 0:
        shown, poses = _gone_to(model, frame, shown, poses, first, points_W, params)
    moved = result is not candidates[0] or bool(np.any(step)) or first > 0
    return SettledPose(shown, poses, moved)


def likeliest(poses: Sequence[PoseHypothesis]) -> int:
    """Return which hypothesis to show: the first, a mean, or one turned from it that is likelier than all others.

    Half way between two turns is a pose that nothing speaks for; half way along a slide is near to all of it.
    """
    best = int(np.argmax([one.probability for one in poses]))
    turn = float(np.linalg.norm(log((poses[best].R @ poses[0].R.T)[None])))
    return best if poses[best].probability > 0.5 and turn > TUNING.apart[0] else 0


def _gone_to(
    model: ModelCloud,
    frame: Frame,
    mean: RegisteredPose,
    poses: Sequence[PoseHypothesis],
    chosen: int,
    points_W: Array,
    params: scenario.Registration,
) -> tuple[RegisteredPose, tuple[PoseHypothesis, ...]]:
    """Return a hypothesis registered anew, with a claim of all that lies about it, and the hypotheses, it first."""
    one, centre = poses[chosen], poses[0]
    found = register(model, frame, one.R, one.p, params, points_W=points_W)
    if apart(found, one):
        found = replace(found, R=one.R, p=one.p)
    off = np.concatenate([log((found.R @ mean.R.T)[None])[0], found.p - mean.p])
    found = replace(found, covariance=mean.covariance + np.outer(off, off))
    # The mean stands for what is near it, no longer for all.
    others = [replace(centre, covariance=one.covariance), *(x for x in poses[1:] if x is not one)]
    first = replace(one, R=found.R, p=found.p, covariance=found.covariance)
    return found, (first, *sorted(others, key=lambda other: -other.probability))


def turned(
    model: ModelCloud, frame: Frame, one: RegisteredPose, points_W: Array, params: scenario.Registration
) -> list[RegisteredPose]:
    """Register what a pose may be mistaken for: turns that leave the shape much as it was, and turns of what stands."""
    yaw = 2.0 * np.pi * np.arange(1, TUNING.yaws) / TUNING.yaws
    upright = exp(np.stack([0.0 * yaw, 0.0 * yaw, yaw], axis=1))
    R = np.concatenate([one.R[None], one.R @ model.mistaken, upright @ one.R])
    laid = Poses(R, model.kept_in_place(one.R, one.p, R))
    cost = compare(model, frame, laid, points_W) + colour_costs(model, frame, laid, TUNING.points)
    nearest = [int(k) for k in np.argsort(cost, kind="stable") if k > 0][: TUNING.rivals]
    return [register(model, frame, laid.R[k], laid.p[k], params, points_W=points_W) for k in nearest]


def beside(
    poses: tuple[PoseHypothesis, ...], rivals: Sequence[RegisteredPose], cost: Array
) -> tuple[PoseHypothesis, ...]:
    """Add rivals to hypotheses, as likely as their costs (B,) say, where none is near them."""
    listed = list(poses)
    for k, one in enumerate(rivals):
        odds = float(np.exp(-min(cost[k] - cost.min(), 50.0)))
        if odds > TUNING.likely and all(apart(one, other) for other in listed):
            listed.append(PoseHypothesis(one.R, one.p, one.covariance, odds))
    whole = sum(one.probability for one in listed)
    first, *others = [replace(one, probability=one.probability / whole) for one in listed]
    return first, *sorted(others, key=lambda one: -one.probability)


def apart(first: RegisteredPose | PoseHypothesis, second: RegisteredPose | PoseHypothesis) -> bool:
    """Return whether two poses differ by more than hypotheses must."""
    turn = float(np.linalg.norm(log((first.R @ second.R.T)[None])))
    return turn > TUNING.apart[0] or float(np.linalg.norm(first.p - second.p)) > TUNING.apart[1]


def _poses(many: Sequence[RegisteredPose]) -> Poses:
    return Poses(np.stack([one.R for one in many]), np.stack([one.p for one in many]))
