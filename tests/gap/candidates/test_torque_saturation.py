"""A limit of a motor is offered where torque is plainly beyond it, was not needed, and is not always beyond it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.torque_saturation import on_joints, rebuilt, saturation, shapes
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.bench import Bench

Array = npt.NDArray[np.float64]
N = 1000


def terms_of(
    beyond: float = 0.3,
    noise: float = 0.1,
    unexplained: tuple[float, float] = (0.0, 0.0),
    unneeded: float = 1.0,
    low: float = 1.0,
    limit: float = 6.0,
) -> Any:
    """A joint that asks for ±10 N·m a share of the time and for ±`low` else."""
    tau = np.where(np.arange(N) < beyond * N, 10.0, low) * np.where(np.arange(N) % 2, 1.0, -1.0)
    over = tau - np.clip(tau, -limit, limit)
    return SimpleNamespace(
        asked_torque=(tau[:400, None], tau[400:, None]),
        torque_noise=np.array([noise]),
        unexplained=lambda j, limit=np.inf: unexplained[0] if np.isinf(limit) else unexplained[1],
        unneeded=unneeded * over[:, None],
        reduce=np.concatenate,
        torque_size=np.array([7.0]),
        records=SimpleNamespace(n=1),
    )


def offered(limit: float = 6.0, **made: Any) -> Candidate | None:
    return saturation(terms_of(limit=limit, **made), 0, limit)


def test_torque_beyond_a_limit_is_what_was_logged_and_not_given() -> None:
    candidate = offered()
    assert candidate is not None
    tau = np.concatenate(terms_of().asked_torque)[:, 0]
    np.testing.assert_allclose(candidate.columns[:, 0, 0], np.sign(tau) * np.maximum(np.abs(tau) - 6.0, 0.0))
    assert candidate.shape == {"limit": 6.0}
    for share, inside in ((0.74, False), (0.76, True), (1.24, True), (1.26, False)):
        assert candidate.allows(np.array([share])) == inside
    assert candidate.parameters(np.ones(1), np.eye(1))["limit"][0] == [6.0]
    assert shapes(terms_of(), candidate) == [("limit", 0.9, 1.1)]
    again = rebuilt(terms_of(limit=5.0), candidate, "limit", 5.0)
    assert again is not None and again.shape == {"limit": 5.0}


def test_samples_beyond_a_limit_fit_for_nothing() -> None:
    """They are told, for the bench to charge their part of the log likelihood; the search is among some five limits."""
    terms = terms_of(beyond=0.3)
    candidate = saturation(terms, 0, 6.0)
    assert candidate is not None and candidate.unheard is not None
    np.testing.assert_array_equal(candidate.unheard, np.arange(N) < 0.3 * N)
    assert candidate.cost == pytest.approx(np.log(5.0)) and candidate.unheard_cost == 0.0
    noise = Whitener(np.ones((1, 1)), np.ones(1), (N,))
    bench = Bench(np.random.default_rng(0).normal(size=(N, 1)), noise, [candidate], [])
    assert bench.candidates[0].price == pytest.approx(-0.5 * N * np.log(0.7) + np.log(5.0))
    # Filters that reduce a log overshoot at steps; no sample counts more than once, or against.
    terms.reduce = lambda logs: 1.1 * np.concatenate(logs) - 0.05
    stepped = saturation(terms, 0, 6.0)
    assert stepped is not None and stepped.unheard is not None
    np.testing.assert_array_equal(stepped.unheard, candidate.unheard)


@pytest.mark.parametrize(("share", "there"), [(0.0, False), (0.955, True), (0.965, False), (1.0, False)])
def test_a_torque_that_is_always_beyond_a_limit_shows_none(share: float, there: bool) -> None:
    assert (offered(beyond=share) is not None) == there


@pytest.mark.parametrize(("limit", "there"), [(0.59, False), (0.61, True)])
def test_a_limit_is_no_small_share_of_the_largest_torque(limit: float, there: bool) -> None:
    assert (offered(limit=limit, low=0.1) is not None) == there


@pytest.mark.parametrize(("times", "there"), [(2.9, False), (3.1, True)])
@pytest.mark.parametrize("where", ["noise", "both"])
def test_torque_beyond_a_limit_is_above_the_noise(times: float, there: bool, where: str) -> None:
    """The smaller of what is left with the limit and without it counts as noise."""
    noise = 4.0 / times
    made = {"noise": noise} if where == "noise" else {"noise": 0.0, "unexplained": (noise, 2.0 * noise)}
    assert (offered(**made) is not None) == there
    assert offered(noise=0.0, unexplained=(9.0, 0.1)) is not None
    assert offered(noise=0.0, unexplained=(0.1, 9.0)) is not None


@pytest.mark.parametrize(("times", "price"), [(5.9, 40.0), (6.1, 0.0)])
def test_what_is_not_plainly_beyond_a_limit_has_its_price(times: float, price: float) -> None:
    candidate, plain = offered(noise=4.0 / times), offered()
    assert candidate is not None and plain is not None
    assert candidate.cost - plain.cost == pytest.approx(price)


@pytest.mark.parametrize(("share", "there"), [(0.49, False), (0.51, True)])
def test_what_the_motion_needed_was_given(share: float, there: bool) -> None:
    assert (offered(unneeded=share) is not None) == there


def test_limits_that_are_tried_leave_no_gap() -> None:
    """Of a torque that is as often at any size: down to a twentieth of the largest, and none beyond it."""
    tau = np.linspace(-20.0, 20.0, 2001)
    over = np.sign(tau) * np.abs(tau)
    terms = SimpleNamespace(
        asked_torque=(tau[:, None],),
        torque_noise=np.array([1e-3]),
        unexplained=lambda j, limit=np.inf: 0.0,
        unneeded=over[:, None],
        reduce=np.concatenate,
        torque_size=np.array([7.0]),
        records=SimpleNamespace(n=1),
    )
    limits = np.array([c.shape["limit"] for c in on_joints(terms)[0]])  # type: ignore[arg-type]
    quantiles = [0.99, 0.97, 0.95, 0.92, 0.88, 0.83, 0.77, 0.7, 0.62, 0.53, 0.44, 0.35, 0.27, 0.2, 0.14, 0.09]
    peaks = [0.95, 0.9, 0.84, 0.78, 0.72, 0.66, 0.6, 0.54]
    np.testing.assert_allclose(limits / 20.0, quantiles + peaks, atol=1e-3)
