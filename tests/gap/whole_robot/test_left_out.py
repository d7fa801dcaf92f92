"""What is left of motion left out where some coordinates stay described: one by one, or all that are tried at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.gap.whole_robot.test_unusual import problem
from twin_diagram.gap.whole_robot.concluding import what_each_brings
from twin_diagram.gap.whole_robot.left_out import LeftOut, Linearised, units
from twin_diagram.gap.whole_robot.physical_fit import solve


def test_parts_that_are_tried_at_once_are_left_as_each_alone_and_go_one_after_the_other() -> None:
    every = replace(problem(), links_free=np.ones(6, dtype=bool))
    linear, parts = Linearised.of(LeftOut.of(every, solve(every))), units(every)
    some = [parts[k] for k in (0, 4, 7, 12, 29)]
    each = np.stack([linear.described(part).likelihood() for part in some])
    np.testing.assert_allclose(linear.likelihoods(some), each, atol=1e-6)
    at_once = linear.described(some[0] | some[2]).likelihood()
    np.testing.assert_allclose(linear.described(some[0]).described(some[2]).likelihood(), at_once, atol=1e-6)
    np.testing.assert_allclose(linear.described(some[0]).likelihoods([some[2], some[0]])[0], at_once, atol=1e-6)


def test_a_part_that_does_not_move_is_left_as_it_is() -> None:
    start = problem()
    linear, parts = Linearised.of(LeftOut.of(start, solve(start))), units(start)
    np.testing.assert_array_equal(linear.likelihoods([parts[0]])[0], linear.likelihood())  # no link is free
    np.testing.assert_array_equal(linear.described(parts[0]).likelihood(), linear.likelihood())


def test_where_nothing_is_free_nothing_is_tried() -> None:
    """As on an arm whose cable pulls at all joints: everything that was freed had gone again, and `gap` crashed."""
    start = problem()
    left_out = LeftOut.of(start, solve(start))
    assert Linearised.of(left_out).likelihoods([]).shape == (0, 6)
    none = replace(start, own_free=np.zeros_like(start.own_free))
    assert not np.any(none.free) and what_each_brings(none, LeftOut.of(none, solve(none))) == {}
