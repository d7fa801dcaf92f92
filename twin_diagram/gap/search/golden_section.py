"""The least of a function of one number by golden sections (Kiefer 1953).

scipy's `minimize_scalar(method="golden")` would not give the same: of two bounds it looks for a bracket beyond them;
three must have their middle below both ends, which a flat cost has not, nor one that is infinite where a shape cannot
be. It works out the ends, stops at a tolerance instead of after a number of costs, and leads ties to one side only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SHARE = 0.5 * (np.sqrt(5.0) - 1.0)
"""By which each section shrinks the bracket: the golden one, so that one of the two inner points can be kept."""


def least(
    cost: Callable[[float], float], low: float, high: float, sections: int, *, ties_low: bool = False
) -> tuple[float, float]:
    """Return the cost and place of the better of the last two points, the bounds being left out.

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
