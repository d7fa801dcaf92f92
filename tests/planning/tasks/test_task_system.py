"""The system around the steps: what it takes in, what it puts out, and its Contexts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from tests.planning.tasks.small_world import DOWN, pose
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.model import Model
from twin_diagram.planning.tasks.step_state import Phase, TaskOutcome, TaskState, Why
from twin_diagram.planning.tasks.step_view import PackedRows, Takeable
from twin_diagram.planning.tasks.task_system import Fingers, TaskRunner
from twin_diagram.planning.tasks.watching_hand import watched
from twin_diagram.scenario import load_scenario
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.hand import HAND_SIZE, Hand
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement, Track
from twin_diagram.signals.pose_vectors import from_matrix
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, THING_SIZE, Thing

TASK = "twin.task=[{kind: pick, object: can, force: 25}, {kind: hold, seconds: 0.2}]"
HOME = np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.785])


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(scenario.ArmModel())


@pytest.fixture(scope="module")
def runner(model: Model) -> TaskRunner:
    library = {"can": Asset.load(models_dir() / "objects" / "can")}
    fingers = Fingers(np.zeros(2), np.zeros(2), np.full(2, 0.04))
    plan = load_scenario("tabletop", [TASK])
    plan.twin.library = {"can": plan.twin.library["can"]}
    return TaskRunner(model, plan.twin, library, fingers)


class Run:
    """The system alone, its inputs set by hand."""

    def __init__(self, runner: TaskRunner, model: Model) -> None:
        self.runner, self.model = runner, model
        self.simulator = Simulator(runner)
        self.context = self.simulator.get_mutable_context()
        self.put(measurement_time=[0.0], arm_state=np.concatenate([HOME, np.zeros(7)]))
        self.fingers(0.0)
        X_WT = from_matrix(model.tool_pose(HOME).GetAsMatrix4())
        self.show(X_WT + np.array([0, 0, 0, 0, 0, 0.2, -0.1]))

    def put(self, **values: Any) -> None:
        for name, value in values.items():
            self.runner.GetInputPort(name).FixValue(self.context, np.array(value, dtype=float))

    def fingers(self, q: float, v: float = 0.0) -> None:
        self.put(gripper_state=[q, q, v, v])

    def show(self, X_WO: np.ndarray) -> None:
        now = self.context.get_time()
        flat = np.array([1.0, 0, 0, 0, *X_WO[4:]])
        self.put(tracks=Track(ObjectStatus.TRACKED, now, flat, np.zeros(6), 1e-6 * np.eye(6)).pack())
        self.put(object_poses=PoseMeasurement(1.0, now, flat, 1e-6 * np.eye(6)).pack())

    def to(self, time: float) -> None:
        self.simulator.AdvanceTo(time)

    def get(self, name: str) -> np.ndarray:
        return np.array(self.runner.GetOutputPort(name).Eval(self.context))


def test_rows_are_unpacked_once_and_only_those_that_are_asked_for() -> None:
    seen: list[float] = []

    def unpack(row: np.ndarray) -> float:
        seen.append(float(row[0]))
        return float(row[0])

    given = np.arange(8.0).reshape(4, 2)
    rows = PackedRows(given, unpack)
    given[:] = 0.0
    assert len(rows) == 4 and rows[1] == 2.0 and rows[1] == 2.0 and seen == [2.0]
    assert rows[2:] == [4.0, 6.0] and list(rows) == [0.0, 2.0, 4.0, 6.0] and len(seen) == 4
    with pytest.raises(IndexError):
        rows[4]


def test_nothing_begins_before_start_or_the_arms_first_message(runner: TaskRunner, model: Model) -> None:
    run = Run(runner, model)
    run.to(0.45)
    assert run.get("outcome")[2] == Phase.START
    assert np.isnan(run.get("gripper_force_limit")[0])
    np.testing.assert_array_equal(run.get("gripper_position_commanded"), [0.0, 0.0])
    late = Run(runner, model)
    late.put(measurement_time=[NEVER])
    late.to(0.7)
    assert late.get("outcome")[2] == Phase.START
    odd = Run(runner, model)
    odd.put(arm_state=np.full(14, np.nan))
    odd.to(0.7)
    assert odd.get("outcome")[2] == Phase.START


def test_where_it_goes_first_is_told_before_it_begins(runner: TaskRunner, model: Model) -> None:
    run = Run(runner, model)
    run.to(0.3)
    told = run.get("next_goal")
    assert told[4:6] == pytest.approx(model.tool_pose(HOME).translation()[:2] + [0.0, 0.2], abs=1e-3)
    assert run.get("next_pause")[0] == pytest.approx(0.2, abs=0.04)
    assert Hand.unpack(run.get("next_hand")).held == -1
    assert not run.get("goal").any()


def test_it_opens_then_goes_above_the_object(runner: TaskRunner, model: Model) -> None:
    run = Run(runner, model)
    run.to(0.6)
    assert run.get("outcome").tolist() == [TaskOutcome.RUNNING, 0.0, Phase.LOOK]
    np.testing.assert_array_equal(run.get("gripper_position_commanded"), [0.04, 0.04])
    assert run.get("gripper_force_limit").tolist() == [25.0]
    assert not run.get("goal").any()
    run.fingers(0.04)
    run.to(0.8)
    assert run.get("outcome")[2] == Phase.LOOK, "an image of before the step is too old to reach by"
    run.show(from_matrix(model.tool_pose(HOME).GetAsMatrix4()) + np.array([0, 0, 0, 0, 0, 0.2, -0.1]))
    run.to(1.0)
    assert run.get("outcome")[2] == Phase.APPROACH
    goal = run.get("goal")
    assert goal[4:6] == pytest.approx(model.tool_pose(HOME).translation()[:2] + [0.0, 0.2], abs=1e-3)
    assert run.get("hand").shape == (HAND_SIZE,) and Hand.unpack(run.get("hand")).held == -1
    told = run.runner.told(run.context)
    assert [(entry["step"], entry["kind"], entry["object"], entry["what"]) for entry in told] == [
        (0, "pick", "can", "started")
    ]
    assert told[0]["time"] == pytest.approx(0.5, abs=0.04)
    assert run.runner.standing(run.context) == {"outcome": "running", "steps": 2, "done": 0, "phase": "approach"}


def test_a_tool_that_moves_has_not_arrived(runner: TaskRunner, model: Model) -> None:
    """The speed is that of the tool, as the joints' speeds make it."""
    run = Run(runner, model)
    run.to(0.55)
    spinning = np.concatenate([HOME, [0.1, 0, 0, 0, 0, 0, 0]])
    run.put(arm_state=spinning)
    seen = runner._seen(run.context)
    p = model.tool_pose(HOME).translation()
    assert seen is not None and seen.speed == pytest.approx(0.1 * np.hypot(p[0], p[1]))


def test_a_perception_s_pose_that_is_no_number_shows_nothing(runner: TaskRunner, model: Model) -> None:
    """Of a user's own: a covariance of NaN ended the run in a traceback."""
    run = Run(runner, model)
    run.put(object_poses=PoseMeasurement(1.0, 0.5, HOME, np.full((6, 6), np.nan)).pack())
    run.to(0.55)
    seen = runner._seen(run.context)
    assert seen is not None and seen.measured[0].quality == 0.0 and np.isfinite(seen.measured[0].pack()).all()
    hand = Hand(0, -1, True, np.array([1.0, 0, 0, 0, 0, 0, 0]), 1e-6 * np.eye(6))
    state = replace(TaskState(), hand=hand, image=0.0)
    can = Takeable((np.eye(3),), False)
    assert watched(state, replace(seen, opening=0.02), can)[1] is Why.NONE


def test_things_instances_and_assets_that_came_later_stand_beside(model: Model) -> None:
    """What an unknown thing's velocity has carried it by counts; what is gone, or free, or no number does not."""
    library = {"can": Asset.load(models_dir() / "objects" / "can")}
    plan = load_scenario("tabletop", [TASK])
    plan.twin.library = {"can": plan.twin.library["can"]}
    runner = TaskRunner(model, plan.twin, library, Fingers(np.zeros(2), np.zeros(2), np.full(2, 0.04)))
    runner.add_asset(Asset.load(models_dir() / "objects" / "sugar_box"))
    run = Run(runner, model)
    further = np.zeros((plan.twin.slots.further(1), FURTHER_TRACK_SIZE))
    for row, kind, status in zip(
        further, (1, 0, 7), (ObjectStatus.TRACKED, ObjectStatus.GONE, ObjectStatus.TRACKED), strict=False
    ):
        row[:OWNER_SIZE] = [kind + 1, kind]
        row[OWNER_SIZE:] = Track(status, 0.0, pose(0.4, 0.2, 0.1), np.zeros(6), np.zeros((6, 6))).pack()
    thing = Thing(5, ObjectStatus.TRACKED, 0.0, 0.0, np.zeros(3), (np.eye(4, 3),), shift=np.array([0.0, 0.5, 0.0]))
    things = np.zeros((plan.twin.slots.unknown, THING_SIZE))
    things[2] = thing.pack()
    run.put(further_tracks=further.ravel(), things=things.ravel())
    seen = runner._seen(run.context)
    assert seen is not None
    box, lump = seen.beside.corners()
    np.testing.assert_allclose(box.max(axis=0) - box.min(axis=0), [0.09, 0.045, 0.175], atol=1e-3)
    np.testing.assert_allclose(lump, np.eye(4, 3) + [0.0, 0.5, 0.0])
    run.put(things=np.full(things.size, np.nan))
    seen = runner._seen(run.context)
    assert seen is not None and len(seen.beside.corners()) == 1


def test_two_contexts_do_not_know_of_each_other(runner: TaskRunner, model: Model) -> None:
    """One that stands still, and two that go the same way to the bit."""
    idle, first, second = (Run(runner, model) for _ in range(3))
    for run in (first, second):
        run.to(0.6)
        run.fingers(0.04)
        run.to(1.2)
    assert idle.get("outcome")[2] == Phase.START
    idle.to(0.6)
    assert idle.get("outcome")[2] == Phase.LOOK
    for name in ("goal", "outcome", "hand", "notes", "step"):
        assert first.get(name).tobytes() == second.get(name).tobytes()


@pytest.mark.parametrize(
    ("arm", "widest"), [("arms/panda_hand.urdf", 0.08), ("arms/iiwa7_wsg.urdf", 0.11), ("arms/ur5e.urdf", 0.0)]
)
def test_fingers_meet_where_they_have_no_travel_left(arm: str, widest: float) -> None:
    plant = MultibodyPlant(0.0)
    made = add_arm(plant, scenario.ArmModel(model=arm, tool_frame=""))
    plant.Finalize()
    described = np.full(len(made.gripper_joint_indices), 0.011)
    fingers = Fingers.of(plant, made, described)
    assert fingers.widest == pytest.approx(widest)
    assert fingers.opening(fingers.at(0.0)) == 0.0
    assert fingers.opening(fingers.at(0.5)) == pytest.approx(0.5 * widest)
    np.testing.assert_array_equal(fingers.at(-1.0), described)


def test_a_pick_without_a_gripper_is_refused(model: Model) -> None:
    plan = load_scenario("tabletop", ["twin.task=[{kind: hold}, {kind: pick, object: can}]"])
    none = Fingers(*(np.zeros(0) for _ in range(3)))
    with pytest.raises(ScenarioError, match=r"twin\.task\.steps\.1\.kind: .*gripper"):
        TaskRunner(model, plan.twin, {"can": Asset.load(models_dir() / "objects" / "can")}, none)


def test_the_goal_is_that_of_the_step(model: Model) -> None:
    plan = load_scenario("tabletop", ["twin.task=[{kind: reach, goal: {translation: [0.5, 0.1, 0.3]}}]"])
    runner = TaskRunner(model, plan.twin, {}, Fingers(*(np.zeros(2) for _ in range(3))))
    simulator = Simulator(runner)
    context = simulator.get_mutable_context()
    runner.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME, np.zeros(7)]))
    runner.GetInputPort("tracks").FixValue(context, np.zeros(0))
    simulator.AdvanceTo(0.6)
    np.testing.assert_allclose(runner.GetOutputPort("goal").Eval(context), pose(0.5, 0.1, 0.3))
    assert not np.allclose(runner.GetOutputPort("goal").Eval(context)[:4], DOWN)
    runner.GetInputPort("reach").FixValue(context, [0.0])
    simulator.AdvanceTo(5.0)
    assert runner.standing(context)["outcome"] == "failed"
    assert "no joint positions" in runner.standing(context)["why"]
    assert not runner.GetOutputPort("goal").Eval(context).any()
