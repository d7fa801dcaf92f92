"""How each joint's dry friction sets in: at once, over a way that the joint bends first, or as it gets under way.

A law that is wrong about reversals is wrong about the level, too: where friction takes some milliradians to build up,
the best level of a law that has it at once is too low. Left-out motion says which law a joint has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import TUNING as REGRESSORS
from twin_diagram.gap.residuals.regressors import levers
from twin_diagram.gap.whole_robot.left_out import LeftOut, likelihood
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.torque_equations import OWN, DryShape, TorqueEquations, low_passed
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    ways: tuple[float, ...] = (1e-3, 2.5e-3, 6e-3, 1.5e-2)
    """Over which friction builds up after a joint has turned [rad]: teeth and grease; beyond, it would be a spring."""

    speeds: tuple[float, ...] = (0.015, 0.025, 0.04, 0.07, 0.12)
    """About which friction changes as a joint gets under way [rad/s]: from where a joint may be held on."""

    below: float = 0.3
    """Of the level at speed, that friction which rises has at a crawl: so it is nearest to tanh(v / w)."""

    above: float = 1.6
    """The same of friction that falls: dry friction before it slides is some 1.2 to 2 times what it is then."""

    worth: float = 3.0
    """Rise of a joint's left-out log likelihood that a shape must bring [nats]: one of some fourteen, and one more."""

    speedy: float = 6.0
    """Rise of the log likelihood of all motion, left out by no fit, that a shape with a speed must bring, too [nats]:
    what does not explain the motion that is fitted may still spoil other motion less, by what it makes of links. On 90
    arms of `sims/benchmarks/gap_whole_robots.py --quick` (seeds 60150 to 60188, 60240 to 60288 and 300100 to 300138)
    what was neither such friction nor bristles brought up to 4, but up to 86 of left-out motion; nine of twelve joints
    with such friction that bring 3 of the latter bring 7 and more."""

    rather: float = 3.0
    """Beyond what a way brings that a shape with a speed must bring: what builds up over a way is weak where a joint
    gets under way, too [nats]."""

    share: float = 0.5
    """Of a joint's fastest motion, above which no speed is told."""


TUNING = Tuning()


def shaped(problem: RobotProblem, z: Array) -> tuple[RobotProblem, Array]:
    """Return the problem with the shape of each joint's dry friction that left-out motion likes best, and its fit.

    Each shape is tried on all joints at once: what one joint's friction does hardly changes another's residual. Where
    a shape is far off on some, links stand in for it, so what one joint's own residual asks for is tried on it alone.

    Args:
        problem: with everything usual free, and its noise.
        z: (Z,) its fit.
    """
    if problem.sums.records.model.arm.link_side:  # what is left of friction behind the sensor is no drive's
        return problem, z
    plain = LeftOut.of(problem, z).likelihood()
    best, chosen = np.full(problem.n, TUNING.worth), [DryShape()] * problem.n
    units = levers(problem.sums.records)
    for per_radian in _shapes():  # ways come first
        of_joints = [per_radian.times(float(unit)) for unit in units]
        there = [shape if _may_have(problem, j, shape) else DryShape() for j, shape in enumerate(of_joints)]
        if not any(one.told for one in there):
            continue
        tried = replace(problem, sums=with_shapes(problem.sums, there))
        fit = solve(tried, None, z)
        gain, within = LeftOut.of(tried, fit).likelihood() - plain, explained(tried, fit) - explained(problem, z)
        for j in range(problem.n):
            least = best[j] + TUNING.rather if there[j].speed and chosen[j].way else best[j]
            real = not there[j].speed or within[j] > TUNING.speedy
            if there[j].told and real and gain[j] > least:
                best[j], chosen[j] = gain[j], there[j]
    chosen = [*one_by_one(problem, z, chosen)]
    if not any(shape.told for shape in chosen):
        return problem, z
    problem = replace(problem, sums=with_shapes(problem.sums, chosen))
    z = solve(problem, None, z)
    problem = with_noise(problem, z)
    return problem, solve(problem, None, z)


def one_by_one(problem: RobotProblem, z: Array, chosen: Sequence[DryShape]) -> list[DryShape]:
    """Return the shapes of joints' dry friction with what rises on joints that have none, tried on one joint at a time.

    Args:
        problem: with plain friction.
        z: (Z,) its fit.
        chosen: shapes found on all joints at once.
    """
    shapes, units = list(chosen), levers(problem.sums.records)
    rising = [shape for shape in _shapes() if shape.speed and shape.crawl < 1.0]
    for j in [j for j in range(problem.n) if not shapes[j].told]:
        there = [shape.times(float(units[j])) for shape in rising]
        there = [shape for shape in there if _may_have(problem, j, shape)]
        asked = [risen(problem, z, j, shape) for shape in there]
        if not asked or max(asked) <= TUNING.speedy:
            continue
        before = with_shapes(problem.sums, shapes)
        more = with_shapes(before, [*shapes[:j], there[int(np.argmax(asked))], *shapes[j + 1 :]])
        tried = [replace(problem, sums=sums) for sums in (before, more)]
        fits = [solve(one, None, z) for one in tried]
        gain, within = (
            measure(tried[1], fits[1])[j] - measure(tried[0], fits[0])[j] for measure in (_left_out, explained)
        )
        if gain > TUNING.worth and within > TUNING.speedy:
            shapes[j] = more.shapes[j]
    return shapes


def risen(problem: RobotProblem, z: Array, j: int, shape: DryShape) -> float:
    """Return by how much likelier a joint's own residual is where its dry friction rises with speed [nats].

    Its own terms settle anew, links stay.

    Args:
        problem: with plain friction.
        z: (Z,) its fit.
        j: joint.
        shape: how friction rises.
    """
    sums, n = problem.sums, problem.n
    own = sums.columns[:, j, 10 * n : 10 * n + len(OWN)]
    parts = zip(sums.records.records, sums.signs, strict=True)
    column = np.concatenate([low_passed(law(r, j, s, shape), r)[r.kept] for r, s in parts])
    counted = sums.weights[:, j] > 0.0
    left = sums.left(problem.difference(z))[counted, j]
    plain = own[counted]
    more = np.column_stack([plain, column[counted] - plain[:, OWN.index("coulomb")]])
    fits = [np.linalg.lstsq(X, left, rcond=None)[0] for X in (plain, more)]
    if fits[1][-1] <= 0.0:
        return 0.0
    squares = [float(np.sum((left - X @ fit) ** 2)) for X, fit in zip((plain, more), fits, strict=True)]
    samples = float(problem.share[j] * sums.counted[j])
    return 0.5 * samples * float(np.log(max(squares[0], 1e-30) / max(squares[1], 1e-30)))


def _left_out(problem: RobotProblem, z: Array) -> Array:
    return LeftOut.of(problem, z).likelihood()


def explained(problem: RobotProblem, z: Array) -> Array:
    """Return (n,) log likelihood of all motion, but for a constant [nats].

    Args:
        problem: that was fitted.
        z: (Z,) its fit to all motion.
    """
    return likelihood(problem, np.sqrt(problem.squares(z, problem.sums.whole) / problem.sums.counted))


def with_shapes(sums: TorqueEquations, shapes: Sequence[DryShape]) -> TorqueEquations:
    """Return the sums with other shapes of dry friction, one per joint.

    What the given model has of dry friction changes its shape, too, or a description that states some would tell
    another level than one that states none.
    """
    columns, records, n = sums.columns.copy(), sums.records, sums.n
    at = 10 * n + OWN.index("coulomb")
    for j, shape in enumerate(shapes):
        if shape == sums.shapes[j]:
            continue
        parts = zip(records.records, sums.signs, strict=True)
        column = np.concatenate([low_passed(law(r, j, s, shape), r)[r.kept] for r, s in parts])
        columns[:, j, -1] -= sums.stated_dry[j] * (column - columns[:, j, at])
        columns[:, j, at] = column
    was = [-1 if k in (at, columns.shape[2] - 1) else k for k in range(columns.shape[2])]
    return replace(sums.with_columns(columns, was), shapes=tuple(shapes))


def law(record: Record, j: int, sign: Array, shape: DryShape) -> Array:
    """Return (N,) a joint's dry friction of a level of one, along a log.

    Args:
        record: the log.
        j: joint.
        sign: (N, n) directions of motion.
        shape: how friction sets in.
    """
    if shape.way:
        return bent(record.q[:, j], shape.way)
    if shape.speed:
        return np.asarray(sign[:, j] * (1.0 + (shape.crawl - 1.0) * np.exp(-((record.v[:, j] / shape.speed) ** 2))))
    return np.asarray(sign[:, j])


def bent(q: Array, way: float) -> Array:
    """Return (N,) share of dry friction that bristles bear which give way over some angle (Dahl 1968, exponent 1).

    Exact for steps of any length: between two samples the share goes to 1 or −1 as exp(−|Δq| / way).

    Args:
        q: (N,) angles [rad].
        way: over which friction builds up [rad].
    """
    steps = np.diff(q)
    moving = np.flatnonzero(steps)
    if not len(moving):
        return np.zeros(len(q))
    gone = np.concatenate([[0.0], np.cumsum(np.abs(steps))]) / way
    # Between two turns all is known in closed form: only the turns come one by one.
    turned = moving[1:][np.sign(steps[moving[1:]]) != np.sign(steps[moving[:-1]])]
    begins = np.concatenate([[0], turned])
    signs = np.sign(steps[np.concatenate([moving[:1], turned])])
    lasts = np.exp(-np.diff(gone[np.concatenate([begins, [len(q) - 1]])]))
    shares = np.empty(len(begins))
    share = float(np.sign(steps[np.argmax(np.abs(np.cumsum(steps)) > way)]))
    for k, (sign, kept) in enumerate(zip(signs.tolist(), lasts.tolist(), strict=True)):
        shares[k] = share
        share = sign + (share - sign) * kept
    run = np.searchsorted(begins, np.arange(len(q)), side="right") - 1
    return np.asarray(signs[run] + (shares[run] - signs[run]) * np.exp(-(gone - gone[begins[run]])))


def _shapes() -> list[DryShape]:
    """Return all shapes: below the speed at which a joint may be held, a fall passes for how it turns."""
    both = [DryShape(speed=s, crawl=c) for s in TUNING.speeds for c in (TUNING.below, TUNING.above)]
    speeds = [shape for shape in both if shape.crawl < 1.0 or shape.speed > REGRESSORS.rest]
    return [*(DryShape(way=way) for way in TUNING.ways), *speeds]


def _may_have(problem: RobotProblem, j: int, shape: DryShape) -> bool:
    """Return whether a joint may have a shape: none that its motion does not show, or its description rules out."""
    sums = problem.sums
    names = {effect.name for effect in sums.records.model.effects if sums.records.model.joints[j] in effect.joints}
    if StribeckFriction.name in names:
        return False
    fastest = max(float(np.max(np.abs(record.v[:, j]))) for record in sums.records.records)
    if shape.speed:
        return not sums.stated_dry[j] and shape.speed <= TUNING.share * fastest
    return True
