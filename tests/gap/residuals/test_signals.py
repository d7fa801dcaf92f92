"""Signals that candidates are made of: signs, smoothed torques, noises, and what the given model has already."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, PAN, RATE, effect, everywhere, record, swing, swinging, terms_of, worn
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import (
    Terms,
    given_load,
    present,
    rate_of,
    slow_speed,
    spread_of,
    turns,
    with_load,
)
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.effects import make
from twin_diagram.scenario import EffectSpec

Array = npt.NDArray[np.float64]


def changed(**signals: Any) -> Terms:
    """The swinging arm's terms with other signals in its record."""
    terms = swinging()
    one = replace(terms.records.records[0], **signals)
    return terms_of(Records(ARM, (one,)))


def robust(x: Array) -> Array:
    return np.asarray(1.4826 * np.median(np.abs(x - np.median(x, axis=0)), axis=0))


def test_the_spread_of_samples_knows_no_outliers() -> None:
    x = np.random.default_rng(0).normal(3.0, [0.5, 2.0], size=(20_000, 2))
    np.testing.assert_allclose(spread_of(x), [0.5, 2.0], rtol=0.03)
    x[::50] = 1e6
    np.testing.assert_allclose(spread_of(x), [0.5, 2.0], rtol=0.06)


def crossing(samples: int, before: float = 1.0, after: float = -1.0) -> Record:
    """An elbow that rests so long on its way."""
    one = swinging().records.records[0]
    v = np.full_like(one.v, 9.0)
    v[:400, ELBOW], v[400:, ELBOW] = before, after
    v[400 : 400 + samples, ELBOW] = 0.001
    return replace(one, v=v)


@pytest.mark.parametrize(("samples", "turn"), [(15, True), (16, True), (17, False)])
def test_a_turn_is_brief(samples: int, turn: bool) -> None:
    """Eighty milliseconds at 200 samples a second."""
    assert turns(crossing(samples), ELBOW, 0.016) == ([(400, 400 + samples)] if turn else [])


def test_a_stop_is_no_turn_nor_is_a_rest_at_the_ends() -> None:
    assert turns(crossing(10, 1.0, 1.0), ELBOW, 0.016) == []
    assert turns(crossing(10, -1.0, 1.0), ELBOW, 0.016) == [(400, 410)]
    for place in (slice(0, 5), slice(-5, None)):
        one = crossing(0, 1.0, 1.0)
        one.v[place, ELBOW] = 0.0
        assert turns(one, ELBOW, 0.016) == []
    one = crossing(0)
    one.v[399, ELBOW], one.v[400, ELBOW] = 0.0161, -0.0159
    assert turns(one, ELBOW, 0.016) == [(400, 401)]
    early = crossing(0)
    early.v[0, ELBOW], early.v[1:4, ELBOW] = -1.0, 0.0
    assert turns(early, ELBOW, 0.016) == [(1, 4)]


def test_signs_go_evenly_from_one_side_to_the_other() -> None:
    one = crossing(9)
    terms = replace(terms_of(Records(ARM, (one,))), slow=np.full(6, 2.0))
    signs = terms.signs[0]
    assert terms.resting(ELBOW) == 4.0, "all is rest"
    np.testing.assert_allclose(signs[:, PAN], np.tanh(4.5))
    known = replace(terms, slow=np.full(6, 0.004))
    np.testing.assert_allclose(known.signs[0][399:410, ELBOW], np.linspace(1.0, -1.0, 11), atol=1e-12)
    assert known.resting(ELBOW) == 0.016
    assert replace(terms, slow=np.full(6, 0.0081)).resting(ELBOW) == pytest.approx(0.0162)
    np.testing.assert_allclose(known.reduced_signs, one.reduce(known.signs[0]))


def test_torques_are_smoothed_at_three_fifths_of_the_band() -> None:
    noise = np.random.default_rng(1).normal(size=(1000, 6))
    terms = changed(torque=noise)
    smooth = lowpass(noise, RATE, 12.0)
    np.testing.assert_allclose(terms.smooth_torque[0], smooth)
    np.testing.assert_allclose(terms.torque_noise, robust(lowpass(noise, RATE, 20.0) - smooth))


@pytest.mark.parametrize(("times", "sharp"), [(5.9, False), (6.1, True)])
def test_a_torque_jumps_where_smoothing_takes_away_six_times_what_it_usually_does(times: float, sharp: bool) -> None:
    noise = np.random.default_rng(2).normal(size=(1000, 6))
    step = np.zeros((1000, 6))
    step[500:, ELBOW] = 1.0

    def ratio(size: float) -> float:
        torque = noise + size * step
        taken = lowpass(torque, RATE, 20.0) - lowpass(torque, RATE, 12.0)
        return float(np.max(np.abs(taken[:, ELBOW])) / robust(taken)[ELBOW])

    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) < times else (low, middle)
    torque = noise + high * step
    terms = changed(torque=torque)
    asked = terms.asked_torque[0]
    np.testing.assert_allclose(asked[:, ELBOW], lowpass(torque[:, ELBOW], RATE, 80.0 if sharp else 12.0), atol=1e-9)
    np.testing.assert_allclose(asked[:, PAN], lowpass(torque[:, PAN], RATE, 12.0), atol=1e-9)


def test_what_was_asked_for_beyond_what_was_transmitted() -> None:
    noise = np.random.default_rng(3).normal(size=(1000, 6))
    base = changed(torque=noise)
    load = 0.3 * np.random.default_rng(4).normal(size=(1000, 6))
    terms = replace(base, load=(load,))
    one = terms.records.records[0]
    np.testing.assert_allclose(terms.unneeded, one.reduce(terms.asked_torque[0] - load))
    left = one.reduce(terms.asked_torque[0] - load)
    assert terms.unexplained(PAN) == pytest.approx(robust(left)[PAN])
    clipped = one.reduce(np.clip(terms.asked_torque[0], -0.2, 0.2) - load)
    assert terms.unexplained(PAN, 0.2) == pytest.approx(robust(clipped)[PAN])


def test_dry_friction_that_is_known_is_what_the_load_has_beyond_what_gears_pass_on() -> None:
    terms = swinging()
    one = terms.records.records[0]
    dry = np.array([1.0, 2.0, 0.0, 0.5, 0.0, 3.0]) * np.sign(one.v)
    known = replace(terms, load=(one.given + dry,), moved=(one.given,))
    np.testing.assert_allclose(known.dry_level, [1.0, 2.0, 0.0, 0.5, 0.0, 3.0])
    assert known.passed_on[0] is one.given
    np.testing.assert_array_equal(terms.passed_on[0], one.passed)
    other = with_load(terms, (dry,), (one.a,))
    assert other.load[0] is dry and other.passed_on[0] is one.a and other.records is terms.records
    assert given_load(terms.records)[0] is one.given


def test_the_size_of_a_joints_torque_is_the_models_where_none_is_logged() -> None:
    torque = np.random.default_rng(5).normal(size=(1000, 6))
    torque[:, PAN] = 0.0
    terms = changed(torque=torque)
    given, logged = (
        np.sqrt(np.mean(terms.records.records[0].reduce(x) ** 2, axis=0))
        for x in (
            terms.records.records[0].given,
            torque,
        )
    )
    np.testing.assert_allclose(terms.torque_size, [given[0], *logged[1:]])
    nothing = changed(torque=0.0 * torque, given=0.0 * torque)
    np.testing.assert_allclose(nothing.torque_size, 1e-6)


@pytest.mark.parametrize(("noise", "slow"), [(1e-5, 1e-3), (2.5e-3, 2.0), (0.05, 1e-2)])
def test_speeds_below_twice_their_noise_have_no_sign(noise: float, slow: float) -> None:
    """Between 1 and 10 mrad/s; of several logs the worst counts."""
    rng = np.random.default_rng(6)
    one = swinging().records.records[0]
    white = noise * rng.normal(size=one.v.shape)
    records = [replace(one, v=one.v + some) for some in (white, 0.1 * white)]
    left = white - lowpass(white, RATE, 40.0)
    wanted = np.full(6, slow) if slow < 1.0 else 2.0 * np.std(left, axis=0)
    for order in (records, records[::-1]):
        np.testing.assert_allclose(slow_speed(Records(ARM, tuple(order))), wanted, rtol=0.02)


def test_the_rate_of_a_signal_is_its_derivative() -> None:
    one = swinging().records.records[0]
    np.testing.assert_allclose(rate_of(one.q, one)[2:-2], one.v[2:-2], atol=2e-3)


def test_what_the_given_model_has_already_is_read_off_it() -> None:
    has = worn().present
    for found, value in ((has.damping, 2.0), (has.coulomb, 4.0), (has.rotor, 0.5), (has.stiffness, 20.0)):
        np.testing.assert_allclose(found, value)
    np.testing.assert_allclose(has.load, 0.1)
    assert has.mass == 3.0
    assert has.names >= {"coulomb_friction", "payload", "joint_spring"}
    nothing = swinging().present
    assert not np.any([nothing.damping, nothing.coulomb, nothing.rotor, nothing.stiffness, nothing.load])
    assert nothing.mass == 0.0 and not nothing.names


def test_what_was_put_down_in_another_run_cannot_be_taken_away_and_what_began_there_can() -> None:
    values = {"mass": [2.0], "com": [0.0, 0.0, 0.0]}
    moments: tuple[tuple[float | None, float | None], ...] = ((None, 3.0), (3.0, None))
    for (onset, end), mass in zip(moments, (0.0, 2.0), strict=True):
        load = make(EffectSpec("payload", [], ["tool0"], values, onset, end, "another run"))
        model = ARM.with_effects([load])
        assert present(Records(model, (record(model, *swing(1.0)),))).mass == mass


def test_of_two_levels_the_lower_can_be_taken_away_and_laws_add_up() -> None:
    elbow, pan = ARM.joints[ELBOW], ARM.joints[PAN]
    effects = [
        effect("coulomb_friction", [elbow, pan], torque_positive=[5.0, 1.0], torque_negative=[3.0, 2.0]),
        effect("stribeck_friction", [elbow], coulomb=0.5, static=2.0, stribeck_velocity=0.1),
        effect("joint_spring", [elbow], stiffness=7.0, rest_angle=0.0),
        effect("joint_spring", [elbow], stiffness=2.0, rest_angle=0.5),
        effect("joint_spring", [pan], curve=[-3.0, 3.0, 1.0, 1.0]),
        effect("payload", mass=1.5, com=[0.0, 0.0, 0.0]),
        effect("payload", mass=0.25, com=[0.0, 0.0, 0.0]),
        everywhere("load_dependent_friction", coefficient=0.05),
        everywhere("load_dependent_friction", coefficient=0.02),
    ]
    model = ARM.with_effects(effects)
    has = present(Records(model, (record(model, *swing(1.0)),)))
    np.testing.assert_allclose(has.coulomb, [1.0, 0.0, 3.5, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(has.stiffness, [0.0, 0.0, 9.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(has.load, 0.07)
    assert has.mass == 1.75


def test_torque_per_inertial_parameter_adds_up_to_the_arms() -> None:
    terms = swinging()
    whole = sum(terms.rigid(body) @ ARM.tree.inertia[body] for body in range(6))
    np.testing.assert_allclose(whole, terms.records.reduce(lambda r: r.given), atol=1e-9)
    assert terms.rigid(2) is terms.rigid(2)
