"""Steps of naming on benches whose fits are known: doubts, suspects, and members that bring too little."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.candidates.test_records import at
from tests.gap.made import ELBOW, PAN, swinging
from twin_diagram.gap import naming
from twin_diagram.gap.candidates import torque_bias, viscous_friction
from twin_diagram.gap.naming import contribution_of, pruned, suspects, trusted, uneven
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.bench import Bench


class Table:
    def __init__(self, values: dict[frozenset[int], float], name: str) -> None:
        self.values, self.candidates = values, [at(name, joint) for joint in range(3)]

    def solve(self, members: frozenset[int]) -> Any:
        return SimpleNamespace(members=members, evidence=self.values[members])


@pytest.mark.parametrize("name", ["torque_bias", "viscous_friction"])
@pytest.mark.parametrize(("brings", "kept"), [(5.9, {1}), (6.1, {0, 1})])
def test_members_that_bring_less_than_six_nats_go(brings: float, kept: set[int], name: str) -> None:
    values = {frozenset(): 0.0, frozenset({0}): 50.0, frozenset({1}): 90.0, frozenset({0, 1}): 90.0 + brings}
    bench: Any = Table(values, name)
    assert pruned(bench, bench.solve(frozenset({0, 1}))).members == kept
    values[frozenset({0})] = values[frozenset({1})] = -np.inf
    assert pruned(bench, bench.solve(frozenset({0, 1}))).members == {0, 1}


@pytest.mark.parametrize(("name", "least"), [("torque_bias", 6.0), ("viscous_friction", 3.0)])
@pytest.mark.parametrize("more", [-0.1, 0.1])
def test_of_a_usual_name_the_third_joint_must_bring_half(name: str, least: float, more: float) -> None:
    gains = (50.0, 90.0, least + more)
    sets = [frozenset(some) for size in range(4) for some in itertools.combinations(range(3), size)]
    bench: Any = Table({some: sum(gains[k] for k in some) for some in sets}, name)
    assert pruned(bench, bench.solve(frozenset({0, 1, 2}))).members == ({0, 1, 2} if more > 0.0 else {0, 1})


def bench() -> Bench:
    terms = swinging()
    count = len(terms.records.residual)
    candidates = [viscous_friction.on_joints(terms)[ELBOW][0], torque_bias.on_joints(terms)[PAN][0]]
    residual = 0.1 * np.random.default_rng(0).normal(size=(count, 6))
    residual[:, ELBOW] += 5.0 * candidates[0].columns[:, 0, 0]
    residual[:, PAN] += 3.0
    return Bench(residual, Whitener(np.ones((6, 1)), np.full(6, 0.1), (count,)), candidates, [])


def test_what_a_fit_adds_is_the_sum_of_its_names() -> None:
    some = bench()
    fit = some.solve(frozenset({0, 1}))
    whole = contribution_of(swinging().records, some, fit)
    np.testing.assert_allclose(whole, (some.left(some.solve(frozenset())) - some.left(fit)), atol=1e-9)
    part = contribution_of(swinging().records, some, fit, without={"viscous_friction"})
    assert not np.any(part[:, ELBOW]) and np.allclose(part[:, PAN], whole[:, PAN])


def test_where_much_was_named_no_law_is_exact() -> None:
    """Three per cent of it, over three tenths of a second, beside the noise."""
    some, terms = bench(), swinging()
    fit = some.solve(frozenset({0, 1}))
    found = trusted(terms.records, some, fit)
    level = fit.coefficients[1] / 0.1
    np.testing.assert_allclose(found[PAN], 1.0 / np.sqrt(1.0 + (0.03 * level) ** 2), rtol=1e-9)
    np.testing.assert_array_equal(found[1], 1.0)
    white = contribution_of(terms.records, some, fit)[:, ELBOW] / 0.1
    width = round(0.3 * terms.records.rate)
    around = np.pad(white**2, (width // 2, (width - 1) // 2), mode="symmetric")
    mean = np.convolve(around, np.ones(width) / width, "valid")
    np.testing.assert_allclose(found[ELBOW], 1.0 / np.sqrt(1.0 + 0.03**2 * mean), rtol=1e-6)


def asked(
    left: list[float], candidates: list[Any], monkeypatch: pytest.MonkeyPatch, late: list[int] | None = None
) -> list[int]:
    statistic = SimpleNamespace(joints=np.array(left))
    monkeypatch.setattr(naming.leftover_structure, "left_over", lambda *arguments: statistic)
    monkeypatch.setattr(naming, "uneven", lambda bench, fit, k: late or [])
    some: Any = SimpleNamespace(candidates=candidates, solve=lambda members: None)
    records: Any = SimpleNamespace(n=len(left))
    terms: Any = None
    return suspects(records, terms, some, frozenset(range(len(candidates))))


def test_joints_with_most_structure_are_suspects_and_those_beside_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked([0.0, 2.9, 0.0, 0.0, 0.0, 0.0], [], monkeypatch) == []
    assert asked([0.0, 3.1, 0.0, 0.0, 0.0, 0.0], [], monkeypatch) == [1, 2, 0]
    assert asked([0.0, 0.0, 0.0, 0.0, 0.0, 3.1], [], monkeypatch) == [5, 4]
    assert asked([9.0, 0.0, 0.0, 0.0, 0.0, 3.1], [], monkeypatch) == [0, 5, 1]
    assert asked([9.0, 8.0, 7.0, 6.0, 5.0, 4.0], [], monkeypatch) == [0, 1, 2, 3]
    swung = [at("reflected_inertia", 4), at("viscous_friction", 3)]
    assert asked([0.0, 3.1, 0.0, 0.0, 0.0, 0.0], swung, monkeypatch) == [1, 4, 2, 0]
    assert asked([0.0] * 6, [at("time_delay", 0)], monkeypatch, [3, 2]) == [3, 2]


@pytest.mark.parametrize("joint", [1, 3])
@pytest.mark.parametrize(("errors", "told"), [(1.8, False), (2.2, True)])
def test_a_joint_is_uneven_by_two_standard_errors(joint: int, errors: float, told: bool) -> None:
    terms = swinging()
    count = len(terms.records.residual)
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(count, 6, 1))
    late = replace(at("time_delay", 0), rows=tuple(range(6)), columns=columns, spread=np.array([1e6]))
    size = np.sum(columns[..., 0] ** 2, axis=0) / 0.01
    residual = columns[..., 0] * 2.0
    noise = Whitener(np.ones((6, 1)), np.full(6, 0.1), (count,))
    others = np.sum(size) - size[joint]
    residual[:, joint] += columns[:, joint, 0] * errors * np.sqrt(1.0 / size[joint] + 1.0 / others)
    some = Bench(residual, noise, [late], [])
    fit = some.solve(frozenset({0}))
    level: Any = SimpleNamespace(members=fit.members, variance=np.ones(6), evidence=0.0)
    assert (joint in uneven(some, level, 0)) == told
    assert uneven(some, level, 0)[:1] == ([joint] if told else [])
