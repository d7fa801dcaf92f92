"""What candidates that sit on one joint, and change its torque alone, are made with."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, Values
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    small: float = 0.05
    """A coefficient may cross zero by this share of what the given model has, where it takes that away."""


TUNING = Tuning()


def single(
    terms: Terms,
    name: str,
    j: int,
    columns: list[Array],
    parameters: Callable[[Array, Array], Values],
    lower: list[float],
    upper: list[float] | None = None,
    **others: Any,
) -> Candidate | None:
    """Return a candidate on one joint; none where its columns, (ΣD,) each, vanish."""
    stacked = np.stack(columns, axis=-1)
    size = np.sqrt(np.mean(stacked**2, axis=0))
    if not np.all(size > 1e-12):
        return None
    return Candidate(
        name=name,
        joints=(j,),
        links=(),
        rows=(j,),
        columns=stacked[:, None, :],
        spread=terms.torque_size[j] / size,
        lower=np.array(lower),
        upper=np.array(upper if upper is not None else [np.inf] * len(columns)),
        parameters=parameters,
        **others,
    )


def those_there(candidates: Iterable[Candidate | None]) -> list[Candidate]:
    """Return candidates without those that do not vary enough to matter."""
    return [candidate for candidate in candidates if candidate is not None]


def below_zero(present: float) -> float:
    """Return the lowest coefficient that takes away what the given model has."""
    return -(1 + TUNING.small) * float(present)
