"""How each learnt parameter stands: settled, not excited by the motion, held at a bound, or in doubt under an alarm.

A filter that starts from parameters that are far off gets them right where the motion excites them. Where it does not,
θ̂ stays near the prior and looks like any other number; this says which is which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a parameter is an answer: chosen by hand."""

    told: float = 0.5
    """A parameter has settled when its deviation is below this share of its prior's: readings then count three times as
    much as the prior."""

    step: float = 1e-3
    """How far a parameter is pushed to see whether a bound gives way, in deviations of its prior."""


TUNING = Tuning()


class ParameterStatus(Enum):
    """Of one parameter."""

    SETTLED = "settled"
    """Readings tell it: the value with its deviation is an answer."""
    NOT_EXCITED = "not excited"
    """Readings told little of it so far, or little since an abrupt change: the value is mostly the prior's."""
    AT_BOUND = "at a bound"
    """Held at the end of what it may be: the truth lies there (a payload of nothing) or beyond, out of reach."""
    IN_DOUBT = "in doubt"
    """Readings tell it, or told it until a change opened it, but an alarm stands: what the model lacks may have been
    taken for it."""
    UNKNOWN = "unknown"
    """The gradient rule keeps no covariance, so nothing tells."""


@dataclass(frozen=True)
class Standing:
    """One parameter.

    Attributes:
        label: name with unit.
        value: relative to the model as given.
        std: standard deviation; 0 under the gradient rule.
        status: whether the value can be used.
    """

    label: str
    value: float
    std: float
    status: ParameterStatus

    def __str__(self) -> str:
        return f"{self.label} {self.value:.4g} ± {self.std:.2g}: {self.status.value}"


def standings(
    parameters: ParameterSet,
    theta: Array,
    covariance: Array,
    joints: Sequence[str],
    rule: str = "covariance",
    *,
    alarm: bool = False,
    freed: Array | None = None,
) -> list[Standing]:
    """Return how all parameters stand.

    Args:
        parameters: what θ means.
        theta: (p,) their values.
        covariance: (p, p) of them.
        joints: names.
        rule: `Filter.rule`.
        alarm: whether one of the drift monitor's stands: nothing has settled then.
        freed: (p,) above 0 where readings refuted what was thought of a parameter, so that it was opened
            (`belief.freed`); None: nowhere.
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    untouched = (theta == parameters.mean) & (std >= (1.0 - 1e-9) * parameters.scale)
    held = at_bound(parameters, theta) & ~untouched  # a prior that begins at a bound is no finding
    opened = np.zeros(parameters.size, dtype=bool) if freed is None else np.asarray(freed) > 0.0
    found = []
    for i, label in enumerate(parameters.labels(joints)):
        if held[i]:
            status = ParameterStatus.AT_BOUND
        elif rule == "gradient":
            status = ParameterStatus.UNKNOWN
        else:
            told = std[i] < TUNING.told * parameters.scale[i]
            calm = ParameterStatus.SETTLED if told else ParameterStatus.NOT_EXCITED
            status = ParameterStatus.IN_DOUBT if alarm and (told or opened[i]) else calm
        found.append(Standing(label, float(theta[i]), float(std[i]), status))
    return found


def at_bound(parameters: ParameterSet, theta: Array) -> np.ndarray:
    """Return (p,) which parameters cannot be moved further one way or the other, the rest being as they are.

    Args:
        parameters: with their bounds.
        theta: (p,) within them.
    """
    held = np.zeros(parameters.size, dtype=bool)
    for i, scale in enumerate(parameters.scale):
        for push in (-TUNING.step * scale, TUNING.step * scale):
            moved = theta.copy()
            moved[i] += push
            parameters.clip(moved)
            held[i] |= bool((moved[i] - theta[i]) * np.sign(push) < 0.5 * abs(push))
    return held
