"""The parts of a simulated drive as functions of arrays: delay lines, brakes, actuators, fittings."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains

from twin_diagram.errors import ModelError
from twin_diagram.model import effects
from twin_diagram.model.description.add_arm import Arm, add_arm
from twin_diagram.model.effects.simulated.actuators import Actuators
from twin_diagram.model.effects.simulated.add_to_plant import lessened
from twin_diagram.model.effects.simulated.brakes import Brakes
from twin_diagram.model.effects.simulated.delay_line import Line
from twin_diagram.model.effects.simulated.realisation import realisation, realisations
from twin_diagram.scenario import ArmModel, EffectSpec

JOINTS = [f"panda_joint{i + 1}" for i in range(7)]


def made(name: str, joints: list[str], onset: float | None = None, end: float | None = None, **parameters: Any) -> Any:
    return effects.make(EffectSpec(name, joints, [], parameters, onset=onset, end=end))


def arm_in(plant: MultibodyPlant, each: list[Any], *, gains: bool = False, damping: float = 0.0) -> Arm:
    arm = add_arm(plant, ArmModel(model="arms/panda.urdf", tool_frame=""))
    if gains:
        for index in arm.actuator_indices:
            plant.get_joint_actuator(index).set_controller_gains(PdControllerGains(p=500.0, d=20.0))
    for index in arm.joint_indices:
        plant.get_joint(index).set_default_damping_vector([damping])
    effects.add_to_plant(plant, arm, each)
    plant.Finalize()
    return arm


@pytest.mark.parametrize("steps", [0.4, 1.0, 2.0, 3.7])
def test_a_line_gives_what_went_in_some_steps_before(steps: float) -> None:
    line = Line(steps, 2)
    state = np.zeros(line.size)
    rng = np.random.default_rng(0)
    fed = rng.standard_normal((12, 2))
    before = np.zeros(2)
    for k, now in enumerate(fed):
        time = k - steps
        padded = np.vstack([np.zeros((6, 2)), fed])
        low = int(np.floor(time + 1e-9))
        share = time - low
        expected = (1 - share) * padded[low + 6] + share * padded[min(low + 7, k + 6)]
        np.testing.assert_allclose(line.end(state, now), expected, atol=1e-12)
        if k:
            np.testing.assert_allclose(line.last(state), before, atol=1e-12)
            np.testing.assert_array_equal(line.newest(state), fed[k - 1])
        before, state = line.end(state, now), line.moved(state, now)


@pytest.fixture(scope="module")
def braked() -> tuple[Brakes, MultibodyPlant, Arm]:
    each = [
        made("load_dependent_friction", JOINTS[:1], coefficient=[0.2]),
        made("coupled_friction", JOINTS[4:6], torque=[1.5], damping=[0.8]),
        made("coulomb_friction", JOINTS[3:4], onset=1.0, end=2.0, torque_positive=[2.0], torque_negative=[0.5]),
    ]
    plant = MultibodyPlant(0.002)
    arm = arm_in(plant, each, gains=True, damping=3.0)
    return Brakes(plant, arm, realisations(each)), plant, arm


def test_a_brake_takes_seven_tenths_of_the_speed_away_within_its_level(
    braked: tuple[Brakes, MultibodyPlant, Arm],
) -> None:
    """Of what the lightest of some poses needs, with dampers and controllers; three tenths are carried on."""
    brakes, plant, _ = braked
    assert brakes.count == 3
    along = np.zeros((3, 7))
    along[0, 0] = along[1, 4] = along[1, 5] = along[2, 3] = 1.0
    h, context = 0.002, plant.CreateDefaultContext()
    generator, least = np.random.default_rng(0), np.full(3, np.inf)
    for _ in range(12):
        plant.SetPositions(context, generator.uniform(-np.pi, np.pi, 7))
        mass = plant.CalcMassMatrix(context) + np.eye(7) * (h * 3.0 + h * 20.0 + h * h * 500.0)
        least = np.minimum(least, [1.0 / (row @ np.linalg.inv(mass) @ row) for row in along])
    v = 1e-5 * np.array([3.0, 0, 0, -2.0, 1.0, 3.0, 0])
    state = np.concatenate([np.zeros(7), v])
    tau, held = np.full(7, 40.0), np.array([0.01, -0.02, 0.03])
    speed = along @ v
    friction = held + 0.7 * least / h * speed
    damping = np.array([0.0, 0.8 * 4e-5, 0.0])
    np.testing.assert_allclose(brakes.torque(state, held, tau, 1.5), -(friction + damping), rtol=1e-6)
    np.testing.assert_allclose(brakes.held(state, held, tau, 1.5), held + 0.3 * least / h * speed, rtol=1e-6)
    fast = 1e5 * state
    for sign, t, levels in (
        (1.0, 40.0, [40 * 0.2 / 1.2, 1.5, 0.5]), (-1.0, 40.0, [40 * 0.2 / 0.8, 1.5, 2.0]),
        (1.0, -40.0, [40 * 0.2 / 0.8, 1.5, 0.5]),
    ):  # fmt: skip
        signs = sign * np.array([1, 1, -1])
        bound = brakes.held(sign * fast, held, np.full(7, t), 1.5)
        np.testing.assert_allclose(bound, signs * levels)
        expected = -(bound + sign * np.array([0, 0.8 * 4.0, 0]))
        np.testing.assert_allclose(brakes.torque(sign * fast, held, np.full(7, t), 1.5), expected)
    for time in (0.999, 2.0):
        assert brakes.held(fast, held, tau, time)[2] == 0.0
    names = [f"{JOINTS[0]}_load_dependent_friction", "other", f"{JOINTS[5]}_coupled_friction"]
    assert brakes.rows(names) == [(0, 0), (2, 1)]


def test_actuators_push_as_their_fittings_say() -> None:
    each = [
        made("joint_spring", JOINTS[:1], stiffness=[30.0], rest_angle=[0.2]),
        made("joint_spring", JOINTS[1:2], onset=1.0, stiffness=[10.0], rest_angle=[-0.1]),
        made("viscous_friction", JOINTS[2:3], onset=1.0, damping=[4.0]),
        made("torque_ripple", JOINTS[2:3], amplitude=[2.0], cycles=[5.0], phase=[0.3]),
        made("torque_bias", JOINTS[3:4], end=2.0, torque=[1.5]),
        made("coulomb_friction", JOINTS[4:5], torque_positive=[3.0], torque_negative=[1.0]),
        made("stribeck_friction", JOINTS[5:6], coulomb=[1.0], static=[2.5], stribeck_velocity=[0.2]),
    ]
    plant = MultibodyPlant(0.002)
    arm = arm_in(plant, each, gains=True)
    found = Actuators.of(plant, plant.GetJointActuatorIndices(), realisations(each))
    names = [plant.get_joint_actuator(index).name() for index in plant.GetJointActuatorIndices()]
    rng = np.random.default_rng(0)
    q, v = rng.standard_normal((2, 7))
    state = np.concatenate([q, v])
    stribeck = (2.5 - 1.0 - 1.5 * np.exp(-((v[5] / 0.2) ** 2))) * np.tanh(v[5] / 0.005)
    expected = {
        f"{JOINTS[1]}_joint_spring": -10.0 * (q[1] + 0.1), f"{JOINTS[2]}_viscous_friction": -4.0 * v[2],
        f"{JOINTS[2]}_torque_ripple_5": -2.0 * np.sin(5.0 * q[2] + 0.3), f"{JOINTS[3]}_torque_bias": 1.5,
        f"{JOINTS[4]}_coulomb_friction_shift": -1.0, f"{JOINTS[5]}_stribeck_friction_push": stribeck,
    }  # fmt: skip
    pushed = dict(zip(names, found.pushes(state, 1.5), strict=True))
    for name, value in pushed.items():
        assert value == pytest.approx(expected.get(name, 0.0)), name
    early, late = (dict(zip(names, found.pushes(state, time), strict=True)) for time in (0.9, 2.0))
    assert early[f"{JOINTS[1]}_joint_spring"] == early[f"{JOINTS[2]}_viscous_friction"] == 0.0
    assert early[f"{JOINTS[3]}_torque_bias"] == 1.5 and late[f"{JOINTS[3]}_torque_bias"] == 0.0
    row = names.index(f"{JOINTS[0]}_joint_spring")
    assert (found.stiffness[row], found.rest[row], found.damping[row]) == (30.0, 0.2, 0.0)
    row = names.index(f"{JOINTS[4]}_coulomb_friction")
    assert found.limit[row] == 2.0 and found.controlled[row] and found.damping[row] > 1e3
    assert found.limit[names.index(f"{JOINTS[5]}_stribeck_friction")] == 2.5
    # What motors gave: controllers about what was asked, within their limits.
    motors = Actuators.of(plant, arm.actuator_indices)
    torque, at, speed = rng.standard_normal((3, 7)) * [[10.0], [0.1], [0.1]]
    free = torque - 500.0 * (q - at) - 20.0 * (v - speed)
    limit = np.array([87, 87, 87, 87, 12, 12, 12.0])
    np.testing.assert_allclose(motors.given(state, np.array([torque, at, speed])), np.clip(free, -limit, limit))
    assert (np.abs(free) > limit).any() and (np.abs(free) < limit).any()


def test_pushes_on_one_joint_go_to_the_last_that_has_no_controller() -> None:
    bare: Any = SimpleNamespace(
        velocity=np.array([3, 4, 3, 5, 3]), controlled=np.array([False, False, False, False, True])
    )
    together = Actuators.together(bare)
    np.testing.assert_allclose(together @ np.array([1.0, 2, 4, 8, 16]), [0, 2, 5, 8, 16])


def test_friction_may_become_less_but_no_less_than_none() -> None:
    some = made("coulomb_friction", JOINTS[:2], torque=[2.0, 3.0])
    less = replace(EffectSpec("coulomb_friction", [JOINTS[1]], [], {"torque": [-1.0]}))
    other = made("torque_bias", JOINTS[:1], torque=[1.0])
    assert lessened([some, other]) == [some, other]
    kept, whole = lessened([some, effects.make(less), other])
    assert kept is other and whole.joints == (JOINTS[0], JOINTS[1])
    for key in ("torque_positive", "torque_negative"):
        np.testing.assert_allclose(whole.value(key), [2.0, 2.0])
    for level, fine in ((-3.0 - 0.9e-9, True), (-3.0 - 1.1e-9, False), (-4.0, False)):
        taken = effects.make(EffectSpec("coulomb_friction", [JOINTS[1]], [], {"torque": [level]}))
        if fine:
            assert lessened([some, taken])[0].value("torque_positive")[1] == 0.0
        else:
            with pytest.raises(ModelError, match=r"not within \[0, inf\]"):
                lessened([some, taken])
    with pytest.raises(ModelError, match="during a run"):
        lessened([some, effects.make(less), made("coulomb_friction", JOINTS[2:3], onset=1.0, torque=[1.0])])


def test_rotors_gears_and_masses_in_a_plant() -> None:
    each = [
        made("reflected_inertia", JOINTS[:2], inertia=[0.3, 0.7]),
        made("joint_elasticity", JOINTS[3:4], stiffness=[900.0], rotor_inertia=[0.2], loss=[2e-3]),
        made("backlash", JOINTS[5:6], gap=[0.03], rotor_inertia=[0.1]),
        made("joint_spring", JOINTS[1:2], stiffness=[30.0], rest_angle=[0.2]),
    ]
    bare = MultibodyPlant(0.002)
    before = arm_in(bare, [])
    plant = MultibodyPlant(0.002)
    arm = add_arm(plant, ArmModel(model="arms/panda.urdf", tool_frame=""))
    effects.add_to_plant(plant, arm, each)
    arm = effects.renewed(plant, arm)
    plant.Finalize()
    added: dict[str, float] = {}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        added[actuator.joint().name()] = added.get(actuator.joint().name(), 0.0) + actuator.default_reflected_inertia()
    for k, name in enumerate(JOINTS):
        rotor = bare.get_joint_actuator(before.actuator_indices[k]).default_reflected_inertia()
        more = {JOINTS[0]: 0.3, JOINTS[1]: 0.7, JOINTS[3]: 0.2, JOINTS[5]: 0.1}.get(name, 0.0)
        assert added[name] == pytest.approx(rotor + more)
        one, other = bare.GetJointByName(name), plant.GetJointByName(name)
        np.testing.assert_array_equal(one.position_lower_limits(), other.position_lower_limits())
        np.testing.assert_array_equal(one.velocity_upper_limits(), other.velocity_upper_limits())
        assert plant.get_joint(arm.joint_indices[k]).name() == name
    gains = plant.GetJointActuatorByName(f"{JOINTS[3]}_gear").get_controller_gains()
    assert (gains.p, gains.d) == (900.0, pytest.approx(1.8))
    play = plant.GetJointByName(f"{JOINTS[5]}_twist")
    assert (play.position_lower_limits()[0], play.position_upper_limits()[0]) == (-0.015, 0.015)


def test_dampers_add_up_and_marks_tell_equals_apart() -> None:
    plant = MultibodyPlant(0.002)
    arm = arm_in(plant, [made("viscous_friction", JOINTS[:2], damping=[2.0, 3.0])] * 2, damping=0.5)
    found = [plant.get_joint(index).default_damping_vector()[0] for index in arm.joint_indices]
    np.testing.assert_allclose(found, [4.5, 6.5, *[0.5] * 5])
    three = realisations([made("load_dependent_friction", JOINTS[:1], coefficient=[0.1])] * 3)
    assert [each.marked_brakes()[0].name for each in three] == [f"load_dependent_friction{m}" for m in ("", "_2", "_3")]


def test_stribeck_friction_that_begins_is_a_brake_of_its_higher_level() -> None:
    """A joint without any has none; at speed it is the law, as what is there for good is, at rest with its level."""
    values = {"coulomb": [1.0, 0.0, 3.0], "static": [2.5, 0.0, 2.0], "stribeck_velocity": [0.2, 0.2, 0.2]}
    always, late = (realisation(made("stribeck_friction", JOINTS[:3], onset=onset, **values)) for onset in (None, 1.0))
    assert always.brakes() == []
    found = [(brake.name, brake.joints, brake.level(np.array([9.0])), brake.damping) for brake in late.brakes()]
    assert found == [
        ("stribeck_friction", (JOINTS[0],), (2.5, 2.5), 0.0),
        ("stribeck_friction", (JOINTS[2],), (3.0, 3.0), 0.0),
    ]
    pushes = [f"{JOINTS[k]}_stribeck_friction_push" for k in (0, 2)]
    assert [fitting.name for fitting in late.fittings()] == pushes
    held = {fitting.name: fitting for fitting in always.fittings()}
    rise = f"{JOINTS[2]}_stribeck_friction_rise"
    assert set(held) == {*pushes, *(name.removesuffix("_push") for name in pushes), rise}
    for fitting, brake, coulomb, static in zip(late.fittings(), late.brakes(), (1.0, 3.0), (2.5, 2.0), strict=True):
        own = held[fitting.name.removesuffix("_push")]
        push, other = fitting.speed_curve, held[fitting.name].speed_curve
        assert push is not None and other is not None and own.limit == static
        damper = min(held[rise].damping * 0.3, held[rise].limit) if coulomb > static else 0.0
        law = coulomb + (static - coulomb) * np.exp(-((0.3 / 0.2) ** 2))
        assert brake.level(np.array([9.0]))[0] - push(0.3) == pytest.approx(law, rel=1e-3)
        assert own.limit + damper - other(0.3) == pytest.approx(law, rel=1e-3)


def test_a_gear_that_yields_cannot_begin_within_a_run() -> None:
    gear = made("joint_elasticity", JOINTS[:1], onset=1.0, stiffness=[900.0], rotor_inertia=[0.2], loss=[2e-3])
    with pytest.raises(ModelError, match=r"joint_elasticity\.onset: a simulator cannot start or end it"):
        arm_in(MultibodyPlant(0.002), [gear])
