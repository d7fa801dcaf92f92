"""Forecasts at both sides of their bounds, and which links and parts of the arm are left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.planning.collision.clearance import Surroundings
from twin_diagram.planning.collision.collision_scene import (
    Forecast,
    Scene,
    _always_touching,
    _never_leaving,
    _samples,
    load_scene,
    travel,
)
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus, Track


def packed(**changes: Any) -> Array:
    values: dict[str, Any] = {
        "status": ObjectStatus.MOVING,
        "last_seen": 0.0,
        "pose": np.array([0.6, 0.8, 0, 0, 0.5, 0.1, 0.2]),
        "velocity": np.array([0.0, 0, 0, 0.1, 0, 0]),
        "covariance": np.zeros((6, 6)),
    }
    return np.asarray(Track(**{**values, **changes}).pack())


def test_slow_is_still_unless_it_turns_in_place() -> None:
    for status, turns in ((ObjectStatus.TRACKED, False), (ObjectStatus.MOVING, True)):
        for spin in (0.149, 0.151):
            told = Forecast.of_tracks(packed(status=status, velocity=np.array([0, spin, 0, 0, 0.0149, 0])))
            assert told.moving[0] == (turns and spin > 0.15)
            assert not told.velocity.any()
            np.testing.assert_allclose(told.spin, [[0, spin * told.moving[0], 0]])
    for speed, spin, moves, turns in (
        (0.0151, 0.149, True, False),
        (0.0151, 0.151, True, True),
        (-0.0151, -0.151, True, True),
    ):
        forecast = Forecast.of_tracks(packed(velocity=np.array([0, spin, 0, 0, speed, 0])))
        assert forecast.moving[0] == moves
        np.testing.assert_allclose(forecast.velocity, [[0, speed * moves, 0]])
        np.testing.assert_allclose(forecast.spin, [[0, spin * turns, 0]])


def test_growth_is_three_deviations_in_the_worst_direction_up_to_six_centimetres() -> None:
    R = Rotation.random(random_state=0).as_matrix()
    for std, grown in ((0.0199, 0.0597), (0.0201, 0.06)):
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = R @ np.diag([std**2, (0.3 * std) ** 2, 0.0]) @ R.T
        covariance[:3, :3] = np.eye(3)
        np.testing.assert_allclose(Forecast.of_tracks(packed(covariance=covariance)).grown, [grown])
    lopsided = np.zeros((6, 6))
    lopsided[3, 4] = 2 * 0.005**2  # its symmetric part alone counts: σ² = 0.005²
    np.testing.assert_allclose(Forecast.of_tracks(packed(covariance=lopsided)).grown, [0.015])


def test_motion_lasts_a_second_and_then_half_a_seconds_worth_more() -> None:
    np.testing.assert_allclose(
        travel(np.array([0.3, 1.0, 1.5, 2.0])), [0.3, 1.0, 1.5 - 0.5 / np.e, 1.5 - 0.5 / np.e**2]
    )
    t = np.linspace(0.0, 4.0, 401)
    rate = np.diff(travel(t)) / np.diff(t)
    assert (np.diff(rate) < 1e-9).all() and rate[0] == pytest.approx(1.0)


def test_a_track_goes_on_as_it_moves_and_turns() -> None:
    velocity = np.array([0.1, -0.4, 0.2, 0.1, 0.05, -0.2])
    X_WO, grown = Forecast.of_tracks(packed(velocity=velocity)).at(np.array([0.6]))
    np.testing.assert_allclose(X_WO[0, 0, :3, 3], [0.56, 0.13, 0.08])
    assert grown.shape == (1, 1) and X_WO[0, 0, 3].tolist() == [0, 0, 0, 1]
    turned = Rotation.from_rotvec(0.6 * velocity[:3]).as_matrix() @ Rotation.from_quat([0.8, 0, 0, 0.6]).as_matrix()
    np.testing.assert_allclose(X_WO[0, 0, :3, :3], turned)


def test_a_track_without_a_rotation_is_none() -> None:
    for size, present in ((0.49, False), (0.51, True)):
        pose = np.array([0.6 * size, 0.8 * size, 0, 0, 0.5, 0.1, 0.2])
        assert Forecast.of_tracks(packed(pose=pose)).present[0] == present


class Told:
    """A clearance whose distances are told."""

    def __init__(self, own: Array, links: Array) -> None:
        self.own, self.links = own, links
        self.chain: Any = type("Chain", (), {"size": links.shape[1]})
        self.bodies = [None] * links.shape[2]
        self.present: Any = None

    def own_distances(self, q: Array, reach: float) -> Array:
        return np.where(self.own < reach, self.own, 1e3)

    def link_distances(self, q: Array, around: Surroundings) -> Array:
        assert around.still.all() and not around.grown.any()
        np.testing.assert_array_equal(around.X_WO[:, 0], np.tile(np.eye(4), (len(self.bodies), 1, 1)))
        self.present = around.present
        return np.where(around.present, self.links, 1e3)


def test_parts_that_touch_in_most_configurations_are_neighbours() -> None:
    near, far = np.full(100, 0.0099), np.full(100, 0.0101)
    half = np.where(np.arange(100) < 50, 0.0, 1.0)
    most = np.where(np.arange(100) < 51, 0.0, 1.0)
    told = Told(np.stack([near, far, half, most], axis=1), np.zeros((100, 1, 1)))
    np.testing.assert_array_equal(_always_touching(told, np.zeros((100, 1))), [True, False, False, True])  # type: ignore[arg-type]


def test_links_that_stay_as_far_from_a_fixture_never_leave_it() -> None:
    links = np.zeros((50, 3, 3))
    links[:, 1, 0] = 0.5 + 0.9e-6 * (np.arange(50) % 2)
    links[:, 2, 0] = 0.5 + 1.1e-6 * (np.arange(50) % 2)
    links[:, 0, 1] = np.linspace(0, 1, 50)
    told = Told(np.zeros((50, 1)), links)
    found = _never_leaving(told, np.zeros((50, 3)), 2)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found, [[True, True], [True, False], [True, True], [False, True]])
    np.testing.assert_array_equal(told.present, [True, True, False])


def test_shares_are_met_to_three_percent_over_all_of_the_limits() -> None:
    lower, upper = np.array([-np.inf, -0.5, 1.0]), np.array([9.0, 0.7, 2.0])
    q = _samples(lower, upper)
    assert 0.5 / np.sqrt(len(q)) == pytest.approx(0.03, abs=0.005)
    low, high = np.array([-np.pi, -0.5, 1.0]), np.array([np.pi, 0.7, 2.0])
    assert (q >= low).all() and (q <= high).all()
    np.testing.assert_allclose(q.min(axis=0), low, atol=0.02 * (high - low).max())
    np.testing.assert_allclose(q.max(axis=0), high, atol=0.02 * (high - low).max())


@pytest.fixture(scope="module")
def ur() -> Scene:
    return load_scene(scenario.ArmModel(model="arms/ur5e.urdf", tool_frame=""), [scenario.Fixture()], {})


def test_fixtures_may_be_left_out(ur: Scene) -> None:
    forecast = Forecast.of_tracks(np.zeros(0))
    times = np.zeros(2)
    assert ur.fixture_count == 1 and ur.object_count == 0
    for fixtures in (True, False):
        around = ur.around(forecast, times, fixtures=fixtures)
        assert around.present.tolist() == [fixtures] and around.still.all()
        np.testing.assert_array_equal(around.X_WO[0], np.tile(np.eye(4), (2, 1, 1)))


def test_shapes_of_the_arm_are_held_by_its_balls_and_the_limits_read(ur: Scene) -> None:
    np.testing.assert_allclose(ur.upper, -ur.lower)
    assert ur.upper[0] > 6.0 and ur.upper[2] == pytest.approx(np.pi)
