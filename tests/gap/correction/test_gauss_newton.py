"""Non-linear least squares ends at the least, and claims errors that are its scatter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from twin_diagram.gap.correction.equation_error import TUNING, blocks
from twin_diagram.gap.correction.gauss_newton import minimise

Array = npt.NDArray[np.float64]

FREE = np.zeros(2), np.full(2, np.inf)
STEPS = np.full(2, 1e-6)


def curve(y: Array) -> object:
    x = np.linspace(0.0, 2.0, len(y))
    return lambda p: p[0] * np.exp(-p[1] * x) - y


def test_it_ends_where_the_cost_is_least() -> None:
    y = np.random.default_rng(0).normal(size=80)
    residual = curve(y + 3.0 * np.exp(-0.7 * np.linspace(0.0, 2.0, 80)))
    wanted = least_squares(residual, [2.0, 0.5])  # type: ignore[arg-type]
    found = minimise(residual, np.array([2.0, 0.5]), STEPS, np.arange(80), FREE, rounds=30)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.vector, wanted.x, atol=2e-3)
    assert found.cost == pytest.approx(wanted.cost, rel=1e-6)
    own = np.linalg.inv(wanted.jac.T @ wanted.jac)
    each = wanted.jac * wanted.fun[:, None]
    sandwich = own @ each.T @ each @ own
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(own), 1.0))
    np.testing.assert_allclose(found.covariance, own * np.outer(ratio, ratio), rtol=0.03)


@pytest.mark.parametrize("worth", [True, False])
def test_where_more_is_not_worth_it_one_step_is_made(worth: bool) -> None:
    """Told by the errors at the start; what is stepped to keeps them."""
    asked: list[Array] = []
    tried: list[Array] = []

    def residual(p: Array) -> Array:
        tried.append(p)
        return np.asarray(curve(3.0 * np.exp(-0.7 * np.linspace(0.0, 2.0, 80)) + 0.1)(p))  # type: ignore[operator]

    def told(covariance: Array) -> bool:
        asked.append(covariance)
        return worth

    start = np.array([2.0, 0.5])
    found = minimise(residual, start, STEPS, np.arange(80), FREE, worth=told)
    assert len(asked) == 1 and np.all(np.diag(asked[0]) > 0.0)
    assert (len(tried) == 4) == (not worth), "the start, both slopes, and where they lead"
    assert (found.cost < 1e-3 + 0.5 * float(residual(start) @ residual(start))) and np.any(found.vector != start)


def test_priors_count_like_further_residuals() -> None:
    rng = np.random.default_rng(1)
    X, y = rng.normal(size=(40, 2)), rng.normal(size=40)
    mean, spread = np.array([2.0, -1.0]), np.array([0.1, np.inf])
    found = minimise(lambda p: X @ p - y, np.zeros(2), STEPS, np.arange(40), (mean, spread))
    H = X.T @ X + np.diag([100.0, 0.0])
    wanted = np.linalg.solve(H, X.T @ y + np.array([200.0, 0.0]))
    np.testing.assert_allclose(found.vector, wanted, rtol=1e-5)
    left = X @ wanted - y
    assert found.cost == pytest.approx(0.5 * left @ left + 50.0 * (wanted[0] - 2.0) ** 2)


def test_nuisances_take_their_part_of_residual_and_information() -> None:
    """As if their coefficients, of deviation one, were fitted along."""
    rng = np.random.default_rng(2)
    X, y = rng.normal(size=(60, 2)), rng.normal(size=60)
    shared = X @ rng.normal(size=(2, 2)) + rng.normal(size=(60, 2))
    found = minimise(lambda p: X @ p - y, np.zeros(2), STEPS, np.arange(60), FREE, shared)
    V = np.linalg.inv(np.eye(60) + shared @ shared.T)
    H = X.T @ V @ X
    wanted = np.linalg.solve(H, X.T @ V @ y)
    np.testing.assert_allclose(found.vector, wanted, rtol=1e-5)
    left = X @ wanted - y
    assert found.cost == pytest.approx(0.5 * left @ V @ left)
    own = np.linalg.inv(H)
    each = (V @ X) * (V @ left)[:, None]
    sandwich = own @ each.T @ each @ own
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(own), 1.0))
    np.testing.assert_allclose(found.covariance, own * np.outer(ratio, ratio), rtol=1e-4)


def scatter(pole: float, cluster: int, count: int = 400, runs: int = 150) -> Array:
    """Errors over claimed ones of a level and a slope in noise of one pole and variance one, taken as white."""
    X = np.column_stack([np.ones(count), np.linspace(-1.0, 1.0, count)])
    white = np.random.default_rng(3).normal(size=(runs, count + 300)) * np.sqrt(1.0 - pole**2)
    off = []
    for y in lfilter([1.0], [1.0, -pole], white, axis=1)[:, 300:]:
        found = minimise(lambda p, y=y: X @ p - y, np.zeros(2), STEPS, np.arange(count) // cluster, FREE)
        off.append(found.vector / np.sqrt(np.diag(found.covariance)))
    return np.asarray(np.std(off, axis=0))


def test_claimed_errors_are_the_scatter_where_noise_is_white() -> None:
    """The larger of two estimates is a little large."""
    np.testing.assert_allclose(scatter(0.0, 1), 0.95, atol=0.1)


def test_stretches_of_two_logs_are_never_one_whatever_their_clocks() -> None:
    times = np.concatenate([np.arange(0.0, 4.0, 0.01), 100_000 * TUNING.cluster + np.arange(0.0, 4.0, 0.01)])
    for owner in (np.repeat([0, 1], 400), np.repeat([1, 0], 400)):
        found = blocks(times, owner)
        assert not set(found[:400]) & set(found[400:])
        assert len(np.unique(found[:400])) == np.ceil(4.0 / TUNING.cluster)


def test_clusters_make_errors_honest_where_noise_hangs_together() -> None:
    """Of samples that a time constant of five makes one: without clusters errors would be three times too small."""
    np.testing.assert_allclose(scatter(0.8, 60, 3000), 1.07, atol=0.17)
    assert np.all(scatter(0.8, 1) > 2.2)


def test_a_step_that_does_not_help_is_shortened() -> None:
    """To two fifths and again; where a fiftieth of it does not help either, it ends."""
    tried: list[float] = []

    def residual(p: Array) -> Array:
        tried.append(float(p[0]))
        return np.array([np.arctan(p[0])])

    one = np.zeros(1), np.full(1, np.inf)
    found = minimise(residual, np.array([3.0]), np.array([1e-6]), np.zeros(1, dtype=np.int64), one, rounds=1)
    step = -np.arctan(3.0) * 10.0
    shares = [(x - 3.0) / step for x in tried if abs(x - 3.0) > 1e-3]
    np.testing.assert_allclose(shares[:2], [1.0, 0.4], rtol=1e-4)
    assert abs(found.vector[0]) < 3.0

    tried.clear()

    def wall(p: Array) -> Array:
        tried.append(float(p[0]))
        return np.array([1.0 + p[0] if abs(p[0]) < 1e-5 else np.inf])

    stuck = minimise(wall, np.zeros(1), np.array([1e-6]), np.zeros(1, dtype=np.int64), one)
    steps = [-x for x in tried if abs(x) > 1e-5]
    np.testing.assert_allclose(steps, 0.4 ** np.arange(5), rtol=1e-5)
    assert stuck.vector[0] == 0.0, "0.4⁵ is below a fiftieth"


def test_it_ends_when_no_coordinate_moves_by_a_fiftieth_of_its_error() -> None:
    """A cost whose steps shrink by a known ratio tells after how many of them it stopped."""
    count = 0

    def residual(p: Array) -> Array:
        nonlocal count
        count += 1
        return np.array([p[0], 0.7])

    one = np.zeros(1), np.full(1, np.inf)
    for start, evaluations in ((0.019, 4 - 1), (0.021, 5)):
        count = 0
        minimise(residual, np.array([start]), np.array([1e-6]), np.zeros(2, dtype=np.int64), one)
        assert (count > 3) == (evaluations > 3), count


@pytest.mark.parametrize(("rounds", "far"), [(2, True), (6, False)])
def test_six_steps_are_enough_and_two_are_not(rounds: int, far: bool) -> None:
    residual = curve(3.0 * np.exp(-0.7 * np.linspace(0.0, 2.0, 80)))
    found = minimise(residual, np.array([0.3, 4.0]), STEPS, np.arange(80), FREE, rounds=rounds)  # type: ignore[arg-type]
    assert (np.max(np.abs(found.vector - [3.0, 0.7])) > 0.05) == far
