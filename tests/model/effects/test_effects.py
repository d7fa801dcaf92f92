"""Effects: torque law and discrete realisation agree; bad parameters are refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.records import sentence
from twin_diagram.model import effects
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.parameter_vector import numeric_sensitivity, sensitivity, vector, with_vector
from twin_diagram.model.effects.simulated.realisation import realisations
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec

ARM = "arms/panda.urdf"
JOINTS = [f"panda_joint{i + 1}" for i in range(7)]
HOME = np.array([0.1, -0.4, 0.2, -1.9, 0.1, 1.6, 0.3])

EFFECTS = {
    "viscous_friction": EffectSpec("viscous_friction", ["panda_joint2", "panda_joint6"], [], {"damping": [4.0, 1.5]}),
    "coulomb_friction": EffectSpec("coulomb_friction", ["panda_joint4", "panda_joint7"], [], {"torque": [6.0, 1.0]}),
    "coulomb_friction two-sided": EffectSpec(
        "coulomb_friction", ["panda_joint4"], [], {"torque_positive": [5.0], "torque_negative": [2.0]}
    ),
    "payload": EffectSpec("payload", [], [], {"mass": [1.7], "com": [0.05, -0.02, 0.1]}),
    "payload on link 4": EffectSpec("payload", [], ["panda_link4"], {"mass": [2.0], "com": [0.1, 0.0, 0.0]}),
    "reflected_inertia": EffectSpec("reflected_inertia", ["panda_joint1", "panda_joint5"], [], {"inertia": [0.7, 0.2]}),
    "torque_bias": EffectSpec("torque_bias", ["panda_joint3"], [], {"torque": [-2.5]}),
    "joint_spring": EffectSpec("joint_spring", ["panda_joint2"], [], {"stiffness": [300.0], "rest_angle": [-0.2]}),
    "joint_spring curve": EffectSpec(
        "joint_spring", ["panda_joint2"], [], {"curve": [-1.5, -0.5, -0.2, 0.5, -20.0, -5.0, 10.0, 12.0]}
    ),
    "stribeck_friction": EffectSpec(
        "stribeck_friction",
        ["panda_joint1", "panda_joint6"],
        [],
        {"coulomb": [3.0, 1.0], "static": [6.0, 1.5], "stribeck_velocity": [0.2, 0.15]},
    ),
    "stribeck_friction rising": EffectSpec(
        "stribeck_friction",
        ["panda_joint1", "panda_joint6"],
        [],
        {"coulomb": [6.0, 1.5], "static": [3.0, 1.0], "stribeck_velocity": [0.2, 0.15]},
    ),
    "load_dependent_friction": EffectSpec("load_dependent_friction", ["panda_joint2"], [], {"coefficient": [0.15]}),
    "coupled_friction": EffectSpec(
        "coupled_friction", ["panda_joint5", "panda_joint6"], [], {"damping": [0.8], "torque": [1.2]}
    ),
    "inertial_parameters": EffectSpec(
        "inertial_parameters",
        [],
        ["panda_link4"],
        {"mass": [-0.8], "com": [0.02, 0.03, -0.04], "inertia": [0.01, 0.02, 0.015, 0.001, -0.002, 0.003]},
    ),
    "torque_ripple": EffectSpec(
        "torque_ripple",
        ["panda_joint2", "panda_joint4"],
        [],
        {"amplitude": [2.0, 1.0], "cycles": [24.0, 40.0], "phase": [0.3, -1.0]},
    ),
    "torque_constant": EffectSpec("torque_constant", ["panda_joint2", "panda_joint4"], [], {"gain": [0.8, 1.3]}),
    "torque_saturation": EffectSpec("torque_saturation", ["panda_joint2"], [], {"limit": [18.0]}),
    "actuator_fault": EffectSpec("actuator_fault", ["panda_joint4"], [], {"gain": [0.6]}),
    "encoder_offset": EffectSpec("encoder_offset", ["panda_joint2"], [], {"offset": [0.05]}),
    "external_force": EffectSpec(
        "external_force", [], ["panda_link5"], {"wrench": [8.0, -5.0, 6.0, 0.5, 1.0, -1.5], "point": [0.1, -0.2, 0.3]}
    ),
    "gravity_tilt": EffectSpec("gravity_tilt", [], [], {"roll": [0.06], "pitch": [-0.09]}),
}


class Signal(LeafSystem):
    """Any function of time as a vector."""

    def __init__(self, function: Callable[[float], Any], size: int) -> None:
        super().__init__()

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(function(context.get_time()))

        self.DeclareVectorOutputPort("value", size, calc, {self.time_ticket()})


def reference(t: float) -> tuple[np.ndarray, np.ndarray]:
    k = np.arange(1, 8)
    amplitude = 0.35 - 0.02 * k
    w = 2.0 + 0.7 * k
    return HOME + amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)


def simulate(
    specs: list[EffectSpec], dt: float, duration: float = 1.0, *, follow: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A discrete plant with effects that follows the reference; answers steps of q, v and the torque logged in each."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, dt)
    arm = add_arm(plant, scenario.ArmModel(model=ARM, tool_frame="", effects=specs))
    fitted = effects.add_to_plant(plant, arm)
    for index in arm.actuator_indices:
        plant.get_joint_actuator(index).set_controller_gains(PdControllerGains(p=2000.0 * follow, d=80.0 * follow))
        plant.get_joint_actuator(index).set_effort_limit(1e4)
    plant.Finalize()
    motors = effects.connect(builder, plant, arm, fitted)
    desired = builder.AddSystem(Signal(lambda t: np.concatenate(reference(t)), 14))
    torque = builder.AddSystem(Signal(lambda t: 3.0 * np.sin(5.0 * t + np.arange(7)), 7))
    builder.Connect(desired.get_output_port(), motors.desired_state)
    builder.Connect(torque.get_output_port(), motors.torque)
    state_log = LogVectorOutput(plant.get_state_output_port(arm.instances[0]), builder, dt)
    torque_log = LogVectorOutput(motors.torque_logged, builder, dt)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    q, v = reference(0.0)
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), arm.instances[0], q)
    plant.SetVelocities(plant.GetMyMutableContextFromRoot(context), arm.instances[0], v * follow)
    simulator.AdvanceTo(duration)
    states = state_log.FindLog(context).data().T
    torques = torque_log.FindLog(context).data().T
    # Sampled outputs show the state before the step that ends now, and the actuation that was applied in it.
    return states[:, :7], states[:, 7:], torques


def realised(specs: list[EffectSpec], dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torque that the effects cost in the discrete plant, what their law says, and the speeds; each (steps, 7).

    A step is M(q_k) (v_{k+1} − v_k)/dt + loads = τ: rigid loads are those of its start, brakes, dampers and springs
    (all that the plant solves for) those of its end.
    """
    q, v, tau = simulate(specs, dt)
    model = Model.load(scenario.ArmModel(model=ARM, tool_frame="", effects=specs))
    a = (v[1:] - v[:-1]) / dt
    rigid = model.with_effects([]).inverse_dynamics(q[:-1], v[:-1], a)
    at_start = all(e.name in EXPLICIT or "curve" in e.parameters for e in specs)
    moment = slice(None, -1) if at_start else slice(1, None)
    total, arrived = rigid, tau[1:]
    for effect in model.effects:
        total = total + effect.torque(model.bodies, q[moment], v[moment], a, rigid)
        if effect.loses:
            total, arrived = total + arrived - effect.applied(model.joints, arrived), np.zeros_like(arrived)
        else:
            total = effect.logged(model.joints, total)
    return (tau[1:] - rigid)[1:], (total - rigid)[1:], v[2:]


EXPLICIT = (
    "payload",
    "torque_bias",
    "gravity_tilt",
    "inertial_parameters",
    "torque_ripple",
    "external_force",
    "coupled_friction",
    "load_dependent_friction",
)
"""Effects that a plant takes from the start of its step."""

LATE = {"coupled_friction": 0.98, "load_dependent_friction": 0.98}
"""Share of samples that are looked at: these brakes need some steps to turn round."""

LOOSE = {"stribeck_friction": 20.0, "stribeck_friction rising": 6.0, "load_dependent_friction": 100.0}
"""Times that a realisation is less exact than the others: levels are those of the step before."""


@pytest.mark.parametrize("name", [name for name in EFFECTS if name != "encoder_offset"])
@pytest.mark.parametrize("dt", [pytest.param(0.0005, marks=pytest.mark.slow), 0.002, 0.004])
def test_realisation_follows_the_law(name: str, dt: float) -> None:
    cost, law, v = realised([EFFECTS[name]], dt)
    size = np.sqrt(np.mean(law**2, axis=0)).max()
    assert size > 0.5, "the effect must matter in the test"
    speed = v.copy()
    if name == "coupled_friction":
        speed[:, 4:6] = speed[:, 4:6].sum(axis=1, keepdims=True)
    moving = np.abs(speed) > 0.02  # below, the smooth law of dry friction is rounded on purpose
    error = np.abs(cost - law) * moving
    assert np.quantile(error[5:], LATE.get(name, 0.999)) < 1e-3 * size * LOOSE.get(name, 1.0) * max(1.0, dt / 0.001)


def test_dry_friction_holds_at_rest() -> None:
    """Below its level a joint creeps by a small share of what one free step would give it (the solver's softness)."""
    spec = EffectSpec("coulomb_friction", JOINTS, [], {"torque": [100.0] * 7})
    dt = 0.002
    q, v, _ = simulate([spec], dt, duration=0.5, follow=False)
    model = Model.load(scenario.ArmModel(model=ARM, tool_frame=""))
    load = np.abs(model.bias(q[0], np.zeros(7))) + 3.0
    free = dt * load.max() * np.diag(np.linalg.inv(model.mass_matrix(q[0])))
    assert np.all(np.abs(v) < 4e-4 * free)


def test_friction_that_rises_with_speed_lets_go_at_its_level_at_rest() -> None:
    """And then creeps, as fast as brings it up to the torque: 3 N·m of 100 at a sixth of the speed."""
    values = {"coulomb": [100.0] * 7, "static": [0.1] * 7, "stribeck_velocity": [0.3] * 7}
    _, v, _ = simulate([EffectSpec("stribeck_friction", JOINTS, [], values)], 0.002, duration=0.3, follow=False)
    creep = 0.3 * np.sqrt(-np.log(1.0 - 3.0 / 100.0))
    assert 0.9 * creep < np.abs(v[:, 6]).max() < 1.05 * creep
    assert np.abs(v[:, 1]).max() > 0.1, "under its own weight"


def test_all_at_once() -> None:
    specs = [EFFECTS[name] for name in ("payload", "viscous_friction", "reflected_inertia", "torque_bias")]
    cost, law, _ = realised(specs, 0.0005)
    assert np.sqrt(np.mean((cost - law) ** 2)) < 5e-3 * np.sqrt(np.mean(law**2))


def test_logged_torque_is_the_plants_own_where_nothing_is_added() -> None:
    """`Drive` works the motor's torque out again; without brakes the plant reports it."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
    arm = add_arm(plant, scenario.ArmModel(model="arms/panda_hand.urdf"))
    for index in (*arm.actuator_indices, *arm.gripper_actuator_indices):
        plant.get_joint_actuator(index).set_controller_gains(PdControllerGains(p=900.0, d=30.0))
    plant.Finalize()
    motors = effects.connect(builder, plant, arm, ())
    desired = builder.AddSystem(Signal(lambda t: np.concatenate(reference(10.0 * t)), 14))
    fingers = builder.AddSystem(Signal(lambda t: [0.02 + 0.1 * t, 0.03, 0.1, 0.0], 4))
    builder.Connect(desired.get_output_port(), motors.desired_state)
    builder.Connect(fingers.get_output_port(), motors.gripper_desired_state)
    logs = [
        LogVectorOutput(port, builder, 0.002)
        for port in (
            motors.torque_logged,
            motors.gripper_torque_logged,
            plant.get_net_actuation_output_port(arm.instances[0]),
        )
    ]
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    own, gripper, net = (log.FindLog(simulator.get_context()).data() for log in logs)
    np.testing.assert_allclose(np.vstack([own, gripper]), net, atol=1e-9)
    assert np.any(np.abs(own) >= 87.0 - 1e-9), "the test is to saturate a motor"


@pytest.mark.parametrize("name", EFFECTS)
def test_change_and_torque_are_the_same_law(name: str) -> None:
    """What an effect folds into the rigid model is what its torque law says."""
    rng = np.random.default_rng(1)
    q, v, a = rng.normal(size=(3, 40, 7))
    model = Model.load(scenario.ArmModel(model=ARM, tool_frame="", effects=[EFFECTS[name]]))
    bare = model.with_effects([])
    effect = model.effects[0]
    q_true = effect.true_position(model.joints, q)
    rigid = bare.inverse_dynamics(q_true, v, a)
    law = effect.logged(model.joints, rigid + effect.torque(model.bodies, q_true, v, a, rigid))
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), law, atol=1e-10)


@pytest.mark.parametrize("name", EFFECTS)
def test_sensitivity(name: str) -> None:
    rng = np.random.default_rng(2)
    q, v, a = rng.normal(size=(3, 30, 7))
    model = Model.load(scenario.ArmModel(model=ARM, tool_frame="", effects=[EFFECTS[name]]))
    effect, tau = model.effects[0], np.zeros_like(q)
    numeric = numeric_sensitivity(effect, model.bodies, q, v, a, tau)
    np.testing.assert_allclose(sensitivity(effect, model.bodies, q, v, a, tau), numeric, atol=1e-6)
    assert numeric.shape == (30, 7, len(vector(effect)))
    np.testing.assert_array_equal(vector(with_vector(effect, vector(effect))), vector(effect))


@pytest.mark.parametrize("name", EFFECTS)
def test_spec_round_trip_and_sentence(name: str) -> None:
    effect = effects.make(EFFECTS[name])
    again = effects.make(effects.spec_of(effect))
    assert effects.spec_of(again) == effects.spec_of(effect)
    assert len(sentence(effect)) > 10
    assert all(joint in sentence(effect) for joint in effect.joints)


@given(
    st.floats(0.0, 1e4), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.sampled_from([2.0, 0.1])
)
def test_payload_is_never_unphysical(mass: float, x: float, y: float, z: float, scale: float) -> None:
    vector = effects.inertia.point_mass(mass, scale * np.array([x, y, z]))
    xx, yy, zz, xy, xz, yz = vector[4:]
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = np.linalg.eigvalsh(tensor)
    assert moments[0] >= -1e-9 * (1.0 + mass)
    assert moments[0] + moments[1] >= moments[2] - 1e-9 * (1.0 + mass)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_curve_is_continuous_and_monotone(x: float, y: float) -> None:
    spring = effects.make(EFFECTS["joint_spring curve"])
    assert isinstance(spring, effects.transmission.JointSpring)
    low, high = spring.curve()(np.array(sorted([x, y])))
    assert low <= high + 1e-12
    assert abs(high - low) <= 100.0 * abs(x - y) + 1e-12


BAD = {
    "no effect is called 'stiction'": EffectSpec("stiction", ["panda_joint1"], [], {}),
    "effects.viscous_friction.damping: is missing": EffectSpec("viscous_friction", ["panda_joint1"], [], {}),
    "within": EffectSpec("viscous_friction", ["panda_joint1"], [], {"damping": [-1.0]}),
    "not finite": EffectSpec("torque_bias", ["panda_joint1"], [], {"torque": [float("nan")]}),
    "needs 2 value": EffectSpec("viscous_friction", ["panda_joint1", "panda_joint2"], [], {"damping": [1.0]}),
    "no such parameter": EffectSpec("viscous_friction", ["panda_joint1"], [], {"damp": [1.0]}),
    "name the joints": EffectSpec("viscous_friction", [], [], {"damping": []}),
    "named twice": EffectSpec("viscous_friction", ["panda_joint1"] * 2, [], {"damping": [1.0, 1.0]}),
    "give `torque`": EffectSpec("coulomb_friction", ["panda_joint1"], [], {"torque_positive": [1.0]}),
    "rising angles": EffectSpec("joint_spring", ["panda_joint1"], [], {"curve": [1.0, 0.0, 3.0, 4.0]}),
    "a curve is one joint's": EffectSpec("joint_spring", JOINTS[:2], [], {"curve": [0.0, 1.0, 3.0, 4.0]}),
    "no joint 'elbow'": EffectSpec("viscous_friction", ["elbow"], [], {"damping": [1.0]}),
    "no link 'hook'": EffectSpec("payload", [], ["hook"], {"mass": [1.0]}),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_effects_are_refused(message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Model.load(scenario.ArmModel(model=ARM, tool_frame="", effects=[BAD[message]]))


def test_a_users_own_effect() -> None:
    """One class and one registration line."""

    class QuadraticDrag(effects.Effect):
        name = "quadratic_drag_of_a_test"
        kinds = {"coefficient": effects.ParameterKind("N·m·s²/rad²", lower=0.0)}  # noqa: RUF012

        def torque(self, model: Model, q: Any, v: Any, a: Any, tau: Any) -> Any:
            return self.spread(model.joints, self.value("coefficient")) * v * np.abs(v)

    effects.register(QuadraticDrag)
    try:
        spec = EffectSpec("quadratic_drag_of_a_test", ["panda_joint1"], [], {"coefficient": [2.0]})
        model = Model.load(scenario.ArmModel(model=ARM, tool_frame="", effects=[spec]))
        v = np.full((30, 7), -3.0)
        zero = np.zeros_like(v)
        difference = model.inverse_dynamics(zero, v, zero) - model.with_effects([]).inverse_dynamics(zero, v, zero)
        np.testing.assert_allclose(difference[:, 0], -18.0, rtol=1e-12)
        assert not np.any(difference[:, 1:])
    finally:
        del effects.REGISTRY["quadratic_drag_of_a_test"]


def test_a_class_is_realised_as_its_nearest_base_that_says_how() -> None:
    class Sticky(CoulombFriction):
        """Inherits the law and, in a plant, the actuators that hold the joint."""

    class Pushed(effects.Effect):
        """Has a realisation of its own."""

    @effects.realises(Pushed)
    class Push(effects.Realisation[Pushed]):
        def fittings(self) -> list[effects.Fitting]:
            return [effects.Fitting(f"{self.effect.joints[0]}_push", self.effect.joints[0], torque=1.0)]

    sticky = effects.make(EFFECTS["coulomb_friction"])
    inherited = Sticky(sticky.joints, (), sticky.parameters)
    assert effects.realisation(inherited).fittings() == effects.realisation(sticky).fittings()
    first, second = realisations([Pushed(["a"]), Pushed(["a"])])
    assert isinstance(first, Push) and not effects.realisation(effects.Effect(["a"])).fittings()
    assert [each.marked_fittings()[0].name for each in (first, second)] == ["a_push", "a_push_2"]


def test_two_contexts_do_not_influence_each_other() -> None:
    """The same diagram, alone and with another run of it in between, gives the same to the bit."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
    specs = [EFFECTS["coulomb_friction"], EFFECTS["joint_spring curve"]]
    arm = add_arm(plant, scenario.ArmModel(model=ARM, tool_frame="", effects=specs))
    fitted = effects.add_to_plant(plant, arm)
    plant.Finalize()
    motors = effects.connect(builder, plant, arm, fitted)
    builder.ExportInput(motors.torque, "torque")
    builder.ExportOutput(motors.torque_logged, "torque_logged")
    diagram = builder.Build()

    def start(torque: float) -> Simulator:
        simulator = Simulator(diagram)
        diagram.get_input_port(0).FixValue(simulator.get_mutable_context(), np.full(7, torque))
        return simulator

    def result(simulator: Simulator) -> np.ndarray:
        context = simulator.get_context()
        logged = diagram.get_output_port(0).Eval(context)
        return np.concatenate([context.get_discrete_state(0).value(), logged])

    alone = start(1.0)
    alone.AdvanceTo(0.05)
    first, second = start(1.0), start(-2.0)
    for time in (0.013, 0.03, 0.05):
        first.AdvanceTo(time)
        second.AdvanceTo(time)
    np.testing.assert_array_equal(result(first), result(alone))
    np.testing.assert_array_equal(result(first)[-7:], 1.0)
    assert np.max(np.abs(result(second) - result(first))) > 0.1


def test_curve_goes_on_with_its_mean_slope() -> None:
    """Beyond its ends: no jump, no kink, and far away the mean slope rather than that of a piece which bends."""
    spec = EffectSpec("joint_spring", ["a"], [], {"curve": [0.0, 0.2, 0.4, 0.6, 0.8, 0.0, 2.0, 4.0, 6.0, 1.0]})
    spring = effects.make(spec)
    assert isinstance(spring, JointSpring)
    law, h = spring.curve(), 1e-6
    for end in (0.0, 0.8):
        before, at, after = law(np.array([end - h, end, end + h]))
        assert abs(after - 2.0 * at + before) / h < 1e-3
    mean = np.polyfit(np.linspace(0.0, 0.8, 5), [0.0, 2.0, 4.0, 6.0, 1.0], 1)[0]
    for far in (np.array([-2.0, -1.9]), np.array([2.8, 2.9])):
        np.testing.assert_allclose(np.diff(law(far))[0] / 0.1, mean, rtol=1e-3)


@pytest.mark.parametrize("specs", list(itertools.permutations(range(3))))
def test_a_constant_torque_comes_beside_what_the_motor_gives(specs: tuple[int, ...]) -> None:
    """In whatever order a model lists them, as in a plant, where it has an actuator of its own."""
    joint = "panda_joint4"
    listed = [
        EffectSpec("torque_bias", [joint], [], {"torque": [4.0]}),
        EffectSpec("torque_constant", [joint], [], {"gain": [0.5]}),
        EffectSpec("torque_saturation", [joint], [], {"limit": [6.0]}),
    ]
    bare = Model.load(scenario.ArmModel(model=ARM, tool_frame=""))
    model = bare.with_effects([effects.make(listed[k]) for k in specs])
    tau = np.zeros(7)
    for logged, gained in ((2.0, 1.0), (-3.0, -1.5)):
        tau[3] = logged
        assert model.applied(tau)[3] == pytest.approx(gained + 4.0)
