"""A known offset of an encoder is taken off at the twin's door: scene, planner and own controllers get true angles."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.small_loop import BLIND, small_scenario
from twin_diagram.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.true_angles import behind_door, offset_of

JOINTS = ["panda_joint2", "panda_joint4"]
OFFSET = np.array([0.0, 0.05, 0.0, -0.03, 0.0, 0.0, 0.0])
HIDDEN = EffectSpec("encoder_offset", JOINTS, [], {"offset": [0.05, -0.03]})


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(ArmModel("arms/panda_hand.urdf", effects=[HIDDEN]))


def loop_with(*effects: EffectSpec, mends: bool = False) -> ClosedLoop:
    more = ("twin.healing.seconds=16",) if mends else ()
    plan = small_scenario(*BLIND, "world.arm.effects=[]", *more, objects=())
    plan.world.arm.effects.append(HIDDEN)
    plan.twin.arm.effects.extend(effects)
    return make_closed_loop(plan)


@pytest.fixture(scope="module")
def told() -> tuple[ClosedLoop, Simulator]:
    loop = loop_with(HIDDEN)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.5)
    return loop, simulator


def port(loop: ClosedLoop, simulator: Simulator, system: str, name: str) -> Array:
    inside = loop.station if system == "station" else loop.twin.diagram
    own = inside.GetMyContextFromRoot(simulator.get_context())
    return np.array(inside.GetOutputPort(name).Eval(own))


def test_the_arms_state_is_where_the_joints_are(told: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = told
    true = port(loop, simulator, "station", ports.ARM_STATE)[:7]
    assert np.abs(port(loop, simulator, "station", ports.POSITION_MEASURED) - true - OFFSET).max() < 1e-3
    believed = port(loop, simulator, "twin", "arm_state")[:7]
    assert np.abs(believed - true).max() < 1e-3
    hands = [loop.model.tool_pose(q).translation() for q in (believed, true)]
    assert np.linalg.norm(hands[0] - hands[1]) < 1e-3, "50 mrad that stay are 30 mm here"


def test_commands_leave_as_encoders_read(told: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = told
    commanded = port(loop, simulator, "twin", ports.POSITION_COMMANDED)
    assert np.abs(commanded - port(loop, simulator, "station", ports.POSITION_MEASURED)).max() < 0.02
    plan = port(loop, simulator, "twin", "plan")[:7]
    assert np.abs(commanded - plan - OFFSET).max() < 0.02


def test_a_twin_without_offsets_has_no_door() -> None:
    names = {system.get_name() for system in loop_with().twin.diagram.GetSystems()}
    assert not names & {"true_position", "measured_position_commanded"}


@pytest.fixture(scope="module")
def mending(model: Model) -> tuple[ClosedLoop, Simulator, Simulator]:
    """One Diagram, and two Contexts half a second on; a model that knows the offset was found meanwhile."""
    loop = loop_with(mends=True)
    first, second = Simulator(loop.diagram), Simulator(loop.diagram)
    for simulator in (first, second):
        simulator.AdvanceTo(0.5)
    assert loop.twin.add_model(model) == 1
    return loop, first, second


@pytest.mark.long
def test_an_offset_that_is_found_while_it_runs_reaches_everything(
    mending: tuple[ClosedLoop, Simulator, Simulator],
) -> None:
    """The arm's state is where the joints are at once and from then on, and the arm is not jerked."""
    loop, simulator, _ = mending
    own = loop.twin.diagram.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    true = port(loop, simulator, "station", ports.ARM_STATE)[:7]
    assert np.abs(port(loop, simulator, "twin", "arm_state")[:7] - true - OFFSET).max() < 1e-3
    before = port(loop, simulator, "twin", ports.POSITION_COMMANDED)
    loop.twin.use_model(own, 1)
    np.testing.assert_allclose(port(loop, simulator, "twin", ports.POSITION_COMMANDED), before, atol=1e-9)
    monitor = loop.twin.monitor
    assert monitor is not None
    inner = loop.twin.diagram.GetSubsystemContext(monitor, own)
    assert monitor.model_number(inner) == 1, "it stops by the corrected model, too, and by what is carried"
    learnt = np.array(monitor.GetInputPort("parameters").Eval(inner))
    np.testing.assert_array_equal(learnt, port(loop, simulator, "twin", "parameters"))
    assert np.abs(port(loop, simulator, "twin", "arm_state")[:7] - true).max() < 1e-3
    for time in 0.5 + 0.02 * np.arange(1, 16):
        simulator.AdvanceTo(time)
        true = port(loop, simulator, "station", ports.ARM_STATE)[:7]
        assert np.abs(port(loop, simulator, "twin", "arm_state")[:7] - true).max() < 2e-3
        commanded = port(loop, simulator, "twin", ports.POSITION_COMMANDED)
        assert np.abs(commanded - before).max() < 0.02 * 2.0, "no faster than 2 rad/s"
        before = commanded
    assert loop.twin.brakes(own) == []


def test_another_context_keeps_its_door(mending: tuple[ClosedLoop, Simulator, Simulator]) -> None:
    loop, _, other = mending
    true = port(loop, other, "station", ports.ARM_STATE)[:7]
    assert np.abs(port(loop, other, "twin", "arm_state")[:7] - true - OFFSET).max() < 1e-3
    own = loop.twin.diagram.GetMyMutableContextFromRoot(other.get_mutable_context())
    state = port(loop, other, "twin", "arm_state")
    loop.twin.use_model(own, 1)
    loop.twin.use_model(own, 0)  # and back
    np.testing.assert_allclose(port(loop, other, "twin", "arm_state"), state, atol=1e-9)


def test_behind_the_door_the_model_takes_true_angles(model: Model) -> None:
    rng = np.random.default_rng(3)
    q, v, a = 0.4 * rng.standard_normal((3, 5, 7))
    inside = behind_door(model, offset_of(model))
    np.testing.assert_allclose(offset_of(model), OFFSET)
    assert not offset_of(inside).any()
    given, expected = model.inverse_dynamics(q + OFFSET, v, a), inside.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(given, expected, atol=1e-9)


def test_what_a_corrected_model_knows_beyond_the_door_stays_in_it(model: Model) -> None:
    """A corrected model may know of another offset, or of none."""
    q, still = np.array([0.1, -0.5, 0.3, -2.0, 0.2, 1.5, 0.4]), np.zeros(7)
    for offset in (0.5 * OFFSET, OFFSET[::-1]):
        inside = behind_door(model, offset)
        np.testing.assert_allclose(offset_of(inside), OFFSET - offset)
        np.testing.assert_allclose(inside.bias(q - offset, still), model.bias(q, still), atol=1e-9)
    bare = model.with_effects([])
    assert behind_door(bare, np.zeros(7)) is bare
