"""The benchmark of effects on several joints: what it draws, how far apart that is, and how it counts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(CHECKOUT / "sims" / "benchmarks"))

import several_joints as bench  # noqa: E402
from gap_truth import cases, explanations, separation, several_joints  # noqa: E402


@pytest.fixture(scope="module")
def case() -> cases.Case:
    """Viscous friction on all joints, dry friction on three."""
    return cases.make_case("joints", 0, duration=4.0)


def test_viscous_friction_on_all_joints_and_dry_on_three(case: cases.Case) -> None:
    joints = {thing.name: thing.joints for thing in case.hidden}
    assert joints["viscous_friction"] == tuple(range(case.chain.n))
    assert len(joints["coulomb_friction"]) == 3
    again = cases.make_case("joints", 0, duration=4.0)
    assert [thing.values for thing in again.hidden] == [thing.values for thing in case.hidden]


def test_every_mixture_has_at_least_two_names_on_its_joints(case: cases.Case) -> None:
    scale = cases.Scale(*(np.ones(case.chain.n),) * 7)
    for seed in range(40):
        things = several_joints.draw(seed, case.chain, scale, np.random.default_rng(seed))
        assert len(things) == (3 if several_joints.MIXTURES[seed % 5] == "friction and another" else 2)
        assert len({thing.name for thing in things}) == len(things)
        for thing in things:
            (values,) = thing.values.values()
            assert len(values) == len(thing.joints) > 0


@pytest.mark.long
def test_modelled_separation_is_that_of_plain_least_squares(case: cases.Case) -> None:
    comparison = separation.Comparison(case)
    parts = comparison.modelled_parts()
    true = [
        (thing.name, place, comparison.columns(explanation))
        for thing in case.hidden
        for place, explanation in explanations.of_truth(comparison.setting, thing)
    ]
    whole = np.hstack([columns for *_, columns in true])
    modelled = whole @ np.linalg.lstsq(whole, comparison.target, rcond=None)[0]
    for k, (name, place, _) in enumerate(true):
        others = np.hstack([columns for i, (*_, columns) in enumerate(true) if i != k])
        left = modelled - others @ np.linalg.lstsq(others, modelled, rcond=None)[0]
        assert (parts[k].name, parts[k].place) == (name, place)
        assert parts[k].strength == pytest.approx(float(np.linalg.norm(left)), rel=1e-5, abs=1e-3)
        assert parts[k].separation <= parts[k].strength


def answer(verdict: str, effects: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "verdict": verdict,
        "remainder": False,
        "effects": effects,
        "gap": {"torque_rms": {"fit": {}, "holdout": {}, "noise_floor": {}}},
    }


def effect(joints: list[str], sure: float, *others: float) -> dict[str, Any]:
    return {
        "name": "viscous_friction",
        "joints": joints,
        "links": [],
        "parameters": {"damping": {j: {"value": 2.2, "std": 0.1, "unit": ""} for j in joints}},
        "confidence": sure,
        "alternatives": [{"name": "torque_bias", "joints": ["a"], "probability": p} for p in others],
        "onset": None,
        "end": None,
    }


TRUTH = {
    "outside": False,
    "kind": "joints",
    "effects": [
        {"name": "viscous_friction", "joints": ["a", "b"], "links": [], "parameters": {"damping": {"a": 2.0, "b": 2.3}}}
    ],
}


def test_a_set_is_right_wrong_or_unknown() -> None:
    assert bench.scored(answer("named", [effect(["a", "b"], 0.9)]), TRUTH)["set"] == "right"
    assert bench.scored(answer("named", [effect(["a"], 0.9)]), TRUTH)["set"] == "wrong"
    assert bench.scored(answer("unknown", []), TRUTH)["set"] == "unknown"


def test_probabilities_that_break_the_rules_are_counted() -> None:
    broken = bench.scored(answer("named", [effect(["a", "b"], 0.3, 0.5, 0.4)]), TRUTH)
    assert (broken["above"], broken["over"], broken["guess"]) == (1, 1, 1)
    sound = bench.scored(answer("named", [effect(["a", "b"], 0.6, 0.4)]), TRUTH)
    assert (sound["above"], sound["over"], sound["guess"]) == (0, 0, 0)
    assert [z for *_, z in sound["z"]] == pytest.approx([2.0, -1.0])


def test_the_table_counts_what_is_far_enough_apart() -> None:
    record = {"seed": 1, "arm": "panda", "mixture": "a pair", "separation": 9.0, "truth": {}}
    record |= bench.scored(answer("named", [effect(["a", "b"], 0.9, 0.05)]), TRUTH)
    near = {"seed": 2, "arm": "panda", "mixture": "a pair", "separation": 7.9, "truth": {}}
    text = bench.table([record | {"again": {"verdict": "none"}}, near])
    assert "1 cases at least 8 apart (1 drawn ones were nearer): right 1, wrong 0, unknown 0, failed 0" in text
    assert "second run: none 1 of 1" in text
    assert "0.500 beyond 1" in text
