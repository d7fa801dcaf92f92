"""What is recognised while it moves goes on, as it did when nobody knew it."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.scene.object_filter import FilterLayout, FilterSettings, Mode, initial_filters, propagate
from twin_diagram.scene.object_update import update
from twin_diagram.scene.taken_over import LinearMotion, motion_before
from twin_diagram.signals.layouts import ObjectStatus, PoseMeasurement
from twin_diagram.signals.things import Thing

V = np.array([-0.3, 0.1, 0.0])


def thing(**other: object) -> Thing:
    own = {"identity": 3, "status": ObjectStatus.GONE, "last_seen": 1.0, "middle": np.array([0.5, 0.0, 0.1])}
    return Thing(**{**own, "velocity": V, "velocity_variance": 4e-4, **other})  # type: ignore[arg-type]


def test_the_thing_that_an_object_is_tells_its_velocity() -> None:
    found = motion_before([Thing(), thing()], np.array([0.46, 0.01, 0.12]), 0.1, 1.1)
    assert found is not None
    np.testing.assert_array_equal(found.velocity, V)
    assert found.variance == 4e-4
    near = thing(identity=4, middle=np.array([0.49, 0.0, 0.12]), velocity=-V)
    found = motion_before([thing(), near], np.array([0.5, 0.0, 0.12]), 0.1, 1.0)
    assert found is not None
    np.testing.assert_array_equal(found.velocity, -V)


@pytest.mark.parametrize(
    "other",
    [
        {"identity": 0},
        {"velocity": np.zeros(3)},
        {"last_seen": 0.5},
        {"last_seen": 1.5},
        {"middle": np.array([0.9, 0.0, 0.1])},
    ],
)
def test_what_is_free_rests_is_old_or_elsewhere_tells_none(other: dict[str, object]) -> None:
    assert motion_before([thing(**other)], np.array([0.46, 0.01, 0.12]), 0.1, 1.1) is None


def test_an_object_found_under_way_is_where_it_goes_between_images() -> None:
    tuning = FilterSettings.of(scenario.SceneUpdater())
    pose = np.array([1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.1])
    first = PoseMeasurement(1.0, 1.0, pose, 1e-6 * np.eye(6))
    after = update(initial_filters(1)[0], first, 1.05, tuning, before=LinearMotion(V, 4e-4))
    assert after[FilterLayout.MODE] == Mode.MOVING
    ahead = propagate(after[None], 1.1, tuning)
    np.testing.assert_allclose(ahead.poses[0, 4:], pose[4:] + 0.1 * V, atol=1e-9)
    np.testing.assert_allclose(ahead.velocities[0], [0, 0, 0, *V], atol=1e-12)
    # How sure that is grows with its velocity's variance.
    assert ahead.covariances[0, 3, 3] > 1e-6 + 0.1**2 * 4e-4
    # Once it was seen to rest for some images it rests.
    for k in range(1, 12):
        again = PoseMeasurement(1.0, 1.0 + k / 15, pose, 1e-6 * np.eye(6))
        after = update(after, again, 1.0 + k / 15, tuning)
    assert after[FilterLayout.MODE] == Mode.REST
    # Without a word of a thing it rests at once.
    assert update(initial_filters(1)[0], first, 1.05, tuning)[FilterLayout.MODE] == Mode.REST
