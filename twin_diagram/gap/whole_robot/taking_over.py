"""Whether what a whole robot lacks at once is the better answer than the few effects that a search has named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Verdict
from twin_diagram.gap.residuals.prepared_logs import Records, roughness
from twin_diagram.gap.verdict.deciding import TUNING as DECIDING
from twin_diagram.gap.verdict.probabilities import less_sure
from twin_diagram.gap.whole_robot.explain import WholeRobot, explain
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual_rms
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    better: float = 0.1
    """Fall of the residual's logarithm, mean over joints, beyond what the search has named."""

    much: float = 0.35
    """The same where it has named nothing: a law that no one knows bends a little to links and frictions, too."""

    above: float = 1.5
    """Noise floors above which what is left counts as a remainder."""


TUNING = Tuning()


def taken_over(
    records: Records, logs: Sequence[Log], verdict: Verdict, corrected: Model
) -> tuple[Verdict, Model, WholeRobot | None]:
    """Return verdict and corrected model, of the whole robot where that is the better answer, and what was found of it.

    It is asked only where a search has left structure: a robot that lacks a few things is explained by their names.

    Args:
        records: prepared with the given model.
        logs: of the fit, as the given model explains them.
        verdict: of the search.
        corrected: the given model with what the search has named.
    """
    if verdict.verdict == "none" or (verdict.verdict == "named" and not verdict.remainder):
        return verdict, corrected, None
    whole = explain(records)
    if whole is None or not outdoes(whole, logs, corrected, named=bool(verdict.findings)):
        return verdict, corrected, None
    remainder = bool(np.any(whole.fitted > TUNING.above * verdict.noise_floor))
    found = tuple(less_sure(f, DECIDING.less_sure) for f in whole.findings) if remainder else whole.findings
    changed = replace(verdict, verdict="named", remainder=remainder, findings=found, separation=())
    return changed, whole.model, whole


def unsearched(records: Records) -> Verdict:
    """Return the verdict where nothing could be searched for: unknown, with the noise that torques themselves show."""
    white = np.max([roughness(record.torque, 1.0 / record.rate) for record in records.records], axis=0)
    share = min(1.0, 2.0 * DIFFERENTIATION.residual_cutoff / records.records[0].rate)
    return Verdict("unknown", False, (), (), (), np.maximum(white * np.sqrt(share), 1e-9))


def outdoes(whole: WholeRobot, logs: Sequence[Log], corrected: Model, *, named: bool) -> bool:
    """Return whether many things at once leave clearly less on motion that they have not seen.

    Args:
        whole: what was found of the robot as a whole.
        logs: of the fit.
        corrected: its rival, which has seen all motion.
        named: whether the rival names anything.
    """
    n = len(whole.left)
    if whole.terms() < n or 2 * whole.places() < n:
        return False
    unseen = np.log(whole.left / np.maximum(whole.fitted, 1e-12))
    gained = np.mean(size_of(corrected, logs) - size_of(whole.model, logs) - unseen)
    return bool(gained > (TUNING.better if named else TUNING.much))


def size_of(model: Model, logs: Sequence[Log]) -> Array:
    """Return (n,) logarithm of what a model leaves of some logs."""
    squares = np.mean([torque_residual_rms(model, log) ** 2 for log in logs], axis=0)
    return np.asarray(0.5 * np.log(np.maximum(squares, 1e-24)))
