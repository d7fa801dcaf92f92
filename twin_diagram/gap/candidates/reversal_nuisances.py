"""What laws of sliding get wrong about the moments at which a joint turns, and filters carry beyond them.

A joint that turns is held for a moment, by any torque between the levels before and after. Such samples are left out
(`stiction`), but a low-pass rings for longer than can be left out, alike at every turn: by as much as the noise where
friction is twenty times that. So every hypothesis may have the held torque come earlier or later, and evenly or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms, turns
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    fewest: int = 4
    """Turns that a joint must make."""


TUNING = Tuning()


def nuisances(terms: Terms) -> list[Candidate]:
    """Return one per joint that has dry friction, as far as is known, and turns."""
    made = (_nuisance(terms, j) for j in np.flatnonzero(terms.dry_level > 0.0).tolist())
    return [candidate for candidate in made if candidate is not None]


def _nuisance(terms: Terms, j: int) -> Candidate | None:
    slow = terms.resting(j)
    spans = [turns(record, j, slow) for record in terms.records.records]
    if sum(len(some) for some in spans) < TUNING.fewest:
        return None
    pairs = zip(terms.records.records, spans, strict=True)
    return Candidate(
        name="",
        joints=(j,),
        links=(),
        rows=(j,),
        columns=terms.reduce(tuple(_shapes(record, j, some) for record, some in pairs))[:, None, :],
        spread=np.full(2, float(terms.dry_level[j])),
        lower=np.full(2, -np.inf),
        upper=np.full(2, np.inf),
        parameters=linear("early", "uneven"),
    )


def _shapes(record: Record, j: int, spans: list[tuple[int, int]]) -> Array:
    """Return (N, 2) of unit height: against the motion before a turn.

    All along it and in its first half less its second.
    """
    result = np.zeros((len(record.time), 2))
    for first, last in spans:
        before = np.sign(record.v[first - 1, j])
        result[first:last, 0] = -before
        result[first:last, 1] = -before * np.sign(np.linspace(1.0, -1.0, last - first))
    return result
