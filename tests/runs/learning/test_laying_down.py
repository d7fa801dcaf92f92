"""What would fall over however it is set down is laid down."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tests.runs.learning.test_easing import OnSupport
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.laying_down import lay_into, laying_of
from twin_diagram.runs.learning.motion import Mover, cloud_cells
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.steadiness import steadiness
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array

AROUND = np.arange(0.0, 2.0 * np.pi, 0.1)


def bottle_upside_down() -> Array:
    """Points (N, 3) in the tool of a bottle held at its bottom, which leans by 25° in the hand, its cap below."""
    profile = [(0.036, z) for z in np.arange(-0.04, 0.085, 0.005)]
    profile += [(0.036 - 0.46 * (z - 0.085), z) for z in np.arange(0.085, 0.135, 0.005)]
    profile += [(0.013, z) for z in np.arange(0.135, 0.161, 0.005)]
    profile += [(r, z) for z, most in ((-0.04, 0.036), (0.16, 0.013)) for r in np.arange(0.002, most, 0.004)]
    points = np.array([[r * np.cos(a), r * np.sin(a), z] for r, z in profile for a in AROUND])
    c, s = np.cos(0.44), np.sin(0.44)
    return np.asarray(points @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T)


def test_a_bottle_held_at_its_bottom_is_rolled_over_its_cap_until_it_lies() -> None:
    points, down = bottle_upside_down(), np.array([0.0, 0.0, 1.0])
    laying = laying_of(points)
    assert laying is not None
    lying = points @ laying.turn[:3, :3].T + laying.turn[:3, 3]
    assert steadiness(lying, down) > 0.2 > steadiness(points, down)
    assert np.ptp(lying[:, 2]) < 0.09, "it lies: its axis is about level"
    assert laying.height[0] == pytest.approx(points[:, 2].max()), "its low end touches as the way aside begins"
    assert laying.height[-1] == pytest.approx(lying[:, 2].max())
    # Its long way down is a way aside, for the low end stays where it touched.
    assert abs(laying.aside[-1]) == pytest.approx(0.17, abs=0.06)
    assert np.abs(np.diff(laying.aside)).max() < 0.012 and np.diff(laying.height).max() < 1e-3


def test_the_low_end_neither_slides_nor_lifts() -> None:
    """A rod turns about its end: the hand goes along a circle."""
    rod = np.array([[0.002 * np.cos(a), 0.03 * np.sin(a), z] for z in np.arange(-0.02, 0.15, 0.003) for a in AROUND])
    c, s = np.cos(0.3), np.sin(0.3)
    leaning = rod @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T
    laying = laying_of(np.asarray(leaning))
    assert laying is not None
    # From the pads' axis, 12.5 mm behind the tool's frame, to its end it is as far all along.
    end = leaning[leaning[:, 2].argmax()]
    far = np.hypot(end[0] + laying.aside[0] - laying.aside, laying.height + 0.0125)
    assert far == pytest.approx(np.full(len(far), far[0]), abs=0.005)


def test_what_stands_on_no_side_of_that_plane_is_not_laid_down() -> None:
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((4000, 3))
    assert laying_of(0.04 * ball / np.linalg.norm(ball, axis=1, keepdims=True) * [1.0, 1e-6, 1.0]) is None


class Opening(OnSupport):
    """A cell in which what is set down presses back; notes where the arm was when its fingers opened."""

    opened: Array

    def __init__(self, mover: Mover, q: Array) -> None:
        super().__init__(mover, q, 10.0)

    def grip(self, opened: float, seconds: float = 0.7, force: float | None = None) -> None:
        super().grip(opened, seconds, force)
        self.opened = self.commanded


def held_as_it_is(points: Array) -> ShownObject:
    """What is held with its tool pointing straight down."""
    followed = Followed(points=points, normals=np.zeros_like(points))
    return ShownObject(followed, [np.eye(4)], [0.07], R_WT=np.diag([1.0, -1.0, -1.0]))


def test_what_would_fall_over_in_the_other_bin_is_laid_down_within_its_walls() -> None:
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    low, high = (np.array(corner) for corner in twin.learning.into_bin)
    mover, points = Mover(twin, {}, np.full(7, 2.0)), bottle_upside_down()
    cell = Opening(mover, np.array(twin.home))
    mover.hold(cloud_cells(points, 0.01))
    put = lay_into(mover, cast(Any, cell), held_as_it_is(points), low, high, [])
    assert put is not None and put.top < low[2] + 0.09, "it lies"
    laying = laying_of(points)
    assert laying is not None
    X = mover.tool(cell.opened)
    swept = laying.swept(points) @ X[:3, :3].T + X[:3, 3]
    # All the way, not only at its end, and a cell's edge over what holds it.
    assert (swept[:, :2] > low[:2] - 0.01).all() and (swept[:, :2] < high[:2] + 0.01).all()
    assert float(np.ptp(swept[-len(points) :, 2])) < 0.09 < 0.15 < float(np.ptp(swept[: len(points), 2]))
    assert swept[:, 2].min() == pytest.approx(low[2], abs=0.003)


def test_what_stands_is_not_laid_down() -> None:
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    low, high = (np.array(corner) for corner in twin.learning.into_bin)
    box = np.random.default_rng(0).uniform([-0.03, -0.03, -0.03], [0.03, 0.03, 0.03], (4000, 3))
    box[np.arange(4000), np.arange(4000) % 3] = 0.03 * np.sign(box[np.arange(4000), np.arange(4000) % 3])
    mover = Mover(twin, {}, np.full(7, 2.0))
    cell = Opening(mover, np.array(twin.home))
    assert lay_into(mover, cast(Any, cell), held_as_it_is(box), low, high, []) is None
    assert len(cell.gone) == 1
