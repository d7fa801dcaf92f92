"""Gains that stand on what their own hypothesis does not hold.

A gain multiplies what its joint transmits, which an earlier hypothesis told. Where that hypothesis had a rotor, say, on
a joint that carries little else, a gain on that joint looks like the rotor, and would take its place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import HypothesisFit, Members
from twin_diagram.model.effects.actuation import ActuatorFault, TorqueConstant
from twin_diagram.signals.arrays import Array

GAINS = (TorqueConstant.name, ActuatorFault.name)
"""Names that are in proportion to what a joint transmits."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    borrowed: float = 0.5
    """Share of what a gain multiplies that may be missing from its own hypothesis: gains are then known to that
    share."""


TUNING = Tuning()


def borrowing(bench: Bench, fit: HypothesisFit, supposed: Array, transmitted: Array) -> Members:
    """Return the gains of a hypothesis that multiply what the rest of it does not transmit.

    Args:
        bench: of the hypothesis.
        fit: it.
        supposed: (ΣD, n) torque that gains were worked out with, reduced [N·m].
        transmitted: (ΣD, n) torque that the hypothesis has without its gains, reduced [N·m].
    """
    missing = np.sum((supposed - transmitted) ** 2, axis=0) > TUNING.borrowed**2 * np.sum(supposed**2, axis=0)
    there = [k for k in fit.members if bench.candidates[k].name in GAINS]
    return frozenset(k for k in there if any(missing[j] for j in bench.candidates[k].joints))
