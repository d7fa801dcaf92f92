"""Long and fast logs come to some 1 kHz without losing what an arm does."""

from __future__ import annotations

import numpy as np

from twin_diagram.logs import Log, fingerprint
from twin_diagram.logs.downsampling import downsampled


def test_a_long_fast_log_is_thinned_and_its_motion_kept() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(300_000) / 5000.0
    wave = np.sin(2.0 * np.pi * 3.0 * time)[:, None]
    log = Log(time, ("a",), wave, torque=wave + 0.1 * rng.normal(size=wave.shape))
    found = downsampled(log)
    assert len(found) == 60_000 and fingerprint(found) == fingerprint(log)
    np.testing.assert_allclose(found.period, 1e-3)
    np.testing.assert_allclose(found.position, wave[::5], atol=1e-5)
    assert np.std(found.motor_torque - wave[::5]) < 0.05  # noise beyond the new rate is gone, not folded


def test_others_stay_as_they_are() -> None:
    for count, rate in ((20_000, 5000.0), (300_000, 1000.0)):
        time = np.arange(count) / rate
        log = Log(time, ("a",), np.sin(time)[:, None], torque=np.ones((count, 1)))
        assert downsampled(log) is log
