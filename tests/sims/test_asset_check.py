"""The trials that set an asset beside the truth: alike things behave alike, and each fault shows in its own trial."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "sims" / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

from real2sim_truth.asset_trials import TUNING, Subject, fallen, period, pushed, task_of, toppling  # noqa: E402
from real2sim_truth.scores import triangles  # noqa: E402

BOX = Path(__file__).parents[2] / "models" / "objects" / "sugar_box"
MASS, CENTRE, INERTIA = 0.5, np.array([0.0, 0.01, -0.02]), np.diag([2e-3, 1.8e-3, 8e-4])
TRUE = Subject(BOX, np.eye(4), (MASS, CENTRE, INERTIA))
TASK = task_of(triangles(BOX / "visual.obj"), CENTRE)


def test_it_stands_on_its_broadest_face() -> None:
    extent = TASK.high - TASK.low
    assert extent[2] == pytest.approx(extent.min()) and np.linalg.det(TASK.R_WO) == pytest.approx(1.0)


def test_a_swing_takes_as_long_as_a_compound_pendulum() -> None:
    axis = TASK.axis / np.linalg.norm(TASK.axis)
    off = CENTRE - TASK.pinch
    lever = np.linalg.norm(off - (off @ axis) * axis)
    about = axis @ INERTIA @ axis + MASS * lever**2
    small = 2.0 * np.pi * np.sqrt(about / (MASS * 9.81 * lever))
    wide = small * (1.0 + TUNING.begun**2 / 16.0 + 11.0 * TUNING.begun**4 / 3072.0)
    assert period(TRUE, TASK) == pytest.approx(wide, rel=2e-3)


def test_the_same_thing_does_the_same() -> None:
    again = Subject(BOX, np.eye(4), (MASS, CENTRE.copy(), INERTIA.copy()))
    assert period(again, TASK) == period(TRUE, TASK) and (fallen(again, TASK) == fallen(TRUE, TASK)).all()


def test_a_centre_that_is_off_shows_in_the_swing() -> None:
    off = Subject(BOX, np.eye(4), (MASS, CENTRE + [0.0, 0.0, 0.03], INERTIA))
    assert abs(period(off, TASK) / period(TRUE, TASK) - 1.0) > 0.01


def test_what_falls_a_centimetre_stays_on_its_face() -> None:
    X = fallen(TRUE, TASK)
    assert (X[:3, :3] @ TASK.R_WO.T)[2, 2] > 0.999 and np.linalg.norm(X[:2, 3]) < 0.005


def test_uneven_feet_tell_how_much_a_push_tells() -> None:
    """They leave a box where it stands, and are the same ones each time."""
    uneven = replace(TRUE, uneven=1e-4)
    X = fallen(uneven, TASK)
    assert (X != fallen(TRUE, TASK)).any() and (X == fallen(uneven, TASK)).all()
    assert (X[:3, :3] @ TASK.R_WO.T)[2, 2] > 0.999


@pytest.mark.slow
def test_a_centre_that_is_off_shows_in_the_push_and_on_the_tilted_plane() -> None:
    off = Subject(BOX, np.eye(4), (MASS, CENTRE + TASK.R_WO.T @ [0.0, 0.02, 0.0], INERTIA))
    X, Y = pushed(TRUE, TASK), pushed(off, TASK)
    assert np.linalg.norm((X - Y)[:2, 3]) > 0.002 and X[0, 3] > 0.05
    # The plane is tilted about x: y goes up, and it topples about its lower edge.
    lower = -TASK.low[1] + (TASK.R_WO @ CENTRE)[1]
    height = (TASK.R_WO @ CENTRE)[2] - TASK.low[2]
    assert toppling(TRUE, TASK) == pytest.approx(np.arctan2(lower, height), abs=0.06)
    assert toppling(off, TASK) > toppling(TRUE, TASK) + 0.05
