"""Gaps that the play of a gear may have, on all joints.

When play knocks depends on the gap, and one that is a tenth off knocks at other times: between gaps of a coarse grid
nothing shows. So a fine one is tried, by a torque that is linear in the twist and cheap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import Members
from twin_diagram.gap.search.scoring import basis, score_candidate
from twin_diagram.model.dynamics.backlash import play_alone
from twin_diagram.model.effects.elasticity import Backlash
from twin_diagram.signals.arrays import Array

GAPS = np.geomspace(0.0018, 0.035, 22)
"""[rad]"""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    peaks: int = 2
    """Gaps that are worth a closer look, per hypothesis."""

    about: tuple[float, ...] = (0.93, 1.0, 1.07)
    """The closer look: where the torque is cheap, a gap may be a little off."""

    least: float = 12.0
    """Evidence beside a rotor's inertia that makes a gap worth it [nats]."""

    share: float = 0.15
    """And this share of what the best gap of all joints explains."""

    shown: float = 0.3
    """Joints that show less of a knock beside their noise than this share of what the best one does are left out."""

    turned: float = 1e-3
    """For the load's slope [rad]."""


TUNING = Tuning()


class Knocks:
    """Tries gaps on a bench; what that takes is worked out once."""

    def __init__(self, terms: Terms, bench: Bench) -> None:
        """Work out inertia and load along the motion, without rotors.

        Args:
            terms: of the logs.
            bench: of the same logs.
        """
        model = terms.records.model
        self.terms = terms
        self.bench = bench
        self.masses = [model.tree.mass_matrix(r.q) - np.diag(model.tree.rotor) for r in terms.records.records]
        self.loads = [model.law.link_load(r.q, r.v, r.a) for r in terms.records.records]
        self._tried: dict[int, list[tuple[Candidate, Array]]] = {}

    def turns(self, j: int) -> bool:
        """Return whether a joint's load ever turns: else its gear rests on one side, which any gap explains alike."""
        return any(np.ptp(np.sign(load[:, j])) > 0.0 for load in self.loads)

    def gaps(self, hypotheses: Mapping[int, Sequence[Members]]) -> dict[int, list[float]]:
        """Return the gaps [rad] of each joint that are worth a closer look, beside one of the hypotheses given for it.

        Where play on one joint explains most, others are looked at when that is named.
        """
        more: dict[tuple[int, Members], Array] = {}
        for members in dict.fromkeys(members for some in hypotheses.values() for members in some):
            Q = basis(self.bench, members)
            told = np.einsum("jrk,jr->k", Q, self.bench.y)
            for j in (j for j, some in hypotheses.items() if members in some):
                more[j, members] = self._more(j, Q, told)
        most: dict[Members, float] = {}
        for (_, members), scores in more.items():
            most[members] = max(most.get(members, 0.0), float(np.max(scores)))
        peaks: dict[int, set[int]] = {j: set() for j in hypotheses}
        for (j, members), scores in more.items():
            least = max(TUNING.least, TUNING.share * most[members])
            high, _ = scipy.signal.find_peaks([-np.inf, *scores, -np.inf], height=least)
            peaks[j] |= set(sorted((high - 1).tolist(), key=lambda k: -scores[k])[: TUNING.peaks])
        return {
            j: [float(GAPS[k] * share) for k in sorted(some) for share in TUNING.about] for j, some in peaks.items()
        }

    def _more(self, j: int, Q: Array, told: Array) -> Array:
        """Return what each gap explains beside what its rotor does [nats]."""
        if j not in self._tried:
            self._tried[j] = self._torques(j)
        rotor, *scores = (score_candidate(self.bench, c, Q, told, white=white) for c, white in self._tried[j])
        return np.array(scores) - rotor

    def _torques(self, j: int) -> list[tuple[Candidate, Array]]:
        """Return candidates of the rotor alone and of each gap on the joints that show it best, each also whitened."""
        records = self.terms.records
        shown = sum(np.mean(mass[:, :, j] ** 2, axis=0) for mass in self.masses) / self.bench.whitener.sigma**2
        rows = [i for i in range(records.n) if i == j or shown[i] > TUNING.shown**2 * np.max(shown)]
        slopes = []
        for record, load in zip(records.records, self.loads, strict=True):
            turned = record.q.copy()
            turned[:, j] += TUNING.turned
            slopes.append((records.model.law.link_load(turned, record.v, record.a) - load)[:, rows] / TUNING.turned)
        rotor = records.reduce(lambda record: record.a[:, j])
        size = max(float(np.sqrt(np.mean(rotor**2))), 1e-9)
        tried = []
        for gap in (0.0, *GAPS):
            parts = []
            for record, mass, load, slope in zip(records.records, self.masses, self.loads, slopes, strict=True):
                angle, _, acceleration = play_alone(mass[:, j, j], load[:, j], 0.5 * gap, 1.0 / record.rate)
                parts.append(mass[:, rows, j] * acceleration[:, None] + slope * angle[:, None])
            columns = np.zeros((len(rotor), len(rows), 2))
            columns[:, :, 0] = self.terms.reduce(tuple(parts))
            columns[:, rows.index(j), 1] = rotor
            candidate = Candidate(
                name=Backlash.name,
                joints=(j,),
                links=(),
                rows=tuple(rows),
                columns=columns,
                spread=np.array([1.0, self.terms.torque_size[j] / size]),
                lower=np.full(2, -np.inf),
                upper=np.full(2, np.inf),
                parameters=linear("gap", "rotor_inertia"),
            )
            tried.append((candidate, self.bench.whiten(candidate)))
        return tried
