"""Refines one pose by Gauss-Newton, compiled: all steps in one call; `registration` says what they minimise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.cloud_kernels import PairRules, SurfaceCloud, opposite
from twin_diagram.perception.registration.colour_kernels import gains, sloped_colours, solve
from twin_diagram.perception.registration.point_kernels import (
    COARSE,
    COLOUR,
    COLUMNS,
    FACING,
    FINE,
    N_AT,
    Images,
    LookLimits,
    LooksFrom,
    NoiseLaw,
    PointTable,
    U,
    V,
    look_up,
)
from twin_diagram.perception.registration.residual_kernels import (
    ColourSums,
    OutlineCells,
    OutlineCuts,
    colour_normal,
    colour_weights,
    depth_normal,
    inward_normal,
)
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place


class ImageTerms(NamedTuple):
    """What an image gives to refine poses by.

    Attributes:
        images: depth, robot, normals.
        camera: its lens and pose, and the table.
        colours: fine and coarse, each (h, w, 3).
        corner: where their first pixel lies, as depth counts pixels (u, v).
        slopes: squared slopes that noise makes of each [1/px²].
        shift_information: (2, 2) of the colours' shift [1/px²].
        shift_certain: whether that is known.
        outline: where the image may show the object.
        any_outline: whether it says anything.
    """

    images: Images
    camera: LooksFrom
    colours: tuple[npt.NDArray[np.float32], ...]
    corner: tuple[float, float]
    slopes: tuple[float, ...]
    shift_information: Array
    shift_certain: bool
    outline: OutlineCells
    any_outline: bool


class TermRules(NamedTuple):
    """Constants of depth's and colours' terms.

    Attributes:
        deepest: along the line of sight, pairs farther apart than this many reaches are cut.
        model_noise: deviation of the model's surface [m].
        colour_factor: what colours' squared differences count beside depth's; 0: nothing.
        colour_cut: a colour farther off is another thing's.
        steeper: how much steeper, squared, the image's colours may be than the model's.
        aside: colours of points within this of the surface count however short the reach [m].
        even: (4,) what holds the brightness the same from all sides.
    """

    deepest: float
    model_noise: float
    colour_factor: float
    colour_cut: float
    steeper: float
    aside: float
    even: Array


class StepBound(NamedTuple):
    """How far a step turns and shifts a pose [rad], [m]."""

    turn: float
    shift: float


class StepSizes(NamedTuple):
    """What the size of a step says of those to come.

    Attributes:
        reach: of the first steps [m].
        narrow: of the last ones [m].
        least_gain: what a step must gain not to be the last [nat].
        small: after a smaller one the next would be lost in the noise.
        fine: after a smaller one colours are fine.
        sound: no more than this from a prediction that was right.
        largest: of all; its shift counts reaches.
    """

    reach: float
    narrow: float
    least_gain: float
    small: StepBound
    fine: StepBound
    sound: StepBound
    largest: StepBound


class StepCourse(NamedTuple):
    """How many steps there are.

    Attributes:
        most: at most.
        most_coarse: of them on coarse colours; 0: they are fine from the begin.
        stays_coarse: whether colours stay coarse, and the reach wide.
        right: whether the start is taken to be right: then the reach is narrow, unless the first step, which is
            undone, is not small.
    """

    most: int
    most_coarse: int
    stays_coarse: bool
    right: bool


class Rules(NamedTuple):
    """Constants of all terms, and of the steps."""

    looking: LookLimits
    noise: NoiseLaw
    terms: TermRules
    outline: OutlineCuts
    pairs: PairRules
    sizes: StepSizes
    course: StepCourse


@compiled
def refine_poses(
    R: Array,
    p: Array,
    model: PointTable,
    cloud: SurfaceCloud,
    image: ImageTerms,
    points_W: Array,
    prior: Array,
    rules: Rules,
    count: int,
) -> None:
    """Refine poses, each by itself, in place.

    Args:
        R: (B, 3, 3).
        p: (B, 3) [m].
        model: the object's points, to be looked up.
        cloud: the same, to be searched.
        image: what is seen.
        points_W: (N, 3) that are to be explained; none: (0, 3).
        prior: (6,) information of the poses.
        rules: constants.
        count: points used per pose.
    """
    told, flags = np.empty((1, count, COLUMNS)), np.empty((1, count), dtype=np.uint8)
    for k in range(R.shape[0]):
        own = (R[k].reshape((1, 3, 3)), p[k].reshape((1, 3)))
        refine_one(own[0], own[1], model, cloud, image, points_W, prior, rules, (told, flags))


@compiled
def refine_one(
    R: Array,
    p: Array,
    model: PointTable,
    cloud: SurfaceCloud,
    image: ImageTerms,
    points_W: Array,
    prior: Array,
    rules: Rules,
    room: tuple[Array, npt.NDArray[np.uint8]],
) -> None:
    """Refine one pose R (1, 3, 3), p (1, 3) in place."""
    goal = (R[0].copy(), p[0].copy())
    sizes, course = rules.sizes, rules.course
    # Not a bare constant, nor arrays set to arrays: for those Numba compiles all below once more, and words of errors.
    level, taken, right = int(COARSE), 0, course.right
    if course.most_coarse == 0:
        level = FINE
    reach = sizes.narrow if right else sizes.reach
    H, b, slope = np.empty((1, 6, 6)), np.empty((1, 6)), np.empty(6)
    for _ in range(course.most):
        normal_equations(R, p, model, cloud, image, points_W, rules, (level, reach), room, (H, b))
        add_prior(R[0], p[0], goal, prior, H[0], b[0])
        for i in range(6):
            slope[i] = b[0, i]
        solve(H[0], b[0])
        gain = 0.0
        for i in range(6):
            gain += 0.5 * slope[i] * b[0, i]
        turn, shift = move(R[0], p[0], b[0], sizes.largest.turn, sizes.largest.shift * reach)
        if course.stays_coarse:
            continue
        if right:
            right = False
            if smaller(turn, shift, sizes.fine):
                level = FINE
            else:
                for i in range(3):
                    p[0, i] = goal[1][i]
                    for j in range(3):
                        R[0, i, j] = goal[0][i, j]
                reach = sizes.reach
            continue
        taken += 1
        if level == COARSE:
            if taken >= course.most_coarse or smaller(turn, shift, sizes.fine):
                level = FINE
                # A prediction that was right needs no wide reach.
                if smaller(turn, shift, sizes.sound):
                    reach = min(reach, sizes.narrow)
        else:
            if reach <= sizes.narrow and (smaller(turn, shift, sizes.small) or gain < sizes.least_gain):
                break
            reach = max(sizes.narrow, 0.6 * reach)


@compiled_in_place
def smaller(turn: float, shift: float, bound: StepBound) -> bool:
    """Return whether a step is smaller than another, in turn and in shift."""
    return turn < bound.turn and shift < bound.shift


@compiled
def normal_equations(
    R: Array,
    p: Array,
    model: PointTable,
    cloud: SurfaceCloud,
    image: ImageTerms,
    points_W: Array,
    rules: Rules,
    stage: tuple[int, float],
    room: tuple[Array, npt.NDArray[np.uint8]],
    sums: tuple[Array, Array],
) -> None:
    """Write what the image says of one pose: H (1, 6, 6) and b (1, 6), on colours of a level, with a reach [m]."""
    level, reach = stage
    told, flags = room
    H, b = sums
    terms = rules.terms
    H[:] = 0.0
    b[:] = 0.0
    look_up(R, p, model, image.images, image.camera, rules.looking, told.shape[1], level, told, flags)
    depth_normal(told, flags, rules.noise, (reach, terms.deepest * reach, terms.model_noise), H, b)
    if terms.colour_factor > 0.0:
        add_colours(told, flags, image, terms, stage, H, b)
    if image.any_outline:
        inward_normal(told, flags, image.outline, image.camera, rules.outline, H, b)
    if points_W.shape[0]:
        n = points_W.shape[0]
        pairs = (np.empty((n, 6)), np.empty(n), np.empty((n, 3)))
        opposite(points_W, (R[0], p[0]), image.camera.p_WC, cloud, reach, rules.pairs, pairs, (H[0], b[0]))


@compiled
def add_colours(
    told: Array,
    flags: npt.NDArray[np.uint8],
    image: ImageTerms,
    terms: TermRules,
    stage: tuple[int, float],
    H: Array,
    b: Array,
) -> None:
    """Add what colours say of one pose, whatever their shift."""
    level, reach = stage
    weight = colour_weights(told, flags, (terms.deepest * reach, max(0.5 * reach, terms.aside)))
    found = sloped_colours(image.colours[level], told[:, :, U], told[:, :, V], weight, image.corner)
    gain = gains(found, told[:, :, COLOUR:COLUMNS], told[:, :, N_AT:FACING], weight, terms.even)
    sums = ColourSums(np.zeros((1, 6, 6)), np.zeros((1, 6)), np.zeros((1, 6, 2)), np.zeros((1, 2, 2)), np.zeros((1, 2)))
    cut = terms.colour_cut if level == FINE else 1.5 * terms.colour_cut
    colour_normal(told, found, weight, gain, image.camera, (cut, terms.steeper, image.slopes[level]), sums)
    factor, known = terms.colour_factor, image.shift_information
    held, pull, cross = sums.H_shift, sums.b_shift, sums.cross
    # Schur's complement of the shift.
    a, d = factor * held[0, 0, 0] + known[0, 0], factor * held[0, 1, 1] + known[1, 1]
    c = factor * held[0, 0, 1] + known[0, 1]
    free = 0.0 if image.shift_certain else factor * factor / (a * d - c * c)
    for i in range(6):
        one = free * (d * cross[0, i, 0] - c * cross[0, i, 1])
        other = free * (a * cross[0, i, 1] - c * cross[0, i, 0])
        b[0, i] += factor * sums.b[0, i] - one * pull[0, 0] - other * pull[0, 1]
        for j in range(6):
            H[0, i, j] += factor * sums.H[0, i, j] - one * cross[0, j, 0] - other * cross[0, j, 1]


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


@compiled_in_place
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
