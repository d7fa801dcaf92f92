"""What a held-out run says of a correction above the frequencies at which the gap is told.

An elasticity may swing, and a ripple run, faster than the 10 Hz below which residuals are compared. What is left there
is noise before and after, and which of the two is less is chance. Such a run is asked in the band of the search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.correction.equation_error import left_by
from twin_diagram.gap.residuals import whitening
from twin_diagram.gap.residuals.prepared_logs import TUNING as PREPARED_LOGS
from twin_diagram.gap.residuals.prepared_logs import prepare
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    speaks: float = 10.0
    """Rise of the held-out log likelihood that is no chance."""


TUNING = Tuning()


def confirmed(given: Model, corrected: Model, held: Log) -> bool:
    """Return whether a run that was fitted by neither is clearly likelier with the corrected model.

    Each residual is held to be noise of a colour of its own.
    """
    if held.time[-1] - held.time[0] - 2.0 * DIFFERENTIATION.residual_cut < PREPARED_LOGS.shortest:
        return False
    records = prepare(given, [held])

    def innovation(model: Model) -> Array:
        residual = left_by(model, records)
        noise = whitening.estimate(residual, records.lengths)
        return np.asarray(0.5 * len(noise.rows) * np.log(np.mean(noise.all(residual) ** 2, axis=1) * noise.sigma**2))

    gain = innovation(given) - innovation(corrected)
    return float(np.sum(gain)) > TUNING.speaks
