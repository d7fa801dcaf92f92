"""A law for which part of a log does not count has no advantage from the noise that it need not explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gap.search.test_evidence import JOINTS, ROWS, candidate, white
from twin_diagram.gap.search.bench import TUNING, Bench, unheard_price
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.verdict.deciding import deaf


def taking(share: float, dropped: float = 0.0) -> tuple[Bench, float]:
    """A bench on which a candidate takes a share of pure noise for its own.

    Args:
        share: of the samples.
        dropped: share of the others that are not weighed.
    """
    rng = np.random.default_rng(5)
    y = rng.choice([-1.0, 1.0], (ROWS, JOINTS))  # of the same size everywhere
    unheard = (np.arange(ROWS) < share * ROWS).astype(float)
    weights = np.ones((JOINTS, ROWS))
    weights[0, ROWS - round(dropped * (1.0 - share) * ROWS) :] = 0.0
    own = replace(candidate("torque_saturation", 0, y[:, 0] * unheard), unheard=unheard)
    bench = Bench(y, white(), [own], [], weights)
    return bench, bench.solve(frozenset({0})).evidence


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_what_noise_brings_it_costs(share: float) -> None:
    bench, evidence = taking(share)
    assert bench.candidates[0].unheard_cost == pytest.approx(-0.5 * ROWS * np.log(1.0 - share))
    assert -PRIOR_COSTS.new_name - 8.0 < evidence < 0.0  # nothing but the price of its name and its one number
    assert evidence + bench.candidates[0].unheard_cost > 0.15 * ROWS * share


def test_only_what_is_weighed_counts() -> None:
    """Of an arm with friction, what is within a limit is where it turns, which is not weighed."""
    bench, evidence = taking(0.8, dropped=0.5)
    assert bench.candidates[0].unheard_cost == pytest.approx(-0.5 * 0.9 * ROWS * np.log(1.0 / 9.0), rel=1e-3)
    assert evidence < 0.0
    assert taking(0.8, dropped=0.9)[1] == -np.inf  # next to nothing is left that could speak against it


@pytest.mark.parametrize(
    ("share", "name", "joint", "expected"),
    [
        (0.6, "torque_constant", 0, True),
        (0.2, "torque_constant", 0, False),
        (0.6, "torque_constant", 1, False),
        (0.6, "coulomb_friction", 0, False),
    ],
    ids=["both", "mostly heard", "elsewhere", "usual"],
)
def test_a_pair_that_explains_whatever_was_logged_is_no_name(
    share: float, name: str, joint: int, expected: bool
) -> None:
    bench, _ = taking(share)
    other = bench.add(candidate(name, joint, np.random.default_rng(1).normal(size=ROWS)))
    assert deaf(bench, bench.solve(frozenset({0, other}))) is expected
    assert not deaf(bench, bench.solve(frozenset({0})))


def test_a_law_that_says_of_everything_that_it_was_not_so_cannot_be_told() -> None:
    heard = np.zeros(100)
    heard[: round(100 * TUNING.least_heard)] = 1.0
    assert unheard_price(heard) == pytest.approx(-50.0 * np.log(TUNING.least_heard))
    assert unheard_price(0.9 * heard) == np.inf and unheard_price(np.zeros(0)) == np.inf
    assert unheard_price(np.ones(7)) == 0.0
