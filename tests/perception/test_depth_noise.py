"""The told noise of depth, and by how much it was told too small."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.perception.depth_noise import DepthSigma, excess
from twin_diagram.scenario import DepthNoise


@pytest.mark.parametrize(
    ("sheet", "wanted"),
    [
        ("ideal", [0.2e-3, 0.8e-3, 3.2e-3]),
        ("d415", [0.375e-3, 1.5e-3, 6.0e-3]),
        ("d435", [0.95e-3, 3.8e-3, 15.2e-3]),
        ("kinect1", [1.219e-3, 1.884e-3, 6.064e-3]),
    ],
)
def test_sheets_say_how_noise_grows(sheet: str, wanted: list[float]) -> None:
    np.testing.assert_allclose(DepthSigma.of(DepthNoise(sheet))(np.array([0.5, 1.0, 2.0])), wanted, rtol=1e-9)


def test_figures_win_over_the_sheet_and_none_means_the_old_noise() -> None:
    own = DepthSigma.of(DepthNoise("kinect1", floor=0.002, growth=0.001, start=0.5))
    assert own(np.array(1.5)) == pytest.approx(0.003)
    assert DepthSigma.of(DepthNoise("kinect1", growth=0.0)) == DepthSigma(0.0012, 0.0, 0.4, 0.6, 0.3)
    assert DepthSigma() == DepthSigma.of(DepthNoise()) == DepthSigma(0.0, 0.0008, 0.0, 0.0, 0.0)
    with pytest.raises(ScenarioError, match=r"depth_noise\.sheet: .*d405"):
        DepthSigma.of(DepthNoise("d405"))


def test_residuals_say_by_how_much_a_sheet_promises_too_much() -> None:
    rng = np.random.default_rng(8)
    sigma = rng.uniform(0.001, 0.004, 4000)
    residual = rng.standard_normal(4000) * sigma
    assert excess(residual, sigma / 2.0) == pytest.approx(2.0, rel=0.05)
    assert excess(residual, 2.0 * sigma) == 1.0
    residual[:400] = 0.1  # what is not of the object
    assert excess(residual, sigma / 2.0) == pytest.approx(2.2, rel=0.1)
    assert excess(np.full(29, 1.0), np.full(29, 0.1)) == 1.0 < excess(np.full(30, 1.0), np.full(30, 0.1))
