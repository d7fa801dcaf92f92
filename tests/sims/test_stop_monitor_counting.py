"""Whose a contact is: the arm's that came, or the thing's that came to an arm that stood."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "sims" / "benchmarks"))

from braking_bench.counting import STANDING, STOOD, ArmCame

LOOK = 0.005


def blamed(contact: float, end: float, command_speed: float, moves_until: float = 0.0, shoved: float = 0.0) -> bool:
    """Return whether the arm came in any contact from `contact` to `end` [s].

    Its command goes at a speed [rad/s] until `moves_until`, and from `contact` on it is shoved at a speed [rad/s].
    """
    came, command, found = ArmCame(LOOK, np.zeros(2)), np.zeros(2), False
    for k in range(1, round(end / LOOK) + 1):
        now = k * LOOK
        goes, touching = now <= moves_until, now >= contact
        command = command + np.array([0.0, command_speed * LOOK]) * goes
        v = np.array([shoved * touching, command_speed * goes])
        found |= came.look(now, touching, v, command) and touching
    return found


def test_what_comes_to_an_arm_that_stood_and_shoves_it_is_not_the_arms_contact() -> None:
    assert not blamed(1.0, 2.0, 1.0, moves_until=0.5, shoved=0.3)
    assert blamed(1.0, 2.0, 1.0, moves_until=0.95), "it had not stood for long enough"


def test_an_arm_that_swings_back_from_a_shove_is_not_blamed_until_it_has_rested_or_is_driven() -> None:
    came, command = ArmCame(LOOK, np.zeros(1)), np.zeros(1)
    for k in range(1, 101):
        assert not came.look(k * LOOK, k > 60 and k % 3 != 0, np.array([0.3 * (k > 60)]), command) or k < 60
    assert not came.look(0.505, False, np.zeros(1), command)
    assert came.look(0.51, False, np.array([0.3]), command), "it has rested since"


def test_an_arm_that_runs_into_a_thing_or_drives_on_against_it_is_blamed() -> None:
    assert blamed(1.0, 2.0, 0.5, moves_until=2.0)
    assert blamed(0.5, 1.0, 2.0 * STANDING, moves_until=1.0)
    assert not blamed(1.0, 3.0, 0.9 * STANDING, moves_until=3.0), "slower than that it stands"


def test_a_command_while_touched_counts_by_how_far_it_goes() -> None:
    came, command = ArmCame(LOOK, np.zeros(1)), np.zeros(1)
    for k in range(1, 101):
        came.look(k * LOOK, k > 60, np.zeros(1), command)
    nudge = command + 0.5 * STANDING * STOOD
    assert not came.look(0.505, True, np.zeros(1), nudge)
    assert came.look(0.51, True, np.zeros(1), command + 2.0 * STANDING * STOOD)
