"""What two pads hold."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.weighing import Grip, WeighingError

GRIP = Grip(force=50.0, friction=0.5, pad_width=0.02, pad_length=0.04, share=0.8)


def test_each_force_and_moment_alone_reaches_its_limit() -> None:
    radius = np.sqrt(0.02 * 0.04 / np.pi)
    expected = [50.0, 50.0, 50.0, 2.0, 2.0 / 3.0 * radius * 50.0, 1.0]
    np.testing.assert_allclose(GRIP.capacity, expected)
    np.testing.assert_allclose(GRIP.use(0.8 * np.diag(GRIP.capacity)), 1.0)


def test_together_they_are_a_ball() -> None:
    both = 0.8 * np.array([0.6, 0.0, 0.0, 0.0, 0.8, 0.0]) * GRIP.capacity
    np.testing.assert_allclose(GRIP.use(both[None]), 1.0)
    assert GRIP.use(2.0 * both[None])[0] == pytest.approx(2.0)


def test_slope() -> None:
    wrench = np.random.default_rng(0).normal(size=(4, 6))
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        numeric = (GRIP.use(wrench + step) - GRIP.use(wrench - step)) / 2e-6
        np.testing.assert_allclose(GRIP.slope(wrench)[:, k], numeric, atol=1e-7)


@pytest.mark.parametrize("field", ["force", "friction", "pad_width", "pad_length", "share"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_what_is_no_grip_is_refused(field: str, value: float) -> None:
    with pytest.raises(WeighingError, match=field):
        Grip(**{"force": 40.0, field: value})
