"""The verdict on a stop, against a point that runs at a wall: closed forms of how far it gets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.planning.braking.stop_check import TUNING, Allowances, Breach, Nearness, Query, breach
from twin_diagram.planning.braking.stopping_motion import travelled


def wall(distance: float, speed: float, wall_speed: float = 0.0, towards: float = 1.0) -> Query:
    """A point at `speed` before a wall that comes at `wall_speed`; nothing is seen beyond what is asked for."""

    def query(time: float, gone: float, within: float) -> Nearness:
        left = distance - towards * speed * gone - wall_speed * time
        seen = 1 if left <= within else 0
        one, part = np.ones(seen), np.full(seen, 3)
        return Nearness(part, np.zeros(seen, dtype=int), left * one, towards * speed * one, speed * one)

    return query


def others(margin: float, growth: float = 0.0, speed: float = 0.0) -> Allowances:
    return Allowances(np.array([margin]), np.array([growth]), np.array([speed]))


@pytest.mark.parametrize("seed", range(40))
def test_a_stop_is_refused_where_it_ends_within_the_margin_and_only_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed, delay, stop = rng.uniform(0.1, 0.8), rng.uniform(0.0, 0.06), rng.uniform(0.02, 0.3)
    margin = rng.uniform(0.0, 0.02)
    needed = margin + speed * travelled(delay + stop, delay, stop)
    slip = TUNING.bend * speed * TUNING.least_step + TUNING.touching
    assert breach(wall(needed + slip, speed), others(margin), speed, delay, stop)[0] is None
    found, _ = breach(wall(needed - slip, speed), others(margin), speed, delay, stop)
    assert found is not None
    assert (found.part, found.body) == (3, 0)
    assert found.distance <= margin + TUNING.touching
    assert found.distance > margin - slip


def test_what_comes_is_taken_to_come_as_fast_as_it_does() -> None:
    speed, delay, stop, margin = 0.4, 0.04, 0.16, 0.005
    end = delay + stop
    needed = margin + speed * travelled(end, delay, stop) + 0.3 * end
    assert breach(wall(needed + 0.01, speed, 0.3), others(margin, speed=0.3), speed, delay, stop)[0] is None
    assert breach(wall(needed - 0.01, speed, 0.3), others(margin, speed=0.3), speed, delay, stop)[0] is not None


def test_what_is_not_known_of_motions_grows_with_time() -> None:
    speed, delay, stop, margin = 0.4, 0.04, 0.16, 0.005
    needed = margin + speed * travelled(delay + stop, delay, stop)
    near = wall(needed + 0.01, speed)
    assert breach(near, others(margin), speed, delay, stop)[0] is None
    assert breach(near, others(margin, growth=0.15), speed, delay, stop)[0] is not None


def test_a_step_leaves_room_for_what_grows_meanwhile() -> None:
    """A slow arm before a thing of which little is known: the way is long, the time is not."""
    speed, end = 0.02, 0.4
    found, _ = breach(wall(0.05, speed), others(0.005, growth=0.2), speed, end, 0.0)
    assert found is not None
    assert found.time == pytest.approx((0.05 - 0.005) / (0.2 + speed), abs=2 * TUNING.least_step)


def test_what_is_too_far_to_be_asked_for_is_looked_at_before_it_is_at_its_margin() -> None:
    margin, speed, end = 0.05, 0.5, 0.16
    before = 2 * margin + TUNING.touching + 0.004  # just beyond what the first query asks for
    found, _ = breach(wall(before, speed), others(margin), speed, end, 0.0)
    assert found is not None
    assert found.time == pytest.approx((before - margin) / speed, abs=2 * TUNING.least_step)


def test_an_arm_that_goes_away_or_stands_by_is_let_go() -> None:
    assert breach(wall(-0.003, 0.4, towards=-1.0), others(0.005), 0.4, 0.04, 0.16)[0] is None
    beside = wall(0.002, TUNING.approach * 0.9)
    assert breach(beside, others(0.005), 0.4, 0.04, 0.16)[0] is None
    found, count = breach(wall(0.002, 0.1), others(0.005), 0.4, 0.04, 0.16)
    assert found == Breach(3, 0, 0.002, 0.0) and count == 1


def test_far_from_everything_one_query_is_enough() -> None:
    assert breach(wall(1.0, 0.5), others(0.005), 0.5, 0.04, 0.1) == (None, 1)


def test_the_nearest_to_its_margin_is_named() -> None:
    def query(time: float, gone: float, within: float) -> Nearness:
        one = np.ones(2)
        return Nearness(np.array([1, 2]), np.array([0, 1]), np.array([0.004, 0.006]), 0.2 * one, 0.2 * one)

    both = Allowances(np.array([0.005, 0.02]), np.zeros(2), np.zeros(2))
    found, _ = breach(query, both, 0.2, 0.04, 0.1)
    assert found is not None and (found.part, found.body, found.distance) == (2, 1, 0.006)


@pytest.mark.parametrize(
    ("distance", "speed", "guessed", "stopped"),
    [
        (-0.05, 0.9, True, False),
        (-0.05, 1.1, True, True),
        (-0.05, 0.9, False, True),
        (-0.009, 0.9, True, True),
        (0.002, 0.9, True, True),
    ],
)
def test_deep_in_a_guess_the_arm_may_go_on_slowly(distance: float, speed: float, guessed: bool, stopped: bool) -> None:
    """What the arm is a centimetre and more inside of is not there; speeds in shares of `backing`."""
    speed *= TUNING.backing
    one = replace(others(0.005), guessed=np.array([guessed]))
    assert (breach(wall(distance, speed), one, speed, 0.04, 0.16)[0] is not None) == stopped


def test_a_guess_that_is_wrong_here_is_believed_elsewhere() -> None:
    """A link that is not inside of the thing keeps clear of it, and so does one that gets into it on the way."""

    def query(time: float, gone: float, within: float) -> Nearness:
        left = np.array([-0.05, 0.012 - 0.06 * gone])
        one = np.ones(2)
        return Nearness(np.array([1, 2]), np.zeros(2, dtype=int), left, 0.06 * one, 0.06 * one)

    one = replace(others(0.005), guessed=np.array([True]))
    found, _ = breach(query, one, 0.06, 0.1, 0.3)
    assert found is not None and found.part == 2
