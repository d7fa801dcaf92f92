"""Impulses, onsets, gears in closed form, and what dry friction holds, against plain loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin_diagram.errors import ModelError
from twin_diagram.model import effects
from twin_diagram.model.dynamics import rigid_changes
from twin_diagram.model.dynamics.backlash import TUNING as BACKLASH
from twin_diagram.model.dynamics.backlash import _between, _Gears, _keep_within, play, play_alone
from twin_diagram.model.dynamics.elastic_gears import _linear, _onward, _start, in_series
from twin_diagram.model.dynamics.friction_impulses import DryFriction, Stop, solve
from twin_diagram.model.dynamics.onsets import epochs, shifted
from twin_diagram.model.effects.elasticity import Gear
from twin_diagram.model.effects.timing import Interval, at
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec

JOINTS = [f"panda_joint{i + 1}" for i in range(7)]


def test_a_signal_is_shifted_with_its_ends_held() -> None:
    time = np.linspace(1.0, 3.0, 201)
    wave = np.stack([np.sin(2 * time), np.cos(time)], axis=1)
    for by in (0.137, -0.26):
        there = np.clip(time + by, 1.0, 3.0)
        np.testing.assert_allclose(
            shifted(wave, time, by), np.stack([np.sin(2 * there), np.cos(there)], axis=1), atol=1e-6
        )
    assert shifted(wave, time, 0.0) is wave
    assert shifted(wave[:2], time[:2], 0.1) is not None and shifted(wave[:2], time[:2], 0.1) is not wave
    three = shifted(wave[:3], time[:3], 0.01)
    np.testing.assert_allclose(three[0], wave[1])


def test_epochs_are_those_of_their_conditions() -> None:
    bias = effects.make(EffectSpec("torque_bias", ["a"], [], {"torque": [1.0]}))
    time = np.arange(6.0)
    found = dict(epochs([at(bias, Interval(1.0, 4.0)), at(bias, Interval(onset=3.0))], time))
    expected = {(False, False): [0], (True, False): [1, 2], (True, True): [3], (False, True): [4, 5]}
    assert {key: np.flatnonzero(mask).tolist() for key, mask in found.items()} == expected
    ((none, mask),) = epochs([], time)
    assert none == () and mask.all()


@pytest.mark.parametrize("count", [1, 2, 9, 50])
def test_steps_put_together_side_by_side_are_those_one_after_the_other(count: int) -> None:
    steps = np.random.default_rng(count).normal(size=(count, 4, 5)) / 2.0
    whole = _onward(steps)
    state = np.eye(4, 5, 1)
    np.testing.assert_array_equal(whole[0], state)
    for k, step in enumerate(steps, start=1):
        state = step[:, :4] @ state
        state[:, 0] += step[:, 4]
        np.testing.assert_allclose(whole[k], state, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_impulses_keep_the_laws_of_dry_friction_and_of_stops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((30, 4, 4))
    inverse = root @ root.transpose(0, 2, 1) + 0.5 * np.eye(4)
    v = rng.standard_normal((30, 4))
    both = np.array([0.0, 1.0, 1.0, 0.0])
    brakes = [
        DryFriction(np.eye(4)[0], rng.uniform(0.0, 0.6, 30), rng.uniform(0.0, 0.3, 30)),
        DryFriction(both, np.full(30, 0.2), np.full(30, 0.4)),
        DryFriction(np.eye(4)[2], np.zeros(30), np.zeros(30)),
    ]
    stop = Stop(3, np.full(30, -0.3), np.full(30, 0.5))
    kept = v.copy()
    after = solve(inverse, v, brakes, [stop])
    np.testing.assert_array_equal(v, kept)
    impulse = np.linalg.solve(inverse, (after - v)[..., None])[..., 0]
    np.testing.assert_allclose(impulse[:, 1], impulse[:, 2], atol=1e-6)
    assert (after[:, 3] >= -0.3 - 1e-6).all() and (after[:, 3] <= 0.5 + 1e-6).all()
    free = (after[:, 3] > -0.3 + 1e-5) & (after[:, 3] < 0.5 - 1e-5)
    np.testing.assert_allclose(impulse[free, 3], 0.0, atol=1e-6)
    assert (impulse[~free, 3] * after[~free, 3] <= 1e-6).all()
    for speed, push, brake in ((after[:, 0], impulse[:, 0], brakes[0]), (after @ both, impulse[:, 1], brakes[1])):
        assert (-push <= brake.forward + 1e-7).all() and (push <= brake.backward + 1e-7).all()
        np.testing.assert_allclose(-push[speed > 1e-5], brake.forward[speed > 1e-5], atol=1e-6)
        np.testing.assert_allclose(push[speed < -1e-5], brake.backward[speed < -1e-5], atol=1e-6)
        assert (np.abs(speed) <= 1e-5).any() and (np.abs(speed) > 1e-5).any()


def test_impulses_at_bounds_are_those_that_a_linear_complementarity_asks_for() -> None:
    inverse = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, -0.3], [0.1, -0.3, 1.5]])
    before = np.array([1.0, -2.0, 0.3])
    v = before.tolist()
    _keep_within(inverse.tolist(), v, [(0, -0.2, 0.4), (1, -0.5, 0.5)])
    impulse = np.linalg.solve(inverse, np.array(v) - before)
    np.testing.assert_allclose(impulse[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(v[:2], [0.4, -0.5], atol=1e-9)
    assert impulse[0] < 0 < impulse[1]
    unchanged = [0.1, 0.2, 9.0]
    _keep_within(inverse.tolist(), unchanged, [(0, -0.2, 0.4), (1, -0.5, 0.5)])
    assert unchanged == [0.1, 0.2, 9.0]


def test_play_alone_falls_freely_between_its_ends() -> None:
    """From rest where the load presses it: once the load turns, s = F t² / 2m, up to a stop without rebound."""
    period, half, mass = 0.01, 0.02, np.full(100, 0.5)
    for sign in (1.0, -1.0):
        load = np.full(100, -2.0 * sign)
        load[0] = -load[1] * 1e-9
        angle, rate, acceleration = play_alone(mass, load, half, period)
        assert angle[0] == pytest.approx(-sign * half)
        time = period * np.arange(100)
        flies = np.flatnonzero(time[1:] ** 2 * 2.0 < 0.9 * 2 * half) + 1
        expected = -half + 2.0 * (time[flies] - period / 4) ** 2
        np.testing.assert_allclose(sign * angle[flies], expected, atol=1.2e-3)
        np.testing.assert_allclose(np.diff(sign * rate[flies]), 4.0 * period, rtol=1e-6)
        np.testing.assert_allclose(sign * angle[30:], half)
        np.testing.assert_allclose(rate[30:], 0.0, atol=1e-12)
        np.testing.assert_allclose(sign * acceleration[flies[1:-1]], 4.0, rtol=1e-6)
        again = play(mass[:, None, None], load[:, None], np.array([np.inf]), np.array([half]), np.zeros(1), period)
        np.testing.assert_array_equal(again[0][:, 0], angle)
    steps = np.array([[1.0], [3.0]])
    np.testing.assert_allclose(_between(steps), [[1.0], [2.0], [3.0]])


def test_gears_rest_where_their_load_has_pushed_them() -> None:
    mass = np.tile(np.eye(3), (2, 1, 1))
    gears = _Gears.of(mass, np.array([50.0, 80.0, np.inf]), np.array([0.0, 0.02, 0.03]), np.full(3, 1e-3), 0.001)
    for sign in (1.0, -1.0):
        found = gears.at_rest([sign * 2.0, sign * 4.0, sign * 1.0])
        np.testing.assert_allclose(found, [-sign * 0.04, -sign * (0.05 + 0.02), -sign * 0.03])
    assert (gears.springs, gears.both, gears.bounded) == ([0], [1], [2])
    # A spring alone is followed where it swings less than half a radian in a step.
    for stiffness, theta in ((0.249e6, 0.5), (0.251e6, 1.0)):
        assert _Gears.of(mass, np.array([stiffness, 1, 1]), np.zeros(3), np.zeros(3), 0.001).theta[0] == theta
    assert np.isclose(BACKLASH.longest_step * 1000, 1.0, rtol=0.4)


def test_gears_in_series_add_their_compliances_and_gaps() -> None:
    found = in_series([
        (3, Gear(100.0, 0.0, 2e-3)), (1, Gear(gap=0.02)), (3, Gear(300.0, 0.01, 4e-3)), (1, Gear(gap=0.01)),
    ])  # fmt: skip
    assert found.joints.tolist() == [1, 3] and len(found) == 2
    np.testing.assert_allclose(found.stiffness, [np.inf, 75.0])
    np.testing.assert_allclose(found.half, [0.015, 0.005])
    lost = (2e-3 / 100 + 4e-3 / 300) * 75.0
    np.testing.assert_allclose(found.loss, [1e-3, lost])
    assert found.chosen(np.array([False, True])).joints.tolist() == [3]


def test_linear_gears_swing_as_their_equation_says() -> None:
    """M ë + D ė + K e = force, from each unit of the start and from the force, against its own derivatives."""
    h, samples = 0.002, 400
    time = h * np.arange(samples)
    M = np.tile([[2.0, 0.3], [0.3, 1.0]], (samples, 1, 1)) * (1 + 0.2 * np.sin(time))[:, None, None]
    D, K = np.tile([[3.0, 0.0], [0.5, 2.0]], (samples, 1, 1)), np.tile([[900.0, 20.0], [10.0, 500.0]], (samples, 1, 1))
    force = np.stack([np.sin(9 * time), 3 * np.cos(5 * time)], axis=1)
    states = _linear(M, D, K, force, h)
    e, rate, acceleration = states[:, :2], states[:, 2:4], states[:, 4:]
    np.testing.assert_array_equal(states[0, :4, 1:], np.eye(4))
    np.testing.assert_array_equal(states[0, :4, 0], 0.0)
    left = np.einsum("kij,kjm->kim", M, acceleration) + np.einsum("kij,kjm->kim", D, rate)
    left += np.einsum("kij,kjm->kim", K, e)
    np.testing.assert_allclose(left[:, :, 0], force, atol=1e-9)
    np.testing.assert_allclose(left[:, :, 1:], 0.0, atol=1e-9)
    for values, slopes in ((e, rate), (rate, acceleration)):
        size = np.abs(slopes).max(axis=(0, 1))
        middle = (values[2:] - values[:-2]) / (2 * h)
        assert (np.abs(middle - slopes[1:-1]).max(axis=(0, 1)) < 2e-3 * size).all()
    rng = np.random.default_rng(0)
    begin, calm = rng.standard_normal(4), rng.standard_normal((samples, 2))
    made = states[:, :2, 0] + states[:, :2, 1:] @ begin
    np.testing.assert_allclose(_start(states, np.zeros((samples, 2, 5)), made, None), begin, atol=1e-8)
    torque = rng.standard_normal((samples, 3, 5)) * np.array([1.0, 5.0, 20.0])[:, None]
    seen = torque[:, :, 0] + torque[:, :, 1:] @ begin
    np.testing.assert_allclose(_start(states, torque, calm, seen), begin, atol=1e-8)


def test_no_more_is_taken_away_than_there_is() -> None:
    def loaded(name: str, **parameters: Any) -> Model:
        return Model.load(
            ArmModel(model="arms/panda.urdf", tool_frame="", effects=[EffectSpec(name, [JOINTS[1]], [], parameters)])
        )

    bare = Model.load("arms/panda.urdf")
    rotor, damping = bare.tree.rotor[1], bare.tree.damping[1]
    for name, key, there in (("reflected_inertia", "inertia", rotor), ("viscous_friction", "damping", damping)):
        changed = loaded(name, **{key: [-there - 0.9e-9]}).tree
        assert (changed.rotor if key == "inertia" else changed.damping)[1] == pytest.approx(0.0, abs=1e-12)
        with pytest.raises(ModelError, match=r"is not within \[0, inf\]"):
            loaded(name, **{key: [-there - 1.1e-9]})
        more = loaded(name, **{key: [0.4]}).tree
        assert (more.rotor if key == "inertia" else more.damping)[1] == pytest.approx(there + 0.4)
    with pytest.raises(ModelError, match="coulomb_friction"):
        loaded("coulomb_friction", torque=[-1.1e-9])
    two = [effects.make(EffectSpec("coulomb_friction", ["a"], [], {"torque_positive": [x], "torque_negative": [y]}))
           for x, y in ((2.0, 1.0), (-1.5, -1.2))]  # fmt: skip
    with pytest.raises(ModelError, match=r"-0\.2 N·m in all on a"):
        rigid_changes.check_friction(["a", "b"], two)
    rigid_changes.check_friction(["a", "b"], [two[0]])
    with pytest.raises(ModelError, match="N in all on a"):
        rigid_changes.check_friction(["a", "b"], two, ["a"])


def test_dry_friction_at_rest_holds_what_arrives_up_to_its_level() -> None:
    specs = [
        EffectSpec("coulomb_friction", JOINTS[:1], [], {"torque_positive": [3.0], "torque_negative": [2.0]}),
        EffectSpec("coupled_friction", JOINTS[4:6], [], {"torque": [1.0], "damping": [0.0]}),
    ]
    model = Model.load(ArmModel(model="arms/panda.urdf", tool_frame="", effects=specs))
    q, v = np.zeros((5, 7)), np.zeros((5, 7))
    total, arrived = np.zeros((5, 7)), np.zeros((5, 7))
    arrived[:, 0] = [1.0, 5.0, -1.0, -5.0, 0.0]
    arrived[:, 4] = [0.6, 1.2, -0.2, -9.0, 0.0]
    arrived[:, 5] = [0.2, 2.0, -0.2, 0.0, 0.0]
    found = model.law.held(total, q, v, arrived)
    np.testing.assert_allclose(found[:, 0], [1.0, 3.0, -1.0, -2.0, 0.0])
    mean = np.clip((arrived[:, 4] + arrived[:, 5]) / 2, -1.0, 1.0)
    np.testing.assert_allclose(found[:, 4:6], np.stack([mean, mean], axis=1))
    moving = np.zeros((5, 7))
    moving[:, [0, 4, 5]] = 0.1
    sliding = model.law.joint_load(q, moving, np.zeros_like(q))
    np.testing.assert_allclose(model.law.held(sliding, q, moving, arrived), sliding, atol=1e-9)
    slow = np.zeros((5, 7))
    slow[:, [0, 4, 5]] = 0.001  # between: the smooth law's friction gives way to what is held by 1 − s²
    own = np.zeros((5, 7))
    s0, s1 = np.tanh(0.2), np.tanh(0.4)
    own[:, 0], own[:, 4], own[:, 5] = 3.0 * s0, s1, s1
    found = model.law.held(own, q, slow, arrived)
    hold = np.clip(arrived[:, 0], -2.0, 3.0)
    np.testing.assert_allclose(found[:, 0], 3.0 * s0 + (1 - s0**2) * (hold - 3.0 * s0))
    np.testing.assert_allclose(found[:, 4], s1 + (1 - s1**2) * (mean - s1))
