"""Motions of experiments: what they show, and that no joint goes farther, faster or harder than was asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM
from twin_diagram.gap.experiments import advice, trajectories
from twin_diagram.gap.experiments.advice import asked, experiment, worded
from twin_diagram.gap.experiments.trajectories import Visited, design, spread_poses, visited
from twin_diagram.gap.findings import Separation
from twin_diagram.logs import Log

Array = npt.NDArray[np.float64]

PERIOD = 0.01


def seen(**changed: object) -> Visited:
    rng = np.random.default_rng(0)
    lower, upper = np.array([-1.0, -0.5, 0.2]), np.array([1.0, 0.7, 1.4])
    time = np.arange(0.0, 5.0, PERIOD)
    run = 0.5 * (lower + upper) + 0.4 * (upper - lower) * np.sin(time[:, None] * [1.0, 1.5, 2.0] + [0.3, 1.0, 2.0])
    made = Visited(
        joints=("a", "b", "c"),
        poses=rng.uniform(lower, upper, size=(400, 3)),
        lower=lower,
        upper=upper,
        speed=np.array([1.0, 0.6, 0.8]),
        acceleration=np.array([3.0, 2.0, 4.0]),
        run=run,
    )
    return replace(made, **changed)  # type: ignore[arg-type]


@pytest.mark.parametrize("text", list(trajectories.MAKERS))
def test_no_motion_leaves_what_was_visited(text: str) -> None:
    made = design(text, seen(), ())
    assert made is not None
    q, some = made.position, seen()
    assert np.all(q >= some.lower - 1e-12) and np.all(q <= some.upper + 1e-12)
    np.testing.assert_allclose(np.diff(made.time), PERIOD)
    assert len(made.time) == len(q) and made.time[0] == 0.0 and made.moved == ("a", "b", "c")
    if text in (advice.STATIC, advice.SLOW, advice.SPEEDS, advice.FAST):
        v = np.diff(q, axis=0) / PERIOD
        a = np.diff(v, axis=0) / PERIOD
        assert np.all(np.max(np.abs(v), axis=0) <= 1.01 * some.speed)
        assert np.all(np.max(np.abs(a), axis=0) <= (1.05 if text == advice.STATIC else 2.0) * some.acceleration)
    columns = made.columns()
    assert list(columns) == ["time", *(f"position_commanded.{j}" for j in "abc")]
    np.testing.assert_array_equal(columns["position_commanded.b"], q[:, 1])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("text", list(trajectories.MAKERS))
def test_no_motion_is_harder_than_what_was_seen(text: str, seed: int) -> None:
    """Also where no visited pose is near the middle of all joints' ranges, and a slow run was cut in motion."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 8.0, PERIOD)
    swings = rng.uniform(0.1, 0.4, 6) * np.sin(rng.uniform(0.5, 9.0, 6) * time[:, None] + rng.uniform(0.0, 6.0, 6))
    rise = (time / 8.0)[:, None] ** 3 * rng.uniform(-0.3, 0.3, 6)
    q = swings + rise + np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * np.sin(0.3 * time)[:, None]
    v = np.gradient(q, PERIOD, axis=0)
    hardest = np.maximum(np.abs(np.gradient(v, PERIOD, axis=0)).max(axis=0), 0.2)
    some = Visited(tuple("abcdef"), q[::2], q.min(0), q.max(0), np.abs(v).max(axis=0), hardest, q)
    made = design(text, some, ())
    assert made is not None
    whole = np.concatenate([made.position[:1], made.position, made.position[-1:]])
    assert np.all(np.abs(np.diff(whole, 2, axis=0)) <= 1.15 * PERIOD**2 * hardest)


def test_only_the_joints_that_are_asked_about_move() -> None:
    for text in (advice.SLOW, advice.SPEEDS, advice.FAST):
        made = design(text, seen(), ["b"])
        assert made is not None and made.moved == ("b",)
        assert np.ptp(made.position[:, 1]) > 0.05 and not np.any(np.ptp(made.position[:, [0, 2]], axis=0))
    assert design("no such advice", seen(), ()) is None


def middle() -> Array:
    some = seen()
    off = (some.poses - 0.5 * (some.lower + some.upper)) / (some.upper - some.lower)
    return np.asarray(some.poses[int(np.argmin(np.sum(off**2, axis=1)))])


def test_static_poses_are_held_twice_reached_from_above_and_from_below() -> None:
    """For a second each, after a step of a twentieth of the range."""
    q = trajectories.static_poses(seen(), [0])
    np.testing.assert_array_equal(q[0], middle())
    still = np.all(np.diff(q, axis=0) == 0.0, axis=1)
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    holds = bounds.reshape(-1, 2)
    long = [(int(a), int(b)) for a, b in holds if b - a >= 90]
    assert len(long) == 24 and all(b - a == 100 for a, b in long)
    poses = spread_poses(seen().poses, 12)
    some = seen()
    size = 0.05 * (some.upper - some.lower)
    for k, (a, _) in enumerate(long):
        np.testing.assert_allclose(q[a], poses[k // 2], atol=1e-12)
        side = 1.0 if k % 2 == 0 else -1.0
        from_there = np.clip(poses[k // 2] + side * size, some.lower, some.upper)
        assert np.min(np.linalg.norm(q[long[k - 1][1] if k else 0 : a] - from_there, axis=1)) < 1e-9
    np.testing.assert_allclose(q[-1], middle(), atol=1e-12)


def test_poses_are_spread_by_the_farthest_from_those_before() -> None:
    rng = np.random.default_rng(1)
    poses = rng.normal(size=(50, 2)) * np.array([1.0, 100.0])
    found = spread_poses(poses, 6)
    scaled = poses / np.ptp(poses, axis=0)
    chosen = [int(np.argmin(np.linalg.norm(scaled - np.median(scaled, axis=0), axis=1)))]
    while len(chosen) < 6:
        far = [min(np.linalg.norm(scaled[i] - scaled[k]) for k in chosen) for i in range(50)]
        chosen.append(int(np.argmax(far)))
    np.testing.assert_array_equal(found, poses[chosen])
    assert len(spread_poses(poses[:3], 12)) == 3


@pytest.mark.parametrize(("width", "half"), [(2.0, 0.02), (0.08, 0.012)])
def test_slow_reversals_crawl_about_five_angles(width: float, half: float) -> None:
    """At 0.02 rad/s, 0.02 rad to each side, or 15 per cent of a short range; ten quarters of a wave at each."""
    some = seen(upper=np.array([-1.0 + width, 0.7, 1.4]), poses=np.tile([-1.0 + 0.5 * width, 0.1, 0.8], (5, 1)))
    q = trajectories.slow_reversals(some, [0])[:, 0]
    v = np.diff(q) / PERIOD
    crawling = np.abs(np.abs(v) - 0.02) < 1e-6
    turns = int(np.sum((v[:-1] > 1e-3) & (v[1:] < -1e-3) | (v[:-1] < -1e-3) & (v[1:] > 1e-3)))
    assert np.sum(crawling) * PERIOD * 0.02 == pytest.approx(5 * 10.0 * half, rel=0.25)
    centres = -1.0 + width * np.linspace(0.15, 0.85, 5)
    for centre in centres:
        near = q[np.abs(q - centre) < 1.3 * half]
        assert np.max(near) - centre == pytest.approx(half, rel=0.3) and turns >= 0
    assert q[0] == q[-1]


def test_a_slow_joint_crawls_slower() -> None:
    some = seen(speed=np.array([0.005, 0.6, 0.8]))
    v = np.abs(np.diff(trajectories.slow_reversals(some, [0])[:, 0])) / PERIOD
    crawled = np.sum(np.abs(v - 0.005) < 1e-6) * PERIOD * 0.005
    assert crawled == pytest.approx(5 * 10.0 * 0.02, rel=0.1) and np.max(v) < 0.011


def test_speeds_go_from_a_crawl_to_the_highest_in_seven_steps() -> None:
    some = seen()
    for joint, lowest in ((0, 0.02), (1, 0.02)):
        q = trajectories.speed_steps(some, [joint])[:, joint]
        v = np.round(np.abs(np.diff(q)) / PERIOD, 6)
        wanted = np.geomspace(lowest, some.speed[joint], 7)
        for speed in wanted[:5]:
            assert np.sum(np.abs(v - speed) < 1e-4) * PERIOD > 1.0, speed
        centre = 0.5 * (some.lower[joint] + some.upper[joint])
        reach = min(0.45 * (some.upper[joint] - some.lower[joint]), 2.0 * some.speed[joint])
        assert np.max(q) == pytest.approx(centre + reach) and np.min(q) == pytest.approx(centre - reach)
        assert 0.9 * some.speed[joint] < np.max(v) <= 1.001 * some.speed[joint]
    crawl = seen(speed=np.array([0.03, 0.6, 0.8]))
    v = np.round(np.abs(np.diff(trajectories.speed_steps(crawl, [0])[:, 0])) / PERIOD, 6)
    assert np.sum(np.abs(v - 0.015) < 1e-6) * PERIOD > 1.0, "half of a low limit"


def test_fast_sines_are_as_hard_as_was_seen() -> None:
    """Eight tenths of the acceleration, nine of the speed, three of the range: whichever is least."""
    for changed, sizes in (
        ({}, [0.8 * 3.0 / (2 * np.pi * f) ** 2 for f in (1.0, 2.0, 4.0)]),
        (
            {"acceleration": np.full(3, 1e9), "speed": np.full(3, 0.5)},
            [0.9 * 0.5 / (2 * np.pi * f) for f in (1.0, 2.0, 4.0)],
        ),
        ({"acceleration": np.full(3, 1e9), "speed": np.full(3, 1e9)}, [0.3 * 2.0] * 3),
    ):
        q = trajectories.fast_sines(seen(**changed), [0])[:, 0] - middle()[0]
        assert len(q) == 1205
        q = q[2:]
        for k, size in enumerate(sizes):
            part = q[1 + 400 * k : 401 + 400 * k]
            assert np.max(np.abs(part)) == pytest.approx(size, rel=0.01)
            spectrum = np.abs(np.fft.rfft(part[80:320] * np.hanning(240), 4096))
            assert np.argmax(spectrum) / 40.96 == pytest.approx(2.0**k, rel=0.1)
            assert abs(part[0]) < 1e-9 and np.max(np.abs(part[:8])) < 0.02 * size
            assert np.max(np.abs(part[-8:])) < 0.02 * size and np.max(np.abs(part[60:100])) > 0.3 * size


def test_runs_are_made_again_with_rests_or_for_three_minutes() -> None:
    calm = np.linspace(0.0, 1.0, 500)
    run = middle() + 0.2 * np.sin(np.pi * calm)[:, None] ** 4
    some = seen(run=run)
    np.testing.assert_array_equal(trajectories.run_again(some, [0]), run)
    rested = trajectories.run_with_rests(some, [0])
    assert len(rested) == 2500
    np.testing.assert_array_equal(rested[:1000], np.tile(run[0], (1000, 1)))
    np.testing.assert_array_equal(rested[-1000:], np.tile(run[-1], (1000, 1)))
    many = trajectories.run_many(some, [0])
    once = 500 + len(trajectories._move(some, run[-1], run[0], 0.5))
    assert len(many) == once * int(np.ceil(18_000 / once))
    long = seen(run=np.tile(run, (40, 1)))
    assert len(trajectories.run_many(long, [0])) == 2 * (20_000 + len(trajectories._move(long, run[-1], run[0], 0.5)))


def test_a_run_that_was_cut_in_motion_starts_from_rest() -> None:
    some = seen()
    again = trajectories.run_again(some, [0])
    steps = np.abs(np.diff(again, axis=0))
    assert np.all(steps[[0, -1]] < 0.01 * np.max(steps, axis=0))
    np.testing.assert_allclose(again[[0, -1]], some.run[[0, -1]], atol=1e-9)
    assert len(again) == pytest.approx(len(some.run) + 100, abs=2)
    v, known = np.max(steps, axis=0), np.max(np.abs(np.diff(some.run, axis=0)), axis=0)
    assert np.all(v < 1.05 * known)
    slow = np.concatenate([np.linspace(0.0, 0.0, 5), np.linspace(0.0, 1.0, 100)])[:, None] * np.ones(3)
    for share, rest in ((0.019, True), (0.021, False)):
        run = np.array(slow)
        run[0] = -share * (slow[-1] - slow[-2])
        run = np.concatenate([run, run[-1:]])
        assert (trajectories._from_rest(seen(run=run)) is run) == rest


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_ways_between_poses_take_as_long_as_speed_and_acceleration_need(share: float) -> None:
    some = seen()
    for a, b in ((some.lower, some.upper), (some.lower, some.lower + 0.01)):
        way = np.concatenate([a[None], trajectories._move(some, a, b, share)])
        np.testing.assert_allclose(way[-1], b)
        v = np.diff(way, axis=0) / PERIOD
        use = np.max(np.abs(v) / some.speed), np.max(np.abs(np.diff(v, axis=0)) / PERIOD / some.acceleration)
        assert max(use[0] / share, use[1] / share**2) == pytest.approx(1.0, abs=0.12)


def test_cruises_have_ramps_and_a_constant_speed() -> None:
    a, b = np.array([0.0, 1.0]), np.array([-2.0, 1.0])
    way = trajectories._cruise(a, b, 0.5, 1.0, 0)
    v = -np.diff(np.concatenate([a[None], way])[:, 0]) / PERIOD
    assert len(way) == 450 and way[-1, 0] == pytest.approx(-2.0) and np.all(way[:, 1] == 1.0)
    np.testing.assert_allclose(v[55:395], 0.5, atol=1e-6)
    np.testing.assert_allclose(np.diff(v[:48]) / PERIOD, 1.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(v[-48:]) / PERIOD, -1.0, atol=1e-6)
    short = trajectories._cruise(a, a + [0.01, 0.0], 0.5, 1.0, 0)
    assert len(short) == 20 and short[-1, 0] == pytest.approx(0.01), "up and down at once"
    assert len(trajectories._cruise(a, a, 0.5, 1.0, 0)) == 1


def test_corners_of_a_wave_are_rounded_over_their_time() -> None:
    wave = np.maximum(0.0, np.arange(-50, 51) * 1.0)
    for duration, width in ((0.06, 6), (0.01, 3), (0.1, 10)):
        soft = trajectories._soften(wave, duration)
        assert len(soft) == len(wave) + width - 1 and soft[0] == wave[0] and soft[-1] == pytest.approx(wave[-1])
        np.testing.assert_allclose(soft[50], np.mean(wave[51 - width : 51]))
        np.testing.assert_allclose(soft[50 + width : 101], wave[50 + width :] - (width - 1) / 2, atol=1e-9)


def test_what_was_visited_is_within_the_description_and_at_least_a_crawl() -> None:
    time = np.arange(0.0, 6.0, 0.004)
    q = np.array([0.2, -1.2, 1.3, -0.9, -1.0, 0.3]) + np.array([0.5, 0.4, 0.3, 0.2, 1e-4, 0.1]) * np.sin(
        2.0 * time[:, None]
    )
    found = visited(
        ARM, [Log(time, ARM.joints, q, torque=np.ones_like(q)), Log(time, ARM.joints, q + 0.1, torque=np.ones_like(q))]
    )
    np.testing.assert_allclose(found.lower, np.min(q, axis=0), atol=2e-3)
    np.testing.assert_allclose(found.upper, np.max(q, axis=0) + 0.1, atol=2e-3)
    np.testing.assert_allclose(found.speed, [1.0, 0.8, 0.6, 0.4, 0.04, 0.2], rtol=0.01)
    np.testing.assert_allclose(found.acceleration, [2.0, 1.6, 1.2, 0.8, 0.2, 0.4], rtol=0.02)
    assert len(found.run) == pytest.approx(600, abs=1) and len(found.poses) == 3000
    np.testing.assert_allclose(found.run[100], 0.5 * (q[250] + q[250]), atol=1e-3)
    fast = visited(ARM, [Log(time, ARM.joints, q + 2.0 * np.sin(3.0 * time[:, None]), torque=np.ones_like(q))])
    np.testing.assert_allclose(fast.speed, np.minimum(fast.speed, 0.9 * ARM.velocity_limit))
    assert np.any(fast.speed == 0.9 * ARM.velocity_limit)


@pytest.mark.parametrize(
    ("a", "b", "text"),
    [
        ("coulomb_friction", "coulomb_friction", advice.SLOW),
        ("reflected_inertia", "reflected_inertia", advice.FAST),
        ("joint_spring", "joint_spring", advice.STATIC),
        ("actuator_fault", "coulomb_friction", advice.STILL),
        ("coulomb_friction", "load_dependent_friction", advice.LOAD),
        ("coulomb_friction", "viscous_friction", advice.SPEEDS),
        ("coulomb_friction", "backlash", advice.SLOW),
        ("torque_constant", "viscous_friction", advice.LOAD),
        ("joint_spring", "torque_bias", advice.STATIC),
        ("payload", "joint_spring", advice.STATIC),
        ("reflected_inertia", "joint_elasticity", advice.FAST),
        ("coulomb_friction", "torque_bias", advice.SLOW),
        ("viscous_friction", "torque_bias", advice.STATIC),
        ("viscous_friction", "torque_ripple", advice.SPEEDS),
    ],
)
def test_what_to_measure_next(a: str, b: str, text: str) -> None:
    assert experiment(a, b) == experiment(b, a) == text


def test_experiments_are_worded_for_their_joints() -> None:
    assert worded(advice.SLOW, ["a"], []) == advice.SLOW
    slide, both = worded(advice.SLOW, ["s"], ["s"]), worded(advice.SLOW, ["a", "s"], ["s"])
    assert "0.02 m/s" in slide and "positions" in slide and "rad" not in slide
    assert "rad/s or m/s" in both and "angles or positions" in both
    pair = Separation("coulomb_friction on s", "viscous_friction on s", 1.0, advice.SLOW)
    assert asked(pair, ["a", "s"], ["s"]) == slide
    none = Separation("payload", "gravity_tilt", 1.0, advice.SLOW)
    assert asked(none, ["a", "s"], ["s"]) == both
