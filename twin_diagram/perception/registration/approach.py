"""Brings a rough pose near enough for exact registration, and lays rival poses along what the image leaves open.

Exact registration looks up what stands at the pixels of the model's points, which is right within a centimetre. From
farther off, the image's points are moved onto the model first: each to the nearest model point that faces the same way,
point-to-plane, and point-to-point where the nearest lies aside (Besl and McKay 1992; Chen and Medioni 1992), with
Tukey's weights of a shrinking reach. What such a step cannot settle (how far along a box, which way round a cup) is
told by the weakest directions of its normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.residuals import Normal, toward, tukey
from twin_diagram.perception.registration.rotation import cross, skew
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on trials below number 100 000 of `sims/benchmarks/registration_peers.py`."""

    reaches: tuple[float, ...] = (0.03, 0.02, 0.012)
    """Pairs farther apart are cut [m]; one stage each."""

    steps: int = 8
    """Gauss-Newton steps of a stage, at most."""

    small_step: tuple[float, float] = (2e-3, 3e-4)
    """A stage ends with a step smaller than this [rad], [m]."""

    sliding: float = 0.3
    """Weight of point-to-point beside point-to-plane."""

    least_cosine: float = 0.3
    """Between the normals of a pair: the inside of a cup is not its outside."""

    noise: float = 0.002
    """Standard deviation of a pair's distance [m]: several times that of depth, since early pairs are wrong."""

    largest_turn: float = 0.3
    """Of one step [rad]."""

    aside: tuple[float, float] = (0.15, 0.02)
    """Rivals lie once and twice as far along each of the weakest directions [rad], [m]."""

    weakest: int = 3
    """Directions along which rivals are laid."""


TUNING = Tuning()


def pull(model: ModelCloud, points_W: Array, normals_W: Array, pose: Poses, reach: float) -> Normal:
    """Return the normal equations that move a model under the image's points.

    Args:
        model: the object.
        points_W: (N, 3) of the image.
        normals_W: (N, 3) theirs, towards the camera.
        pose: one pose.
        reach: pairs farther apart are cut [m].
    """
    R, p = pose.R[0], pose.p[0]
    distance, index = model.nearest.query((points_W - p) @ R, reach)
    good = np.isfinite(distance)
    good[good] = np.einsum("ni,ni->n", model.normals[index[good]], (normals_W @ R)[good]) > TUNING.least_cosine
    index = index[good]
    r, n = model.points[index] @ R.T, model.normals[index] @ R.T
    apart = points_W[good] - p - r
    along = np.einsum("ni,ni->n", apart, n)
    w = tukey(distance[good], 1.5 * reach) / TUNING.noise**2
    J = -np.concatenate([cross(r, n), n], axis=1)
    H = (J * w[:, None]).T @ J
    b = -(J * w[:, None]).T @ along
    tangent = apart - along[:, None] * n
    slide = np.linalg.norm(tangent, axis=1)
    # Within the model's own spacing, points lie aside for no reason.
    tangent *= np.maximum(1.0 - model.spacing / np.maximum(slide, 1e-9), 0.0)[:, None]
    far = slide > model.spacing
    if far.any():
        block = np.concatenate([-skew(r[far]), np.broadcast_to(np.eye(3), (int(far.sum()), 3, 3))], axis=2)
        weighted = (block * (TUNING.sliding * w[far])[:, None, None]).reshape(-1, 6).T
        H += weighted @ block.reshape(-1, 6)
        b += weighted @ tangent[far].ravel()
    return Normal(H[None], b[None])


def approach(model: ModelCloud, points_W: Array, normals_W: Array, start: Poses, prior: Array) -> tuple[Poses, Array]:
    """Move a model under the image's points from a rough pose.

    Args:
        model: the object.
        points_W: (N, 3) of the image, those that should be the object's; others are cut by their distance.
        normals_W: (N, 3) theirs.
        start: one pose.
        prior: (6,) information of `start`.

    Returns:
        The pose, and the information (6, 6) of the pairs there.
    """
    pose = start
    for reach in TUNING.reaches:
        for _ in range(TUNING.steps):
            data, held = pull(model, points_W, normals_W, pose, reach), toward(pose, start, prior)
            step = np.linalg.solve(data.H + held.H, (data.b + held.b)[..., None])[..., 0]
            turn, shift = float(np.linalg.norm(step[:, :3])), float(np.linalg.norm(step[:, 3:]))
            share = min(1.0, TUNING.largest_turn / max(turn, 1e-9), reach / max(shift, 1e-9))
            pose = pose.moved(np.asarray(step) * share)
            if turn < TUNING.small_step[0] and shift < TUNING.small_step[1]:
                break
    return pose, pull(model, points_W, normals_W, pose, TUNING.reaches[-1]).H[0]


def rivals(pose: Poses, information: Array) -> Poses:
    """Return a pose, and others aside of it along the directions of which `information` (6, 6) knows least."""
    scale = np.repeat(TUNING.aside, 3)
    _, ways = np.linalg.eigh(information * scale[:, None] * scale)
    weakest = ways[:, : TUNING.weakest].T * scale
    steps = np.concatenate([np.zeros((1, 6)), *(k * weakest for k in (-2.0, -1.0, 1.0, 2.0))])
    many = Poses(np.repeat(pose.R, len(steps), axis=0), np.repeat(pose.p, len(steps), axis=0))
    return many.moved(np.asarray(steps, dtype=np.float64))
