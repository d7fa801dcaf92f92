"""What the search is given where motors saturate, joints creep and friction holds, against signals made by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.gap.candidates import reversal_nuisances, torque_saturation
from twin_diagram.gap.naming import name
from twin_diagram.gap.residuals import regressors, stiction
from twin_diagram.gap.residuals.log_noise import roughness
from twin_diagram.gap.residuals.prepared_logs import prepare
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed, turns
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import stiction_proposals
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.effects import make
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec

Array = npt.NDArray[np.float64]

GIVEN = Model.load(ArmModel(model="arms/ur5e.urdf", tool_frame=""))
HOME = np.array([0.2, -1.2, 1.3, -0.9, -1.0, 0.3])
RATE = 250.0
LIFT, ELBOW, WRIST = 1, 2, 5


def log_with(wrist: Array | None = None, asked: Array | None = None) -> Log:
    """The arm swings in two sines for 12 s; a wrist's angle and what the elbow's motor is asked for may be given."""
    rng = np.random.default_rng(5)
    time = np.arange(round(12.0 * RATE)) / RATE
    q, v, a = np.tile(HOME, (len(time), 1)), np.zeros((len(time), 6)), np.zeros((len(time), 6))
    for frequency, size in ((0.3, 0.25), (0.7, 0.1)):
        w = 2.0 * np.pi * frequency
        angle = w * time[:, None] + rng.uniform(0.0, 6.0, 6)
        q += size * np.sin(angle)
        v += size * w * np.cos(angle)
        a -= size * w**2 * np.sin(angle)
    if wrist is not None:
        q[:, WRIST], v[:, WRIST] = wrist, np.gradient(wrist, time)
        a[:, WRIST] = np.gradient(v[:, WRIST], time)
    tau = GIVEN.inverse_dynamics(q, v, a) + 0.02 * rng.normal(size=q.shape)
    if asked is not None:
        tau[:, ELBOW] += asked
    return Log(time, GIVEN.joints, q + 2e-6 * rng.normal(size=q.shape), torque=tau)


def coarse_log(step: float, rate: float, shake: float = 0.0) -> tuple[Log, Array]:
    """20 s of slow sines, the last joint shaken at 5 Hz [rad], by encoders of some step, and the exact torque."""
    rng, time = np.random.default_rng(3), np.arange(round(20.0 * rate)) / rate
    q, v, a = np.tile(HOME, (len(time), 1)), np.zeros((len(time), 6)), np.zeros((len(time), 6))
    for frequency, size in ((0.06, 0.4), (0.14, 0.2), (0.27, 0.08), (5.0, np.append(np.zeros(5), shake))):
        w = 2.0 * np.pi * frequency * rng.uniform(0.8, 1.2, 6)
        angle = w * time[:, None] + rng.uniform(0.0, 6.0, 6)
        q += size * np.sin(angle)
        v += size * w * np.cos(angle)
        a -= size * w**2 * np.sin(angle)
    exact = GIVEN.inverse_dynamics(q, v, a)
    tau = exact + np.array([0.3, 0.3, 0.3, 0.05, 0.05, 0.05]) * rng.normal(size=q.shape)
    return Log(time, GIVEN.joints, np.round(q / step) * step, torque=tau), exact


def test_what_coarse_encoders_do_to_accelerations_is_no_load() -> None:
    """The residual holds the same noise, so that it would seem to follow the load."""
    log, exact = coarse_log(1e-4, 100.0, 3e-4)
    records = prepare(GIVEN, [log])
    (record,), (load,) = records.records, given_load(records)
    off = [lowpass(x - exact, record.rate, record.band)[record.kept, LIFT] for x in (record.given, load)]
    assert record.band == 8.0 and np.std(off[1]) < 0.5 * np.std(off[0])
    np.testing.assert_array_equal(load[:, 3:], record.given[:, 3:])  # wrists are too light to shake
    fine = prepare(GIVEN, [coarse_log(1e-6, 100.0)[0]])
    assert given_load(fine)[0] is fine.records[0].given


@pytest.mark.long
@pytest.mark.parametrize("rate", [50.0, 100.0])
def test_a_clean_log_of_slow_motion_by_coarse_encoders_lacks_nothing(rate: float) -> None:
    """Accelerations are noise above 5 Hz there: it was `unknown`, as the residual followed its own noise."""
    log, _ = coarse_log(1e-4, rate)
    records = prepare(GIVEN, [log])
    assert 4.0 <= records.records[0].band < 6.0
    assert name(GIVEN, [log], records=records).verdict == "none"


def terms_of(log: Log) -> Terms:
    records = prepare(GIVEN, [log])
    return Terms(records, given_load(records), slow_speed(records))


def jumps(size: float) -> Array:
    """A square wave of 9 Hz in the middle third of a log [N·m]."""
    time = np.arange(round(12.0 * RATE)) / RATE
    return size * np.sign(np.sin(2.0 * np.pi * 9.0 * time)) * ((time > 4.0) & (time < 8.0))


def test_a_torque_that_jumps_keeps_its_edges_and_others_are_smoothed() -> None:
    log = log_with(asked=jumps(60.0))
    terms = terms_of(log)
    asked, smooth = terms.asked_torque[0], terms.smooth_torque[0]
    assert log.torque is not None
    kept = [np.mean(np.abs(x[:, ELBOW] - log.torque[:, ELBOW]) < 8.0) for x in (asked, smooth)]
    assert kept[0] > 0.85 and kept[1] < 0.75, kept
    assert np.array_equal(asked[:, ELBOW + 1 :], smooth[:, ELBOW + 1 :]), "wrists that nothing happens to are smoothed"


def test_a_limit_that_is_passed_most_of_the_time_is_offered() -> None:
    """What was asked for beyond a limit leaves no trace but in the log."""
    log = log_with()
    assert log.torque is not None
    needed = log.torque[:, ELBOW]
    limit = float(np.quantile(np.abs(needed), 0.3))
    beyond = np.where(np.abs(needed) > limit, np.sign(needed) * 40.0, 0.0)
    terms = terms_of(log_with(asked=beyond))
    found = torque_saturation.saturation(terms, ELBOW, float(np.max(np.abs(needed))))
    assert found is not None
    left = terms.records.residual[:, ELBOW] - found.columns[:, 0, 0]
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(terms.records.residual[:, ELBOW] ** 2))
    calm = terms_of(log)
    assert torque_saturation.saturation(calm, ELBOW, 0.999 * float(np.max(np.abs(needed)))) is None


@pytest.mark.parametrize("held", [True, False], ids=["held", "slides"])
def test_a_joint_that_creeps_while_it_is_held_is_no_sliding_one(held: bool) -> None:
    time = np.arange(round(12.0 * RATE)) / RATE
    speed = np.where(time % 3.0 < 1.2, 0.028, 0.4) * np.where(time % 6.0 < 3.0, 1.0, -1.0)
    smooth = np.convolve(np.pad(speed, 25, mode="edge"), np.hanning(51) / np.sum(np.hanning(51)), mode="valid")
    terms = terms_of(log_with(wrist=0.3 + np.cumsum(smooth) / RATE))
    records = terms.records
    v = records.reduce(lambda r: r.v)[:, WRIST]
    left = 0.02 * np.random.default_rng(1).normal(size=records.residual.shape)
    left[:, WRIST] -= np.where(np.abs(v) < 0.06, 0.4 if held else -0.4, 0.0) * np.sign(v)
    slowest = stiction.creep(records, terms, left, [ELBOW, WRIST])
    assert slowest[ELBOW] == regressors.TUNING.rest
    assert (slowest[WRIST] > 0.03) == held, "friction that rises at slow speed is no creep"
    fewer, usual = (np.mean(stiction.sliding(records, terms, [WRIST], s)[:, WRIST]) for s in (slowest, None))
    assert fewer < usual - 0.2 if held else fewer == usual


def test_a_joint_that_turns_counts_the_less_the_more_friction_holds_it() -> None:
    """Its sign goes evenly from one side to the other meanwhile."""
    terms = terms_of(log_with())
    record = terms.records.records[0]
    spans = turns(record, ELBOW, regressors.TUNING.rest)
    assert len(spans) >= 4
    for first, last in spans:
        assert last - first <= 0.08 * record.rate
        signs = terms.signs[0][first - 1 : last + 1, ELBOW]
        assert np.ptp(np.diff(signs)) < 1e-9 and signs[0] * signs[-1] < 0.0
    masked = stiction.sliding(terms.records, terms, [ELBOW])[:, ELBOW]
    kept = stiction.sliding(terms.records, terms, [ELBOW], turning=True)[:, ELBOW]
    assert np.all(kept >= masked) and np.mean(kept) > np.mean(masked) + 0.05
    white = Whitener(np.ones((6, 1)), np.full(6, 0.1), terms.records.lengths)
    weak, strong = (
        stiction.turning(terms.records, terms, white, np.full(terms.records.residual.shape, level), [ELBOW])[ELBOW]
        for level in (0.01, 1.0)
    )
    about = weak > 0.0
    assert np.array_equal(about, ((kept > 0.0) & (masked == 0.0))[white.rows])
    assert np.allclose(weak[about], 1.0 / np.sqrt(1.0 + 0.07**2)) and np.max(strong) < 0.15


def test_two_joints_whose_speeds_cancel_are_held_by_friction_on_their_sum() -> None:
    """Both slide meanwhile."""
    terms = terms_of(log_with())
    record = terms.records.records[0]
    against = replace(record, v=np.array(record.v))
    half = len(record.v) // 2
    against.v[:, 3:5] = [0.5, 0.4]
    against.v[half:, 4] = -0.498
    terms = replace(terms, records=replace(terms.records, records=(against,)))
    usual = stiction.sliding(terms.records, terms, [3, 4])
    coupled = stiction.sliding(terms.records, terms, [3, 4], coupled=[(3, 4)])
    assert np.all(usual[:, 3:5] == 1.0)
    early = against.kept < half - 0.1 * record.rate
    late = against.kept > half
    assert np.all(coupled[early, 3:5] == 1.0) and np.all(coupled[late, 3:5] == 0.0)
    assert np.array_equal(np.delete(coupled, [3, 4], axis=1), np.delete(usual, [3, 4], axis=1))


def test_what_a_turn_leaves_beyond_the_samples_left_out_bears_no_name() -> None:
    """A held joint's torque that comes 6 ms before the sliding law's, at each turn: the low-pass carries it on."""
    plain = terms_of(log_with())
    record = plain.records.records[0]
    level = 3.0
    friction = level * np.sign(record.v[:, ELBOW])
    given = np.array(record.given)
    given[:, ELBOW] += friction
    terms = replace(plain, load=(given,), moved=(record.passed,))
    assert terms.dry_level == pytest.approx([level if j == ELBOW else 0.0 for j in range(6)])
    (nuisance,) = reversal_nuisances.nuisances(terms)
    assert nuisance.rows == (ELBOW,) and nuisance.name == ""
    early = np.roll(friction, -round(0.006 * record.rate)) - friction
    left = record.reduce(early[:, None])[:, 0]
    columns = nuisance.columns[:, 0]
    beside = stiction.sliding(terms.records, terms, [ELBOW])[:, ELBOW] > 0.0
    c, *_ = np.linalg.lstsq(columns[beside], left[beside], rcond=None)
    explained = left[beside] - columns[beside] @ c
    assert np.std(left[beside]) > 0.005
    assert np.std(explained) < 0.4 * np.std(left[beside])


class _Bench:
    """One joint whose Coulomb friction and what is left beside it are known."""

    def __init__(self, friction: Array, level: float, noise: float) -> None:
        count = len(friction)
        self.candidates = [SimpleNamespace(joints=(0,), rows=(0,), columns=np.zeros((count, 1, 1)))]
        self.whitener = SimpleNamespace(rows=np.arange(count))
        self.weights = np.zeros((1, count))
        self.weights[0, : count // 2] = 1.0
        self.level, self.friction = level, friction[:, None]
        self.friction[: count // 2] = noise * np.random.default_rng(2).normal(size=(count // 2, 1))

    def part(self, fit: object, k: int) -> tuple[Array, None]:
        return np.array([self.level]), None

    def left(self, fit: object) -> Array:
        return self.friction


@pytest.mark.parametrize(("held", "rises"), [(1.0, False), (0.8, False), (1.4, True)])
def test_rests_that_hold_more_than_the_sliding_level_refute_it(
    held: float, rises: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    level, noise = 0.5, 0.25
    rng = np.random.default_rng(3)
    stuck = np.zeros(1200, dtype=bool)
    friction = noise * rng.normal(size=1200)
    for k in range(10):
        place = slice(620 + 50 * k, 650 + 50 * k)
        stuck[place] = True
        friction[place] += held * level * (-1.0) ** k
    monkeypatch.setattr(stiction, "stuck", lambda *arguments: stuck)
    terms: Any = SimpleNamespace(records=None)
    bench: Any = _Bench(friction, level, noise)
    fit: Any = None
    found = stiction_proposals.dwells(bench, terms, fit, 0, level)
    assert (found is not None) == rises
    if found is not None:
        static, evidence = found
        assert static == pytest.approx(held * level, rel=0.2) and evidence > 5.0


def test_friction_goes_by_what_gears_pass_on_without_the_dry_friction_that_is_known() -> None:
    levels = [8.0, 8.0, 6.0, 1.0, 1.0, 1.0]
    dry = make(EffectSpec(name="coulomb_friction", joints=list(GIVEN.joints), parameters={"torque": levels}))
    log = log_with()
    record = prepare(GIVEN.with_effects([dry]), [log]).records[0]
    slick = prepare(GIVEN, [log]).records[0]
    np.testing.assert_allclose(record.passed, slick.given, atol=1e-9)
    moving = np.abs(record.v) > 0.05
    np.testing.assert_allclose((record.given - record.passed)[moving], (levels * np.sign(record.v))[moving], atol=1e-6)
    np.testing.assert_array_equal(slick.passed, slick.given)


@pytest.mark.parametrize("resting", [0.0, 0.7])
def test_an_encoders_noise_is_known_though_the_joint_rests(resting: float) -> None:
    rng = np.random.default_rng(8)
    time = np.arange(6000) / 500.0
    stays = np.where(time < resting * time[-1], 0.0, time - resting * time[-1])
    signal = np.stack([0.5 * np.sin(3.0 * time), np.sin(2.0 * stays), np.zeros(6000)], axis=1)
    signal[:, 0] += 1e-4 * rng.normal(size=6000)
    step = 2e-3
    signal[:, 1] = np.round(signal[:, 1] / step) * step
    noise = roughness(signal, 0.002)
    assert noise[0] == pytest.approx(1e-4, rel=0.06)
    assert noise[1] == pytest.approx(step / np.sqrt(12.0), rel=0.25)
    assert noise[2] == 0.0
