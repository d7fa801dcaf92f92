"""Room for the hand at its goal: boxes at known distances, and draws that take it away are drawn anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.small_loop import small_scenario
from twin_diagram.runs import randomization
from twin_diagram.runs.goal_room import TUNING, HandShape, kept_at_goal
from twin_diagram.scenario import ArmModel, Planner, Pose
from twin_diagram.scenario.poses import pose

DOWN = [np.pi, 0.0, 0.0]


def test_the_distance_of_a_ball_from_a_box() -> None:
    hand = HandShape(np.array([[0.0, 0.1, -0.05]]), np.array([0.02]))
    X_WT = pose(Pose([0.5, 0.0, 0.2], DOWN)).GetAsMatrix4()  # the ball's centre is at (0.5, -0.1, 0.25)
    size = np.array([0.1, 0.06, 0.2])
    for place, rpy, distance in (
        ([0.5, -0.2, 0.25], [0.0, 0.0, 0.0], 0.1 - 0.03 - 0.02),
        ([0.5, -0.2, 0.25], [0.0, 0.0, np.pi / 2], 0.1 - 0.05 - 0.02),
        ([0.5, -0.1, 0.05], [0.0, 0.0, 0.3], 0.1 - 0.02),
        ([0.6, -0.1, 0.25], [0.0, 0.0, 0.0], 0.1 - 0.05 - 0.02),
        ([0.5, -0.1, 0.25], [0.0, 0.0, 0.0], -0.03 - 0.02),
        ([0.58, -0.17, 0.25], [0.0, 0.0, 0.0], 0.05 - 0.02),
    ):
        X_WO = pose(Pose(list(place), list(rpy))).GetAsMatrix4()
        assert hand.distance(X_WT, X_WO, size) == pytest.approx(distance, abs=1e-9)


def test_the_pandas_hand_is_as_wide_as_it_is() -> None:
    """0.102 m to each side; what covers it reaches a centimetre beyond."""
    hand = HandShape.of(ArmModel())
    across = np.abs(hand.centres_T[:, 1]) + hand.radii
    assert 0.102 < across.max() < 0.115
    assert kept_at_goal(Planner()) == pytest.approx(0.25 * Planner().clearance + TUNING.unsure)


def test_draws_without_room_are_drawn_anew_and_others_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    base = small_scenario(objects=("cracker_box",))
    monkeypatch.setattr(randomization, "retexture", lambda source, folder, seed: source)
    goal = base.twin.task.X_WG
    assert goal is not None
    x, y, goal.translation[2] = *goal.translation[:2], 0.12
    monkeypatch.setattr(randomization, "REGION", ((x - 0.1, y - 0.29), (x + 0.1, y + 0.29)))  # beside the hand
    hand, rule = HandShape.of(base.twin.arm), randomization._has_room

    def gap(drawn: Any) -> float:
        (item,) = drawn.world.objects.values()
        size = randomization.Asset.load(item.asset).size
        return hand.distance(pose(goal).GetAsMatrix4(), pose(item.X_WO).GetAsMatrix4(), size)

    model = randomization.Model.load(base.twin.arm)
    monkeypatch.setattr(randomization.HandShape, "of", lambda *_: hand)
    monkeypatch.setattr(randomization.Model, "load", lambda *_: model)
    changed = 0
    for seed in range(15):
        monkeypatch.setattr(randomization, "_has_room", lambda *_: True)
        before = randomization.vary(base, seed, tmp_path)
        monkeypatch.setattr(randomization, "_has_room", rule)
        after = randomization.vary(base, seed, tmp_path)
        fine = gap(before) >= kept_at_goal(base.twin.planner)
        assert gap(after) >= kept_at_goal(base.twin.planner)
        assert (before == after) == fine
        changed += not fine
    assert 0 < changed < 15
