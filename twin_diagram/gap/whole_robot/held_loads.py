"""Loads that a whole robot holds for a part of its logs: an object that is picked and placed, a tool that is changed.

A load is there or it is not, and is the same each time. So mass, centre and spans are looked for in turns: with the
spans, all else is fitted beside the load; with that, each moment says whether it is likelier with the load or without.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate, Moment, Span
from twin_diagram.gap.candidates.payload import payload, payload_about
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.proposals import active
from twin_diagram.gap.whole_robot.events import TUNING as EVENTS
from twin_diagram.gap.whole_robot.events import SpansBeside, Tried, likeliest_spans
from twin_diagram.gap.whole_robot.held_by_friction import shares_of_friction
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.pushes import TUNING as PUSHES
from twin_diagram.gap.whole_robot.pushes import beside_rough_friction, while_sliding
from twin_diagram.gap.whole_robot.setting_off import TUNING as SETTING_OFF
from twin_diagram.gap.whole_robot.sharp_moments import between_samples
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    rounds: int = 8
    """Times at most that the load, and when it is held, are looked for in turn."""

    span: float = 10.0
    """What a span must bring beyond the price of its two moments [nats]: as much as a push."""

    parts: int = 600
    """Of the logs at whose bounds a load may come and go, at first."""

    likely: float = 0.5
    """Fall of the log likelihood up to which a moment is as good as another [nats]: at rest all are."""


TUNING = Tuning()

Mask = npt.NDArray[np.bool_]


def held_loads(problem: RobotProblem, z: Array, terms: Terms) -> list[Candidate]:
    """Return the load, over the spans of time that suit it best; or none.

    Args:
        problem: of what is there beside it.
        z: (Z,) its coordinates.
        terms: of the same samples.
    """
    # A load that is not there lets the joints that it drives hang together over all of its span.
    quiet = replace(problem, share=np.maximum(problem.share, np.median(problem.share)))
    plain = payload(terms)
    found = likeliest_spans(SpansBeside.of(quiet, solve(quiet, None, z)), [plain])
    if not found:
        return []
    held = np.zeros(len(terms.records.owner), dtype=bool)
    held[found[0][2] : found[0][3]] = True
    load = _in_turns(quiet, z, terms, plain, held)
    load = None if load is None else _sharper(quiet, z, terms, load)
    if load is None or np.all(shares_of_friction(problem, z, load) < PUSHES.drifts):
        return []
    problem, z = while_sliding(problem, z, terms, load)
    tried = Tried.of(problem, z, load)
    if tried.score < PUSHES.worth or beside_rough_friction(problem, z, tried) < PUSHES.worth:
        return []
    return [load]


def _in_turns(problem: RobotProblem, z: Array, terms: Terms, plain: Candidate, held: Mask) -> Candidate | None:
    """Return a load with the spans in which it is held, looked for in turns; None where there is none.

    Args:
        problem: of what is there beside it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        plain: the load, always.
        held: (N,) samples at which it is held, roughly.
    """
    about, turned, possible, load = plain, False, False, plain
    for _ in range(TUNING.rounds):
        load = _during(terms, about, held)
        if not load.passing:
            return None
        either = replace(load, lower=np.full_like(load.lower, -np.inf))
        tried = replace(problem, sums=problem.sums.with_further([*problem.sums.further, either]))
        fitted = solve(tried, None, np.concatenate([z, np.zeros(load.size)]))
        own = fitted[-load.size :]
        if own[0] < plain.lower[0]:  # it is held in between: what is there else is then in the last link
            if turned:
                return None
            held, turned = ~held, True
            continue
        if own[0] == 0.0:
            return None
        tried = with_noise(tried, fitted)
        tried = replace(tried, share=np.maximum(tried.share, problem.share))
        possible = plain.allows(own)  # over spans that are not yet right its centre may be anywhere
        before, held = held, _likelier(tried, fitted, about, own, load)
        if not np.any(held) or np.all(held):
            return None
        if np.array_equal(held, before) and (about is not plain or not possible):
            break
        about = _about(terms, own) if possible else plain
    return load if possible and load.passing else None


def _likelier(problem: RobotProblem, z: Array, plain: Candidate, own: Array, load: Candidate) -> Mask:
    """Return (N,) at which samples a load is likelier held than not, spans being dear.

    Args:
        problem: with the load.
        z: (Z,) its coordinates.
        plain: the load, always.
        own: (k,) its coefficients.
        load: as it was held.
    """
    torque, without = _torques(problem, z, plain, own, load)
    rise = without * torque - 0.5 * torque**2
    each = np.sum(rise * (problem.share / problem.variance)[list(plain.rows)], axis=1)
    # Colour is what laws leave over a while: when the load comes and goes, each sample tells.
    return spans_of(
        each, np.sum(rise / problem.variance[list(plain.rows)], axis=1), np.log(TUNING.parts) + 0.5 * TUNING.span
    )


def _torques(problem: RobotProblem, z: Array, plain: Candidate, own: Array, load: Candidate) -> tuple[Array, Array]:
    """Return (N, r) a load's torque, were it always there, and what is left without it [N·m]; see `_likelier`."""
    sums, rows = problem.sums, list(plain.rows)
    torque = (plain.columns @ own) * sums.weights[:, rows]
    held = (load.columns @ own) * sums.weights[:, rows]
    return torque, sums.left(problem.difference(z))[:, rows] + held


def spans_of(rise: Array, sharp: Array, price: float) -> Mask:
    """Return (N,) the samples of the likeliest spans.

    Args:
        rise: (N,) by how much likelier each sample is within a span [nats].
        sharp: (N,) the same where all samples are independent: it tells moments.
        price: of each begin and each end [nats].
    """
    edges = np.unique(np.round(np.linspace(0, len(rise), TUNING.parts + 1)).astype(np.int64))
    total = np.concatenate([[0.0], np.cumsum(rise)])
    parts, total = np.diff(total[edges]), np.concatenate([[0.0], np.cumsum(sharp)])
    on, came = 0.0, np.zeros((len(parts), 2), dtype=bool)
    off = 0.0
    for k, part in enumerate(parts):  # Viterbi's, of two states
        came[k] = off - price > on, on - price > off
        on, off = max(on, off - price) + part, max(off, on - price)
    state, held = on > off, np.zeros(len(parts), dtype=bool)
    for k in range(len(parts) - 1, -1, -1):
        held[k] = state
        state = state != bool(came[k, 0] if state else came[k, 1])
    result = np.zeros(len(rise), dtype=bool)
    width = int(np.max(np.diff(edges)))
    for begin, end in edges[stretches(held)]:
        result[_moment(total, begin, width, 1.0) : _moment(total, end, width, -1.0)] = True
    return result


def _moment(total: Array, near: int, width: int, sign: float) -> int:
    """Return the likeliest sample at which a span begins, or ends, near a rough one: the middle of those as likely."""
    if near in (0, len(total) - 1):
        return int(near)
    first, last = max(near - 2 * width, 0), min(near + 2 * width, len(total) - 1)
    alike = _alike(sign * total, first + int(np.argmin(sign * total[first : last + 1])))
    return round(float(np.mean(alike)))


def _alike(cost: Array, best: int) -> tuple[int, int]:
    """Return the first and the last sample about the best one that are as likely, by their costs (N + 1,) [nats]."""
    worse = np.flatnonzero(np.abs(cost - cost[best]) > TUNING.likely)
    at = int(np.searchsorted(worse, best))
    first = int(worse[at - 1]) + 1 if at > 0 else 0
    return first, int(worse[at]) - 1 if at < len(worse) else len(cost) - 1


def _sharper(problem: RobotProblem, z: Array, terms: Terms, load: Candidate) -> Candidate:
    """Return a load whose spans begin and end between kept samples.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        load: as it was found.
    """
    tried = replace(problem, sums=problem.sums.with_further([*problem.sums.further, load]))
    fitted = solve(tried, None, np.concatenate([z, np.zeros(load.size)]))
    own, spans = fitted[-load.size :], [list(span) for span in load.spans]
    plain = _about(terms, own)
    torque, without = _torques(tried, fitted, plain, own, load)
    weight = 0.5 / with_noise(tried, fitted).variance[list(load.rows)]

    def cost(k: int, i: int, log: int, time: float) -> float:
        moved = [
            [(log, time) if (at, side) == (k, i) else span[side] for side in range(2)] for at, span in enumerate(spans)
        ]
        share = np.sum([active(terms, *span) for span in moved], axis=0)
        return float(np.sum(weight * (without - share[:, None] * torque) ** 2))

    for k, i in itertools.product(range(len(spans)), range(2)):
        spans[k][i] = between_samples(terms, spans[k][i], partial(cost, k, i))
    made = _over(terms, plain, [(begin, end) for begin, end in spans])
    total = np.concatenate([[0.0], np.cumsum(np.sum(weight * (2.0 * without * torque - torque**2), axis=1))])
    return replace(made, vague=tuple((_vague(terms, total, a), _vague(terms, total, b)) for a, b in made.spans))


def _vague(terms: Terms, total: Array, moment: Moment | None) -> float:
    """Return a moment's standard error [s] by how long each one is as likely, `total` being by how much up to each."""
    if moment is None:
        return 0.0
    records = terms.records
    own = np.flatnonzero(records.owner == moment[0])
    at = int(own[0] + np.searchsorted(records.times[own], moment[1]))
    first, last = np.clip(_alike(total, at), own[0], own[-1])
    return max(float(records.times[last] - records.times[first]), 1.0 / records.rate) / np.sqrt(12.0)


def _about(terms: Terms, own: Array) -> Candidate:
    """Return a load that is always there about the centre that its coefficients (4,) tell."""
    return payload_about(terms, own[1:] / own[0])


def _during(terms: Terms, plain: Candidate, held: Mask) -> Candidate:
    """Return a load that is held at some samples (N,)."""
    spans = sorted(_spans(terms, held), key=lambda one: -one[0])
    return _over(terms, plain, [span for _, span in spans])


def _over(terms: Terms, plain: Candidate, spans: Sequence[Span]) -> Candidate:
    """Return a load that is held over some spans, the longest first."""
    share = np.sum([active(terms, *span) for span in spans], axis=0)
    made = replace(plain.during(share, *spans[0]), spans=tuple(spans), variant="held")
    return replace(made, cost=2.0 * float(np.log(EVENTS.blocks)) * len(spans))


def _spans(terms: Terms, held: Mask) -> list[tuple[float, Span]]:
    """Return spans of some samples (N,), none of two logs but where it goes on to the last one's end; how long each is.

    One that begins as the first log does was there before.
    """
    records = terms.records
    owner, times, count = records.owner, records.times, len(held)
    result: list[tuple[float, Span]] = []
    for begin, end in stretches(held):
        cuts = [int(begin), *(int(begin) + 1 + np.flatnonzero(np.diff(owner[begin:end]))), int(end)]
        if end == count:
            cuts = [int(begin), count]
        for b, e in itertools.pairwise(cuts):
            log = int(owner[b])
            starts = bool(np.flatnonzero(owner == log)[0] == b)
            ends = bool(np.flatnonzero(owner == owner[e - 1])[-1] == e - 1)
            early = log == 0 and times[b] - times[0] < SETTING_OFF.calm
            onset = None if early else (log, float(times[b] if starts else 0.5 * (times[b - 1] + times[b])))
            final = e == count or (owner[e - 1] == owner[-1] and times[-1] - times[e - 1] < SETTING_OFF.calm)
            stop = float(times[e - 1] if ends else 0.5 * (times[e - 1] + times[min(e, count - 1)]))
            stops = None if final else (int(owner[e - 1]), stop)
            lasts = float(np.ptp(times[b:e])) if owner[b] == owner[e - 1] else float(e - b) / records.rate
            if onset is not None or stops is not None:
                result.append((lasts, (onset, stops)))
    return result or [(0.0, (None, None))]
