"""Which readings speak for noise, and how loudly: one at a time, on a gantry."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun, constant_friction
from twin_diagram.estimation.dynamics.arm_dynamics import Laws
from twin_diagram.estimation.filter.belief import Entry, SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.noise_adaptation import Update, adapt, noise_now
from twin_diagram.estimation.sensors import BodyPose, Linear, Sensor
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

SPAN, DT = 2.0, 0.005
PARAMS = Filter(parameters=[])


def ready(laws: Laws | None = None, v: tuple[float, float] = (0.5, -0.4)) -> tuple[Ekf, BodyPose]:
    ekf = begun(PARAMS, laws, v)
    camera = BodyPose(ekf.terms, "car", std_p=0.01, std_r=0.02)
    ekf.add(camera)
    ekf.predict(np.zeros(2), DT)
    ekf.belief.header[[Entry.HEARD, Entry.COUNTED]] = ekf.belief.time, 1e9
    ekf.belief.tracks[0][[SensorTrack.LAST, SensorTrack.COUNTED]] = ekf.belief.time - 0.04, 1e9
    return ekf, camera


def say(
    ekf: Ekf, sensor: Sensor, y: Array, *, accepted: bool = True, surprise: bool = False, late: bool = False,
    noise: Array | None = None, S: Array | None = None, t: float | None = None,
) -> None:  # fmt: skip
    """Innovations of a covariance of 4 R."""
    track = None if sensor.name in ekf.own else ekf.belief.tracks[0]
    at = Linear(sensor.reading(ekf.belief.x), sensor.jacobian(ekf.belief.x), sensor.noise(ekf.belief.x))
    S = 4.0 * at.noise if S is None else S
    result = Update(accepted, surprise, 0.0, y, S, late)
    adapt(ekf, sensor, track, at, noise, result, ekf.belief.time if t is None else t)


def test_a_sensor_s_level_moves_by_its_share_and_the_time_since_its_last_reading() -> None:
    """A quarter of S is R's; a square three times what it should be; 40 ms of two seconds."""
    ekf, camera = ready()
    y = np.sqrt(3.0 * 4.0 * camera.noise(ekf.belief.x).diagonal())
    say(ekf, camera, y)
    np.testing.assert_allclose(ekf.belief.levels[0], 0.02 * 0.25 * 2.0)
    assert ekf.belief.tracks[0][SensorTrack.COUNTED] == 1e9 + 1.0
    again, camera = ready()
    again.belief.levels[0][:] = np.log(2.0)
    say(again, camera, y, noise=0.5 * camera.noise(again.belief.x))  # R of this reading, scaled as learnt
    np.testing.assert_allclose(again.belief.levels[0], np.log(2.0) + 0.02 * 0.25 * 2.0)
    assert not ekf.belief.noise.any()


def test_first_readings_count_for_more_and_each_is_counted() -> None:
    ekf, camera = ready()
    ekf.belief.tracks[0][SensorTrack.COUNTED] = 120.0
    say(ekf, camera, np.zeros(6))
    np.testing.assert_allclose(ekf.belief.levels[0], -0.25 * 4.0 / (120.0 + 80.0))
    assert ekf.belief.tracks[0][SensorTrack.COUNTED] == 121.0
    for sensor, rows in ((ekf.encoder, [0]), (ekf.velocity, [1])):
        ekf, _ = ready()
        ekf.belief.header[Entry.COUNTED] = 120.0
        say(ekf, ekf.encoder if rows == [0] else ekf.velocity, np.zeros(2))
        np.testing.assert_allclose(ekf.belief.noise[rows], -0.25 * 0.02)
        assert not np.delete(ekf.belief.noise, rows, axis=0).any() and sensor.size == 2
        assert ekf.belief.header[Entry.COUNTED] == 121.0


@pytest.mark.parametrize(
    ("streak", "accepted", "own", "speaks"),
    [
        (0.0, True, True, True),
        (2.0, False, True, False),  # an outlier
        (3.0, False, True, True),  # a run of them is none any more
        (0.0, True, False, True),
        (2.0, False, False, False),
        (3.0, False, False, False),  # of a sensor it is a fault, while the joints vouch for the state
    ],
)
def test_who_speaks(streak: float, accepted: bool, own: bool, speaks: bool) -> None:
    ekf, camera = ready()
    ekf.belief.header[Entry.ALARM] = ekf.belief.time - 0.5  # held before: now it is free as long
    ekf.belief.header[Entry.STREAK] = streak if own else 0.0
    ekf.belief.tracks[0][SensorTrack.STREAK] = 0.0 if own else streak
    say(ekf, ekf.joints if own else camera, np.zeros(4 if own else 6), accepted=accepted)
    level = ekf.belief.noise[:2] if own else ekf.belief.levels[0]
    assert bool(np.all(level < 0.0)) == speaks and bool(np.any(level)) == speaks


@pytest.mark.parametrize(
    ("what", "holds"),
    [
        ({"accepted": False}, True),
        ({"surprise": True}, True),
        ({}, False),
    ],
)
def test_trouble_with_the_arm_holds_all_noise_for_a_second(what: dict[str, bool], holds: bool) -> None:
    ekf, _ = ready()
    say(ekf, ekf.joints, np.zeros(4), **what)  # type: ignore[arg-type]
    assert (ekf.belief.header[Entry.ALARM] == ekf.belief.time + 1.0) == holds


def test_a_sensor_s_refusals_are_trouble_from_the_third_on() -> None:
    for streak, holds in ((2.0, False), (3.0, True)):
        ekf, camera = ready()
        ekf.belief.tracks[0][SensorTrack.STREAK] = streak
        say(ekf, camera, np.zeros(6), accepted=False)
        assert (ekf.belief.header[Entry.ALARM] > 0.0) == holds


def test_without_the_joints_nobody_speaks() -> None:
    for silent, speaks in ((0.099, True), (0.101, False)):
        ekf, camera = ready()
        ekf.belief.header[Entry.HEARD] = ekf.belief.time - silent
        say(ekf, camera, np.zeros(6))
        assert bool(ekf.belief.levels[0].any()) == speaks


@pytest.mark.parametrize(
    ("streak", "nis", "anew"), [(0.0, 2.9, False), (0.0, 3.1, True), (2.0, 0.0, False), (3.0, 0.0, True)]
)
def test_where_surprises_outlast_a_hold_noise_is_found_anew(streak: float, nis: float, anew: bool) -> None:
    """With innovations three times their covariance, or the third in a row."""
    ekf, _ = ready()
    h = ekf.belief.header
    h[Entry.ALARM], h[Entry.STREAK], h[Entry.NIS_MEAN] = ekf.belief.time - 0.5, streak, nis
    say(ekf, ekf.joints, np.zeros(4), surprise=True)
    assert h[Entry.COUNTED] == (1.0 if anew else 1e9 + 1.0)
    ekf, _ = ready()
    ekf.belief.header[[Entry.STREAK, Entry.NIS_MEAN]] = 0.0, 9.0
    say(ekf, ekf.joints, np.zeros(4))
    assert ekf.belief.header[Entry.COUNTED] == 1e9 + 1.0


def test_time_must_have_passed() -> None:
    for last, speaks in ((0.04, True), (0.0, False), (-0.01, False)):
        ekf, camera = ready()
        ekf.belief.tracks[0][SensorTrack.LAST] = ekf.belief.time - last
        say(ekf, camera, np.zeros(6))
        assert bool(ekf.belief.levels[0].any()) == speaks
    ekf, _ = ready()
    ekf.belief.header[Entry.SPAN] = 0.0
    say(ekf, ekf.joints, np.zeros(4))
    assert not ekf.belief.noise.any()
    ekf, camera = ready()
    say(ekf, camera, np.zeros(6), late=True, t=ekf.belief.time - 0.02)
    np.testing.assert_allclose(ekf.belief.levels[0], -0.25 * 0.01)


def test_joints_that_creep_or_rest_say_nothing_of_their_sensors() -> None:
    for speed, speaks in ((0.06, True), (0.04, False)):
        ekf, _ = ready(v=(0.5, -speed))
        say(ekf, ekf.joints, np.zeros(4))
        assert ekf.belief.noise[0, 0] < 0.0 and ekf.belief.noise[1, 0] < 0.0
        assert bool(np.all(ekf.belief.noise[:2, 1] < 0.0)) == speaks == bool(ekf.belief.noise[:2, 1].any())
        assert bool(ekf.belief.noise[2, 1]) == speaks


def test_the_arm_s_messages_tell_white_torque_too() -> None:
    """Without haste: by the period over two seconds, however few were heard; as the variance of one filter period."""
    ekf, _ = ready()
    ekf.belief.header[Entry.COUNTED] = 0.0
    ekf.belief.noise[2] = np.log([0.25, 4.0])
    before, by = ekf.belief.noise[2].copy(), ekf.by_torque
    assert by is not None
    S = 4.0 * ekf.joints.noise(ekf.belief.x)
    expected = np.einsum("ij,ij->j", by, np.linalg.solve(S, by))
    variance = 0.09 * np.array([0.25, 4.0])
    say(ekf, ekf.joints, np.zeros(4))
    moved = -DT / SPAN * np.sqrt(np.minimum(variance * expected, 1.0))
    np.testing.assert_allclose(ekf.belief.noise[2] - before, moved, rtol=1e-9)
    assert ekf.belief.told.all()
    for sensor, late in ((ekf.encoder, False), (ekf.joints, True)):
        ekf, _ = ready()
        say(ekf, ekf.encoder if sensor.size == 2 else ekf.joints, np.zeros(sensor.size), late=late)
        assert not ekf.belief.noise[2].any() and not ekf.belief.told.any()


@pytest.mark.parametrize(("share", "speaks"), [(0.09, True), (0.11, False)])
def test_a_reading_that_friction_may_have_moved_says_nothing(share: float, speaks: bool) -> None:
    """A tenth of its variance is the border."""
    ekf, camera = ready(constant_friction(3.0, 3.0), v=(0.5, 0.0))
    H, by = camera.jacobian(ekf.belief.x)[:, :4], ekf.by_torque
    assert by is not None
    creep = np.square(H @ by) @ ekf.creep
    assert creep[4] > 0.0
    S = np.diag(np.where(creep > 0.0, creep / share, 4e-4))
    say(ekf, camera, np.zeros(6), S=S)
    assert (ekf.belief.levels[0][4] < 0.0) == speaks and ekf.belief.levels[0][0] < 0.0
    ekf, camera = ready(constant_friction(3.0, 3.0), v=(0.5, 0.0))
    say(ekf, camera, np.zeros(6), S=S, late=True, t=ekf.belief.time - 0.01)
    assert ekf.belief.levels[0][4] < 0.0


def test_noise_as_it_is_now() -> None:
    """The sensor's own or that of a reading, each as adapted; what its model adds is not."""
    ekf, camera = ready()
    own = camera.noise(ekf.belief.x)
    level = np.log([4.0, 1.0, 1.0, 9.0, 1.0, 1.0])
    ekf.belief.levels[0][:] = level
    track, more = ekf.belief.tracks[0], 0.5 * np.eye(6)
    at = Linear(np.zeros(7), np.zeros((6, 6)), own + more)
    scaled = own * np.exp(level)
    np.testing.assert_allclose(noise_now(ekf, camera, track, at, None), scaled + more)
    np.testing.assert_allclose(noise_now(ekf, camera, track, at, 2.0 * own), 2.0 * scaled)
    ekf.belief.noise[:] = np.log([[4.0, 1.0], [1.0, 9.0], [5.0, 5.0]])
    for sensor, factor in ((ekf.joints, [4, 1, 1, 9]), (ekf.encoder, [4, 1]), (ekf.velocity, [1, 9])):
        base = sensor.noise(ekf.belief.x)
        at = Linear(np.zeros(1), np.zeros((1, 1)), base)
        np.testing.assert_allclose(noise_now(ekf, sensor, None, at, None), base * factor)


def test_no_time_means_no_adaptation() -> None:
    ekf = begun(Filter(parameters=[], noise_time=0.0))
    ekf.predict(np.zeros(2), DT)
    say(ekf, ekf.joints, np.full(4, 9.0), surprise=True)
    assert not ekf.belief.noise.any() and ekf.belief.header[Entry.ALARM] == 0.0
