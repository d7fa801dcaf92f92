"""Checks that a curve of the angle pays no more for its level than an offset does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.whole_robot.test_unusual import OFFSET, problem
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.whole_robot.free_level import with_free_level
from twin_diagram.gap.whole_robot.unusual import offered, terms_of

FREE = 50.0
"""Prior standard deviation of the level [N·m]."""


def curves() -> list[Candidate]:
    start = problem(OFFSET)
    made = offered(terms_of(start.sums, start.sums.records.model), ("joint_spring",))
    return [c for c in made if c.variant == "curve"]


def test_a_level_costs_a_curve_what_it_costs_an_offset() -> None:
    """Made of pieces alone each of them drew it to zero: the same torque cost a curve many times as much."""
    for before in curves():
        curve = with_free_level(before, FREE)
        assert curve.size == before.size
        assert curve.columns[..., 0] == pytest.approx(np.ones_like(curve.columns[..., 0]), abs=1e-9)
        assert curve.spread[0] == FREE


def test_pieces_are_drawn_to_the_level_by_what_drew_them_to_zero() -> None:
    """The prior of pieces is the same as that of a level and, on top of it, of pieces as they were."""
    for before in curves():
        curve = with_free_level(before, FREE)
        told = curve.parameters(np.zeros(curve.size), np.diag(curve.spread**2))["curve"][1]
        level = FREE**2 - 1.0 / np.sum(before.spread**-2.0)  # some of which the pieces have as it is
        both = before.parameters(np.zeros(before.size), np.diag(before.spread**2) + level)["curve"][1]
        _, torques = np.split(told, 2)
        _, expected = np.split(both, 2)
        assert torques == pytest.approx(expected, rel=1e-6)


def test_a_curve_that_is_a_level_alone_says_that_level_at_every_angle() -> None:
    curve = with_free_level(curves()[0], FREE)
    level = np.where(np.arange(curve.size) == 0, 2.0, 0.0)
    torques, errors = (np.split(x, 2)[1] for x in curve.parameters(level, np.diag(0.01 * level**2))["curve"])
    assert torques == pytest.approx(np.full(len(torques), 2.0), abs=1e-9)
    assert errors == pytest.approx(np.full(len(errors), 0.2), rel=1e-3)
