"""A further sensor whose stamps run ahead of the arm's own messages: the state is then ahead of these, too."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import INERTIA, RADIUS, crank
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.sensors import LinkImu
from twin_diagram.scenario import Filter

DT = 0.005


def swing(t: float) -> tuple[float, float, float]:
    """Angle, speed and acceleration [rad, rad/s, rad/s²]."""
    return float(np.sin(2.0 * t)), float(2.0 * np.cos(2.0 * t)), float(-4.0 * np.sin(2.0 * t))


@pytest.mark.parametrize("lead", [0.004, 0.006, 0.03])
def test_messages_that_come_in_order_are_used_though_the_state_is_ahead_of_them(lead: float) -> None:
    """An IMU that is `lead` quicker than the arm's bus; by 30 ms, messages meet steps that were made for the IMU."""
    ekf, rng = Ekf(crank(), Filter(parameters=[])), np.random.default_rng(0)
    ekf.add(LinkImu(ekf.terms, "hand"))
    for t in DT * np.arange(1, 81):
        q, v, a = swing(t - lead)
        if t > lead:
            noisy = np.array([q + 2e-5 * rng.normal()]), np.array([v + 2e-3 * rng.normal()])
            assert ekf.observe(*noisy, np.array([INERTIA * a]), t - lead)
        if ekf.belief.valid:
            q, v, a = swing(t)
            reading = np.array([0.0, 0.0, v, -(v**2) * RADIUS, a * RADIUS, 9.81])
            assert ekf.update("imu", reading + np.repeat([1e-3, 1e-2], 3) * rng.normal(size=6), t).accepted
    h = ekf.belief.header
    assert h[Entry.RESTARTS] == h[Entry.STALE] == h[Entry.STREAK] == 0.0 and h[Entry.ACCEPTED] >= 72.0
    assert h[Entry.MESSAGE] == h[Entry.HEARD] == pytest.approx(0.4 - lead) and h[Entry.TIME] == pytest.approx(0.4)
    assert h[Entry.NIS_MEAN] < 2.0  # they are watched as others are
    np.testing.assert_allclose([*ekf.belief.q, *ekf.belief.v], swing(0.4)[:2], atol=5e-3)


def test_a_clock_that_was_set_back_is_still_noticed() -> None:
    ekf = Ekf(crank(), Filter(parameters=[]))
    for t in DT * np.arange(1, 41):
        ekf.observe(np.zeros(1), np.zeros(1), np.zeros(1), t)
    ekf.predict(np.zeros(1), 0.01)
    used = [ekf.observe(np.zeros(1), np.zeros(1), np.zeros(1), 0.15 + 0.0005 * k + 1e-4) for k in range(12)]
    assert ekf.belief.header[Entry.RESTARTS] == 1.0 and ekf.belief.time < 0.17 and used[9]
