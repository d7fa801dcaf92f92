"""Logs summed up: what is left in time is what the sums say, and repeats are of one kind."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, effect, record, swing
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import torque_equations
from twin_diagram.gap.whole_robot.column_sums import summed
from twin_diagram.gap.whole_robot.torque_equations import equations, kinds_of_motion


def test_sums_say_what_a_difference_leaves() -> None:
    rng = np.random.default_rng(4)
    time, q, v, a = swing(8.0)
    extra = 2.0 * v + 0.5 * a - 0.7
    sums = equations(Records(ARM, (record(ARM, time, q, v, a, extra=extra),)))
    difference = np.zeros((6, 64))
    np.testing.assert_allclose(sums.left(difference), sums.columns[:, :, -1] * sums.weights)
    difference[:, 60], difference[:, 62], difference[:, 63] = 2.0, 0.7, 0.5
    assert np.max(np.abs(sums.left(difference))) < 1e-6 * np.max(np.abs(extra))
    difference = rng.normal(size=(6, 64))
    full = np.concatenate([-difference, np.ones((6, 1))], axis=1)
    stretches = summed(sums.columns, sums.weights, sums.stretch)
    squares = np.einsum("jk,sjkl,jl->j", full, stretches, full)
    np.testing.assert_allclose(np.sum(sums.left(difference) ** 2, axis=0), squares, rtol=1e-9)
    np.testing.assert_allclose(np.sum(sums.counts, axis=0), np.sum(sums.weights, axis=0))
    kinds = np.stack([np.sum(stretches[sums.fold == kind], axis=0) for kind in sums.kinds])
    np.testing.assert_allclose(sums.of_kinds, kinds, atol=1e-12 * np.max(kinds))


@pytest.mark.parametrize(("moves", "kept"), [(0.25, 0.0), (0.05, 1.0)])
def test_a_joint_that_mostly_rests_is_told_by_how_it_slides(moves: float, kept: float) -> None:
    """What holds it is no friction that slides. Where too few samples slide, all count."""
    time, q, v, a = swing(24.0)
    moving = np.arange(len(time)) < moves * len(time)
    for x, rest in ((q, q[np.argmin(moving), ELBOW]), (v, 0.0), (a, 0.0)):
        x[~moving, ELBOW] = rest
    sums = equations(Records(ARM, (record(ARM, time, q, v, a),)))
    held = ~moving[sums.records.records[0].kept]
    assert np.mean(sums.weights[held, ELBOW]) == kept


def test_what_links_weigh_beyond_the_description_pulls_aside_on_a_tilted_base() -> None:
    """Nothing else does: such columns span what a link that is off adds to a tilted arm's torque, level ones do not."""
    tilt = effect("gravity_tilt", roll=0.15, pitch=-0.1)
    heavier = effect("inertial_parameters", links=["forearm_link"], mass=1.5, com=[0.0, 0.03, 0.02])
    time, q, v, a = swing(4.0)
    more = [ARM.with_effects(some).inverse_dynamics(q, v, a, time=time) for some in ([tilt], [tilt, heavier])]
    made = record(ARM, time, q, v, a)
    level = equations(Records(ARM, (replace(made, torque=made.given + more[1] - more[0]),)))
    tilted = level.on_base((0.15, -0.1))
    left = []
    for sums in (level, tilted):
        links, residual = (
            sums.columns[:, :, 10 * ELBOW : 10 * ELBOW + 10].reshape(-1, 10),
            sums.columns[:, :, -1].ravel(),
        )
        best = np.linalg.lstsq(links, residual, rcond=None)[0]
        left.append(np.linalg.norm(residual - links @ best) / np.linalg.norm(residual))
    assert left[1] < 1e-6 < 0.02 < left[0]
    np.testing.assert_allclose(tilted.with_further([]).whole, level.whole, atol=1e-9 * np.max(level.whole))


def test_a_slow_log_is_thinned_no_more_than_a_fast_one_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torque_equations, "TUNING", replace(torque_equations.TUNING, samples=800))
    long, short = record(ARM, *swing(30.0)), record(ARM, *swing(6.0), index=1)
    kept = np.arange(15, len(short.time) // 4 - 15, 2)
    slow = {name: getattr(short, name)[::4] for name in ("time", "q", "v", "a", "torque", "given", "passed")}
    there = replace(short, rate=50.0, period=0.02, band=10.0, kept=kept, **slow)
    fast, other = equations(Records(ARM, (replace(long, band=10.0), there))).records.records
    assert np.diff(other.times)[0] == pytest.approx(np.diff(fast.times)[0], abs=0.02)
    assert len(fast.kept) + len(other.kept) <= 800


def test_a_long_logs_columns_are_never_there_at_its_full_rate() -> None:
    records = Records(ARM, (record(ARM, *swing(60.0)),))
    tracemalloc.start()
    columns = equations(records).columns
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < len(records.records[0].time) * columns[0].nbytes


@pytest.mark.parametrize("level", [0.0, -7.3])
def test_a_torque_that_never_changes_in_a_log_tells_nothing_of_it(level: float) -> None:
    made = [record(ARM, *swing(4.0, seed), index=seed, extra=1.0) for seed in range(2)]
    dead = replace(made[1], torque=np.where(np.arange(6) == ELBOW, level, made[1].torque))
    sums, whole = (equations(Records(ARM, (made[0], one))) for one in (dead, made[1]))
    of_second = sums.records.owner == 1
    assert not np.any(sums.weights[of_second, ELBOW]) and np.any(whole.weights[of_second, ELBOW])
    others = np.arange(6) != ELBOW
    np.testing.assert_array_equal(sums.weights[:, others], whole.weights[:, others])
    np.testing.assert_array_equal(sums.weights[~of_second], whole.weights[~of_second])
    assert sums.residual_rms[ELBOW] == pytest.approx(1.0, rel=0.01)


def test_a_motion_that_comes_back_is_of_the_same_kind() -> None:
    once = np.random.default_rng(5).normal(size=(20, 6))
    kinds = kinds_of_motion(np.vstack([once, once + 1e-6]))
    assert np.mean(kinds[:20] == kinds[20:]) > 0.85
    assert sorted(np.unique(kinds)) == [0, 1, 2, 3, 4]
    assert np.max(np.bincount(kinds)) <= 8


def test_what_links_weigh_is_worked_out_once_whatever_tilts_are_tried() -> None:
    time, q, v, a = swing(4.0)
    level = equations(Records(ARM, (record(ARM, time, q, v, a),)))
    straight, around = level.on_base((0.1, 0.05)), level.on_base((-0.2, 0.3)).on_base((0.1, 0.05))
    assert straight.weight.per_axis is around.weight.per_axis
    size = np.max(np.abs(straight.columns))
    np.testing.assert_allclose(around.columns, straight.columns, atol=1e-12 * size)
    np.testing.assert_allclose(around.on_base((0.0, 0.0)).columns, level.columns, atol=1e-12 * size)
