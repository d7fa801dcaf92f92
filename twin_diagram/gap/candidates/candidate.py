"""Hypotheses: a catalogue effect at one place, as torque that is linear in its coefficients once its shape is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from twin_diagram.signals.arrays import Array

Values = dict[str, tuple[Array, Array]]
"""Parameter key → value and standard error, each (k,)."""

Moment = tuple[int, float]
"""Record and time [s]."""

Span = tuple[Moment | None, Moment | None]
"""From one moment until another; None: the logs' begin or end."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect at one place.

    Attributes:
        name: of the catalogue.
        joints: indices of the joints that it is named on.
        links: names of the links that it is named on.
        rows: indices of the joints whose torque it changes.
        columns: (ΣD, len(rows), k) reduced torque per unit coefficient [N·m].
        spread: (k,) prior standard deviation of the coefficients; the prior's mean is 0.
        lower: (k,) what the coefficients may be.
        upper: (k,)
        parameters: from coefficients (k,) and their covariance (k, k) to the catalogue's parameters.
        shape: values that were searched for.
        cost: of the search, in nats: the logarithm of how many independent shapes there were.
        admits: further conditions on the coefficients.
        onset: (record, time) from which on it acts, else from the begin.
        end: (record, time) until which it acts.
        spans: all in which it acts, of which `onset` and `end` are the longest; empty: in that one, or always.
        vague: standard errors of the spans' begins and ends [s], where they are known.
        variant: tells candidates of one name and place apart.
        excludes: names that are not said beside it.
        unheard: (ΣD,) share of each sample whose logged torque does not count for it, nor the noise in it; None: all
            count.
        unheard_cost: what that costs on a bench, which knows the samples that are weighed [nats].
    """

    name: str
    joints: tuple[int, ...]
    links: tuple[str, ...]
    rows: tuple[int, ...]
    columns: Array
    spread: Array
    lower: Array
    upper: Array
    parameters: Callable[[Array, Array], Values]
    shape: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0
    admits: Callable[[Array], bool] | None = None
    onset: Moment | None = None
    end: Moment | None = None
    spans: tuple[Span, ...] = ()
    vague: tuple[tuple[float, float], ...] = ()
    variant: str = ""
    excludes: frozenset[str] = frozenset()
    unheard: Array | None = None
    unheard_cost: float = 0.0

    @property
    def price(self) -> float:
        """Of all that was chosen to suit the data [nats]."""
        return self.cost + self.unheard_cost

    @cached_property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.columns.shape[2])

    @cached_property
    def place(self) -> tuple[object, ...]:
        """Name, joints and links, and spans where there may be several: what a finding claims."""
        return self.name, self.joints, self.links, *self.spans

    @property
    def passing(self) -> bool:
        """Whether it acts for a part of the logs alone."""
        return self.onset is not None or self.end is not None

    def allows(self, coefficients: Array) -> bool:
        """Return whether coefficients are physical."""
        # Without arrays, as this is asked of everything that is scored.
        inside = all(a <= c <= b for (a, b), c in zip(self._bounds, coefficients.tolist(), strict=True))
        return inside and (self.admits is None or self.admits(coefficients))

    @cached_property
    def _bounds(self) -> list[tuple[float, float]]:
        """Of each coefficient."""
        return list(zip(self.lower.tolist(), self.upper.tolist(), strict=True))

    def during(self, active: Array, onset: Moment | None, end: Moment | None) -> Candidate:
        """Return the same, acting only where `active` (ΣD,) is 1."""
        return replace(self, columns=self.columns * active[:, None, None], onset=onset, end=end)


def linear(*keys: str, scale: float = 1.0) -> Callable[[Array, Array], Values]:
    """Return the parameters that are the coefficients themselves, times a constant."""

    def values(coefficients: Array, covariance: Array) -> Values:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return {key: (scale * coefficients[k : k + 1], abs(scale) * std[k : k + 1]) for k, key in enumerate(keys)}

    return values


def transformed(function: Callable[[Array], dict[str, Array]]) -> Callable[[Array, Array], Values]:
    """Return the parameters that are smooth functions of the coefficients; errors by the first-order law."""

    def values(coefficients: Array, covariance: Array) -> Values:
        centre = {key: np.atleast_1d(value) for key, value in function(coefficients).items()}
        step = 1e-4 * np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), 1e-9)
        slopes: dict[str, list[Array]] = {key: [] for key in centre}
        for k in range(len(coefficients)):
            sides = []
            for sign in (1.0, -1.0):
                moved = coefficients.copy()
                moved[k] += sign * step[k]
                sides.append(function(moved))
            for key in centre:
                slopes[key].append((np.atleast_1d(sides[0][key]) - np.atleast_1d(sides[1][key])) / (2.0 * step[k]))
        result: Values = {}
        for key, value in centre.items():
            J = np.stack(slopes[key], axis=1)
            result[key] = (value, np.sqrt(np.maximum(np.einsum("ik,kl,il->i", J, covariance, J), 0.0)))
        return result

    return values
