"""Refines one pose by Gauss-Newton, compiled: all steps in one call; `registration` says what they minimise."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.cloud_kernels import opposite
from twin_diagram.perception.registration.colour_kernels import gains, sloped_colours, solve
from twin_diagram.perception.registration.point_kernels import (
    COARSE,
    COLOUR,
    COLUMNS,
    FACING,
    FINE,
    N_AT,
    U,
    V,
    colour_normal,
    colour_weights,
    depth_normal,
    inward_normal,
    look_up,
)
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def refine_poses(
    R: Array,
    p: Array,
    model: tuple[Any, ...],
    cloud: tuple[Any, ...],
    picture: tuple[Any, ...],
    points_W: Array,
    prior: Array,
    rules: tuple[Any, ...],
    count: int,
) -> None:
    """Refine poses, each by itself, in place.

    Args:
        R: (B, 3, 3).
        p: (B, 3) [m].
        model: as for `look_up`.
        cloud: as for `opposite`.
        picture: images and camera as for `look_up`; colours, fine and coarse; their corner; squared slopes that noise
            makes of each; information of their shift (2, 2); whether that is certain; silhouette as for
            `inward_normal`, and whether there is one.
        points_W: (N, 3) that are to be explained; none: (0, 3).
        prior: (6,) information of the poses.
        rules: limits of `look_up`; noise of depth; constants of residuals (how much deeper in reaches, the model's
            noise, factor of colours, their cut, how much steeper, how far aside); cuts of `inward_normal`; of
            `opposite` without the reach; of the steps (reach, narrow reach, what a step must gain [nat] not to be the
            last, then turn and shift each of a small step, of one after which colours are fine, of one from a right
            prediction, of the largest one, in reaches);
            counts (steps, coarse steps, whether colours stay coarse, whether the start is taken to be right: then the
            reach is narrow, unless the first step, which is undone, is not small).
        count: points used per pose.
    """
    told, flags = np.empty((1, count, COLUMNS)), np.empty((1, count), dtype=np.uint8)
    for k in range(R.shape[0]):
        own = (R[k].reshape((1, 3, 3)), p[k].reshape((1, 3)))
        refine_one(own[0], own[1], model, cloud, picture, points_W, prior, rules, (told, flags))


@compiled
def refine_one(
    R: Array,
    p: Array,
    model: tuple[Any, ...],
    cloud: tuple[Any, ...],
    picture: tuple[Any, ...],
    points_W: Array,
    prior: Array,
    rules: tuple[Any, ...],
    room: tuple[Array, npt.NDArray[np.uint8]],
) -> None:
    """Refine one pose R (1, 3, 3), p (1, 3) in place."""
    goal = (R[0].copy(), p[0].copy())
    reach, narrow, least_gain = rules[5][:3]
    small_turn, small_shift, fine_turn, fine_shift, right_turn, right_shift, largest_turn, largest_shift = rules[5][3:]
    iterations, coarse_steps, stays_coarse, right = rules[6]
    level, taken, wide = COARSE, 0, reach
    if right:
        reach = narrow
    H, b, slope = np.empty((1, 6, 6)), np.empty((1, 6)), np.empty(6)
    for _ in range(iterations):
        normal_equations(R, p, model, cloud, picture, points_W, rules, (level, reach), room, (H, b))
        add_prior(R[0], p[0], goal, prior, H[0], b[0])
        slope[:] = b[0]
        solve(H[0], b[0])
        gain = 0.0
        for i in range(6):
            gain += 0.5 * slope[i] * b[0, i]
        turn, shift = move(R[0], p[0], b[0], largest_turn, largest_shift * reach)
        if stays_coarse:
            continue
        if right:
            right = False
            if turn < fine_turn and shift < fine_shift:
                level = FINE
            else:
                R[0], p[0] = goal
                reach = wide
            continue
        taken += 1
        if level == COARSE:
            if taken >= coarse_steps or (turn < fine_turn and shift < fine_shift):
                level = FINE
                # A prediction that was right needs no wide reach.
                if turn < right_turn and shift < right_shift:
                    reach = min(reach, narrow)
        else:
            small = turn < small_turn and shift < small_shift
            if reach <= narrow and (small or gain < least_gain):
                break
            reach = max(narrow, 0.6 * reach)


@compiled
def normal_equations(
    R: Array,
    p: Array,
    model: tuple[Any, ...],
    cloud: tuple[Any, ...],
    picture: tuple[Any, ...],
    points_W: Array,
    rules: tuple[Any, ...],
    stage: tuple[int, float],
    room: tuple[Array, npt.NDArray[np.uint8]],
    sums: tuple[Array, Array],
) -> None:
    """Write what the image says of one pose: H (1, 6, 6) and b (1, 6), on colours of a level, with a reach [m]."""
    images, camera, _, _, _, _, _, silhouette, any_silhouette = picture
    level, reach = stage
    told, flags = room
    H, b = sums
    H[:] = 0.0
    b[:] = 0.0
    look_up(R, p, model, images, camera, rules[0], told.shape[1], level, told, flags)
    deepest, model_noise, factor = rules[2][:3]
    depth_normal(told, flags, rules[1], (reach, deepest * reach, model_noise), H, b)
    if factor > 0.0:
        add_colours(told, flags, picture, rules[2], stage, H, b)
    if any_silhouette:
        inward_normal(told, flags, silhouette, camera, rules[3], H, b)
    if points_W.shape[0]:
        n = points_W.shape[0]
        pairs = (np.empty((n, 6)), np.empty(n), np.empty((n, 3)))
        share, deviation, spacing = rules[4]
        opposite(points_W, (R[0], p[0]), camera[5], cloud, (reach, share, deviation, spacing), pairs, (H[0], b[0]))


@compiled
def add_colours(
    told: Array,
    flags: npt.NDArray[np.uint8],
    picture: tuple[Any, ...],
    constants: tuple[Any, ...],
    stage: tuple[int, float],
    H: Array,
    b: Array,
) -> None:
    """Add what colours say of one pose, whatever their shift."""
    _, camera, colours, corner, slopes, information, certain, _, _ = picture
    level, reach = stage
    deepest, _, factor, cut, steeper, aside, even = constants
    image = colours[level]
    weight = colour_weights(told, flags, (deepest * reach, max(0.5 * reach, aside)))
    found = sloped_colours(image, told[:, :, U], told[:, :, V], weight, corner)
    gain = gains(found, told[:, :, COLOUR:COLUMNS], told[:, :, N_AT:FACING], weight, even)
    sums = (np.zeros((1, 6, 6)), np.zeros((1, 6)), np.zeros((1, 6, 2)), np.zeros((1, 2, 2)), np.zeros((1, 2)))
    colour_normal(
        told, found, weight, gain, camera, (cut if level == FINE else 1.5 * cut, steeper, slopes[level]), sums
    )
    own, right, cross, held, pull = sums
    # Schur's complement of the shift.
    a, d = factor * held[0, 0, 0] + information[0, 0], factor * held[0, 1, 1] + information[1, 1]
    c = factor * held[0, 0, 1] + information[0, 1]
    free = 0.0 if certain else factor * factor / (a * d - c * c)
    for i in range(6):
        one = free * (d * cross[0, i, 0] - c * cross[0, i, 1])
        other = free * (a * cross[0, i, 1] - c * cross[0, i, 0])
        b[0, i] += factor * right[0, i] - one * pull[0, 0] - other * pull[0, 1]
        for j in range(6):
            H[0, i, j] += factor * own[0, i, j] - one * cross[0, j, 0] - other * cross[0, j, 1]


@compiled
def add_prior(R: Array, p: Array, goal: tuple[Array, Array], prior: Array, H: Array, b: Array) -> None:
    """Add the normal equations that hold a pose where it began, with information (6,)."""
    miss = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                miss[i, j] += goal[0][i, k] * R[j, k]
    x, y, z = 0.5 * (miss[2, 1] - miss[1, 2]), 0.5 * (miss[0, 2] - miss[2, 0]), 0.5 * (miss[1, 0] - miss[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, 0.5 * (miss[0, 0] + miss[1, 1] + miss[2, 2] - 1.0))
    longer = angle / sine if sine > 1e-9 else 1.0
    b[0] += prior[0] * x * longer
    b[1] += prior[1] * y * longer
    b[2] += prior[2] * z * longer
    for i in range(3):
        b[3 + i] += prior[3 + i] * (goal[1][i] - p[i])
    for i in range(6):
        H[i, i] += prior[i]


@compiled
def move(R: Array, p: Array, step: Array, most_turn: float, most_shift: float) -> tuple[float, float]:
    """Turn and shift a pose in place, at most so far; return how far was asked for [rad], [m]."""
    turn = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    shift = np.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    factor = min(1.0, min(most_turn / max(turn, 1e-9), most_shift / max(shift, 1e-9)))
    half = max(0.5 * factor * turn, 1e-12)
    sine = np.sin(half) / half
    x, y, z = 0.5 * factor * sine * step[0], 0.5 * factor * sine * step[1], 0.5 * factor * sine * step[2]
    w = np.cos(half)
    # The unit quaternion (w, x, y, z) as a matrix.
    for column in range(3):
        a, b, c = R[0, column], R[1, column], R[2, column]
        u, v, t = y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c
        R[0, column] = a + 2.0 * (y * t - z * v)
        R[1, column] = b + 2.0 * (z * u - x * t)
        R[2, column] = c + 2.0 * (x * v - y * u)
    for i in range(3):
        p[i] += factor * step[3 + i]
    return turn, shift
