"""The true arm in the world's plant: its driver's gains, where it stands, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import ArmModel, Driver, EffectSpec, Scenario
from twin_diagram.station.sim.arm_plant import ArmPlant, add_arm, driver_gains, initial_angles

LIMITS = np.array([87.0, 43.5, np.inf, 0.0, 24.0, 12.0, -1.0])


def test_gains_grow_with_what_a_joint_can_give() -> None:
    """600 for the first four and 250 for the rest, which suit 87 and 12 N·m; where no limit is told, as they are."""
    stiffness, damping = driver_gains(Driver(), LIMITS)
    np.testing.assert_allclose(stiffness, [600.0, 300.0, 600.0, 600.0, 500.0, 250.0, 250.0])
    np.testing.assert_allclose(damping, 2.0 * np.sqrt([600.0, 300.0, 600.0, 600.0, 500.0, 250.0, 250.0]))


def test_gains_that_are_told_are_taken_and_damping_follows_stiffness() -> None:
    stiffness, damping = driver_gains(Driver(stiffness=[100.0, 0.0, 4.0]), np.full(3, 87.0))
    np.testing.assert_array_equal(stiffness, [100.0, 0.0, 4.0])
    np.testing.assert_allclose(damping, [20.0, 0.0, 4.0])
    stiffness, damping = driver_gains(Driver(damping=[1.0, 0.0, 3.0]), np.full(3, 87.0))
    np.testing.assert_allclose(stiffness, 600.0)
    np.testing.assert_array_equal(damping, [1.0, 0.0, 3.0])


@pytest.mark.parametrize("name", ["stiffness", "damping"])
@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, 2.0, 3.0, 4.0], [1.0, -1e-9, 2.0], [-1.0, -1.0, -1.0]])
def test_gains_that_cannot_be_are_refused(name: str, values: list[float]) -> None:
    with pytest.raises(ScenarioError, match=rf"twin\.driver\.{name}: .* for each of 3 joints"):
        driver_gains(Driver(**{name: values}), np.full(3, 87.0))


def test_the_arm_begins_where_the_world_says_else_at_home_else_at_zero() -> None:
    plan = Scenario(seed=1)
    plan.twin.home, plan.world.q0 = [], []
    np.testing.assert_array_equal(initial_angles(plan, 2), [0.0, 0.0])
    plan.twin.home = [0.1, 0.2]
    np.testing.assert_array_equal(initial_angles(plan, 2), [0.1, 0.2])
    plan.world.q0 = [0.3, 0.4]
    np.testing.assert_array_equal(initial_angles(plan, 2), [0.3, 0.4])
    plan.world.q0 = [0.3]
    with pytest.raises(ScenarioError, match=r"world\.q0: 1 numbers for 2 joints"):
        initial_angles(plan, 2)


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (EffectSpec("coulomb_friction", joints=["joint1"], parameters={"torque": [3.0]}), "has no joint 'joint1'"),
        (EffectSpec("joint_elasticity", joints=["j"], parameters={"stiffness": [3e4]}), "has no joint 'j'"),
        (EffectSpec("payload", links=["nope"], parameters={"mass": [1.0], "com": [0.0] * 3}), "has no link 'nope'"),
    ],
)
def test_effects_on_what_is_not_there_are_refused(effect: EffectSpec, said: str) -> None:
    plan = Scenario(seed=1)
    plan.world.arm = ArmModel(effects=[effect])
    with pytest.raises(ScenarioError, match=rf"^world\.arm.*effects\.{effect.name}\..*{said}"):
        add_arm(MultibodyPlant(0.001), plan)


@pytest.fixture(scope="module")
def panda() -> tuple[MultibodyPlant, ArmPlant]:
    plan = Scenario(seed=1)
    plan.twin.arm, plan.world.arm = ArmModel(), ArmModel()
    plan.twin.home = [0.1, 0.2, 0.3, -1.4, 0.5, 1.6, 0.7]
    plant = MultibodyPlant(0.001)
    found = add_arm(plant, plan)
    plant.Finalize()
    return plant, found


def test_each_motor_has_its_own_gains(panda: tuple[MultibodyPlant, ArmPlant]) -> None:
    """A finger gives half a millimetre way under a newton, and is damped for the 1.5 kg of its drive."""
    plant, found = panda
    motors = [*found.arm.actuator_indices, *found.arm.gripper_actuator_indices]
    gains = [plant.get_joint_actuator(index).get_controller_gains() for index in motors]
    np.testing.assert_allclose([g.p for g in gains], found.stiffness)
    np.testing.assert_allclose([g.d for g in gains], found.damping)
    np.testing.assert_allclose(found.stiffness[:7], [600.0] * 4 + [250.0] * 3)
    np.testing.assert_allclose(1.0 / found.stiffness[7:], [0.5e-3] * 2)
    np.testing.assert_allclose((found.damping[7:] / 2.0) ** 2 / found.stiffness[7:], [1.5] * 2, rtol=0.01)
    drives = [plant.get_joint_actuator(index) for index in found.arm.gripper_actuator_indices]
    assert [m.default_rotor_inertia() * m.default_gear_ratio() ** 2 for m in drives] == [1.5] * 2


def test_it_knows_its_joints_fingers_and_start(panda: tuple[MultibodyPlant, ArmPlant]) -> None:
    plant, found = panda
    assert [joint.name() for joint in found.joints] == [f"panda_joint{k}" for k in range(1, 8)]
    assert [joint.name() for joint in found.fingers] == list(found.arm.gripper_joints) and len(found.fingers) == 2
    assert found.driven == [0, 1] and found.effects == ()
    np.testing.assert_allclose(found.q0, [0.1, 0.2, 0.3, -1.4, 0.5, 1.6, 0.7, *found.q0[7:]])
    assert found.q0.shape == (9,)
    context = plant.CreateDefaultContext()
    np.testing.assert_allclose([joint.get_angle(context) for joint in found.joints], found.q0[:7])
