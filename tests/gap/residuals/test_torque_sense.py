"""Torques of another sign or unit are said to be such before anything is fitted."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, swing
from twin_diagram.errors import LogError
from twin_diagram.gap.residuals.torque_sense import checked
from twin_diagram.logs import Log


def scaled(factor: float | np.ndarray, share: float = 1.0) -> list[Log]:
    """A log with friction and some noise, its torques times something, and a share of the torque of gravity."""
    time, q, v, a = swing(5.0)
    rest = ARM.inverse_dynamics(q, 0.0 * v, 0.0 * a)
    torque = ARM.inverse_dynamics(q, v, a) + (share - 1.0) * rest + 2.0 * np.sign(v) + 3.0 * v
    rng = np.random.default_rng(1)
    noisy = q + 1e-4 * rng.normal(size=q.shape)
    return [Log(time, ARM.joints, noisy, torque=(torque + 0.5 * rng.normal(size=q.shape)) * factor)]


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (-1.0, "opposite sign of those that the description needs"),
        (1e3, "it looks like mN·m"),
        (1e-3, "it looks like kN·m"),
        (0.01, "before the gear, or currents"),
    ],
)
def test_another_sign_or_unit_is_refused(factor: float, said: str) -> None:
    with pytest.raises(LogError, match=said):
        checked(ARM, scaled(factor))


def test_an_arm_that_is_described_wrongly_is_no_wrong_unit() -> None:
    for factor in (1.0, 0.5, 3.0):
        assert checked(ARM, scaled(factor)) == []
    (odd,) = checked(ARM, scaled(0.1))
    assert "if they are currents" in odd


def test_some_joints_within_their_limits_are_still_in_another_unit() -> None:
    factor = np.full(6, 1e3)
    factor[5] = 10.0
    with pytest.raises(LogError, match="it looks like mN·m"):
        checked(ARM, scaled(factor))


def test_a_single_joint_of_the_other_sign_is_refused() -> None:
    """The rest of the arm shows that it does not hang, and a link of negative mass is none."""
    sign = np.ones(6)
    sign[2] = -1.0
    with pytest.raises(LogError, match=r"the torque of elbow_joint has the opposite sign.*turn its sign"):
        checked(ARM, scaled(sign))


def test_a_single_joint_of_the_other_sign_and_size_is_named() -> None:
    sign = np.ones(6)
    sign[2] = -4.0
    (odd,) = checked(ARM, scaled(sign))
    assert "the torque of elbow_joint has the opposite sign" in odd


def test_exchanged_joints_are_refused() -> None:
    (log,) = scaled(1.0)
    with pytest.raises(LogError, match=r"torques of shoulder_lift_joint and elbow_joint are .* of each other"):
        checked(ARM, [replace(log, torque=log.motor_torque[:, [0, 2, 1, 3, 4, 5]])])


def test_an_arm_that_hangs_is_no_wrong_sign() -> None:
    """Gravity pulls the other way, but inertia does not."""
    checked(ARM, scaled(1.0, share=-1.0))


@pytest.mark.parametrize("every", [1, 2, 4])
def test_a_wrong_sign_is_seen_at_any_rate_and_on_uneven_times(every: int) -> None:
    (log,) = scaled(-1.0)
    kept = np.sort(np.random.default_rng(2).choice(len(log), len(log) // every * 9 // 10, replace=False))
    assert log.torque is not None
    fewer = Log(log.time[kept], log.joints, log.position[kept], torque=log.torque[kept])
    with pytest.raises(LogError, match="opposite sign"):
        checked(ARM, [fewer])


def test_reading_and_refusing_load_no_filters_and_no_pictures() -> None:
    """What is refused is refused at once: these take most of a second to load."""
    heavy = ("matplotlib", "scipy.signal", "scipy.stats", "scipy.optimize")
    code = f"import twin_diagram.gap.workflow, sys; print(*[x for x in {heavy} if x in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.split() == []
