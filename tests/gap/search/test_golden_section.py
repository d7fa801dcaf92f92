"""Golden sections close in on a least, ask no more than they say, and lean to the side that ties name."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_diagram.gap.search.golden_section import SHARE, least

RANGE = st.floats(-100.0, 100.0)


@given(RANGE, RANGE, RANGE, st.integers(1, 30))
def test_least_is_within_the_last_bracket(low: float, width: float, share: float, sections: int) -> None:
    low, width, share = low, abs(width) + 1.0, abs(share) / 100.0
    at = low + share * width
    asked: list[float] = []

    def cost(x: float) -> float:
        asked.append(x)
        return abs(x - at)

    value, found = least(cost, low, low + width, sections)
    assert value == abs(found - at)
    assert abs(found - at) <= width * SHARE**sections + 1e-9
    assert len(asked) == sections + 2 and all(low <= x <= low + width for x in asked)


@pytest.mark.parametrize(("ties_low", "side"), [(True, 0.0), (False, 1.0)])
@pytest.mark.parametrize("level", [3.0, math.inf])
def test_ties_lead_to_the_side_that_is_asked_for(ties_low: bool, side: float, level: float) -> None:
    assert abs(least(lambda x: level, 0.0, 1.0, 20, ties_low=ties_low)[1] - side) < 1e-3
