"""The planner as a whole and as a system: closed loops without physics, commands, contexts, hostile input."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from tests import planning_bench as bench
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.collision_scene import Scene, load_scene
from twin_diagram.planning.collision.held_shape import holding
from twin_diagram.planning.given import check_planner
from twin_diagram.planning.mpc.arm_torque import ArmTorque
from twin_diagram.planning.mpc.motion_program import MotionProgram
from twin_diagram.planning.mpc.payload_gravity import gravity_regressor
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.mpc_system import PAYLOAD, Mpc, _offset
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.planning.paths.situation import Aim, Route
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import NEVER, TRACK_SIZE, ObjectStatus, Track

HOME = bench.HOME
NOTHING = np.zeros(7)
GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.16])


@pytest.fixture(scope="module")
def loaded() -> tuple[Scene, dict[str, Asset]]:
    return bench.load()


@pytest.fixture(scope="module")
def planner(loaded: tuple[Scene, dict[str, Asset]]) -> MotionPlanner:
    return MotionPlanner(loaded[0], bench.VELOCITY_LIMIT, scenario.Planner())


def track_of(p: tuple[float, float, float], velocity: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    moving = any(velocity)
    status = ObjectStatus.MOVING if moving else ObjectStatus.TRACKED
    pose = np.array([1.0, 0, 0, 0, *p])
    return Track(status, 0.0, pose, np.array([0, 0, 0, *velocity, 0.0]), 1e-6 * np.eye(6)).pack()


def tracks_with(mover: np.ndarray | None) -> np.ndarray:
    tracks = np.zeros((len(bench.NAMES), TRACK_SIZE))
    if mover is not None:
        tracks[-1] = mover
    return tracks.ravel()


# Whole runs.


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        pytest.param("cross", 3, marks=pytest.mark.slow),
        ("attack", 3),
        pytest.param("demo", 2, marks=pytest.mark.slow),
        pytest.param("near", 5, marks=pytest.mark.slow),
    ],
)
def test_runs_touch_nothing_and_arrive(loaded, planner: MotionPlanner, kind: str, seed: int) -> None:  # type: ignore[no-untyped-def]
    scene, library = loaded
    world = bench.draw(kind, seed, scene, library)
    result = bench.run(planner, scene, world, seed, duration=7.0 if world.goal is not None else 5.0)
    assert result.clearance > 0.02
    assert all(report.solved for report in result.reports)
    if world.goal is not None:
        assert result.reached_at is not None
        assert result.error_mm < 2.0
    speed = np.abs(np.diff(np.array(result.q_command), axis=0)) / np.diff(result.times)[:, None]
    assert (speed <= 1.2 * planner.limits.velocity).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", bench.KINDS)
def test_many_runs_touch_nothing_and_arrive(loaded, planner: MotionPlanner, kind: str) -> None:  # type: ignore[no-untyped-def]
    scene, library = loaded
    clearances, reached = [], 0
    for seed in range(100, 120):
        world = bench.draw(kind, seed, scene, library)
        result = bench.run(planner, scene, world, seed)
        clearances.append(result.clearance)
        reached += world.goal is None or result.reached_at is not None
    assert min(clearances) > 0.01
    assert reached >= 19


def test_a_six_joint_arm_goes_around_too() -> None:
    spec = scenario.ArmModel(model="arms/ur5e.urdf", tool_frame="")
    library = {"mover": Asset.load(models_dir() / "objects" / "mover")}
    scene = load_scene(spec, [scenario.Fixture()], library)
    model = Model.load(spec)
    planner = MotionPlanner(scene, model.velocity_limit, scenario.Planner())
    q = np.array([0.5, -1.6, 1.9, -1.9, -1.57, 0.5])
    goal_q = q - [1.0, 0, 0, 0, 0, 0]
    X_WG = scene.chain.tool(scene.chain.place(goal_q[None]))[0]
    middle = scene.chain.tool(scene.chain.place((0.5 * q + 0.5 * goal_q)[None]))[0, :3, 3]
    tracks = track_of((middle[0], middle[1], max(middle[2], 0.12)))
    quaternion = bench.Rotation.from_matrix(X_WG[:3, :3]).as_quat()[[3, 0, 1, 2]]
    goal = np.concatenate([quaternion, X_WG[:3, 3]])
    memory, nearest = planner.initial(q), np.inf
    for tick in range(90):
        now = tick / 15
        q = memory.trajectory.position(now)
        memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(6)]), tracks, goal)
        around = scene.around(bench.Forecast.of_tracks(tracks), np.zeros(1))
        nearest = min(nearest, scene.clearance.distances(q[None], around, 0.3)[0, :-1].min())
    assert nearest > 0.02
    error = inverse_kinematics.pose_error(scene.chain.tool(scene.chain.place(q[None])), X_WG)[0]
    assert np.linalg.norm(error[3:]) < 0.002


# Commands.


def test_commands_are_smooth_across_ticks_and_end_at_rest(planner: MotionPlanner) -> None:
    memory = planner.initial(HOME)
    tracks = tracks_with(track_of((0.62, 0.02, 0.12), (-0.1, 0.0)))
    for tick in range(30):
        now = tick / 15
        q = memory.trajectory.position(now)
        before = memory
        memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), tracks, GOAL)
        for old, new in zip(before.trajectory.at(np.array([now])), memory.trajectory.at(np.array([now])), strict=True):
            if tick:
                np.testing.assert_allclose(new, old, atol=1e-9)
        _, v, a = memory.trajectory.at(memory.trajectory.start + np.linspace(0, 0.999, 200) * 1.8)
        assert (np.abs(a) <= planner.limits.acceleration + 1e-3).all()
        # Between knots the speed may pass the limit, by no more than a change of acceleration within one allows.
        assert (np.abs(v) <= planner.limits.velocity + 0.13).all()
        _, v_end, a_end = memory.trajectory.at(np.array([memory.trajectory.end - 1e-9]))
        assert np.abs(v_end).max() < 1e-3 and np.abs(a_end).max() < 1e-6
        assert (memory.trajectory.knots <= planner.scene.upper + 1e-6).all()
        assert (memory.trajectory.knots >= planner.scene.lower - 1e-6).all()


def test_without_a_goal_the_arm_stays(planner: MotionPlanner) -> None:
    memory = planner.initial(HOME)
    for tick in range(10):
        memory, report = planner.tick(
            memory, tick / 15, np.concatenate([HOME, np.zeros(7)]), tracks_with(None), NOTHING
        )
    np.testing.assert_allclose(memory.trajectory.position(1.0), HOME, atol=1e-6)
    assert report.aim is Aim.GOAL


def test_a_goal_that_is_taken_away_stops_the_arm(planner: MotionPlanner) -> None:
    memory = planner.initial(HOME)
    for tick in range(60):
        now = tick / 15
        q = memory.trajectory.position(now)
        goal = GOAL if tick < 8 else NOTHING
        memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), tracks_with(None), goal)
    moved = np.abs(memory.trajectory.position(4.0) - memory.trajectory.position(3.0)).max()
    assert moved < 1e-3
    X_WT = planner.scene.chain.tool(planner.scene.chain.place(memory.trajectory.position(4.0)[None]))[0]
    assert np.linalg.norm(X_WT[:3, 3] - GOAL[4:]) > 0.05


def test_a_goal_out_of_reach_is_not_chased(planner: MotionPlanner) -> None:
    memory = planner.initial(HOME)
    far = GOAL.copy()
    far[4] = 3.0
    for tick in range(20):
        now = tick / 15
        q = memory.trajectory.position(now)
        memory, report = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), tracks_with(None), far)
    assert report.aim is Aim.NOTHING
    np.testing.assert_allclose(memory.trajectory.position(2.0), HOME, atol=1e-6)


def test_a_goal_that_something_stands_on_is_waited_for(planner: MotionPlanner) -> None:
    """The arm keeps off, and goes there once the way is free."""
    memory = planner.initial(HOME)
    blocked = tracks_with(track_of((0.5, -0.25, 0.12)))
    scene = planner.scene
    for tick in range(150):
        now = tick / 15
        q = memory.trajectory.position(now)
        tracks = blocked if tick < 60 else tracks_with(track_of((0.5, 0.45, 0.12)))
        memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), tracks, GOAL)
        around = scene.around(bench.Forecast.of_tracks(tracks), np.zeros(1))
        assert scene.clearance.distances(q[None], around, 0.3)[0, :-1].min() > 0.02
    X_WT = scene.chain.tool(scene.chain.place(q[None]))[0]
    assert np.linalg.norm(X_WT[:3, 3] - GOAL[4:]) < 0.002


def test_the_command_starts_anew_where_the_arm_is_found_elsewhere(planner: MotionPlanner) -> None:
    memory = planner.initial(HOME)
    state = np.concatenate([HOME, np.zeros(7)])
    memory, first = planner.tick(memory, 0.0, state, tracks_with(None), NOTHING)
    memory, second = planner.tick(memory, 1 / 15, state, tracks_with(None), NOTHING)
    assert first.reanchored and not second.reanchored
    pushed = HOME + 0.3
    velocity = np.full(7, 0.2)
    memory, third = planner.tick(memory, 2 / 15, np.concatenate([pushed, velocity]), tracks_with(None), NOTHING)
    assert third.reanchored
    np.testing.assert_allclose(memory.trajectory.position(2 / 15), pushed, atol=1e-9)


@pytest.mark.long
def test_a_lasting_difference_is_made_up_for(planner: MotionPlanner) -> None:
    """An arm that hangs a little below its command still brings the tool to the goal."""
    memory = planner.initial(HOME)
    sag = np.array([0.0, 0.012, 0.0, 0.012, 0.0, -0.01, 0.0])
    for tick in range(105):
        now = tick / 15
        q = memory.trajectory.position(now) + sag
        v = memory.trajectory.at(np.array([now]))[1][0]
        memory, _ = planner.tick(memory, now, np.concatenate([q, v]), tracks_with(None), GOAL)
    X_WT = planner.scene.chain.tool(planner.scene.chain.place((memory.trajectory.position(7.0) + sag)[None]))[0]
    assert np.linalg.norm(X_WT[:3, 3] - GOAL[4:]) < 0.001


class Refusing:
    """Solves the first few programs, then none."""

    def __init__(self, program: MotionProgram, count: int) -> None:
        self.program, self.count = program, count

    def solve(self, *arguments: Any) -> np.ndarray | None:
        self.count -= 1
        return self.program.solve(*arguments) if self.count >= 0 else None


def test_without_a_solver_the_last_plan_is_carried_out_to_rest(loaded) -> None:  # type: ignore[no-untyped-def]
    scene, _ = loaded
    planner = MotionPlanner(scene, bench.VELOCITY_LIMIT, scenario.Planner())
    planner.optimiser._program = Refusing(planner.optimiser._program, 14)  # type: ignore[assignment]
    memory, positions, unsolved = planner.initial(HOME), [], 0
    for tick in range(60):
        now = tick / 15
        q = memory.trajectory.position(now)
        memory, report = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), tracks_with(None), GOAL)
        unsolved += not report.solved
        positions += [memory.trajectory.position(now + d) for d in np.linspace(0, 1 / 15, 8)[:-1]]
    assert unsolved > 40
    steps = np.abs(np.diff(positions, axis=0)).max(axis=1)
    assert steps[:60].max() > 1e-3  # it did set off
    assert steps.max() < 1.2 * planner.limits.velocity.max() / 15 / 7  # without a jump
    assert steps[-20:].max() < 1e-9


def test_hostile_inputs_do_no_harm(planner: MotionPlanner) -> None:
    memory = planner.initial(HOME)
    state = np.concatenate([HOME, np.zeros(7)])
    memory, _ = planner.tick(memory, 0.0, state, tracks_with(None), NOTHING)
    rng = np.random.default_rng(0)
    broken_goal = GOAL.copy()
    broken_goal[5] = np.nan
    for state_in, tracks, goal in (
        (np.full(14, np.nan), tracks_with(None), GOAL),
        (state, np.full(TRACK_SIZE * len(bench.NAMES), np.nan), GOAL),
        (state, 1e3 * rng.normal(size=TRACK_SIZE * len(bench.NAMES)), GOAL),
        (state, tracks_with(None), broken_goal),
        (state, tracks_with(track_of((0.49, 0.30, 0.3))), GOAL),  # the hand inside an object
    ):
        after, _ = planner.tick(memory, 1 / 15, state_in, tracks, goal)
        assert np.isfinite(after.pack()).all()
        knots = after.trajectory.knots
        assert (np.abs(np.diff(knots, axis=0)) < 0.2).all()


def test_memory_survives_packing(planner: MotionPlanner) -> None:
    rng = np.random.default_rng(0)
    memory = planner.initial(HOME)
    memory = replace(
        memory,
        trajectory=replace(memory.trajectory, start=1.5, v0=rng.normal(size=7), accelerations=rng.normal(size=(16, 7))),
        goals=rng.normal(size=(3, 7)),
        route=Route(Aim.REFUGE, rng.normal(size=(2, 7))),
        goal=GOAL,
        tick=12,
        asked=7,
    )
    vector = memory.pack()
    assert vector.shape == (Memory.size(7, 16),)
    again = Memory.unpack(vector, 7, 16, memory.trajectory.step)
    np.testing.assert_array_equal(again.pack(), vector)
    assert again.route.aim is Aim.REFUGE and again.tick == 12


# The system.


def told(**changes: object) -> scenario.Twin:
    twin = scenario.Twin(home=HOME.tolist(), fixtures=[scenario.Fixture()], library={"mover": "objects/mover"})
    twin.task.start = 0.2
    return replace(twin, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(scenario.ArmModel())


@pytest.fixture(scope="module")
def mpc(model: Model) -> Mpc:
    names = ["friction [N·m]", *(f"{name} [kg]" for name in PAYLOAD)]
    return Mpc(model, told(), {"mover": Asset.load(models_dir() / "objects" / "mover")}, parameter_names=names)


def test_no_abstract_state_holds_none(mpc: Mpc) -> None:
    """Drake 1.58, which CPython 3.12 gets, takes no None for a value."""
    context = mpc.CreateDefaultContext()
    held = [context.get_abstract_state(k).get_value() for k in range(context.num_abstract_states())]
    assert held == [()] and mpc.memory(context).pending is None


def connect(mpc: Mpc, context: Context, q: np.ndarray = HOME, time: float | None = None) -> None:
    mpc.GetInputPort("arm_state").FixValue(context, np.concatenate([q, np.zeros(7)]))
    mpc.GetInputPort("tracks").FixValue(context, np.zeros(TRACK_SIZE))
    mpc.GetInputPort("parameters").FixValue(context, np.array([3.0, 0.8, 0.01, -0.02, 0.1]))
    mpc.GetInputPort("goal").FixValue(context, GOAL)
    if time is not None:
        mpc.GetInputPort("measurement_time").FixValue(context, np.array([time]))


def position(mpc: Mpc, context: Context) -> np.ndarray:
    return np.array(mpc.GetOutputPort("position_commanded").Eval(context))


def test_ports_are_as_named(mpc: Mpc) -> None:
    inputs = {"arm_state": 14, "tracks": TRACK_SIZE, "parameters": 5, "goal": 7, "measurement_time": 1}
    assert {mpc.get_input_port(i).get_name(): mpc.get_input_port(i).size() for i in range(5)} == inputs
    outputs = {"position_commanded": 7, "torque_commanded": 7, "plan": 16 * 7}
    assert {mpc.get_output_port(i).get_name(): mpc.get_output_port(i).size() for i in range(3)} == outputs
    assert mpc.HasDirectFeedthrough(mpc.GetInputPort("tracks").get_index(), 0) is False
    assert mpc.HasDirectFeedthrough(mpc.GetInputPort("goal").get_index(), 0) is False


def test_the_arm_is_held_until_the_goal_counts_and_then_moves(mpc: Mpc) -> None:
    simulator = Simulator(mpc)
    context = simulator.get_mutable_context()
    connect(mpc, context)
    simulator.Initialize()
    for until in (0.001, 0.1, 0.19):
        simulator.AdvanceTo(until)
        np.testing.assert_allclose(position(mpc, context), HOME, atol=1e-9)
    simulator.AdvanceTo(0.5)
    assert np.abs(position(mpc, context) - HOME).max() > 0.01
    # Between ticks the command goes on along the plan.
    plan = np.array(mpc.GetOutputPort("plan").Eval(context)).reshape(16, 7)
    trajectory = mpc.memory(context).trajectory
    np.testing.assert_allclose(plan, trajectory.knots)
    context.SetTime(0.52)
    np.testing.assert_allclose(position(mpc, context), trajectory.position(0.52))


def test_what_is_foreseen_goes_on_from_the_goal_where_a_way_on_is_known(mpc: Mpc) -> None:
    simulator = Simulator(mpc)
    context = simulator.get_mutable_context()
    connect(mpc, context)
    simulator.Initialize()
    simulator.AdvanceTo(0.5)
    memory = mpc.memory(context)
    rests = replace(
        memory, trajectory=replace(memory.trajectory, q0=HOME, v0=0 * HOME, accelerations=np.zeros((16, 7)))
    )
    rests = replace(rests, offset=0 * HOME, route=Route(Aim.GOAL, HOME[None]))
    on = replace(rests, next_goal=GOAL, beyond=np.stack([HOME + 0.2, HOME + 0.1]))
    for then, foreseen in ((rests, HOME), (on, HOME + 0.1)):
        context.SetDiscreteState(0, then.pack())
        np.testing.assert_allclose(mpc.GetOutputPort("position_planned").Eval(context), foreseen, atol=0.05)
        np.testing.assert_array_equal(position(mpc, context), HOME)
    mpc.GetInputPort("next_pause").FixValue(context, np.array([2.0]))
    np.testing.assert_allclose(mpc.GetOutputPort("position_planned").Eval(context), HOME, atol=1e-6)


def test_nothing_is_planned_before_the_first_message(mpc: Mpc) -> None:
    simulator = Simulator(mpc)
    context = simulator.get_mutable_context()
    connect(mpc, context, q=np.zeros(7), time=NEVER)
    simulator.Initialize()
    simulator.AdvanceTo(0.3)
    np.testing.assert_array_equal(position(mpc, context), HOME)
    assert mpc.memory(context).trajectory.start == NEVER
    found = HOME + 0.4
    connect(mpc, context, q=found, time=0.3)
    np.testing.assert_allclose(position(mpc, context), found)
    simulator.AdvanceTo(0.306)
    assert mpc.memory(context).trajectory.start != NEVER
    connect(mpc, context, q=found - 0.01, time=0.31)
    np.testing.assert_allclose(position(mpc, context), found, atol=0.01)


def test_the_payloads_weight_is_carried(mpc: Mpc) -> None:
    context = mpc.CreateDefaultContext()
    connect(mpc, context)
    expected = gravity_regressor(mpc.planner.scene.chain, HOME) @ np.array([0.8, 0.01, -0.02, 0.1])
    np.testing.assert_allclose(mpc.GetOutputPort("torque_commanded").Eval(context), expected)
    mpc.GetInputPort("parameters").FixValue(context, np.full(5, np.nan))
    np.testing.assert_array_equal(mpc.GetOutputPort("torque_commanded").Eval(context), np.zeros(7))


def test_without_a_payload_among_the_parameters_there_is_no_torque(model: Model) -> None:
    mpc = Mpc(model, told(), {}, parameter_names=["friction"])
    context = mpc.CreateDefaultContext()
    mpc.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME, np.zeros(7)]))
    mpc.GetInputPort("parameters").FixValue(context, np.ones(1))
    np.testing.assert_array_equal(mpc.GetOutputPort("torque_commanded").Eval(context), np.zeros(7))


def test_two_contexts_do_not_disturb_each_other(mpc: Mpc) -> None:
    alone = Simulator(mpc)
    connect(mpc, alone.get_mutable_context())
    alone.Initialize()
    alone.AdvanceTo(1.0)
    expected = np.array(alone.get_context().get_discrete_state_vector().value())

    first, second = Simulator(mpc), Simulator(mpc)
    connect(mpc, first.get_mutable_context())
    connect(mpc, second.get_mutable_context(), q=HOME - 0.2)
    second.get_mutable_context()
    for simulator in (first, second):
        simulator.Initialize()
    for until in np.arange(0.1, 1.01, 0.1):
        first.AdvanceTo(until)
        second.AdvanceTo(until)
    first.AdvanceTo(1.0)
    np.testing.assert_array_equal(first.get_context().get_discrete_state_vector().value(), expected)
    assert not np.array_equal(second.get_context().get_discrete_state_vector().value(), expected)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("rate", 0.0),
        ("step", -0.1),
        ("clearance", float("nan")),
        ("knots", 3),
        ("influence", 0.04),
        ("velocity_share", 1.5),
    ],
)
def test_senseless_tuning_is_refused_by_name(model: Model, field: str, value: float) -> None:
    with pytest.raises(ScenarioError, match=f"twin.planner.{field}"):
        Mpc(model, told(planner=replace(scenario.Planner(), **{field: value})), {})  # type: ignore[arg-type]


def test_ticks_follow_the_updater() -> None:
    twin = told()
    offset = _offset(twin)
    assert 0 <= offset < 1 / twin.planner.rate
    # The image of time 0 is delivered at 35 ms, is in the tracks at the updater's tick at 50 ms, and is used then.
    assert offset == pytest.approx(0.051)
    assert _offset(told(camera=None)) == 0.0


@pytest.mark.parametrize(
    ("latency", "scene_rate", "rate", "offset"),
    [(0.12, 40.0, 10.0, 0.026), (0.049, 40.0, 10.0, 0.051), (0.0495, 40.0, 10.0, 0.076), (0.03, 100.0, 50.0, 0.001)],
)
def test_a_tick_comes_a_millisecond_after_the_updaters(
    latency: float, scene_rate: float, rate: float, offset: float
) -> None:
    """Which comes with the first of its ticks that is a millisecond after an image's delivery."""
    twin = told()
    assert twin.camera is not None
    twin = replace(
        twin,
        camera=replace(twin.camera, latency=latency),
        scene=replace(twin.scene, rate=scene_rate),
        planner=replace(twin.planner, rate=rate),
    )
    assert _offset(twin) == pytest.approx(offset, abs=1e-9)


def test_plans_are_made_at_the_planners_rate_and_the_arm_is_held_at_the_filters(model: Model) -> None:
    twin = told(camera=None, planner=replace(scenario.Planner(), rate=8.0))
    mpc = Mpc(model, replace(twin, filter=replace(twin.filter, rate=125.0)), {})
    simulator = Simulator(mpc)
    context = simulator.get_mutable_context()
    mpc.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME, np.zeros(7)]))
    mpc.GetInputPort("tracks").FixValue(context, np.zeros(0))
    mpc.GetInputPort("parameters").FixValue(context, np.zeros(4))
    mpc.GetInputPort("goal").FixValue(context, NOTHING)
    mpc.GetInputPort("measurement_time").FixValue(context, np.array([NEVER]))
    simulator.Initialize()
    simulator.AdvanceTo(0.0161)
    mpc.GetInputPort("measurement_time").FixValue(context, np.array([0.016]))
    simulator.AdvanceTo(0.0239)
    assert mpc.memory(context).trajectory.start == NEVER
    simulator.AdvanceTo(0.0241)
    assert mpc.memory(context).trajectory.start == pytest.approx(0.024)
    for until, ticks in ((0.124, 0), (0.126, 1), (0.24, 1), (0.26, 2)):
        simulator.AdvanceTo(until)
        assert mpc.memory(context).tick == ticks


def test_tuning_is_fine_up_to_its_bounds() -> None:
    least = {"rate": 1e-6, "step": 1e-6, "clearance": 1e-6, "velocity_share": 1e-6, "acceleration": 1e-6}
    check_planner(replace(scenario.Planner(), **least, knots=4))  # type: ignore[arg-type]
    check_planner(replace(scenario.Planner(), velocity_share=1.0))
    for field in least:
        for value in (0.0, -1.0, float("inf")):
            with pytest.raises(ScenarioError, match=f"twin.planner.{field}"):
                check_planner(replace(scenario.Planner(), **{field: value}))  # type: ignore[arg-type]


def test_a_goal_counts_from_the_tasks_start_on_and_a_payload_needs_all_its_parts(model: Model) -> None:
    for start, moves in ((1 / 15, True), (1 / 15 + 1e-3, False)):
        twin = told(camera=None)
        twin.task.start = start
        mpc = Mpc(model, twin, {}, parameter_names=PAYLOAD[:3])
        simulator = Simulator(mpc)
        context = simulator.get_mutable_context()
        mpc.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME, np.zeros(7)]))
        mpc.GetInputPort("tracks").FixValue(context, np.zeros(0))
        mpc.GetInputPort("parameters").FixValue(context, np.array([1.0, 0.1, 0.1]))
        mpc.GetInputPort("goal").FixValue(context, GOAL)
        simulator.Initialize()
        simulator.AdvanceTo(0.07)
        assert bool(mpc.memory(context).goal.any()) == moves
        assert not np.any(mpc.GetOutputPort("torque_commanded").Eval(context))


def test_a_corrected_models_torque_is_added_beside_the_payloads(model: Model) -> None:
    mpc = Mpc(model, told(), {}, parameter_names=PAYLOAD)
    spring = scenario.EffectSpec("joint_spring", ["panda_joint2"], [], {"stiffness": [20.0], "rest_angle": [-0.2]})
    context = mpc.CreateDefaultContext()
    connect_all = np.array([0.8, 0.01, -0.02, 0.1])
    mpc.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME, np.full(7, 0.3)]))
    mpc.GetInputPort("parameters").FixValue(context, connect_all)
    before = np.array(mpc.GetOutputPort("torque_commanded").Eval(context))
    mpc.use_model(context, mpc.add_model(Model.load(replace(scenario.ArmModel(), effects=[spring]))))
    after = np.array(mpc.GetOutputPort("torque_commanded").Eval(context))
    np.testing.assert_allclose(after - before, 20.0 * (HOME[1] + 0.2) * np.eye(7)[1], atol=1e-9)
    mpc.use_model(context, 0)
    np.testing.assert_allclose(mpc.GetOutputPort("torque_commanded").Eval(context), before)
    assert np.abs(before).max() > 1.0


# The hand.


def test_what_is_held_is_in_the_first_plan_and_out_of_the_first_after_release(
    loaded: tuple[Scene, dict[str, Asset]],
) -> None:
    """Each plan is that of a planner for the arm as it is then, whose tracks are without what the hand is about."""
    _, library = loaded
    twin = scenario.Twin(home=HOME.tolist(), library={name: "" for name in library})
    twin.task.start = 0.0
    model = Model.load(twin.arm)
    mpc = Mpc(model, twin, library)
    can = bench.NAMES.index("can")
    context = mpc.CreateDefaultContext()
    tracks = np.zeros((len(library), TRACK_SIZE))
    X_WT = model.tool_pose(HOME)
    place = X_WT.translation() - [0.0, 0.0, 0.03]
    tracks[can] = track_of((float(place[0]), float(place[1]), float(place[2])))
    tracks[-1] = track_of((0.6, -0.3, 0.12), (0.0, 0.2))
    state = np.concatenate([HOME, np.zeros(7)])
    below = np.array([*X_WT.rotation().ToQuaternion().wxyz(), *(X_WT.translation() - [0.0, 0.0, 0.06])])
    for name, value in (("arm_state", state), ("tracks", tracks.ravel()), ("parameters", np.zeros(4)), ("goal", below)):
        mpc.GetInputPort(name).FixValue(context, value)
    held = Hand(held=can, X_TO=np.array([1.0, 0, 0, 0, 0.0, 0.0, 0.03]))
    carrying = MotionPlanner(
        holding(mpc.planner.scene, library["can"].convex_pieces, held),
        model.velocity_limit,
        twin.planner,
        hand=held.pack().tobytes(),
        limits=mpc.planner.limits,
    )
    arm = ArmTorque(model, mpc.planner.scene.chain, np.zeros(4))
    free = tracks.copy()
    free[can, 0] = ObjectStatus.GONE
    still = free.copy()
    still[-1, 0] = ObjectStatus.GONE
    steps = [
        (Hand(), mpc.planner, tracks),
        (Hand(touched=can), mpc.planner, free),
        (held, carrying, free),
        (Hand(touched=can), mpc.planner, free),
        (Hand(), mpc.planner, tracks),
        (Hand(touched=can, around=True), mpc.planner, still),
    ]
    for k, (hand, planner, seen) in enumerate(steps):
        mpc.GetInputPort("hand").FixValue(context, hand.pack())
        context.SetTime(k / twin.planner.rate)
        memory, now = mpc.memory(context), context.get_time()
        expected, _ = planner.tick(memory, now, state, seen.ravel(), below, None, None, arm=arm)
        after = context.Clone()
        mpc._tick(context, after.get_mutable_state())
        np.testing.assert_array_equal(after.get_discrete_state(0).value(), expected.pack())
        context.SetTimeStateAndParametersFrom(after)


# Searches beside.


def searching(library: dict[str, Asset], *, beside: bool) -> list[np.ndarray]:
    """Memories of a second before a wall of boxes, behind which the goal lies, of two Contexts, one a copy."""
    twin = scenario.Twin(home=HOME.tolist(), library={name: "" for name in library})
    twin.task.start = 0.0
    mpc = Mpc(Model.load(twin.arm), twin, library)
    tracks = np.zeros((len(library), TRACK_SIZE))
    for k, x in ((0, 0.45), (1, 0.62)):
        tracks[k] = track_of((x, 0.05, 0.2))
    with mpc.searching_beside() if beside else nullcontext():
        simulator = Simulator(mpc)
        context = simulator.get_mutable_context()
        values = {"arm_state": np.concatenate([HOME, np.zeros(7)]), "tracks": tracks.ravel()}
        for name, value in {**values, "parameters": np.zeros(4), "goal": GOAL}.items():
            mpc.GetInputPort(name).FixValue(context, value)
        simulator.AdvanceTo(0.15)
        memory = mpc.memory(context)
        assert memory.pending is not None  # a way was asked for, and counts 0.2 s later
        assert mpc.GetOutputPort("reach").Eval(context)[0] != 0.0
        copied = Simulator(mpc, context.Clone())
        simulator.AdvanceTo(0.5)
        assert mpc.memory(context).heard
        copied.AdvanceTo(0.5)
        return [mpc.memory(each.get_context()).pack() for each in (simulator, copied)]


def test_where_ways_are_searched_for_shows_in_no_figure(loaded: tuple[Scene, dict[str, Asset]]) -> None:
    here, here_copied = searching(loaded[1], beside=False)
    there, there_copied = searching(loaded[1], beside=True)
    for other in (here_copied, there, there_copied):
        np.testing.assert_array_equal(other, here)
