"""Steps of a rollout against closed forms: order, starts, delays, gears and onsets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.model.dynamics.torque_law import TorqueLaw
from twin_diagram.model.model import Model
from twin_diagram.model.rollout import rollout, trajectory
from twin_diagram.scenario import ArmModel, EffectSpec

ARM = """<robot name="arm"><link name="base"/><link name="a"><inertial><mass value="1"/>
  <inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" effort="99" velocity="9"/></joint></robot>"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = Path(tmp_path_factory.mktemp("arm")) / "arm.urdf"
    file.write_text(ARM)
    return file


def arm(path: Path, *specs: EffectSpec) -> Model:
    return Model.load(ArmModel(model=str(path), tool_frame="", effects=list(specs)))


def on(name: str, **parameters: float) -> EffectSpec:
    return EffectSpec(name, ["turn"], [], {key: [value] for key, value in parameters.items()})


def column(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


def test_a_spring_and_a_damper_swing_as_their_equation_says(path: Path) -> None:
    """To second order in steps of at most 4 ms, whatever the period."""
    model = arm(path, on("joint_spring", stiffness=50.0, rest_angle=0.1), on("viscous_friction", damping=0.4))
    decay, omega = 0.4, np.sqrt(100.0 - 0.16)
    for period in (0.001, 0.004, 0.02):
        steps = round(0.4 / period)
        path_of = [q[0, 0] for q in trajectory(model, column(0.3), column(1.0), np.zeros((steps + 1, 1, 1)), period)]
        t = period * np.arange(1, steps + 1)
        expected = 0.1 + np.exp(-decay * t) * (
            0.2 * np.cos(omega * t) + (1.0 + decay * 0.2) / omega * np.sin(omega * t)
        )
        h = min(
            period, 0.004
        )  # second order: the phase of a swing of 0.24 rad is wrong by at most (ω h)² / 12 of itself
        np.testing.assert_allclose(path_of, expected, atol=0.24 * omega * 0.4 * (omega * h) ** 2 / 12)


def test_torques_are_linear_between_samples(path: Path) -> None:
    model = arm(path)
    tau = np.linspace(0.0, 1.0, 11)[:, None, None] * np.array([2.0, -4.0])[None, :, None]
    end = rollout(model, np.zeros((2, 1)), column(0.0, 0.5), tau, 0.05)
    expected = column(4.0, -8.0) * 0.5**2 / 6 + column(0.0, 0.5) * 0.5
    np.testing.assert_allclose(end, expected, atol=1e-5)


def test_readings_gains_and_what_has_arrived(path: Path) -> None:
    model = arm(
        path,
        on("encoder_offset", offset=0.2),
        on("torque_constant", gain=0.5),
        on("joint_spring", stiffness=30.0, rest_angle=0.1),
    )
    tau = np.full((101, 1, 1), 3.0)
    end = rollout(model, column(0.3), column(0.0), tau, 0.002)
    swing = np.sqrt(60.0) * 0.2
    rest = 0.1 + 0.05
    np.testing.assert_allclose(end, 0.2 + rest + (0.1 - rest) * np.cos(swing), atol=1e-5)
    np.testing.assert_allclose(
        rollout(model, column(0.3), column(0.0), 0.5 * tau, 0.002, arrived=True), end, atol=1e-12
    )


def test_what_starts_and_ends_counts_from_each_rollouts_own_time(path: Path) -> None:
    timed = replace(on("torque_bias", torque=2.0), onset=1.0, end=1.1)
    model = arm(path, timed)
    start = np.array([0.9, 1.0, 1.05, 1.1])
    end = rollout(model, np.zeros((4, 1)), np.zeros((4, 1)), np.zeros((51, 4, 1)), 0.004, start)
    # 4 rad/s² while it lasts, and then on at that speed until 0.2 s have passed.
    for k, (begins, lasts) in enumerate([(0.1, 0.1), (0.0, 0.1), (0.0, 0.05), (0.0, 0.0)]):
        speed = 4.0 * lasts
        assert end[k, 0] == pytest.approx(speed * lasts / 2 + speed * (0.2 - begins - lasts), abs=2e-3)
    stays = arm(path, replace(timed, end=None))
    never = rollout(stays, np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((51, 1, 1)), 0.004)
    np.testing.assert_allclose(never, 4.0 * 0.02, atol=1e-6)  # without times, what is there to stay counts


def test_each_samples_torque_is_worked_out_once_whatever_acts_when(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But where torque acts late: what was before counts there."""
    asked, rigid = [], TorqueLaw.rigid

    def counted(law: TorqueLaw, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        asked.append(len(q))
        return rigid(law, q, v, a)

    monkeypatch.setattr(TorqueLaw, "rigid", counted)
    time = np.linspace(0.0, 2.0, 201)
    motion = tuple(x[:, None] for x in (np.sin(3.0 * time), 3.0 * np.cos(3.0 * time), -9.0 * np.sin(3.0 * time)))
    always, late = on("torque_bias", torque=2.0), on("time_delay", delay=0.03)
    timed = replace(always, onset=1.0, end=1.1)
    acts = arm(path, timed).inverse_dynamics(*motion, time=time)
    assert sum(asked) == len(time)
    meanwhile = (time >= 1.0) & (time < 1.1)
    np.testing.assert_allclose(arm(path).inverse_dynamics(*motion) - acts, 2.0 * meanwhile[:, None], atol=1e-12)
    waits = arm(path, timed, replace(late, joints=[])).inverse_dynamics(*motion, time=time)
    both = arm(path, always, replace(late, joints=[])).inverse_dynamics(*motion, time=time)
    np.testing.assert_allclose(waits[meanwhile], both[meanwhile], atol=1e-12)


def test_dry_friction_slows_by_its_level_and_then_holds(path: Path) -> None:
    model = arm(
        path, EffectSpec("coulomb_friction", ["turn"], [], {"torque_positive": [1.0], "torque_negative": [2.0]})
    )
    v = column(0.4, -0.4)
    for steps, share in ((25, None), (200, 1.0)):
        end = rollout(model, np.zeros((2, 1)), v, np.zeros((steps + 1, 2, 1)), 0.002)
        for k, level in ((0, 1.0), (1, 2.0)):
            a, t = level / 0.5, 0.002 * steps
            t = min(t, 0.4 / a)
            assert abs(end[k, 0]) == pytest.approx(0.4 * t - a * t * t / 2, abs=4e-4), (steps, share)


def test_a_motor_on_a_spring_swings_against_its_link(path: Path) -> None:
    """Both inertias and the spring: the motor's rotor 0.25, the link 0.5 kg·m²; their centre moves as pushed."""
    rotor, link, k = 0.25, 0.5, 200.0
    model = arm(path, on("joint_elasticity", stiffness=k, rotor_inertia=rotor, loss=0.0))
    e0 = 0.02
    steps = 150
    path_of = [q[0, 0] for q in trajectory(model, column(0.1), column(0.0), np.zeros((steps + 1, 1, 1)), 0.002,
                                           twist=(column(e0), column(0.0)))]  # fmt: skip
    t = 0.002 * np.arange(1, steps + 1)
    omega = np.sqrt(k * (1 / rotor + 1 / link))
    expected = 0.1 + e0 * link / (rotor + link) * (1 - np.cos(omega * t))
    np.testing.assert_allclose(path_of, expected, atol=4e-4)
    # Begun at rest under a torque, the spring carries the link's part of it.
    tau = np.full((steps + 1, 1, 1), 3.0)
    smooth = rollout(model, column(0.0), column(0.0), tau, 0.002)
    assert smooth[0, 0] == pytest.approx(3.0 / 0.75 * (0.002 * steps) ** 2 / 2, rel=0.01)


def test_play_lets_the_motor_run_alone_until_its_end(path: Path) -> None:
    model = arm(path, on("backlash", gap=0.1, rotor_inertia=0.25))
    # At +0.05 the link is ahead: a motor pushed forward runs 0.1 rad alone, then pushes the link with it.
    twist = (column(0.05), column(0.0))
    steps = 40
    path_of = np.array(
        [q[0, 0] for q in trajectory(model, column(0.0), column(0.0), np.full((201, 1, 1), 1.0), 0.002, twist=twist)]
    )
    t = 0.002 * np.arange(1, 202)[: len(path_of)]
    alone = 0.5 * 4.0 * t**2 < 0.095
    np.testing.assert_allclose(path_of[alone], 0.5 * 4.0 * t[alone] ** 2, atol=3e-3)
    late = np.diff(path_of[-steps:], 2) / 0.002**2
    np.testing.assert_allclose(np.median(late), 1.0 / 0.75, rtol=0.02)
