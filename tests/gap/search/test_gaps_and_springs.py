"""Which gaps and springs are looked at closely, and which gears are worth offering: at both sides of each bound."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.candidates.test_records import at
from tests.gap.made import ARM, ELBOW, PAN, effect, record, swing, swinging, terms_of
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import backlash_gaps, gear_proposals
from twin_diagram.gap.search.backlash_gaps import GAPS, Knocks
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.gear_proposals import _rests, play_shapes, propose, spring_shapes
from twin_diagram.model.dynamics.backlash import play_alone

Array = npt.NDArray[np.float64]


def bench_of(sigma: Array | float = 1.0) -> Bench:
    count = len(swinging().records.residual)
    noise = Whitener(np.ones((6, 1)), np.ones(6) * sigma, (count,))
    return Bench(np.random.default_rng(0).normal(size=(count, 6)), noise, [], [])


def looked_at(scores: dict[int, Array], monkeypatch: pytest.MonkeyPatch) -> dict[int, list[int]]:
    """Which places on the grid of gaps are looked at closely, of joints whose gaps explain so much."""
    knocks = Knocks(swinging(), bench_of())
    monkeypatch.setattr(knocks, "_more", lambda j, Q, told: scores[j])
    found = knocks.gaps({j: [frozenset()] for j in scores})
    places = {}
    for j, gaps in found.items():
        near = np.array(gaps).reshape(-1, 3)
        np.testing.assert_allclose(near / near[:, [1]], np.tile([0.93, 1.0, 1.07], (len(near), 1)))
        places[j] = [int(np.argmin(np.abs(GAPS - gap))) for gap in near[:, 1]]
    return places


def peaks(**heights: float) -> Array:
    scores = np.zeros(22)
    for place, height in heights.items():
        scores[int(place[1:])] = height
    return scores


def test_gaps_that_explain_twelve_nats_and_a_share_of_the_best_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two best of a joint; fifteen per cent of the best of all joints."""
    assert looked_at({0: peaks(p3=12.1, p9=11.9)}, monkeypatch) == {0: [3]}
    assert looked_at({0: peaks(p3=30.0, p9=50.0, p15=40.0)}, monkeypatch) == {0: [9, 15]}
    found = looked_at({0: peaks(p5=1000.0), 1: peaks(p3=149.0, p9=151.0)}, monkeypatch)
    assert found == {0: [5], 1: [9]}
    assert looked_at({0: peaks(p0=50.0, p21=60.0)}, monkeypatch) == {0: [0, 21]}
    np.testing.assert_allclose(np.diff(np.log(GAPS)), np.log(0.035 / 0.0018) / 21.0)
    assert GAPS[0] == pytest.approx(0.0018) and len(GAPS) == 22


def test_what_a_gap_explains_is_beyond_its_rotor(monkeypatch: pytest.MonkeyPatch) -> None:
    knocks = Knocks(swinging(), bench_of())
    tried = [(SimpleNamespace(value=x), None) for x in (5.0, 9.0, 2.0)]
    monkeypatch.setattr(knocks, "_torques", lambda j: tried)
    monkeypatch.setattr(backlash_gaps, "score_candidate", lambda bench, c, Q, told, white: c.value)
    none: Any = None
    np.testing.assert_allclose(knocks._more(0, none, none), [4.0, -3.0])


def test_the_torque_of_play_is_the_loads_answer_to_the_motors_lag() -> None:
    terms = swinging()
    one = terms.records.records[0]
    model = ARM.with_effects([effect("reflected_inertia", ARM.joints, inertia=[2.0] * 6)])
    heavy = terms_of(Records(model, (record(model, one.time, one.q, one.v, one.a),)))
    for some in (terms, heavy):
        knocks = Knocks(some, bench_of())
        mass = ARM.tree.mass_matrix(one.q)
        np.testing.assert_allclose(knocks.masses[0], mass, atol=1e-9)
        np.testing.assert_allclose(knocks.loads[0], ARM.inverse_dynamics(one.q, one.v, one.a), atol=1e-9)
    tried = knocks._torques(PAN)
    assert len(tried) == 23
    candidate, _ = tried[10]
    gap = float(GAPS[9])
    load = knocks.loads[0]
    angle, _, acceleration = play_alone(mass[:, PAN, PAN], load[:, PAN], 0.5 * gap, 1.0 / one.rate)
    rows = list(candidate.rows)
    turned = np.array(one.q)
    turned[:, PAN] += 1e-3
    slope = (ARM.inverse_dynamics(turned, one.v, one.a) - load) / 1e-3
    wanted = one.reduce(mass[:, rows, PAN] * acceleration[:, None] + slope[:, rows] * angle[:, None])
    np.testing.assert_allclose(candidate.columns[..., 0], wanted, atol=1e-6)
    rate = one.reduce(one.a)[:, PAN]
    np.testing.assert_allclose(candidate.columns[:, rows.index(PAN), 1], rate)
    np.testing.assert_allclose(candidate.spread, [1.0, some.torque_size[PAN] / np.sqrt(np.mean(rate**2))])
    assert candidate.allows(np.full(2, 1e9)) and candidate.allows(np.full(2, -1e9))


@pytest.mark.parametrize(("share", "shown"), [(0.29, False), (0.31, True)])
def test_joints_that_show_little_of_a_knock_are_left_out(share: float, shown: bool) -> None:
    """Three tenths of what the best one shows, beside its noise."""
    one = swinging().records.records[0]
    mass = ARM.tree.mass_matrix(one.q)
    shows = np.sqrt(np.mean(mass[:, :, PAN] ** 2, axis=0))
    sigma = np.full(6, 1e6)
    sigma[PAN], sigma[ELBOW] = shows[PAN], shows[ELBOW] / share
    rows = Knocks(swinging(), bench_of(sigma))._torques(PAN)[0][0].rows
    assert rows == ((PAN, ELBOW) if shown else (PAN,))


def test_a_gear_whose_load_keeps_its_side_rests_on_it() -> None:
    knocks = Knocks(swinging(), bench_of())
    knocks.loads = [np.ones((5, 6)), np.ones((5, 6))]
    assert not knocks.turns(0)
    knocks.loads[1][2, 0] = -1.0
    assert knocks.turns(0) and not knocks.turns(1)


def test_springs_are_tried_by_how_their_links_would_swing() -> None:
    """Ten frequencies from 2.5 to 16 Hz with two losses; three of them with one that calms them."""
    model = ARM.with_effects([effect("reflected_inertia", ARM.joints, inertia=[2.0] * 6)])
    one = record(model, *swing(4.0))
    terms = terms_of(Records(model, (one,)))
    inertia = np.mean(ARM.tree.mass_matrix(one.q[::20])[:, PAN, PAN])
    shapes = [dict(shape.values) for shape in spring_shapes(terms, PAN)]
    swings = np.geomspace(2.5, 16.0, 10)
    wanted = [(f, loss) for f in swings for loss in (3e-3, 1.2e-2)] + [(f, 6e-2) for f in swings[[1, 4, 7]]]
    for shape, (f, loss) in zip(shapes, wanted, strict=True):
        assert shape["loss"] == loss
        assert np.sqrt(shape["stiffness"] / inertia) / (2.0 * np.pi) == pytest.approx(f, rel=1e-3)


def test_what_may_stand_beside_a_gear() -> None:
    bench: Any = SimpleNamespace(
        candidates=[at("reflected_inertia", 0), at("viscous_friction", 0), at("reflected_inertia", 1)]
    )
    members = frozenset({0, 1, 2})
    assert _rests(bench, members, 0) == [members, {1, 2}, {2}, {1}, frozenset()]
    assert _rests(bench, frozenset(), 0) == [frozenset()]


def test_play_is_asked_about_beside_what_is_on_its_own_joint() -> None:
    candidates = [at("reflected_inertia", 0), at("viscous_friction", 0), at("viscous_friction", 1)]
    bench: Any = SimpleNamespace(candidates=candidates, n=2)
    asked: dict[int, Any] = {}

    class Fake:
        def turns(self, j: int) -> bool:
            return j == 0

        def gaps(self, hypotheses: Any) -> dict[int, list[float]]:
            asked.update(hypotheses)
            return {0: [0.005]}

    knocks: Any = Fake()
    found = play_shapes(bench, frozenset({0, 1, 2}), [0, 1], knocks)
    assert {j: [shape.values[0][1] for shape in some] for j, some in found.items()} == {
        0: [0.005],
        1: [0.004, 0.01, 0.025],
    }
    assert asked == {0: [frozenset({0, 1, 2}), frozenset({1, 2}), frozenset({2}), frozenset()]}


def proposed(
    scores: dict[frozenset[int], float],
    monkeypatch: pytest.MonkeyPatch,
    evidence: dict[frozenset[int], float],
    members: frozenset[int] = frozenset({0}),
) -> bool:
    """Whether a gear is offered on a joint whose friction is named, where it scores so beside what may stand there."""
    made = replace(at("backlash"), cost=2.0)
    candidates = [at("viscous_friction", 0)]
    offered: list[int] = []

    def add(candidate: Any, offered_: bool = True, **more: bool) -> int:
        candidates.append(candidate)
        if more.get("offered", offered_):
            offered.append(len(candidates) - 1)
        return len(candidates) - 1

    bench: Any = SimpleNamespace(
        candidates=candidates,
        n=1,
        y=np.zeros((1, 3)),
        add=add,
        whiten=lambda candidate: candidate.columns,
        offered=SimpleNamespace(offer=offered.append),
        solve=lambda some: SimpleNamespace(evidence=evidence[frozenset(min(k, 1) for k in some)]),
    )
    monkeypatch.setattr(gear_proposals, "basis", lambda bench, rest: np.full((1, 3, 1), float(len(rest))))
    monkeypatch.setattr(
        gear_proposals, "play_shapes", lambda *arguments: {0: [gear_proposals.GearShape("backlash", 0, ())]}
    )
    monkeypatch.setattr(gear_proposals, "gear", lambda terms, shape, bare: made)
    monkeypatch.setattr(
        gear_proposals,
        "score_both",
        lambda bench, candidate, Q, told, white: (
            scores[frozenset({9})],
            scores[frozenset({0}) if Q[0, 0, 0] else frozenset()],
        ),
    )
    some: Any = None
    found = propose(bench, some, members, [], some)
    assert found == sorted(set(offered))
    return bool(found)


MEMBER, GEAR, BOTH = frozenset({0}), frozenset({1}), frozenset({0, 1})


@pytest.mark.parametrize(
    ("crowded", "beside", "alone", "there"),
    [
        (18.1, -1.0, 50.0, True),
        (17.9, -1.0, 50.0, False),
        (0.0, 110.1, 50.0, True),
        (0.0, 109.9, 50.0, False),
        (0.0, 50.0, 100.1, True),
        (0.0, 50.0, 99.9, False),
    ],
)
def test_a_gear_is_offered_where_it_is_worth_it(
    crowded: float, beside: float, alone: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten nats beyond its name's price and its own beside all; better than all and ten, or alone than any alone."""
    evidence = {MEMBER: 100.0, BOTH: beside, GEAR: alone, frozenset(): 0.0}
    assert proposed({frozenset({9}): crowded, MEMBER: 1.0, frozenset(): 1.0}, monkeypatch, evidence) == there
    assert not proposed({frozenset({9}): 0.0, MEMBER: -1.0, frozenset(): -1.0}, monkeypatch, evidence)
