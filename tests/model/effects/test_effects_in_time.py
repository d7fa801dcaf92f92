"""Effects that wait, remember, start or end: what a simulated arm logs is what the model says of its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from twin_diagram.logs import Log
from twin_diagram.model import effects
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import rollout_rms, torque_residual_rms
from twin_diagram.scenario import ArmModel, EffectSpec

JOINTS = tuple(f"panda_joint{i + 1}" for i in range(7))
HOME = np.array([0.1, -0.4, 0.2, -1.9, 0.1, 1.6, 0.3])
ROTORS = EffectSpec("reflected_inertia", list(JOINTS), [], {"inertia": [0.6, 0.6, 0.46, 0.46, 0.2, 0.2, 0.2]})
ARM = ArmModel(model="arms/panda.urdf", tool_frame="", effects=[ROTORS])
PERIOD = 0.002

CASES = {
    "viscous_friction": EffectSpec("viscous_friction", ["panda_joint2"], [], {"damping": [6.0]}),
    "coulomb_friction": EffectSpec("coulomb_friction", ["panda_joint4"], [], {"torque": [4.0]}),
    "coulomb_friction later": EffectSpec("coulomb_friction", ["panda_joint4"], [], {"torque": [4.0]}, onset=1.2),
    "viscous_friction later": EffectSpec("viscous_friction", ["panda_joint2"], [], {"damping": [6.0]}, onset=1.2),
    "stribeck_friction": EffectSpec(
        "stribeck_friction", ["panda_joint4"], [], {"coulomb": [2.5], "static": [3.5], "stribeck_velocity": [0.2]}
    ),
    "load_dependent_friction": EffectSpec("load_dependent_friction", ["panda_joint2"], [], {"coefficient": [0.2]}),
    "coupled_friction": EffectSpec(
        "coupled_friction", ["panda_joint5", "panda_joint6"], [], {"damping": [0.8], "torque": [1.2]}
    ),
    "payload": EffectSpec("payload", [], [], {"mass": [1.5], "com": [0.02, 0.0, 0.08]}),
    "inertial_parameters": EffectSpec(
        "inertial_parameters", [], ["panda_link4"], {"mass": [1.0], "com": [0.02, 0.03, -0.04]}
    ),
    "reflected_inertia": EffectSpec("reflected_inertia", ["panda_joint4"], [], {"inertia": [0.5]}),
    "gravity_tilt": EffectSpec("gravity_tilt", [], [], {"roll": [0.04], "pitch": [0.03]}),
    "joint_spring": EffectSpec("joint_spring", ["panda_joint2"], [], {"stiffness": [60.0], "rest_angle": [-0.2]}),
    "joint_elasticity": EffectSpec(
        "joint_elasticity", ["panda_joint2", "panda_joint4"], [], {"stiffness": [4e3, 2e3], "rotor_inertia": [0.0, 0.2]}
    ),
    "joint_elasticity that swings": EffectSpec(
        "joint_elasticity", ["panda_joint2"], [], {"stiffness": [600.0], "rotor_inertia": [0.1], "loss": [2e-3]}
    ),
    "backlash": EffectSpec("backlash", ["panda_joint5"], [], {"gap": [0.02], "rotor_inertia": [0.1]}),
    "torque_ripple": EffectSpec(
        "torque_ripple", ["panda_joint4"], [], {"amplitude": [2.0], "cycles": [20.0], "phase": [0.3]}
    ),
    "torque_constant": EffectSpec("torque_constant", ["panda_joint2"], [], {"gain": [0.85]}),
    "torque_bias": EffectSpec("torque_bias", ["panda_joint2"], [], {"torque": [3.0]}, onset=1.2, end=2.1),
    "torque_saturation": EffectSpec("torque_saturation", ["panda_joint2"], [], {"limit": [20.5]}),
    "time_delay": EffectSpec("time_delay", [], [], {"delay": [0.0073]}),
    "encoder_offset": EffectSpec("encoder_offset", ["panda_joint4"], [], {"offset": [0.05]}),
    "external_force": EffectSpec(
        "external_force", [], ["panda_link5"], {"wrench": [8.0, -5.0, 6.0, 0.5, 1.0, -1.5]}, onset=1.0, end=2.0
    ),
    "actuator_fault": EffectSpec("actuator_fault", ["panda_joint4"], [], {"gain": [0.6]}, onset=1.5),
}
CASES |= {
    f"{name} for a while": replace(CASES[name], onset=1.2, end=2.1)
    for name in ("payload", "stribeck_friction", "load_dependent_friction", "coupled_friction", "torque_constant")
}


class Reference(LeafSystem):
    """Desired positions and speeds."""

    def __init__(self) -> None:
        super().__init__()

        def calc(context: Context, output: BasicVector) -> None:
            t, k = context.get_time(), np.arange(1, 8)
            amplitude, w = 0.35 - 0.02 * k, 1.5 + 0.5 * k
            q, v = HOME + amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)
            output.SetFromVector(np.concatenate([q, v]))

        self.DeclareVectorOutputPort("value", 14, calc, {self.time_ticket()})


def recorded(spec: EffectSpec, dt: float = 0.001, duration: float = 3.0, more: Sequence[EffectSpec] = ()) -> Log:
    """A run of the arm with an effect, as a station would log it: motors' positions and torques."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, dt)
    plant.SetUseSampledOutputPorts(False)
    arm = add_arm(plant, replace(ARM, effects=[ROTORS, spec, *more]))
    fitted = effects.add_to_plant(plant, arm)
    arm = effects.renewed(plant, arm)
    for index in arm.actuator_indices:
        plant.get_joint_actuator(index).set_controller_gains(PdControllerGains(p=600.0, d=30.0))
        plant.get_joint_actuator(index).set_effort_limit(1e4)
    plant.Finalize()
    motors = effects.connect(builder, plant, arm, fitted)
    reference = builder.AddSystem(Reference())
    builder.Connect(reference.get_output_port(), motors.desired_state)
    states = LogVectorOutput(plant.get_state_output_port(), builder, dt)
    torques = LogVectorOutput(motors.torque_logged, builder, dt)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    inside = plant.GetMyMutableContextFromRoot(context)
    start = reference.get_output_port().Eval(reference.CreateDefaultContext())
    joints = [plant.get_joint(index) for index in arm.joint_indices]
    for k, joint in enumerate(joints):
        joint.set_angle(inside, start[k])
        joint.set_angular_rate(inside, start[7 + k])
    simulator.AdvanceTo(duration)
    q = states.FindLog(context).data()[[joint.position_start() for joint in joints]].T
    tau = torques.FindLog(context).data().T
    time = states.FindLog(context).sample_times()
    # The torque logged at a moment is that of the step before it.
    tau = np.vstack([0.5 * (tau[1:-1] + tau[2:]), tau[-1:]])
    every = round(PERIOD / dt)
    q = effects.measured_position(fitted, JOINTS, q[1:])
    return Log(time[1::every], JOINTS, q[::every], torque=tau[::every])


TWICE = {name for name in CASES if name.endswith(("for a while", "later", "that swings"))}
"""Whose law is among the others, too."""
BRIEF = {"coulomb_friction", "payload", "joint_elasticity", "backlash", "encoder_offset", "actuator_fault"}
"""One of each way in which a law enters: friction, inertia, two gears, what is late, measured or lost."""


def marks(name: str) -> list[pytest.MarkDecorator]:
    return [] if name in BRIEF else [pytest.mark.slow if name in TWICE else pytest.mark.long]


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(name, marks=marks(name)) for name in CASES])
def test_model_explains_what_is_simulated(name: str) -> None:
    log = recorded(CASES[name]).between(0.3, 3.0)
    model = Model.load(replace(ARM, effects=[ROTORS, CASES[name]]))
    without = Model.load(ARM)
    before, after = torque_residual_rms(without, log), torque_residual_rms(model, log)
    apart, together = rollout_rms(without, log, 0.1), rollout_rms(model, log, 0.1)
    print(name, before.max(), after.max(), apart.max(), together.max())
    assert np.max(after) < 0.1 * np.max(before)
    assert np.max(together) < 0.15 * np.max(apart)


@pytest.mark.long
@pytest.mark.parametrize(
    "beside",
    [
        "joint_elasticity",
        pytest.param("joint_elasticity that swings", marks=pytest.mark.slow),
        pytest.param("more play", marks=pytest.mark.slow),
    ],
)
def test_play_among_gears_that_yield_is_explained(beside: str) -> None:
    """Knocks pass from gear to gear: what one does, the others feel."""
    play = CASES["backlash"]
    more = CASES.get(beside, replace(play, joints=[JOINTS[3]]))
    log = recorded(play, more=[more]).between(0.3, 3.0)
    before, one, other, after = (
        np.max(torque_residual_rms(Model.load(replace(ARM, effects=[ROTORS, *specs])), log))
        for specs in ([], [play], [more], [play, more])
    )
    assert after < 0.1 * before
    assert after < 0.3 * min(one, other)


@pytest.mark.parametrize("late", ["torque_bias", "payload for a while"])
def test_before_an_onset_a_model_says_what_it_says_without(late: str) -> None:
    """At rest friction holds what arrives, which is not what a motor with another torque constant logs."""
    wrong = [replace(CASES["coulomb_friction"], joints=list(JOINTS), parameters={"torque": [4.0] * 7})]
    wrong += [replace(CASES["torque_constant"], joints=list(JOINTS), parameters={"gain": [1.3] * 7})]
    plain = Model.load(replace(ARM, effects=wrong))
    timed = Model.load(replace(ARM, effects=[*wrong, CASES[late]]))
    time = np.linspace(0.0, 1.1, 12)
    q, still = np.tile(HOME, (len(time), 1)), np.zeros((len(time), 7))
    logged = plain.inverse_dynamics(q, still, still) + np.linspace(-2.0, 2.0, len(time))[:, None]
    for model in (plain, timed):
        np.testing.assert_allclose(model.inverse_dynamics(q, still, still, time=time, seen=logged), logged, atol=1e-9)
    np.testing.assert_allclose(plain.inverse_dynamics(q, still, still, seen=logged), logged, atol=1e-9)


def test_a_model_with_an_onset_takes_whole_numbers_for_numbers() -> None:
    model = Model.load(replace(ARM, effects=[CASES["torque_bias"], CASES["torque_constant"]]))
    time, q = np.linspace(0.0, 2.0, 5), np.zeros((5, 7))
    whole = [part.astype(int) for part in (q, q + 1.0, q - 2.0)]
    np.testing.assert_array_equal(
        model.inverse_dynamics(*whole, time=time), model.inverse_dynamics(q, q + 1.0, q - 2.0, time=time)
    )
    np.testing.assert_array_equal(model.applied(whole[1], time), model.applied(q + 1.0, time))


DRY, RIPPLE = CASES["coulomb_friction"], CASES["torque_ripple"]


@pytest.mark.parametrize(
    ("parts", "whole"),
    [
        (
            [replace(DRY, parameters={"torque": [2.0]}), RIPPLE, replace(DRY, parameters={"torque": [2.0]}), RIPPLE],
            [DRY, replace(RIPPLE, parameters={**RIPPLE.parameters, "amplitude": [4.0]})],
        ),
        ([replace(DRY, parameters={"torque": [6.0]}), replace(DRY, parameters={"torque": [-2.0]})], [DRY]),
    ],
    ids=["equals on one joint", "one takes away from the other"],
)
def test_effects_of_one_name_add_up(parts: list[EffectSpec], whole: list[EffectSpec]) -> None:
    """In a simulator and in the model."""
    log = recorded(parts[0], duration=1.5, more=parts[1:]).between(0.3, 1.5)
    before = torque_residual_rms(Model.load(ARM), log)
    for specs in (parts, whole):
        after = torque_residual_rms(Model.load(replace(ARM, effects=[ROTORS, *specs])), log)
        assert np.max(after) < 0.1 * np.max(before)
