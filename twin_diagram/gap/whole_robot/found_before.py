"""What is known of a model that was corrected before, and how much it may leave of a later log of another motion.

A number that the first logs hardly told is unsure, and leaves more of a motion that asks for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.concluding import WholeRobot, every_beside
from twin_diagram.gap.whole_robot.estimates import covariance
from twin_diagram.gap.whole_robot.physical_links import Links, slopes
from twin_diagram.gap.whole_robot.torque_equations import OWN, equations
from twin_diagram.model.description.corrected_folder import CorrectedStanding
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    least: float = 1e-4
    """Share of a scale by which coordinates are off whatever a fit says, a joint's own term's being that at which it is
    as large as the residual: no covariance is singular."""


TUNING = Tuning()


def factor_of(whole: WholeRobot) -> list[list[float]]:
    """Return rows of the triangular factor of the covariance (14 n, 14 n) that the robot was found with, named or not.

    Links' ten coordinates each come first, then joints' own terms: the first 10 n rows are of the links alone.
    """
    every, size = every_beside(whole.problem), 14 * whole.problem.n
    spread = covariance(every, whole.coordinates)[:size, :size]
    weightless = np.flatnonzero(np.repeat(~every.links.heavy, 10))
    spread[weightless], spread[:, weightless] = 0.0, 0.0
    own = np.sqrt(every.variance)[:, None] / np.maximum(every.sums.own_size, 1e-9)
    scale = np.concatenate([every.links.scale.ravel(), own.ravel()])
    rows = np.linalg.cholesky(spread + np.diag((TUNING.least * scale) ** 2))
    return [[float(f"{x:.4g}") for x in row[: k + 1]] for k, row in enumerate(rows)]


def told_of(standing: CorrectedStanding, given: Model) -> Array | None:
    """Return the covariance (14 n, 14 n) that links and joints' own terms were found with; None where it is not known.

    Args:
        standing: of the given model; where it tells of links alone, joints' own terms count as sure.
        given: of n joints.
    """
    links, size = 10 * len(given.joints), 14 * len(given.joints)
    told = len(standing.links)
    if not standing.remainder or told not in (links, size):
        return None
    if [len(row) for row in standing.links] != list(range(1, told + 1)):
        return None
    lower = np.zeros((size, size))
    lower[:told, :told][np.tril_indices(told)] = np.concatenate(standing.links)
    return np.asarray(lower @ lower.T)


def prior_of(told: Array | None) -> Array | None:
    """Return what of a covariance, see `told_of`, draws later fits: links' part alone where it tells of no more.

    Joints' own terms count as sure there, which they were not.
    """
    if told is None:
        return None
    links = 10 * len(told) // 14
    return told if np.any(np.diag(told)[links:]) else told[:links, :links]


def beyond_expected(records: Records, recorded: Array, told: Array | None) -> tuple[Array, Array]:
    """Return times the expected that a corrected model leaves of logs, and times the recorded that is expected (n,).

    Where dry friction may hold a joint its torque may be anything up to that: such samples do not count.

    Args:
        records: of logs, prepared with the corrected model.
        recorded: (n,) what it left when it was corrected [N·m].
        told: covariance of its numbers, see `told_of`; None: they count as sure.
    """
    sums = equations(records)
    more = np.zeros(records.n) if told is None else doubt(records, sums.whole, told) / sums.counted
    expected = np.sqrt(recorded**2 + more)
    return sums.residual_rms / expected, expected / recorded


def doubt(records: Records, sums: Array, told: Array) -> Array:
    """Return (n,) squares that numbers with a covariance are expected to leave [N²·m²].

    Args:
        records: prepared with the corrected model.
        sums: (n, K + 1, K + 1) of its torque equations.
        told: (14 n, 14 n) covariance.
    """
    n, links = records.n, 10 * records.n
    slope = np.eye(links + len(OWN))
    for body, block in enumerate(slopes(Links.of(records.model).mean)):
        slope[10 * body : 10 * body + 10, 10 * body : 10 * body + 10] = block
    result = np.zeros(n)
    for j in range(n):
        mine = np.concatenate([np.arange(links), links + len(OWN) * j + np.arange(len(OWN))])
        spread = slope @ told[np.ix_(mine, mine)] @ slope.T
        result[j] = np.sum(spread * sums[j, : len(mine), : len(mine)])
    return result
