"""The arm's own driver by itself: its filter in closed form, its limits, what counts as a command."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from scipy.linalg import expm

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import ArmModel, Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.driver import ArmDriver, NominalGravity, follow

W = 200.0
"""Of the filter [rad/s]: a steady motion is lagged by 10 ms."""


def exact(q: float, v: float, goal: float, dt: float) -> Array:
    """One step of q̈ = w² (goal − q) − 2 w v by the matrix exponential."""
    A = np.array([[0.0, 1.0, 0.0], [-(W**2), -2.0 * W, W**2], [0.0, 0.0, 0.0]])
    return np.asarray(expm(A * dt) @ [q, v, goal])[:2]


def test_a_step_is_that_of_the_critically_damped_filter() -> None:
    rng = np.random.default_rng(2041)
    q, v, goal = rng.normal(size=(3, 20))
    for dt in (1e-4, 0.0025, 0.02):
        found = follow(q, v, goal, np.full(20, 1e4), dt)
        wanted = np.array([exact(*given, dt) for given in zip(q, v, goal, strict=True)]).T
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


def test_a_steady_motion_is_lagged_by_ten_milliseconds() -> None:
    q, v, dt = np.zeros(1), np.zeros(1), 1e-4
    for k in range(1, 2001):
        q, v = follow(q, v, np.array([0.5 * k * dt]), np.array([10.0]), dt)
    assert (2000 * 0.5 * dt - q[0]) / 0.5 == pytest.approx(0.010, abs=1e-4)
    assert v[0] == pytest.approx(0.5, rel=1e-3)


def test_a_command_far_away_is_followed_at_the_speed_limit() -> None:
    limit = np.array([2.0, 0.5])
    q, v = np.zeros(2), np.zeros(2)
    for _ in range(2000):
        q, v = follow(q, v, np.array([90.0, -90.0]), limit, 5e-5)
    np.testing.assert_allclose(v, [2.0, -0.5], rtol=5e-3)  # but for the step
    # A command counts in full up to 2 · limit / w: 2 cm and half a centimetre.
    near = follow(np.zeros(2), np.zeros(2), np.array([0.0199, -0.0049]), limit, 0.0025)
    np.testing.assert_allclose(near, np.array([exact(0, 0, g, 0.0025) for g in (0.0199, -0.0049)]).T, rtol=1e-9)
    far = follow(np.zeros(2), np.zeros(2), np.array([0.03, -0.03]), limit, 0.0025)
    np.testing.assert_allclose(far, np.array([exact(0, 0, g, 0.0025) for g in (0.02, -0.005)]).T, rtol=1e-9)


# The system: two joints and three fingers, of which the last two have motors.


class Weight:
    """Stands for the driver's model: torque 2 q + 1."""

    def __init__(self, n: int = 2) -> None:
        self.n = n

    def __len__(self) -> int:
        return self.n

    def torque(self, q: Array) -> Array:
        return 2.0 * q + 1.0


def joint(low: float, high: float) -> Any:
    return SimpleNamespace(velocity_lower_limits=lambda: [low], velocity_upper_limits=lambda: [high])


Q0 = np.array([0.3, -0.4, 0.01, 0.02, 0.03])
DT = 0.0025


def driver() -> ArmDriver:
    arm = SimpleNamespace(
        joints=[joint(-2.0, 3.0), joint(-np.inf, np.inf)],
        fingers=[joint(-0.2, 0.1), joint(0.0, 0.0), joint(-0.3, 0.3)],
        driven=[1, 2],
        q0=Q0,
        stiffness=np.array([600.0, 250.0, 2000.0, 1000.0]),
        linkage=None,
    )
    return ArmDriver(arm, Weight(), DT)  # type: ignore[arg-type]


def stepped(**commands: Any) -> tuple[dict[str, Array], Array]:
    """The ports at the start, and the filter's state after a step."""
    system = driver()
    context = system.CreateDefaultContext()
    system.GetInputPort("motor_state").FixValue(context, np.arange(10.0))
    for name, value in commands.items():
        system.GetInputPort(name).FixValue(context, np.asarray(value, dtype=float))
    names = ("torque", "desired_state", "gripper_desired_state")
    ports = {name: np.array(system.GetOutputPort(name).Eval(context)) for name in names}
    return ports, np.array(system.EvalUniquePeriodicDiscreteUpdate(context).value())


def test_without_a_command_it_holds_its_pose_and_its_weight() -> None:
    ports, after = stepped()
    np.testing.assert_allclose(ports["torque"], [1.0, 3.0])
    np.testing.assert_array_equal(ports["desired_state"], [0.3, -0.4, 0.0, 0.0])
    np.testing.assert_array_equal(ports["gripper_desired_state"], [0.02, 0.03, 0.0, 0.0])
    np.testing.assert_allclose(after, np.concatenate([Q0, np.zeros(5)]), atol=1e-15)


def test_a_vector_with_a_nan_in_it_is_no_command() -> None:
    _, after = stepped(position_commanded=[np.nan, 1.0], gripper_commanded=[0.0, np.inf, 0.0])
    np.testing.assert_allclose(after, np.concatenate([Q0, np.zeros(5)]), atol=1e-15)
    ports, _ = stepped(torque_commanded=[np.nan, 5.0])
    np.testing.assert_allclose(ports["torque"], [1.0, 8.0])
    ports, _ = stepped(torque_commanded=[-7.0, -np.inf])
    np.testing.assert_allclose(ports["torque"], [-6.0, 3.0])


def test_commands_go_through_the_filter_each_at_its_joints_own_limit() -> None:
    """The slower of both ways; where the description gives none, or zero, 1000 rad/s."""
    goal, fingers = Q0[:2] + [90.0, 90.0], Q0[2:] + [90.0, 90.0, -90.0]
    _, after = stepped(position_commanded=goal, gripper_commanded=fingers)
    limits, ways = np.array([2.0, 1000.0, 0.1, 1000.0, 0.3]), np.array([1.0, 1.0, 1.0, 1.0, -1.0])
    wanted = np.array([exact(q, 0.0, q + way * 2.0 * u / W, DT) for q, u, way in zip(Q0, limits, ways, strict=True)])
    np.testing.assert_allclose(after, wanted.T.ravel(), rtol=1e-9)


def test_what_is_desired_of_arm_and_fingers_is_the_filters_state() -> None:
    system = driver()
    context = system.CreateDefaultContext()
    context.SetDiscreteState(0, np.arange(10.0))
    np.testing.assert_array_equal(system.GetOutputPort("desired_state").Eval(context), [0.0, 1.0, 5.0, 6.0])
    np.testing.assert_array_equal(system.GetOutputPort("gripper_desired_state").Eval(context), [3.0, 4.0, 8.0, 9.0])


@pytest.mark.parametrize(
    ("limit", "wanted"),
    [
        (20.0, [1.01, 0.02, 0.0, 0.0]),
        (2000.0, [2.0, 2.0, 0.0, 0.0]),
        (1e6, [3.0, 4.0, 8.0, 9.0]),
        (np.nan, [3.0, 4.0, 8.0, 9.0]),
        (-5.0, [1.0, 0.0, 0.0, 0.0]),
    ],
)
def test_fingers_springs_are_wound_up_to_the_force_limit(limit: float, wanted: list[float]) -> None:
    """Of 2000 and 1000 N/m, about where the fingers are: 20 N is 1 cm for one and 2 cm for the other."""
    system = driver()
    context = system.CreateDefaultContext()
    context.SetDiscreteState(0, np.arange(10.0))
    motor = np.zeros(10)
    motor[3:5] = [1.0, 0.0]  # the driven fingers
    system.GetInputPort("motor_state").FixValue(context, motor)
    system.GetInputPort("gripper_force_limit").FixValue(context, [limit])
    np.testing.assert_allclose(system.GetOutputPort("gripper_desired_state").Eval(context), wanted)


def test_a_driver_of_another_arm_is_refused() -> None:
    arm = SimpleNamespace(
        joints=[joint(-1.0, 1.0)], fingers=[], driven=[], q0=np.zeros(1), stiffness=np.ones(1), linkage=None
    )
    with pytest.raises(ScenarioError, match=r"twin\.arm\.model: has 2 joints where world\.arm has 1"):
        ArmDriver(arm, Weight(2), DT)  # type: ignore[arg-type]
    assert ArmDriver(arm, Weight(1), DT).num_input_ports() == 3  # type: ignore[arg-type]


def test_its_weight_is_the_slope_of_the_arms_height() -> None:
    plan = Scenario(seed=1)
    plan.twin.arm = ArmModel("arms/ur5e.urdf", tool_frame="tool0")
    gravity = NominalGravity(plan)
    plant = MultibodyPlant(0.0)
    from twin_diagram.station.add_models import twin_arm

    arm = twin_arm(plan, plant)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    at = [plant.get_joint(index).position_start() for index in arm.joint_indices]

    def height(q: Array) -> float:
        positions = np.zeros(plant.num_positions())
        positions[at] = q
        plant.SetPositions(context, positions)
        return float(plant.CalcPotentialEnergy(context))

    q = np.array([0.3, -1.1, 1.2, -0.7, 0.4, 0.2])
    slope = [(height(q + 1e-5 * e) - height(q - 1e-5 * e)) / 2e-5 for e in np.eye(6)]
    assert len(gravity) == 6 and np.max(np.abs(slope)) > 10.0
    np.testing.assert_allclose(gravity.torque(q), slope, atol=1e-5)
