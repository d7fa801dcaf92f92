"""What is held while a joint sticks refutes Coulomb's law only beyond what noise and the low-pass make of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, effect, record, swing, swinging, terms_of
from twin_diagram.gap.candidates import coulomb_friction, load_dependent_friction, stribeck_friction
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import stiction_proposals
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.stiction_proposals import beyond, dwells, inner, peaks_of, propose, short_holds

Array = npt.NDArray[np.float64]

TERMS: Any = SimpleNamespace(records=None)
FIT: Any = None


def bench_of(friction: Array, noise: float) -> Any:
    """Twenty samples of motion with just this noise, then friction as a joint has it while it sticks."""
    whole = np.concatenate([noise * np.resize([1.0, -1.0], 20), friction])
    return SimpleNamespace(
        candidates=[SimpleNamespace(joints=(0,), rows=(0,), columns=np.ones((len(whole), 1, 1)))],
        whitener=SimpleNamespace(rows=np.arange(len(whole))),
        weights=np.concatenate([np.ones(20), np.zeros(len(friction))])[None],
        part=lambda fit, k: (np.array([7.0]), None),
        left=lambda fit: np.concatenate([whole[:20], whole[20:] - 7.0])[:, None],
    )


def rise_beyond(
    friction: list[float],
    level: float,
    noise: float,
    monkeypatch: pytest.MonkeyPatch,
    slid: float = 0.0,
    held: float = 1.0,
) -> tuple[float, float] | None:
    values = np.array(friction)
    reach = (
        np.concatenate([np.zeros(20), np.full(len(values), slid)]),
        np.concatenate([np.zeros(20), np.full(len(values), held)]),
    )
    monkeypatch.setattr(stiction, "reach", lambda *arguments: reach)
    return beyond(bench_of(values, noise), TERMS, FIT, 0, level)


@pytest.mark.parametrize(
    ("friction", "level", "there"),
    [
        ([124.9] * 9, 100.0, False),
        ([125.1] * 9, 100.0, True),
        ([-125.1] * 9, 100.0, True),
        ([3.45] * 9, 1.0, False),
        ([3.55] * 9, 1.0, True),
        ([9.0] * 2 + [0.0] * 4, 1.0, False),
        ([9.0] * 3 + [0.0] * 4, 1.0, True),
        ([3.6] * 3 + [0.0] * 8, 1.0, True),
        ([3.6] * 3 + [0.0] * 9, 1.0, False),
    ],
)
def test_friction_beyond_what_coulombs_law_could_hold(
    friction: list[float], level: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter more than the level, 2.5 deviations of the noise, three samples of it, three nats: each must be."""
    assert (rise_beyond(friction, level, 1.0, monkeypatch) is not None) == there


def test_evidence_of_a_hold_is_what_it_exceeds_less_what_noise_would(monkeypatch: pytest.MonkeyPatch) -> None:
    friction = [12.0, -11.0, 10.0, 9.0, 1.0, -0.5]
    found = rise_beyond(friction, 2.0, 0.5, monkeypatch)
    over = np.array([10.0, 9.0, 8.0, 7.0]) / 0.5
    assert found is not None
    assert found[0] == 10.0, "the third largest"
    assert found[1] == pytest.approx((0.5 * np.sum(over**2) - 0.375 * 6) / 2.0)
    mixed = rise_beyond(friction, 2.0, 0.5, monkeypatch, slid=0.5, held=0.9)
    most = 2.0 * np.array([1.4, 1.0, 1.4, 1.4])
    over = (np.array([12.0, 11.0, 10.0, 9.0]) - most) / 0.5
    assert mixed is not None and mixed[1] == pytest.approx((0.5 * np.sum(over**2) - 0.375 * 6) / 2.0)
    assert rise_beyond(friction, 2.0, 0.5, monkeypatch, held=0.049) is None
    assert rise_beyond(friction, 2.0, 0.5, monkeypatch, held=0.051) is not None


def rests(held: float, lengths: list[int], noise: float, monkeypatch: pytest.MonkeyPatch) -> tuple[float, float] | None:
    parts, stuck = [np.zeros(3)], [np.zeros(23, dtype=bool)]
    for k, length in enumerate(lengths):
        parts += [np.full(length + 4, held * (-1.0) ** k), np.zeros(5)]
        stuck += [np.ones(length + 4, dtype=bool), np.zeros(5, dtype=bool)]
    monkeypatch.setattr(stiction, "stuck", lambda *arguments: np.concatenate(stuck))
    return dwells(bench_of(np.concatenate(parts), noise), TERMS, FIT, 0, 1.0)


@pytest.mark.parametrize(
    ("held", "lengths", "noise", "there"),
    [
        (1.14, [10] * 5, 0.01, False),
        (1.16, [10] * 5, 0.01, True),
        (2.0, [10] * 2, 0.01, False),
        (2.0, [10] * 3, 0.01, True),
        (2.0, [10, 10, 5], 0.01, False),
        (2.0, [10, 10, 6], 0.01, True),
        (2.0, [20] * 5, 1.0 / (2.9 * np.sqrt(2.0 / 100.0)), False),
        (2.0, [20] * 5, 1.0 / (3.1 * np.sqrt(2.0 / 100.0)), True),
    ],
)
def test_whole_rests_that_hold_more_on_average(
    held: float, lengths: list[int], noise: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By 15 per cent and three standard errors, in three rests of six samples without the two at each end."""
    found = rests(held, lengths, noise, monkeypatch)
    assert (found is not None) == there
    if found is not None:
        error = noise * np.sqrt(2.0 * np.mean(1.0 / np.array(lengths)) / len(lengths))
        assert found == (pytest.approx(held), pytest.approx(0.5 * ((held - 1.0) / error) ** 2))


def test_the_level_at_rest_is_what_few_rests_exceed(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = np.linspace(1.5, 2.5, 11)
    friction = np.concatenate([np.concatenate([np.full(12, x), np.zeros(4)]) for x in levels])
    stuck = np.concatenate([np.zeros(20, dtype=bool), np.tile(np.arange(16) < 12, 11)])
    monkeypatch.setattr(stiction, "stuck", lambda *arguments: stuck)
    found = dwells(bench_of(friction, 0.1), TERMS, FIT, 0, 1.0)
    assert found is not None and found[0] == pytest.approx(2.4)


@pytest.mark.parametrize(
    ("peaks", "level", "noise", "there"),
    [
        (np.resize([2.0, 2.2], 7), 1.0, 0.0, False),
        (np.resize([2.0, 2.2], 8), 1.0, 0.0, True),
        (np.resize([1.3, 1.38], 16), 1.0, 0.0, False),
        (np.resize([1.3, 1.42], 16), 1.0, 0.0, True),
        (np.resize([0.9, 3.0], 16), 0.5, 0.3, True),
        (np.resize([-0.03, 3.0], 16), 0.5, 0.4, False),
    ],
)
def test_peaks_about_short_sticks(
    peaks: Array, level: float, noise: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight of them, a quarter of the level and four standard errors above the low-pass's overshoot and noise."""
    monkeypatch.setattr(stiction, "stuck", lambda *arguments: None)
    monkeypatch.setattr(stiction_proposals, "peaks_of", lambda friction, stuck: peaks)
    found = short_holds(bench_of(np.zeros(4), noise), TERMS, FIT, 0, level)
    rise = peaks - 1.1 * level - 0.85 * noise
    error = np.std(rise) / np.sqrt(len(rise))
    expected = len(rise) >= 8 and np.mean(rise) >= max(0.25 * level, 4.0 * error)
    assert (found is not None) == there == expected
    if found is not None:
        assert found[0] == pytest.approx(np.median(peaks) / 1.1)
        assert found[1] == pytest.approx(0.5 * (np.mean(rise) / error) ** 2)


def test_peaks_four_standard_errors_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiction, "stuck", lambda *arguments: None)
    for errors, there in ((3.9, False), (4.1, True)):
        rise = np.resize([1.0, -1.0], 16) + errors / 4.0
        monkeypatch.setattr(stiction_proposals, "peaks_of", lambda friction, stuck, rise=rise: rise + 1.1 + 0.85 * 0.5)
        assert (short_holds(bench_of(np.zeros(4), 0.5), TERMS, FIT, 0, 1.0) is not None) == there


@pytest.mark.parametrize(("length", "brief"), [(8, True), (9, False)])
def test_a_short_stick_lasts_eight_samples(length: int, brief: bool) -> None:
    friction = np.concatenate([np.full(6, -2.0), np.linspace(-3.0, 4.0, length), np.full(6, 2.0)])
    stuck = np.zeros(len(friction), dtype=bool)
    stuck[6 : 6 + length] = True
    found = peaks_of(friction, stuck)
    assert len(found) == (2 if brief else 0)
    if brief:
        np.testing.assert_allclose(found, [3.0, 4.0])


def test_directions_are_told_by_three_samples_on_each_side() -> None:
    friction = np.array([9.0, -2.0, -2.0, 1.0, -3.0, 3.5, 2.0, -1.0, 2.0, -9.0])
    stuck = np.zeros(10, dtype=bool)
    stuck[4:6] = True
    np.testing.assert_allclose(peaks_of(friction, stuck), [3.0, 3.5])


def test_ends_of_holds_are_left_out() -> None:
    stuck = np.array([0, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1, 1], dtype=bool)
    wanted = np.zeros(19, dtype=bool)
    wanted[[3, 4]] = True
    wanted[[16, 17, 18]] = True
    np.testing.assert_array_equal(inner(stuck), wanted)
    assert stuck[1], "what was given stays as it was"


def offered(
    monkeypatch: pytest.MonkeyPatch,
    rises: tuple[tuple[float, float] | None, ...],
    members: frozenset[int] = frozenset({0}),
    size: float = 2.0,
    dry: bool = False,
) -> tuple[Bench, list[int]]:
    """What is proposed for an elbow with Coulomb friction of that size, where holds say such things."""
    terms = swinging()
    if dry:
        model = ARM.with_effects([effect("coulomb_friction", [ARM.joints[ELBOW]], torque=1.0)])
        terms = terms_of(Records(model, (record(model, *swing(2.0)),)))
    candidates = [
        coulomb_friction.on_joints(terms)[ELBOW][0],
        stribeck_friction.on_joints(terms)[ELBOW][3],
        load_dependent_friction.on_joints(terms)[ELBOW][0],
        coulomb_friction.on_joints(terms)[ELBOW][1],
    ]
    count = len(terms.records.residual)
    residual = 0.1 * np.random.default_rng(0).normal(size=(count, 6))
    residual[:, ELBOW] += size * candidates[0].columns[:, 0, 0]
    bench = Bench(residual, Whitener(np.ones((6, 1)), np.full(6, 0.1), (count,)), candidates, [])
    for which, rise in zip(("beyond", "dwells", "short_holds"), rises, strict=True):
        monkeypatch.setattr(stiction_proposals, which, lambda *arguments, rise=rise: rise)
    return bench, propose(bench, terms, bench.solve(members))


def test_a_hold_offers_coulombs_torque_under_stribecks_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worth the nats of what says most of it, at most sixty."""
    bench, (k,) = offered(monkeypatch, ((3.0, 10.0), (5.0, 20.0), None))
    made = bench.candidates[k]
    assert made.name == "stribeck_friction" and made.variant == "held" and made.cost == -20.0 and k in bench.offered
    values = {key: value[0] for key, (value, _) in made.parameters(np.array([2.0]), np.eye(1)).items()}
    assert values["coulomb"] == 2.0 and values["static"] == pytest.approx(5.0, rel=0.05)
    assert values["stribeck_velocity"] == 0.05
    np.testing.assert_array_equal(made.columns, bench.candidates[0].columns)
    bench, (k,) = offered(monkeypatch, ((3.0, 61.0), None, None))
    assert bench.candidates[k].cost == -60.0
    assert made.allows(np.array([0.0])) and not made.allows(np.array([-1e-9]))


def test_stribecks_law_that_was_found_is_the_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, (k,) = offered(monkeypatch, (None, None, (3.0, 7.0)), frozenset({1}))
    assert bench.candidates[k].cost == pytest.approx(bench.candidates[1].cost - 7.0)
    assert bench.candidates[k].variant == "held" and bench.candidates[k].size == 2


def test_nothing_is_offered_where_nothing_was_held_or_other_friction_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    rise = (3.0, 30.0), None, None
    assert offered(monkeypatch, (None, None, None))[1] == []
    assert offered(monkeypatch, rise, frozenset({0, 2}))[1] == []
    assert offered(monkeypatch, rise, frozenset({3}))[1] == [], "of two levels, none is the sliding one"
    assert offered(monkeypatch, rise, size=-2.0)[1] == []
    assert offered(monkeypatch, rise, dry=True)[1] == []
    assert offered(monkeypatch, rise, frozenset())[1] == []
