"""Who is held goes along with the tool; what is not seen to, does not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.scene import object_filter, object_life
from twin_diagram.scene.object_filter import FilterLayout, Mode
from twin_diagram.scene.object_life import LifeLayout, Tool
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.rotations import exp

Array = npt.NDArray[np.float64]
TURN = exp(np.array([0.3, -0.2, 0.5]))
POSE = np.r_[TURN, 0.5, 0.1, 0.3]
TOOL = Tool(np.r_[exp(np.array([0.0, 0.4, 0.0])), 0.48, 0.12, 0.33], np.array([0.0, 0.0, 1.0, 0.2, 0.0, 0.0]))


def moving(velocity: Array) -> Array:
    one = object_filter.initial_filters(1)[0]
    one[FilterLayout.MODE] = Mode.MOVING
    one[FilterLayout.POSE] = POSE
    one[FilterLayout.VELOCITY] = np.r_[0.0, 0.0, 0.0, velocity]
    return one


def after(life: Array, velocity: Array, images: int, tool: Tool = TOOL, radius: float = 0.05) -> Array:
    for _ in range(images):
        life = object_life.along_with(life, moving(velocity), tool, radius)
    return life


START = object_life.initial_lives(np.array([1.0]))[0]
ALONG = TOOL.velocity[3:] + np.cross(TOOL.velocity[:3], POSE[4:] - TOOL.pose[4:])


def held(life: Array) -> bool:
    return bool(object_life.statuses(life[None], np.array([float(ObjectStatus.TRACKED)]))[0] == ObjectStatus.HELD)


def test_what_goes_along_with_the_tool_for_four_images_is_held_and_one_left_behind_as_long_is_not() -> None:
    assert not held(after(START, ALONG, 3)) and held(after(START, ALONG, 4))
    life = after(START, ALONG, 4)
    assert held(after(life, np.zeros(3), 3)) and not held(after(life, np.zeros(3), 4))
    # A tool at rest tells nothing.
    assert held(after(life, np.zeros(3), 9, Tool(TOOL.pose, np.zeros(6))))


def test_what_is_far_or_goes_another_way_is_not_held() -> None:
    assert not held(after(START, -ALONG, 9)) and not held(after(START, 1.6 * ALONG, 9))
    assert held(after(START, 1.2 * ALONG, 9))
    away = Tool(TOOL.pose + [0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0], TOOL.velocity)
    there = away.velocity[3:] + np.cross(away.velocity[:3], POSE[4:] - away.pose[4:])
    assert not held(after(START, there, 9, away))
    assert held(after(START, there, 9, away, radius=0.2))


def test_a_held_object_keeps_its_place_in_the_tool() -> None:
    life = after(START, ALONG, 4)
    X_TO = life[LifeLayout.X_TO]
    np.testing.assert_allclose(object_life.with_tool(X_TO, TOOL.pose), POSE, atol=1e-12)
    moved = TOOL.pose + [0.0, 0.0, 0.0, 0.0, 0.1, -0.2, 0.05]
    np.testing.assert_allclose(object_life.with_tool(X_TO, moved), POSE + [0, 0, 0, 0, 0.1, -0.2, 0.05], atol=1e-12)


def test_only_images_that_are_new_and_see_through_count_towards_gone() -> None:
    life = START
    for time, quality in ((0.1, -0.5), (0.1, -0.5), (0.1, -0.5), (0.2, -0.5), (0.15, -0.5)):
        life = object_life.after_image(life, quality, time)
    assert life[LifeLayout.EMPTY] == 2 and life[LifeLayout.GONE_SINCE] < 0
    hidden = object_life.after_image(life, 0.0, 0.3)
    assert hidden[LifeLayout.EMPTY] == 0
    gone = object_life.after_image(life, -0.5, 0.3)
    assert gone[LifeLayout.GONE_SINCE] == 0.3
    # Hidden afterwards, it is not back; found, it is.
    assert object_life.after_image(gone, 0.0, 0.4)[LifeLayout.GONE_SINCE] == 0.3
    assert object_life.after_image(gone, 0.8, 0.4)[LifeLayout.GONE_SINCE] < 0
    np.testing.assert_array_equal(object_life.after_image(life, -0.5, np.nan), life)
    assert object_life.statuses(gone[None], np.array([0.0]))[0] == ObjectStatus.UNSEEN
    assert object_life.statuses(gone[None], np.array([3.0]))[0] == ObjectStatus.GONE
