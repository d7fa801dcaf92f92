"""What friction may be beyond its laws: rough where a joint turns, crawls or runs fast, or drifting: no event.

No drive's friction is quite a catalogue's. What is left of it comes again whenever a joint turns, or is as fast; where
that happens but once in a log, a push over the same span would pass for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import levers
from twin_diagram.gap.whole_robot.dry_shapes import law
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.torque_equations import OWN, DryShape, low_passed
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    ways: tuple[float, ...] = (2.5e-3, 1.5e-2)
    """Over which friction may build up after a joint has turned [rad]: teeth and grease, see `dry_shapes`."""

    speeds: tuple[float, ...] = (0.03, 0.1)
    """About which friction may change as a joint gets under way [rad/s]: held, and crawling."""

    rough: float = 0.3
    """Share of a joint's friction by which such a shape may be off its law, one standard deviation: sigmoids, powers of
    the speed and hysteresis are within that."""

    drift: float = 0.1
    """Share of it by which friction, and what it has in one direction more than in the other, may change from the
    middle of a log to its ends: grease warms up."""


TUNING = Tuning()


def rough_friction(problem: RobotProblem, z: Array, joints: Sequence[int]) -> list[Candidate]:
    """Return what friction of some joints may be beyond its law, without a name: one candidate per joint.

    Args:
        problem: that was fitted.
        z: (Z,) its coordinates.
        joints: whose.
    """
    sums = problem.sums
    own = z[10 * problem.n : 14 * problem.n].reshape(problem.n, len(OWN))
    units = levers(sums.records)
    result = []
    for j in joints:
        parts = zip(sums.records.records, sums.signs, strict=True)
        shapes = np.concatenate([_shapes(r, j, s, float(units[j])) for r, s in parts])
        speed = np.sqrt(np.mean(np.concatenate([r.v[:, j] for r in sums.records.records]) ** 2))
        level = abs(own[j, OWN.index("coulomb")] + sums.stated_dry[j]) + abs(own[j, OWN.index("viscous")]) * speed
        wide = np.full(shapes.shape[1], np.inf)
        spread = np.full(shapes.shape[1], max(TUNING.rough * float(level), 1e-9))
        result.append(Candidate("", (), (), (j,), shapes[:, None], spread, -wide, wide, lambda c, covariance: {}))
    return result


def _shapes(record: Record, j: int, sign: Array, unit: float) -> Array:
    """Return (M, k) of a log's kept samples: by how much friction of a level of one may differ from its law."""
    v, plain = record.v[:, j], sign[:, j]
    fastest = max(float(np.max(np.abs(v))), 1e-9)
    shares = np.abs(v) / fastest
    bending = [law(record, j, sign, DryShape(way=way * unit)) - plain for way in TUNING.ways]
    crawling = [np.exp(-((v / (speed * unit)) ** 2)) * plain for speed in TUNING.speeds]
    growing = [shares**power * side for power in (0.5, 2.0) for side in (plain, np.ones_like(v))]
    load = np.abs(record.passed[:, j])
    loaded = load / max(float(np.max(load)), 1e-9) * plain
    drifted = TUNING.drift / TUNING.rough * np.linspace(-1.0, 1.0, len(v))
    every = low_passed(np.stack([*bending, *crawling, *growing, loaded, drifted * plain, drifted], axis=1), record)
    return np.asarray(every[record.kept])
