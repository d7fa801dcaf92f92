"""A parameter's standard error holds what else may be there: the law of total variance over hypotheses."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests import gap_bench
from tests.gap.search.test_evidence import JOINTS, ROWS, candidate, white
from twin_diagram.gap.candidates.candidate import linear
from twin_diagram.gap.correction.add_effects import add
from twin_diagram.gap.findings import Estimate
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.verdict.posterior import doubt_of, parameters_of
from twin_diagram.model.model import Model


def correlated(seed: int, damping: float) -> Bench:
    """Dry friction of 0.5 beside viscous friction, whose columns go together, on one joint."""
    rng = np.random.default_rng(seed)
    dry = rng.normal(size=ROWS)
    viscous = 0.9 * dry + 0.436 * rng.normal(size=ROWS)
    y = rng.normal(size=(ROWS, JOINTS))
    y[:, 0] += 0.5 * dry + damping * viscous
    offered = [
        candidate("coulomb_friction", 0, dry),
        replace(candidate("viscous_friction", 0, viscous), parameters=linear("damping")),
    ]
    return Bench(y, white(), offered, [])


def test_total_variance_over_two_hypotheses() -> None:
    bench = correlated(0, 0.2)
    alone, both = bench.solve(frozenset({0})), bench.solve(frozenset({0, 1}))
    (a, A), (b, B) = bench.part(alone, 0), bench.part(both, 0)
    doubt = doubt_of(bench, alone, 0, [(alone, 0.6), (both, 0.3), (bench.solve(frozenset({1})), 0.1)])
    # Of the third nothing: it does not hold the parameter.
    expected = np.sqrt(0.3 / 0.9 * ((b - a) ** 2 + B[0, 0] - A[0, 0]))
    assert doubt["torque"] == pytest.approx(expected)
    assert doubt_of(bench, alone, 0, [(alone, 1.0)])["torque"] == pytest.approx([0.0])
    records = cast(Any, SimpleNamespace(model=SimpleNamespace(joints=tuple("abc"), prismatic=frozenset())))
    told = parameters_of(records, bench, alone, [0], [(alone, 0.6), (both, 0.3)])["torque"]
    assert isinstance(told, dict)
    assert told["a"].std == pytest.approx(float(np.hypot(np.sqrt(A[0, 0]), expected[0])))
    assert told["a"].doubt == pytest.approx(float(expected[0]))


def test_errors_that_leave_something_out_are_covered() -> None:
    with_doubt, without = [], []
    for seed in range(60):
        bench = correlated(seed, 0.15)
        alone, both = bench.solve(frozenset({0})), bench.solve(frozenset({0, 1}))
        value, covariance = bench.part(alone, 0)
        std = float(np.sqrt(covariance[0, 0]))
        doubt = float(doubt_of(bench, alone, 0, [(alone, 0.5), (both, 0.5)])["torque"][0])
        without.append((value[0] - 0.5) / std)
        with_doubt.append((value[0] - 0.5) / np.hypot(std, doubt))
    assert np.sqrt(np.mean(np.square(without))) > 3.0
    assert np.sqrt(np.mean(np.square(with_doubt))) < 2.2


@pytest.mark.long
def test_refined_parameters_keep_their_doubt(tmp_path: Any) -> None:
    given = Model.load(gap_bench.arm(tmp_path))
    log = gap_bench.run(given, [gap_bench.dry(3.0)], seed=3)
    stds = []
    for doubt in (0.0, 0.4):
        rough = {"torque": {"elbow": Estimate(2.9, 0.4, "N·m", doubt)}}
        told = add(given, [log], [gap_bench.friction_finding(parameters=rough)]).findings[0].parameters["torque"]
        assert isinstance(told, dict)
        assert told["elbow"].value == pytest.approx(3.0, abs=0.1)
        stds.append(float(np.asarray(told["elbow"].std)))
    assert stds[0] < 0.1
    assert stds[1] == pytest.approx(float(np.hypot(stds[0], 0.4)), rel=1e-3)
