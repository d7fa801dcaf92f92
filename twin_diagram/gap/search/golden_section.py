"""The least of a function of one number by golden sections (Kiefer 1953)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SHARE = 0.5 * (np.sqrt(5.0) - 1.0)


def least(
    cost: Callable[[float], float], low: float, high: float, sections: int, *, ties_low: bool = False
) -> tuple[float, float]:
    """Cost and place of the better of the last two points, the bounds being left out.

    Args:
        cost: with one least between the bounds; where it has more, one of them is found.
        low: bound.
        high: bound.
        sections: times that the bracket shrinks by `SHARE`; two more costs than that are worked out.
        ties_low: whether equal costs lead towards `low`; else towards `high`.
    """
    a, b = low, high
    x, y = b - SHARE * (b - a), a + SHARE * (b - a)
    fx, fy = cost(x), cost(y)
    for _ in range(sections):
        if fx < fy or (ties_low and fx == fy):
            b, y, fy = y, x, fx
            x = b - SHARE * (b - a)
            fx = cost(x)
        else:
            a, x, fx = x, y, fy
            y = a + SHARE * (b - a)
            fy = cost(y)
    return min((fx, float(x)), (fy, float(y)))
