"""Noise that is larger than told, counted on made-up look-ups."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.registration_bench import frame
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration.assessment import residual_excess

COUNT = 500


def looked(scale: float, facing: float = 0.8) -> Any:
    """Points at 1 m whose distances scatter as `scale` times 3.8 mm would have it, and some of another thing."""
    rng = np.random.default_rng(3)
    sigma = np.hypot(0.0038 * facing, 0.0007)
    distance = scale * sigma * rng.standard_normal((2, COUNT))
    deeper = np.zeros((2, COUNT))
    deeper[:, :200], distance[:, :200] = 0.05, 0.05
    full = {"z": 1.0, "facing": facing}
    arrays = {name: np.full((2, COUNT), value) for name, value in full.items()}
    return SimpleNamespace(**arrays, distance=distance, deeper=deeper, matched=np.ones((2, COUNT), bool))


def told(sheet: DepthSigma) -> Any:
    return replace(frame(), camera=replace(frame().camera, depth_noise=sheet))


def test_residuals_larger_than_the_sheet_says_are_noticed() -> None:
    sheet = told(DepthSigma(growth=0.0038))
    assert residual_excess(looked(2.0), sheet, 1) == pytest.approx(2.0, rel=0.12)
    assert residual_excess(looked(0.5), sheet, 0) == 1.0
