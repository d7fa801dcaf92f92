"""With the torques that a fast swing takes the driver's arm stays on its way; by its spring alone it leaves it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform

from twin_diagram import load_scenario
from twin_diagram.estimation.weighing import Shape, feed_forward
from twin_diagram.model.model import Model
from twin_diagram.runs.learning.bearing import holding
from twin_diagram.runs.learning.start import check_cell, tools_of
from twin_diagram.runs.learning.weighing import swing, torques_of
from twin_diagram.signals.arrays import Array

PERIOD = 3.0


def motion_about(posture: Array) -> Any:
    """Return a motion of three joints at up to 1.2 Hz and 1.4 rad/s, at rest at both ends."""

    def at(time: Array) -> tuple[Array, Array, Array]:
        parts = [np.tile(posture, (len(time), 1)), np.zeros((len(time), 7)), np.zeros((len(time), 7))]
        for joint, size, rounds in ((0, 0.25, 2), (1, 0.17, 3), (3, 0.17, 2)):
            w, about = 2.0 * np.pi * rounds / PERIOD, 2.0 * np.pi / PERIOD
            share, rate, more = (
                0.5 - 0.5 * np.cos(about * time),
                0.5 * about * np.sin(about * time),
                0.5 * about**2 * np.cos(about * time),
            )
            s, c = np.sin(w * time), np.cos(w * time)
            parts[0][:, joint] += size * share * s
            parts[1][:, joint] = size * (rate * s + share * w * c)
            parts[2][:, joint] = size * (more * s + 2.0 * rate * w * c - share * w**2 * s)
        return parts[0], parts[1], parts[2]

    return SimpleNamespace(harmonics=SimpleNamespace(period=PERIOD), at=at, posture=posture)


def test_added_torques_are_what_the_motion_takes_beyond_what_is_borne() -> None:
    twin = load_scenario("bin_picking").twin
    model = Model.load(twin.arm, torque_side="motor")
    motion, X_TO, box = motion_about(np.array(twin.home)), np.eye(4), Shape.box(np.full(3, 0.1)).even(1.0)
    added = torques_of(model, motion, X_TO, box)
    assert len(added) == 1201 and np.abs(added[[0, -1]]).max() < 1e-6 and np.abs(added).max() > 5.0
    middle = motion.at(np.array([1.1]))
    whole = feed_forward(model, RigidTransform(), box, middle)[0]
    borne = holding(model, 1.0, np.zeros(3))(middle[0][0])
    assert added[440] == pytest.approx(whole - borne, abs=1e-9) and np.abs(borne).max() > 1.0


@pytest.mark.long
def test_a_swung_hand_stays_within_a_centimetre_of_its_way() -> None:
    """By the spring alone a hand left its swing by 87 mm, and met the rim of a bin."""
    scenario = load_scenario("bin_picking")
    scenario.world.objects = {}
    tools = tools_of(scenario, check_cell(scenario))
    cell, motion = tools.cell, motion_about(np.array(scenario.twin.home))
    planned = np.array([tools.mover.tool(q)[:3, 3] for q in motion.at(np.arange(0.0, PERIOD, 0.01))[0]])
    cell.wait(0.3)

    def farthest(torque: Array | None) -> float:
        log = swing(cell, motion, tools.driven.joints, "empty", torque=torque)
        hand = np.array([tools.mover.tool(q)[:3, 3] for q in log.position[::4]])
        return float(np.linalg.norm(hand[:, None] - planned, axis=2).min(axis=1).max())

    alone, added = farthest(None), farthest(torques_of(tools.driven, motion, np.eye(4), np.zeros(10)))
    assert added < 0.01 < 0.02 < alone, (added, alone)
