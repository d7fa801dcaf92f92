"""What brakes hold while the motors are off is no motor's torque, and is left out; rests under control stay."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.made import ARM, HOME, Array
from twin_diagram.gap.residuals.motors_off import without_brakes
from twin_diagram.gap.workflow import _driven
from twin_diagram.logs import Log, LogWarning

PERIOD = 0.004


def run(stop: tuple[float, float], seconds: float = 10.0) -> tuple[Array, Array, Array]:
    """Times, positions and torques of an arm that stands still for a while, and then goes on."""
    time = PERIOD * np.arange(round(seconds / PERIOD))
    standing = (time >= stop[0]) & (time < stop[1])
    angle = np.cumsum(np.where(standing, 0.0, PERIOD))[:, None] + np.arange(6)
    rate = np.where(standing, 0.0, 1.0)[:, None]
    q, v, a = HOME + 0.4 * np.sin(angle), 0.4 * rate * np.cos(angle), -0.4 * rate * np.sin(angle)
    return time, q, ARM.inverse_dynamics(q, v, a)


def log_of(time: Array, q: Array, torque: Array, noise: float = 0.05) -> Log:
    rng = np.random.default_rng(3)
    return Log(time, ARM.joints, q + 1e-5 * rng.normal(size=q.shape), torque=torque + noise * rng.normal(size=q.shape))


@pytest.mark.parametrize(("stop", "slow"), [((4.0, 6.0), 0.2), ((0.0, 1.5), 0.0), ((8.0, 10.0), 0.0)])
def test_a_stop_amid_a_run_and_motors_that_are_not_on_yet_are_left_out(stop: tuple[float, float], slow: float) -> None:
    """Also while the motors take the load over, which brakes hold meanwhile."""
    time, q, torque = run(stop)
    share = np.clip((time - stop[1] + slow) / max(slow, PERIOD), 0.0, 1.0)
    torque[time >= stop[0]] *= share[time >= stop[0], None]
    log = log_of(time, q, torque)
    kept = without_brakes(ARM, log)
    off = ~kept
    assert np.all(off[(time > stop[0] + 0.06) & (time < stop[1] - 0.01)])
    assert not np.any(off[(time < stop[0] - 0.06) | (time > stop[1] + 0.1)])
    warnings: list[LogWarning] = []
    left = _driven(ARM, log, warnings)
    assert len(left) == np.sum(kept) and [warning.code for warning in warnings] == ["motors_off"]
    assert "brakes hold it: left out:" in warnings[0].message


def test_rests_that_motors_hold_stay_and_so_does_a_torque_that_passes_through_zero() -> None:
    time, q, torque = run((4.0, 6.0))
    log = log_of(time, q, torque)
    assert np.all(without_brakes(ARM, log))
    warnings: list[LogWarning] = []
    assert _driven(ARM, log, warnings) is log and not warnings
    falling = torque.copy()
    falling[(time > 1.0) & (time < 2.0)] = 0.0  # motors that are off while the arm moves hold nothing back, but brakes
    assert np.all(without_brakes(ARM, log_of(time, q, falling)))


def test_a_rest_at_which_no_joint_bears_a_weight_stays() -> None:
    """Friction may hold such a pose, as on a SCARA, and controllers let go there."""
    time, q, torque = run((4.0, 6.0))
    standing = (time >= 4.0) & (time < 6.0)
    bears = ARM.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))
    light = torque - bears + np.array([20.0, 300.0, 150.0, 40.0, 40.0, 20.0]) * np.sin(2.0 * time)[:, None]
    light[standing] = 0.0
    assert np.all(without_brakes(ARM, log_of(time, q, light)))


def test_noise_hides_no_torque_that_holds_an_arm_and_creeping_joints_are_not_braked() -> None:
    """A soft controller lets go of what friction holds, beside noise of a fifth of the torque."""
    time, q, torque = run((4.0, 6.0))
    size = np.sqrt(np.mean(torque**2, axis=0))
    standing = (time >= 4.0) & (time < 6.0)
    held = torque.copy()
    held[standing] *= 0.2
    rng = np.random.default_rng(4)
    coarse = Log(time, ARM.joints, q, torque=held + 0.2 * size * rng.normal(size=q.shape))
    assert np.all(without_brakes(ARM, coarse))
    creeping = q + np.where(standing, 0.01 * (time - 4.0), 0.0)[:, None] + 0.02 * (time >= 6.0)[:, None]
    held[standing] = 0.0
    assert np.all(without_brakes(ARM, Log(time, ARM.joints, creeping, torque=held)))
    assert not np.all(without_brakes(ARM, Log(time, ARM.joints, q, torque=held)))
