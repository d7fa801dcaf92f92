"""A pendulum that spins and swings far faster than arms do: no limit named, nothing wrong, nothing to be alarmed about.

The truth is an ODE of its own, solved in steps of 1 ms by Runge and Kutta's method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.estimation.drift.monitor import Monitor
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter

MASS, CENTRE, CENTRAL, DAMPING = 1.0, 0.5, 0.02, 0.02
INERTIA, MOMENT = CENTRAL + MASS * CENTRE**2, MASS * 9.81 * CENTRE
STEP, EVERY = 1e-3, 5
URDF = """<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 -{centre}"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pin" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>{limit}
<dynamics damping="{damping}"/></joint></robot>"""


def terms(limit: str = "") -> ArmTerms:
    plant = MultibodyPlant(0.0)
    text = URDF.format(mass=MASS, centre=CENTRE, i=CENTRAL, damping=DAMPING, limit=limit)
    Parser(plant).AddModelsFromString(text, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    return ArmTerms(plant, ["pin"])


def swing(wanted: Callable[[float], float], duration: float, seed: int = 0) -> np.ndarray:
    """Rows (N, 4) of time, measured q, v and torque while a drive holds the speed near what is wanted."""
    q, v, rows = 0.1, 0.0, []

    def rate(q: float, v: float, tau: float) -> float:
        return (tau - MOMENT * np.sin(q) - DAMPING * v) / INERTIA

    for k in range(int(duration / STEP)):
        tau = float(np.clip(1.2 * (wanted(k * STEP) - v), -8.0, 8.0))
        if k % EVERY == 0:
            rows.append((k * STEP, q, v, tau))
        a = rate(q, v, tau)
        b = rate(q + STEP / 2 * v, v + STEP / 2 * a, tau)
        c = rate(q + STEP / 2 * (v + STEP / 2 * a), v + STEP / 2 * b, tau)
        d = rate(q + STEP * (v + STEP / 2 * b), v + STEP * c, tau)
        q, v = q + STEP * (v + STEP / 6 * (a + b + c)), v + STEP / 6 * (a + 2 * b + 2 * c + d)
    noise = np.random.default_rng(seed).standard_normal((len(rows), 3)) * [2e-5, 2e-3, 0.05]
    return np.array(rows) + np.column_stack([np.zeros(len(rows)), noise])


@dataclass
class Seen:
    alarms: int
    armed: bool
    mass: float
    """The largest that was learnt [kg]."""


def watch(rows: np.ndarray) -> Seen:
    arm = terms()
    ekf, monitor, mass = Ekf(arm, Filter()), Monitor(arm), 0.0
    for t, q, v, tau in rows:
        ekf.heed(monitor.alarm())
        ekf.observe(np.array([q]), np.array([v]), np.array([tau]), t)
        monitor.watch(ekf.belief, np.array([q]), np.array([tau]))
        mass = max(mass, abs(float(ekf.belief.theta[0])))
    return Seen(int((monitor.log[:, 0] >= 0.0).sum()), monitor.armed, mass)


def spinning(peak: float) -> Callable[[float], float]:
    return lambda t: peak * (1.0 - 0.02 * np.sin(0.7 * t))


def to_and_fro(peak: float) -> Callable[[float], float]:
    return lambda t: peak * float(np.sign(np.sin(np.pi * t / 2.0)))


@pytest.mark.parametrize(
    "wanted",
    [
        pytest.param(spinning(20.0), marks=pytest.mark.slow, id="spinning"),
        pytest.param(to_and_fro(30.0), marks=pytest.mark.long, id="to and fro"),
    ],
)
def test_an_exact_model_raises_no_alarm_and_learns_nothing(wanted: Callable[[float], float]) -> None:
    rows = swing(wanted, 12.5)
    assert np.abs(rows[:, 2]).max() > 20.0
    seen = watch(rows)
    assert seen.armed
    assert seen.alarms == 0
    assert seen.mass <= 0.01 * MASS


@pytest.mark.slow
@pytest.mark.parametrize("peak", [5.0, 12.0, 20.0, 30.0])
@pytest.mark.parametrize("kind", [spinning, to_and_fro])
def test_ten_minutes_without_an_alarm(kind: Callable[[float], Callable[[float], float]], peak: float) -> None:
    seen = watch(swing(kind(peak), 600.0, seed=1))
    assert seen.armed
    assert seen.alarms == 0
    assert seen.mass <= 0.01 * MASS


@pytest.mark.long
def test_a_heavier_rod_is_still_noticed_at_speed() -> None:
    rows = swing(spinning(20.0), 8.0)
    rows[rows[:, 0] > 6.0, 3] += 1.0
    assert watch(rows).alarms >= 1


@pytest.mark.parametrize("speed", [1.0, 9.0, 45.0, 300.0])
def test_a_prediction_gains_the_speed_that_its_torque_gives(speed: float) -> None:
    arm = terms()
    ekf = Ekf(arm, Filter())
    ekf.start(np.zeros(1), np.array([speed]), np.zeros(1), 0.0)
    dt, tau = 1e-3, 5.0
    ekf.predict(np.array([tau]), dt)
    gained = (tau - MOMENT * np.sin(0.5 * dt * speed) - DAMPING * speed) / INERTIA * dt
    assert float(ekf.belief.v[0]) - speed == pytest.approx(gained, rel=2e-3, abs=1e-6)


def test_what_no_limit_names_comes_from_the_plant_and_is_said() -> None:
    arm = terms()
    effort = 2.0 * MOMENT + 10.0 * INERTIA
    assert float(arm.effort_limit[0]) == pytest.approx(effort, rel=0.03)  # the largest weight of 16 poses
    assert float(arm.velocity_limit[0]) == pytest.approx(
        np.sqrt(4.0 * np.pi * float(arm.effort_limit[0]) / INERTIA), rel=1e-9
    )
    said = arm.assumptions()
    assert [("pin" in line, "speed" in line, "effort" in line) for line in said] == [
        (True, True, False),
        (True, False, True),
    ]
    assert f"{float(arm.velocity_limit[0]):.3g} rad/s" in said[0]
    named = terms('<limit velocity="7" effort="90"/>')
    assert float(named.velocity_limit[0]) == 7.0
    assert not [line for line in named.assumptions() if "speed" in line]
