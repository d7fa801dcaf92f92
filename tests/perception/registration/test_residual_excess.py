"""Noise that is larger than told, counted on made-up look-ups."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.registration_bench import frame
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration import point_kernels
from twin_diagram.perception.registration.assessment import residual_excess
from twin_diagram.perception.registration.data_association import Looked

COUNT = 500


def looked(scale: float, facing: float = 0.8) -> Any:
    """Points at 1 m whose distances scatter as `scale` times 3.8 mm would have it, and some of another thing."""
    rng = np.random.default_rng(3)
    sigma = np.hypot(0.0038 * facing, 0.0007)
    distance = scale * sigma * rng.standard_normal((2, COUNT))
    deeper = np.zeros((2, COUNT))
    deeper[:, :200], distance[:, :200] = 0.05, 0.05
    told = np.zeros((2, COUNT, point_kernels.COLUMNS))
    told[..., point_kernels.Z], told[..., point_kernels.FACING] = 1.0, facing
    told[..., point_kernels.DISTANCE], told[..., point_kernels.DEEPER] = distance, deeper
    return Looked(told, np.full((2, COUNT), point_kernels.MATCHED, dtype=np.uint8))


def told(sheet: DepthSigma) -> Any:
    return replace(frame(), camera=replace(frame().camera, depth_noise=sheet))


def test_residuals_larger_than_the_sheet_says_are_noticed() -> None:
    sheet = told(DepthSigma(growth=0.0038))
    assert residual_excess(looked(2.0), sheet, 1) == pytest.approx(2.0, rel=0.12)
    assert residual_excess(looked(0.5), sheet, 0) == 1.0
