"""Chi-square's quantiles, and the mean and variance of its root, against scipy.stats."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi, chi2

from twin_diagram.signals import chi_square

DEGREES = np.array([1, 2, 3, 6, 7, 14, 50, 400])


@pytest.mark.parametrize("probability", [1e-6, 0.05, 0.5, 0.99, 1.0 - 1e-9])
def test_quantiles_are_scipys(probability: float) -> None:
    np.testing.assert_allclose(chi_square.quantile(probability, DEGREES), chi2.ppf(probability, DEGREES), rtol=1e-12)
    assert float(chi_square.quantile(probability, 3)) == pytest.approx(float(chi2.ppf(probability, 3)), rel=1e-12)


def test_the_root_is_scipys_chi() -> None:
    np.testing.assert_allclose(chi_square.mean_of_root(DEGREES), chi.mean(DEGREES), rtol=1e-12)
    np.testing.assert_allclose(chi_square.variance_of_root(DEGREES), chi.var(DEGREES), rtol=1e-10)
