"""What joints may do, where a description does not say how fast they go."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.collision_scene import load_scene
from twin_diagram.planning.mpc.limits import limits_of


def test_joints_without_a_limit_of_speed_are_told_of_in_a_line(caplog: pytest.LogCaptureFixture) -> None:
    model, params = Model.load("arms/panda.urdf"), replace(scenario.Planner(), velocity_share=0.5)
    scene = load_scene(scenario.ArmModel(), [], {})
    with caplog.at_level(logging.WARNING, "twin_diagram"):
        limits_of(model, scene, model.velocity_limit, params)
        assert not caplog.messages
        speed = model.velocity_limit.copy()
        speed[[2, 5]] = np.inf
        limits = limits_of(model, scene, speed, params)
    assert limits.velocity[2] == pytest.approx(0.5 * np.pi)
    (line,) = caplog.messages
    assert "planned at 1.57 at most" in line and "panda_joint3 (rad/s), panda_joint6 (rad/s)" in line
