"""Samples at which friction may hold a joint are left out, as far as filters spread them, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, PAN, WRIST, effect, everywhere, record, swing, swinging
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.model.model import Model

Array = npt.NDArray[np.float64]

RATE, BAND, STRIDE = 1000.0, 20.0, 20


def moving_at(speed: Array, model: Model = ARM) -> Terms:
    """An elbow that moves at such speeds, all other joints at 1 rad/s; nothing of it is known but the speed."""
    count = len(speed)
    one = swinging().records.records[0]
    v = np.ones((count, 6))
    v[:, ELBOW] = speed
    zero = np.zeros((count, 6))
    made = replace(
        one,
        time=np.arange(count) / RATE,
        rate=RATE,
        band=BAND,
        **dict.fromkeys(("q", "a", "torque", "given", "passed"), zero),  # type: ignore[arg-type]
        v=v,
        kept=np.arange(300, count - 300, STRIDE),
    )
    return Terms(Records(model, (made,)), (zero,), np.full(6, 1e-3))


def resting(*spans: tuple[int, int], count: int = 6000, at: float = 0.0) -> Array:
    speed = np.ones(count)
    for first, last in spans:
        speed[first:last] = at
    return speed


def out(terms: Terms, **more: object) -> npt.NDArray[np.int64]:
    """The samples of the log that are left out for the elbow."""
    weights = stiction.sliding(terms.records, terms, [ELBOW], **more)  # type: ignore[arg-type]
    assert set(np.unique(weights)) <= {0.0, 1.0}
    assert np.all(np.delete(weights, ELBOW, axis=1) == 1.0)
    return terms.records.records[0].kept[weights[:, ELBOW] == 0.0]


def test_a_rest_is_left_out_as_far_as_the_filters_spread_it() -> None:
    """0.9 periods of the band's edge to both sides, 45 ms, and two thinned samples after that."""
    found = out(moving_at(resting((3000, 3100))))
    kept = np.arange(300, 5700, STRIDE)
    wanted = kept[(kept >= 3000 - 45) & (kept <= 3099 + 45)]
    np.testing.assert_array_equal(found, [*wanted, wanted[-1] + STRIDE, wanted[-1] + 2 * STRIDE])


@pytest.mark.parametrize(("samples", "rests"), [(3, False), (4, True)])
def test_a_joint_that_turns_back_at_once_does_not_stick(samples: int, rests: bool) -> None:
    """Four milliseconds."""
    assert bool(len(out(moving_at(resting((3000, 3000 + samples)))))) == rests


@pytest.mark.parametrize(("speed", "rests"), [(0.0159, True), (0.0161, False), (-0.0159, True)])
def test_a_joint_may_stick_below_16_mrad_per_second(speed: float, rests: bool) -> None:
    assert bool(len(out(moving_at(resting((3000, 3100), at=speed))))) == rests


def test_where_speeds_are_not_known_or_a_joint_creeps_more_is_rest() -> None:
    terms = moving_at(resting((3000, 3100), at=0.03))
    assert not len(out(terms)) and len(out(terms, slowest=np.full(6, 0.031)))
    assert not len(out(terms, slowest=np.full(6, 0.029)))
    noisy = replace(terms, slow=np.full(6, 0.0151))
    assert len(out(noisy)) and not len(out(replace(terms, slow=np.full(6, 0.0149))))


@pytest.mark.parametrize(("moves", "masked"), [(0.27, False), (0.33, True)])
def test_a_joint_that_hardly_moves_keeps_its_samples_unless_it_is_known_to_stick(moves: float, masked: bool) -> None:
    """Below three tenths of the time."""
    speed = resting((0, 300 + round(5400 * (1.0 - moves)) - 85))
    terms = moving_at(speed)
    assert bool(len(out(terms))) == masked
    dry = moving_at(speed, ARM.with_effects([effect("coulomb_friction", [ARM.joints[ELBOW]], torque=1.0)]))
    assert np.mean(stiction.sliding(dry.records, dry, [ELBOW])[:, ELBOW]) == pytest.approx(moves, abs=0.01)


def test_turns_count_where_no_dry_friction_is_known() -> None:
    speed = resting((3000, 3050))
    speed[3050:] = -1.0
    terms = moving_at(speed)
    assert len(out(terms)) and not len(out(terms, turning=True))
    dry = moving_at(speed, ARM.with_effects([effect("coulomb_friction", [ARM.joints[ELBOW]], torque=1.0)]))
    assert len(out(dry, turning=True))


@pytest.mark.parametrize(("moves", "masked"), [(0.08, False), (0.13, True)])
@pytest.mark.parametrize(("speed", "rests"), [(-1.0159, True), (-1.0161, False)])
def test_friction_on_a_sum_of_speeds_holds_both_joints(moves: float, masked: bool, speed: float, rests: bool) -> None:
    """Below a tenth of the time it says nothing."""
    terms = moving_at(resting((0, 300 + round(5400 * (1.0 - moves)) - 85), at=speed))
    weights = stiction.sliding(terms.records, terms, [], coupled=[(PAN, ELBOW)])
    assert (np.min(weights[:, PAN]) == 0.0) == (masked and rests)
    np.testing.assert_array_equal(weights[:, PAN], weights[:, ELBOW])
    assert np.all(weights[:, [1, 3, 4, 5]] == 1.0)


def test_a_sums_sign_is_as_well_known_as_both() -> None:
    terms = moving_at(resting((3000, 3100), at=-1.05))
    slow = np.full(6, 1e-3)
    slow[[PAN, ELBOW]] = 0.015, 0.02
    for share, rests in ((0.99, False), (1.01, True)):
        some = replace(terms, slow=share * slow)
        weights = stiction.sliding(some.records, some, [], coupled=[(PAN, ELBOW)])
        assert (np.min(weights) == 0.0) == rests


def test_joints_with_dry_friction_and_pairs_with_friction_between_them_are_known() -> None:
    a, b, c = (ARM.joints[j] for j in (1, 2, 4))
    model = ARM.with_effects(
        [
            effect("coupled_friction", [a, b], damping=1.0, torque=1.0),
            effect("coulomb_friction", [c], torque=1.0),
            effect("viscous_friction", [ARM.joints[0]], damping=1.0),
        ]
    )
    records = Records(model, swinging().records.records)
    assert stiction.coupled_pairs(records) == {(1, 2)} and stiction.dry_joints(records) == {1, 2, 4}
    assert not stiction.coupled_pairs(swinging().records) and not stiction.dry_joints(swinging().records)


def test_whitened_samples_have_the_weights_of_their_rows() -> None:
    terms = moving_at(resting((3000, 3100)))
    whitener = Whitener(np.ones((6, 3)), np.ones(6), terms.records.lengths)
    weights = stiction.moving(terms.records, terms, whitener, [ELBOW])
    wanted = stiction.sliding(terms.records, terms, [ELBOW])
    np.testing.assert_array_equal(weights, wanted[2:].T)
    assert np.any(weights == 0.0)


def test_what_is_held_is_within_what_the_low_pass_makes_of_it() -> None:
    """Friction that slides on one level and holds anything up to it stays within the reach, and may come near it."""
    terms = moving_at(resting((1000, 1200), (2500, 2520), (4000, 4010)) * np.where(np.arange(6000) < 3000, 1.0, -1.0))
    one = terms.records.records[0]
    slid, held = stiction.reach(terms.records, terms, ELBOW)
    still = np.abs(one.v[:, ELBOW]) < 0.016
    np.testing.assert_array_equal(stiction.stuck(terms.records, terms, ELBOW), still[one.kept])
    rng = np.random.default_rng(0)
    for _ in range(5):
        friction = np.where(still, np.repeat(rng.choice([-1.0, 1.0], 600), 10), np.sign(one.v[:, ELBOW]))
        seen = one.reduce(friction[:, None])[:, 0]
        assert np.all(seen <= slid + held + 1e-3) and np.all(seen >= slid - held - 1e-3)
    sliding = held < 1e-6
    np.testing.assert_allclose(seen[sliding], slid[sliding], atol=1e-3)
    at = int(np.argmin(np.abs(one.kept - 2510)))
    worst = np.where(still, 1.0, np.sign(one.v[:, ELBOW]))
    near = slice(one.kept[at] - 20, one.kept[at] + 20)
    lobe = one.response[len(one.response) // 2 - 20 : len(one.response) // 2 + 20]
    worst[near] = np.where(still[near], np.sign(lobe), worst[near])
    assert one.reduce(worst[:, None])[at, 0] == pytest.approx(slid[at] + held[at], abs=0.01)


@pytest.mark.parametrize(("level", "share"), [(0.0, 0.0), (1.0, 0.7), (3.0, 2.1)])
def test_samples_about_a_turn_count_less_by_what_may_be_missed(level: float, share: float) -> None:
    """Seven tenths of dry friction, in standard deviations of the noise, beside the noise itself."""
    speed = resting((3000, 3030))
    speed[3030:] = -1.0
    terms = moving_at(speed)
    noise = Whitener(np.ones((6, 1)), np.full(6, 0.5), terms.records.lengths)
    dry = np.full((sum(terms.records.lengths), 6), 0.5 * level)
    weights = stiction.turning(terms.records, terms, noise, dry, [ELBOW])
    about = stiction.sliding(terms.records, terms, [ELBOW])[:, ELBOW] == 0.0
    np.testing.assert_allclose(weights[ELBOW][about], 1.0 / np.sqrt(1.0 + share**2))
    assert not np.any(weights[ELBOW][~about]) and not np.any(weights[PAN])


def test_what_may_be_missed_is_averaged_over_six_tenths_of_a_second() -> None:
    speed = resting((3000, 3030))
    speed[3030:] = -1.0
    terms = moving_at(speed)
    noise = Whitener(np.ones((6, 1)), np.ones(6), terms.records.lengths)
    about = np.flatnonzero(stiction.sliding(terms.records, terms, [ELBOW])[:, ELBOW] == 0.0)
    dry = np.zeros((sum(terms.records.lengths), 6))
    dry[about[0], ELBOW] = 10.0
    weights = stiction.turning(terms.records, terms, noise, dry, [ELBOW])[ELBOW]
    np.testing.assert_allclose(weights[about], 1.0 / np.sqrt(1.0 + 0.49 * 100.0 / 30.0))


def creeping(speeds: list[float], fast: float = 0.4) -> Terms:
    """An elbow that is at each of some speeds for a while, ahead and back."""
    each = [np.full(400, sign * s) for s in (fast, *speeds) for sign in (1.0, -1.0)]
    steps = np.concatenate(each * 2)
    return moving_at(np.convolve(np.pad(steps, 10, mode="edge"), np.ones(21) / 21.0, "valid"))


@pytest.mark.parametrize(
    ("short", "slowest"),
    [
        ({}, 0.016),
        ({0.02: 1.0}, 0.024),
        ({0.02: 1.0, 0.03: 1.0}, 0.036),
        ({0.02: 1.0, 0.03: 1.0, 0.045: 1.0}, 0.054),
        ({0.03: 1.0}, 0.016),
        ({0.02: -1.0}, 0.016),
    ],
)
def test_a_joint_is_held_below_the_speed_at_which_friction_stops_falling_short(
    short: dict[float, float], slowest: float
) -> None:
    terms = creeping([0.02, 0.03, 0.045, 0.2])
    v = terms.records.reduce(lambda r: r.v)
    rng = np.random.default_rng(1)
    left = 0.1 * rng.normal(size=v.shape)
    size = np.abs(v[:, ELBOW])
    left[:, ELBOW] += 2.0 * np.sign(v[:, ELBOW])
    for speed, less in short.items():
        left[:, ELBOW] -= np.where(np.abs(size / speed - 1.0) < 0.19, less, 0.0) * np.sign(v[:, ELBOW])
    found = stiction.creep(terms.records, terms, left, [ELBOW])
    assert found[ELBOW] == pytest.approx(slowest) and np.all(np.delete(found, ELBOW) == 0.016)
    assert np.all(stiction.creep(terms.records, terms, left, []) == 0.016)


@pytest.mark.parametrize(("errors", "held"), [(3.8, False), (4.2, True)])
def test_friction_falls_short_by_four_standard_errors(errors: float, held: bool) -> None:
    """Of a mean of half as many samples as there are."""
    terms = creeping([0.02, 0.2])
    v = terms.records.reduce(lambda r: r.v)[:, ELBOW]
    left = np.zeros((len(v), 6))
    weights = stiction.sliding(terms.records, terms, [ELBOW])[:, ELBOW] > 0.0
    fast = weights & (np.abs(v) > 0.1)
    rng = np.random.default_rng(2)
    left[:, ELBOW] = np.sign(v) * (1.0 + 0.1 * rng.normal(size=len(v)))
    against = np.sign(v) * left[:, ELBOW]
    noise = 1.4826 * np.median(np.abs(against[fast] - np.median(against[fast])))
    slow = weights & (np.abs(v) >= 0.016) & (np.abs(v) < 0.024)
    shift = np.median(against[fast]) - errors * noise / np.sqrt(np.sum(slow) / 2.0)
    left[slow, ELBOW] = np.sign(v[slow]) * shift
    assert (stiction.creep(terms.records, terms, left, [ELBOW])[ELBOW] > 0.02) == held


def test_a_joint_that_never_moves_fast_tells_of_no_creep() -> None:
    terms = creeping([0.02, 0.05], fast=0.09)
    left = np.zeros((len(terms.records.residual), 6))
    v = terms.records.reduce(lambda r: r.v)[:, ELBOW]
    left[:, ELBOW] = np.sign(v) * np.where(np.abs(v) < 0.03, 0.0, 1.0)
    assert stiction.creep(terms.records, terms, left, [ELBOW])[ELBOW] == 0.016
    sure = creeping([0.02, 0.05], fast=0.11)
    v = sure.records.reduce(lambda r: r.v)[:, ELBOW]
    level = 1.0 + 0.05 * np.random.default_rng(3).normal(size=len(v))
    left[:, ELBOW] = np.sign(v) * np.where(np.abs(v) < 0.03, 0.0, level)
    assert stiction.creep(sure.records, sure, left, [ELBOW])[ELBOW] == 0.024


def test_a_swinging_arm_with_friction_everywhere_sticks_about_its_turns() -> None:
    model = ARM.with_effects([everywhere("coulomb_friction", torque=1.0)])
    one = record(model, *swing(3.0))
    terms = Terms(Records(model, (one,)), (one.given,), np.full(6, 1e-3))
    masked = stiction.sliding(terms.records, terms, range(6))
    v = one.v[one.kept]
    assert np.all(masked[np.abs(v) < 0.01] == 0.0) and np.mean(masked[np.abs(v) > 0.5]) > 0.95
    assert masked[:, WRIST].shape == (len(one.kept),)
