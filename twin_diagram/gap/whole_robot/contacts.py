"""Spans in which something holds an arm that is no steady force: a wall, a part that jams, a hand that guides.

What such a contact does is of no law that a fit has, and is many times what links and friction leave elsewhere: fitted
along, it would bend all of them. So all else is fitted as if these spans had not been logged, and they are told.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from twin_diagram.gap.candidates.external_force import external_forces
from twin_diagram.gap.findings import Place, Verdict
from twin_diagram.gap.residuals.prepared_logs import TUNING as PREPARED_LOGS
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.verdict.locating import TUNING as LOCATING
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.torque_equations import TorqueEquations, equations
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.parting import chosen
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand.

    On two joints at once what is left of 49 logs without a contact or a push nowhere stands out by more than 10.1, of
    real arms' 14 by 5.8; a wall did by 3,100.
    """

    window: float = 0.2
    """Over which squares of what is left are averaged [s]."""

    begins: float = 6.0
    """Times what is left elsewhere, median, up to which a sample is of no contact,"""

    least: float = 15.0
    """and above which some of a contact must be,"""

    joint: float = 6.0
    """as must what is left on each of two joints at least: what a single one does, its own motor or gear may do."""

    steady: float = 0.95
    """Share of what stands out that a steady force, or a mass that is held, may explain: that has a name."""

    steadily: float = 0.3
    """That a steady force lasts beside what is at its edges [s]: what is over sooner has no name, see `pushes`."""

    edge: float = 0.25
    """On either side of a span, where averages and the low-pass carry what is beside it [s]."""

    most: float = 0.3
    """Share of the logs that contacts may take: what goes on for longer is no event."""

    left: float = 0.4
    """Share of the logs' time that stretches of some length beside contacts must hold."""

    rounds: int = 8
    """Times at most that samples are left out and the rest is fitted again."""


TUNING = Tuning()

CONDITION = "during a contact"
"""What the report says of where the residual is."""


@dataclass(frozen=True)
class Contact:
    """A span of a log.

    Attributes:
        log: index of the log.
        begin, end: on its clock [s].
        share: (n,) of the squares of all that the given model leaves of all logs, in units of what is left elsewhere.
    """

    log: int
    begin: float
    end: float
    share: Array


def contacts(records: Records) -> list[Contact]:
    """Return the spans of fit logs that no steady force explains, in order.

    Args:
        records: prepared with the given model.
    """
    try:
        sums = equations(records)
        standing = _StandingOut.of(records, sums)
    except np.linalg.LinAlgError:  # a log in which next to nothing moves
        return []
    if not np.any(standing.out) or np.mean(standing.out) > TUNING.most:
        return []
    result = []
    owner, times = sums.records.owner, sums.records.times
    for begin, end in _spans(standing.out, owner):
        inside = begin > 0 and end < len(owner) and owner[begin - 1] == owner[begin] and owner[end] == owner[end - 1]
        if inside and standing.is_contact(begin, end):
            share = standing.share(begin, end)
            result.append(Contact(int(owner[begin]), float(times[begin]), float(times[end - 1]), share))
    return result


def beside_contacts(
    given: Model, logs: list[Log], notes: list[str], more: str = ""
) -> tuple[list[Log], Records, list[Contact]]:
    """Return what is left of logs around contacts, in order, prepared, and these, of those stretches; `notes` grow.

    Where contacts leave little of the logs, they stay whole.

    Args:
        given: the given model.
        logs: checked.
        notes: of all logs.
        more: what is done with what is left.
    """
    records = prepare(given, logs)
    spans = contacts(records)
    shortest = PREPARED_LOGS.shortest + 2.0 * DIFFERENTIATION.residual_cut
    free: list[Log] = []
    renumbered: list[Contact] = []
    for index, log in enumerate(logs):
        own = [one for one in spans if one.log == index]
        renumbered += [replace(one, log=len(free)) for one in own]
        kept = np.ones(len(log), dtype=bool)
        for one in own:
            kept &= (log.time < one.begin) | (log.time > one.end)
        parts = stretches(kept)
        free += [_part(log, a, b) for a, b in parts if not own or log.time[b - 1] - log.time[a] >= shortest]
    lasting = [sum(float(log.time[-1] - log.time[0]) for log in some) for some in (free, logs)]
    if not spans or lasting[0] < TUNING.left * lasting[1]:
        return logs, records, []
    notes += [note + more for note in told(logs, spans)]
    return free, prepare(given, free), renumbered


def _part(log: Log, begin: int, end: int) -> Log:
    kept = np.zeros(len(log), dtype=bool)
    kept[begin:end] = True
    return log if np.all(kept) else chosen(log, kept)


def told(logs: Sequence[Log], spans: Sequence[Contact]) -> list[str]:
    """Return what is said of contacts, a line per log."""
    result = []
    for index, log in enumerate(logs):
        own = [one for one in spans if one.log == index]
        if not own:
            continue
        names = [log.joints[k] for k in np.argsort(-np.sum([one.share for one in own], axis=0))[:2]]
        when = ", ".join(f"{one.begin:.2f} to {one.end:.2f} s" for one in own)
        result.append(
            f"{log.source}: something touched or held the arm that is no steady force (a contact; most on "
            f"{' and '.join(names)}), which nothing in the catalogue describes: left out: {when}"
        )
    return result


def placed(verdict: Verdict, joints: Sequence[str], spans: Sequence[Contact], *, fresh: bool) -> Verdict:
    """Return a verdict on what was left of some logs that says where contacts were: they are no part of what is named.

    Args:
        verdict: on all else.
        joints: names.
        spans: found.
        fresh: whether the given model is a description, of which `none` would say that nothing else was seen.
    """
    if not spans:
        return verdict
    own = [
        Place(joints[j], float(one.share[j]), CONDITION, (one.begin, one.end), one.log)
        for one in spans
        for j in np.argsort(-one.share)
        if one.share[j] > LOCATING.least_share
    ]
    rest = 1.0 - sum(place.share for place in own)
    where = (*own, *(replace(place, share=rest * place.share) for place in verdict.where))
    if verdict.verdict == "none" and fresh:
        return replace(verdict, verdict="unknown", where=where)
    return replace(verdict, where=where, remainder=verdict.verdict == "named")


@dataclass(frozen=True)
class _StandingOut:
    """What all links and joints' own terms, fitted without what stands out, leave of fit logs.

    Attributes:
        records: of the kept samples.
        left: (N, n) of the residual, 0 where dry friction may hold a joint [N·m].
        scale: (n,) of what is left elsewhere [N·m].
        above: (N,) times what is left elsewhere, all joints together.
        out: (N,) what stands out.
        columns: (N, n, 4) per unit of mass at the last link and its moment.
        given: (N, n) of the given model's residual, likewise [N·m].
    """

    records: Records
    left: Array
    scale: Array
    above: Array
    out: npt.NDArray[np.bool_]
    columns: Array
    given: Array

    @staticmethod
    def of(records: Records, sums: TorqueEquations) -> _StandingOut:
        """Fit in turns with what is left out."""
        whole, counts = begun(records, sums), sums.weights > 0.0
        out = np.zeros(len(sums.columns), dtype=bool)
        width = max(1, round(TUNING.window * len(out) / sums.seconds))
        many = uniform_filter1d(np.sum(counts, axis=1).astype(float), width)
        z = None
        for _ in range(TUNING.rounds):
            problem, z = settled(replace(whole, sums=sums.weighted(sums.weights * ~out[:, None])), z)
            left = sums.left(problem.difference(z))
            usual = counts & ~out[:, None]
            scale = np.array([_spread(left[one, j]) for j, one in enumerate(usual.T)])
            squares = uniform_filter1d(np.sum((left / scale) ** 2, axis=1), width)
            above = np.sqrt(np.maximum(squares, 0.0) / np.maximum(many, 1.0))  # running sums may fall below 0
            above /= max(float(np.median(above[np.any(usual, axis=1)])), 1e-12)
            before, out = out, above > TUNING.begins
            if np.array_equal(out, before) or np.mean(out) > TUNING.most:
                break
        last = 10 * (sums.n - 1)
        columns, given = sums.columns[:, :, last : last + 4], sums.columns[:, :, -1] * sums.weights
        return _StandingOut(sums.records, left, scale, above, out, columns, given)

    def share(self, begin: int, end: int) -> Array:
        """Return (n,) of all squares of the given model's residual that samples from one to another have."""
        squares = (self.given / self.scale) ** 2
        return np.asarray(np.sum(squares[begin:end], axis=0) / max(float(np.sum(squares)), 1e-300))

    def is_contact(self, begin: int, end: int) -> bool:
        """Return whether samples from one to another stand out far, on two joints, and no steady force explains it."""
        sizes = np.sqrt(np.mean((self.left[begin:end] / self.scale) ** 2, axis=0))
        if np.max(self.above[begin:end]) < TUNING.least or np.sum(sizes > TUNING.joint) < 2:
            return False
        lasting = max(float(np.ptp(self.records.times[begin:end])), 1e-9)
        if lasting - 2.0 * TUNING.edge < TUNING.steadily:
            return True
        edge = round(TUNING.edge * (end - begin) / lasting)
        inner = slice(begin + edge, end - edge)
        terms = Terms(self.records, given_load(self.records), slow_speed(self.records))
        there = [(c.rows, c.columns[inner]) for c in external_forces(terms)]
        there.append((tuple(range(len(self.scale))), self.columns[inner]))
        return not any(self._explained(inner, *one) > TUNING.steady for one in there)

    def _explained(self, inner: slice, rows: tuple[int, ...], columns: Array) -> float:
        """Return the share of what is left that columns (N, r, k) on some joints explain."""
        left = self.left[inner] / self.scale
        counts = left[:, list(rows)] != 0.0
        A = (columns * counts[:, :, None] / self.scale[list(rows), None]).reshape(-1, columns.shape[2])
        y = left[:, list(rows)].ravel()
        beyond = y - A @ np.linalg.lstsq(A, y, rcond=1e-6)[0]
        return 1.0 - float((beyond @ beyond + np.sum(left**2) - y @ y) / max(np.sum(left**2), 1e-300))


def _spread(values: Array) -> float:
    """Return a robust standard deviation, never 0."""
    return max(1.4826 * float(np.median(np.abs(values))), 1e-9) if len(values) else 1.0


def _spans(out: npt.NDArray[np.bool_], owner: npt.NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return first and last + 1 samples of what stands out, none of two logs."""
    result: list[tuple[int, int]] = []
    for begin, end in stretches(out):
        cuts = begin + 1 + np.flatnonzero(np.diff(owner[begin:end]))
        edges = [int(begin), *map(int, cuts), int(end)]
        result += itertools.pairwise(edges)
    return result
