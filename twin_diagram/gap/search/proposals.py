"""Candidates that are made to measure for what a hypothesis leaves: ripples of any count, starts and ends in time.

There are too many of either to keep. Ripples are scored by projection; starts and ends by sums over blocks of time, so
that every pair of moments costs one small solution.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates import external_force, torque_ripple
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.blocks_of_time import TUNING as BLOCKS
from twin_diagram.gap.search.blocks_of_time import block_edges, block_sums, scores, span_scores, spans, sums_of
from twin_diagram.gap.search.evidence import Members
from twin_diagram.gap.search.normal_equations import increments
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.push_points import at_their_points
from twin_diagram.gap.search.scoring import basis, score_candidate, score_spans
from twin_diagram.model.effects.ripple import TorqueRipple
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    nearby: tuple[float, ...] = (-1.5, -1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0, 1.5)
    """Moments that are tried about the best sample, in thinned periods."""

    worth: float = 10.0
    """Evidence beyond the price of a name that makes a candidate worth proposing [nats]."""

    further_worth: float = 5.0
    """The same of a name that is there already, on a further joint [nats]."""

    start_worth: float = 3.0
    """Evidence beyond that of acting all the time [nats]."""

    seen: float = 0.05
    """Share of a candidate's information that must lie before its start: where an arm stood still, nothing could
    show."""

    remembered: int = 200
    """Steps in time that are kept, of a few kilobytes each; of a log of ten minutes 0.2 MB."""

    crowded: int = 8
    """A hypothesis with more members is not asked what it leaves."""


TUNING = Tuning()


class Proposer:
    """Proposes for one bench; keeps what does not depend on the hypothesis."""

    def __init__(self, terms: Terms) -> None:
        self.terms = terms
        self._ripples: dict[int, tuple[Array, Array, Array]] = {}
        self._forces: list[Candidate] | None = None
        self._force_columns: list[Array] = []
        self._steps: dict[tuple[int, float], Array] = {}
        self._asked: set[frozenset[tuple[object, ...]]] = set()

    def __call__(self, bench: Bench, members: Members) -> list[int]:
        """Add candidates beside a hypothesis and return their indices; each hypothesis is looked at once."""
        # A hypothesis with other shapes says the same, and leaves much the same.
        said = frozenset(bench.candidates[k].place for k in members)
        if said in self._asked or len(members) > TUNING.crowded:
            return []
        self._asked.add(said)
        Q = basis(bench, members)
        projected = np.einsum("jrk,jr->k", Q, bench.y)
        return [
            *self.ripples(bench, members, Q, projected),
            *self.starts(bench, Q, projected),
            *self.forces(bench, Q, projected),
        ]

    def ripples(self, bench: Bench, members: Members, Q: Array, projected: Array) -> list[int]:
        """Return the best count of each joint; where another joint has a ripple, one more is easily believed."""
        made = []
        rippled = any(bench.candidates[k].name == TorqueRipple.name for k in members)
        least = PRIOR_COSTS.further_joint + TUNING.further_worth if rippled else PRIOR_COSTS.new_name + TUNING.worth
        for j in range(bench.n):
            if not len(torque_ripple.ripple_counts(self.terms, j)):
                continue
            counts, X, spread = self._ripple_columns(bench, j)
            m = len(counts)
            C = Q[j].T @ X
            b = X.T @ bench.y[j] - C.T @ projected
            sine, cosine = slice(0, m), slice(m, 2 * m)
            G = np.empty((m, 2, 2))
            for i, one in enumerate((sine, cosine)):
                for k, other in enumerate((sine, cosine)):
                    G[:, i, k] = np.sum(X[:, one] * X[:, other], axis=0) - np.sum(C[:, one] * C[:, other], axis=0)
            scores = increments(G, np.stack([b[sine], b[cosine]], axis=1), spread)
            best = int(np.argmax(scores))
            candidate = torque_ripple.ripple(self.terms, j, float(counts[best]))
            if candidate is not None and scores[best] - candidate.cost > least:
                made.append(bench.add(candidate))
        return made

    def _ripple_columns(self, bench: Bench, j: int) -> tuple[Array, Array, Array]:
        if j not in self._ripples:
            counts = torque_ripple.ripple_counts(self.terms, j)
            columns = torque_ripple.ripple_columns(self.terms, j, counts)
            size = np.sqrt(np.mean(columns**2, axis=0)).reshape(2, -1).T + 1e-9
            white = bench.whitener.joint(j, columns) * bench.weights[j][:, None]
            self._ripples[j] = counts, white, self.terms.torque_size[j] / size
        return self._ripples[j]

    def starts(self, bench: Bench, Q: Array, projected: Array) -> list[int]:
        """Return the best start of every candidate that may start within the logs, where it is worth it."""
        found: list[tuple[float, int, int]] = []
        edges = block_edges(bench.rows)
        of_rows: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
        for k, candidate in enumerate(bench.candidates):
            plain = candidate.onset is None and candidate.variant == "" and k in bench.offered
            if plain and record_of(candidate.name).starts:
                of_rows[candidate.rows].append(k)
        for rows, some in of_rows.items():
            there = list(rows)
            each = sums_of([bench.columns[k] for k in some], Q[there], bench.y[there], edges)
            for k, sums in zip(some, each, strict=True):
                candidate = bench.candidates[k]
                size = np.einsum("bkk,k->b", sums[0], candidate.spread**2)
                seen = np.cumsum(size) - size >= TUNING.seen * np.sum(size)
                # Sums from each block on.
                G, C, b = (np.cumsum(x[::-1], axis=0)[::-1] for x in sums)
                rises = scores(G, C, b, candidate.spread, projected) - np.log(BLOCKS.blocks) - candidate.cost
                whole = rises[0] + np.log(BLOCKS.blocks)
                start = BLOCKS.margin + int(np.argmax(np.where(seen, rises, -np.inf)[BLOCKS.margin : -BLOCKS.margin]))
                if rises[start] > max(whole + TUNING.start_worth, PRIOR_COSTS.new_name + TUNING.worth):
                    found.append((float(rises[start]), k, start))
        made = []
        for _, k, start in sorted(found, reverse=True)[:6]:
            made.append(bench.add(self._started(bench, Q, projected, k, start, edges)))
        return made

    def _started(
        self, bench: Bench, Q: Array, projected: Array, k: int, start: int, edges: npt.NDArray[np.int64]
    ) -> Candidate:
        """Return a candidate from its best sample on, near the start of a block."""
        base = bench.candidates[k]
        rows = list(base.rows)
        fine = np.append(np.arange(edges[start - 1], edges[start + 1] + 1), bench.rows)
        G, C, b = block_sums(bench.columns[k], Q[rows], bench.y[rows], fine)
        G, C, b = (np.cumsum(x[::-1], axis=0)[::-1] for x in (G, C, b))
        at = int(fine[int(np.argmax(scores(G, C, b, base.spread, projected)))])
        made = self._during(bench, base, at, bench.rows, Q, projected)
        made = replace(made, cost=base.cost + float(np.log(BLOCKS.blocks)), variant="starting")
        return replace(made, name=record_of(made.name).started or made.name)

    def _during(self, bench: Bench, base: Candidate, at: int, to: int, Q: Array, projected: Array) -> Candidate:
        """Return a candidate that acts from about whitened row `at` to about row `to`, at the best moments nearby."""
        records = self.terms.records
        rows = np.append(bench.whitener.rows, len(records.residual))
        first, last = int(rows[at]), int(rows[to])
        onset = (int(records.owner[first]), float(records.times[first]))
        end = (int(records.owner[last]), float(records.times[last])) if last < len(records.residual) - 3 else None
        if end is not None and end[0] != onset[0]:  # what ends in another run was over at the end of its own
            end = (onset[0], float(records.times[records.owner == onset[0]][-1]))
        period = 1.0 / records.rate
        if last - first < 2:
            return base.during(active(self.terms, onset, end), onset, end)
        for _ in range(2):
            starts = [(onset[0], onset[1] + share * period) for share in TUNING.nearby]
            ended = 0.0 if end is None else self._begun(end)
            acts = [self._begun(moment) - ended for moment in starts]
            onset = starts[int(np.argmax(score_spans(bench, base, acts, Q, projected)))]
            if end is None:
                break
            ends = [(end[0], end[1] + share * period) for share in TUNING.nearby]
            begun = self._begun(onset)
            acts = [begun - self._begun(moment) for moment in ends]
            end = ends[int(np.argmax(score_spans(bench, base, acts, Q, projected)))]
        return base.during(active(self.terms, onset, end), onset, end)

    def _begun(self, moment: tuple[int, float]) -> Array:
        """Return `active` from a moment on: a hypothesis after the other asks for the same ones."""
        if moment not in self._steps:
            if len(self._steps) >= TUNING.remembered:
                self._steps.clear()
            self._steps[moment] = active(self.terms, moment, None)
        return self._steps[moment]

    def forces(self, bench: Bench, Q: Array, projected: Array) -> list[int]:
        """Return the best link and span of time of a constant wrench."""
        if self._forces is None:
            self._forces = external_force.external_forces(self.terms) + external_force.forces_at_centres(self.terms)
            self._force_columns = [bench.whiten(candidate) for candidate in self._forces]
        edges = block_edges(bench.rows)
        pairs = spans()
        found: list[tuple[float, int, int, int]] = []
        for (index, candidate), sums in zip(
            enumerate(self._forces), sums_of(self._force_columns, Q, bench.y, edges), strict=True
        ):
            rises = span_scores(*sums, pairs, candidate.spread, projected)
            best = int(np.argmax(rises))
            score = float(rises[best]) - 2.0 * np.log(BLOCKS.blocks) - candidate.cost
            if score > PRIOR_COSTS.new_name + TUNING.worth:
                found.append((score, index, int(pairs[best, 0]), int(pairs[best, 1])))
        likeliest = sorted(found, reverse=True)[:4]
        made = [self._spanned(bench, Q, projected, index, i, k, edges) for _, index, i, k in likeliest]
        return [bench.add(candidate) for candidate in self._pointed(bench, Q, projected, made)]

    def _pointed(self, bench: Bench, Q: Array, projected: Array, made: list[Candidate]) -> list[Candidate]:
        """Return pushes, or, where a force at another point of a link suits better, the best two of either kind."""
        if not made or self._forces is None:
            return made
        acts = active(self.terms, made[0].onset, made[0].end)
        wrenches = [force for force in self._forces if force.size > 3]
        points = at_their_points(bench, self.terms, Q, projected, wrenches, made[0], acts)

        def worth(candidate: Candidate) -> float:
            return score_candidate(bench, candidate, Q, projected) - candidate.cost

        points = sorted(points, key=worth, reverse=True)[:2]
        if not points or worth(points[0]) <= max(map(worth, made)):
            return made
        return [*points, *sorted(made, key=worth, reverse=True)[:2]]

    def _spanned(
        self, bench: Bench, Q: Array, projected: Array, index: int, i: int, k: int, edges: npt.NDArray[np.int64]
    ) -> Candidate:
        """Return a wrench over its best span of samples near two blocks' starts."""
        assert self._forces is not None
        base = self._forces[index]
        rows = list(base.rows)
        step = int(edges[1])
        at, to = int(edges[i]), int(edges[k])
        for _ in range(2):
            fine = np.unique(np.clip(np.append(np.arange(at - step, at + step + 1), to), 0, to))
            G, C, b = block_sums(self._force_columns[index], Q[rows], bench.y[rows], fine)
            G, C, b = (np.cumsum(x[::-1], axis=0)[::-1] for x in (G, C, b))
            at = int(fine[int(np.argmax(scores(G, C, b, base.spread, projected)))])
            fine = np.unique(np.clip(np.append(at, np.arange(to - step, to + step + 1)), at, bench.rows))
            G, C, b = block_sums(self._force_columns[index], Q[rows], bench.y[rows], fine)
            G, C, b = (np.cumsum(x, axis=0) for x in (G, C, b))
            to = int(fine[1 + int(np.argmax(scores(G, C, b, base.spread, projected)))])
        made = self._during(bench, base, at, to, Q, projected)
        return replace(made, cost=base.cost + 2.0 * float(np.log(BLOCKS.blocks)), variant="spanned")


def active(terms: Terms, onset: tuple[int, float] | None, end: tuple[int, float] | None) -> Array:
    """Return (ΣD,) 1 from the onset until the end, low-passed like the torque: what is switched on is seen so."""
    parts = []
    for record in terms.records.records:
        started = np.ones(len(record.kept)) if onset is None else after(record, onset)
        parts.append(started if end is None else started - after(record, end))
    return np.concatenate(parts)


def after(record: Record, moment: tuple[int, float]) -> Array:
    """Return (D,) 1 from a moment on and 0 before, low-passed like the torque."""
    if record.index != moment[0]:
        return np.full(len(record.kept), float(record.index > moment[0]))
    # A sample's share of the period before it, so that the moment counts below the log's own resolution.
    shares = np.clip((record.time - moment[1]) * record.rate + 0.5, 0.0, 1.0)
    at, answer = int(np.searchsorted(shares, 1.0)), record.step_response
    far = len(answer) // 2
    if at - 2 < far or at + far > len(shares):  # what lies beyond a log's ends is turned about them
        return record.reduce(shares)
    result = (record.kept >= at).astype(float)
    near = slice(*np.searchsorted(record.kept, (at - far, at + far - 2)))
    place = record.kept[near] - at + far
    steps = np.diff(shares[at - 3 : at + 1])  # all of it is in these, but for how times are rounded
    result[near] = sum(step * answer[place + back] for step, back in zip(steps, (2, 1, 0), strict=True))
    return result
