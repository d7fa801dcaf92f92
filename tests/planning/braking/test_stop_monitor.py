"""The stop monitor with planners that go wrong, before an arm that follows as told; no station, no images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.model import Model
from twin_diagram.planning.braking.brake_state import BrakeMode, BrakeState, Cause, told
from twin_diagram.planning.braking.drake_distances import DrakeDistances, Shapes
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.planning.collision.collision_scene import TUNING as COLLISION_SCENE
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.signals.pose_vectors import from_matrix
from twin_diagram.signals.things import THING_SIZE, Thing

N = 7
ARM = scenario.ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")
ACCELERATION = 10.0
HOME = np.array([0.0, 0.2, 0.0, -2.1, 0.0, 2.3, 0.785])
SIDE = np.eye(N)[0]
"""Turning the first joint takes the hand, which points down, sideways."""
BOX = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)

Asked = Callable[[float], Array]


class Source(LeafSystem):
    """A port that is any function of time."""

    def __init__(self, name: str, size: int, function: Asked) -> None:
        super().__init__()
        self.DeclareVectorOutputPort(
            name,
            size,
            lambda context, output: output.SetFromVector(function(context.get_time())),
            prerequisites_of_calc={self.time_ticket()},
        )


class FollowingArm(LeafSystem):
    """Is where it was commanded to be a few milliseconds ago."""

    def __init__(self, q: Array) -> None:
        super().__init__()
        self.DeclareVectorInputPort("command", N)
        self.DeclareDiscreteState(np.concatenate([q, np.zeros(N)]))
        self.DeclarePeriodicDiscreteUpdateEvent(0.005, 0.0, self._step)
        self.DeclareVectorOutputPort(
            "arm_state",
            2 * N,
            lambda context, output: output.SetFromVector(context.get_discrete_state_vector().value()),
            prerequisites_of_calc={self.xd_ticket()},
        )

    def _step(self, context: Context, discrete: Any) -> None:
        q = np.array(context.get_discrete_state_vector().value())[:N]
        command: Any = self.get_input_port().Eval(context)
        to = q + 0.6 * (command - q)
        discrete.set_value(np.concatenate([to, (to - q) / 0.005]))


@pytest.fixture(scope="module")
def twin() -> scenario.Twin:
    monitor = scenario.Braking(acceleration=ACCELERATION)
    return scenario.Twin(arm=ARM, home=HOME.tolist(), fixtures=[scenario.Fixture()], stop_monitor=monitor)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(ARM)


@pytest.fixture(scope="module")
def library() -> dict[str, Asset]:
    return {name: Asset.load(models_dir() / "objects" / name) for name in ("can",)}


class Rig:
    """A monitor between functions of time and an arm that follows."""

    def __init__(
        self, model: Model, twin: scenario.Twin, library: dict[str, Asset], asked: Asked, **ports: Asked
    ) -> None:
        self.monitor = StopMonitor(model, twin, library)
        builder = DiagramBuilder()
        builder.AddSystem(self.monitor)
        given: dict[str, Asked] = {
            "position_commanded": asked,
            "torque_commanded": lambda t: np.zeros(N),
            "plan_time": lambda t: np.array([t]),
            "measurement_time": lambda t: np.array([t]),
            "image_time": lambda t: np.array([t]),
        }
        arm: LeafSystem = builder.AddSystem(FollowingArm(asked(0.0)))
        for name, function in (given | ports).items():
            source = builder.AddSystem(Source(name, self.monitor.GetInputPort(name).size(), function))
            builder.Connect(source.get_output_port(), self.monitor.GetInputPort(name))
        if "arm_state" not in ports:
            builder.Connect(arm.get_output_port(), self.monitor.GetInputPort("arm_state"))
        builder.Connect(self.monitor.GetOutputPort("position_commanded"), arm.get_input_port())
        self.diagram: Diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.simulator.Initialize()

    @property
    def context(self) -> Context:
        return self.monitor.GetMyContextFromRoot(self.simulator.get_context())

    def run(self, until: float, step: float = 0.01) -> Array:
        """Return (k, N) commands on the way."""
        rows = []
        for t in np.arange(self.simulator.get_context().get_time() + step, until + 1e-9, step):
            self.simulator.AdvanceTo(float(t))
            rows.append(self.command())
        return np.array(rows)

    def command(self) -> Array:
        return np.array(self.monitor.GetOutputPort("position_commanded").Eval(self.context))

    def brakes(self) -> list[dict[str, Any]]:
        return [event for event in self.monitor.told(self.context) if event["event"] == "brake"]


def steady(t: float) -> Array:
    """From rest to 0.5 rad/s in a quarter of a second, smoothly."""
    s = min(t, 0.25)
    return HOME + SIDE * (0.5 * s * s / 0.5 + 0.5 * max(0.0, t - 0.25))


def box_at(model: Model, q: Array, away: Array | None = None) -> Array:
    """A thing's row: a box where the fingers' ends are."""
    middle = model.tool_pose(q).translation() + (np.zeros(3) if away is None else away)
    return Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, middle, (BOX + middle,)).pack()


def things(*rows: Array) -> Array:
    result = np.zeros((scenario.Slots().unknown, THING_SIZE))
    for k, row in enumerate(rows):
        result[k] = row
    return result.ravel()


def gap(near: DrakeDistances, q: Array, row: Array) -> float:
    """How far the arm is from a thing [m]."""
    thing = Thing.unpack(row)
    slots = len(near.names) - near.fixture_count
    present = np.arange(slots) == slots - near.thing_count
    near.surround(Shapes(present, [0] * near.further_count, [thing.pieces, *[()] * (near.thing_count - 1)]))
    found = near.near(q, np.zeros(N), None, present, np.tile(np.eye(4), (slots, 1, 1)), 0.5)
    return float(found.distance[found.body > 0].min())


# It passes what is sound, to the bit.


def test_what_is_sound_passes_to_the_bit(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    rig = Rig(model, twin, library, steady)
    for t in np.arange(0.013, 1.0, 0.037):
        rig.simulator.AdvanceTo(float(t))
        assert rig.command().tobytes() == steady(rig.simulator.get_context().get_time()).tobytes()
    assert rig.brakes() == []
    assert rig.monitor.standing(rig.context) == {"count": 0, "seconds": 0.0, "braking": False}
    brake = rig.monitor.GetOutputPort("brake").Eval(rig.context)
    assert brake[0] == 0.0


def test_before_the_first_message_commands_pass_whatever_they_are(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    def leap(t: float) -> Array:
        return HOME + 0.5 * (t > 0.1)

    rig = Rig(model, twin, library, leap, measurement_time=lambda t: np.array([-1.0]))
    rig.run(0.3)
    np.testing.assert_array_equal(rig.command(), leap(1.0))
    assert rig.brakes() == []


# It stops before what is in the way, and goes on when that is gone.


def test_a_planner_that_drives_into_a_thing_is_stopped_before_it(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    row = box_at(model, steady(1.3))
    rig = Rig(model, twin, library, steady, things=lambda t: things(row))
    commands = rig.run(1.6)
    (brake,) = rig.brakes()
    assert brake["cause"] == "clearance" and brake["object"] == "an unknown thing"
    assert brake["why"] and 0.0 < brake["distance_mm"] < 20.0
    assert brake["speed"] == pytest.approx(0.5, abs=0.01)
    near = DrakeDistances(ARM, twin.fixtures, library, scenario.Slots().further(1), scenario.Slots().unknown)
    least = twin.stop_monitor.clearance + COLLISION_SCENE.thing_growth  # type: ignore[union-attr]
    assert least < gap(near, commands[-1], row) < least + 0.02, "stopped before it, and not far before"
    v = np.diff(commands, axis=0) / 0.01
    a = np.diff(v, axis=0) / 0.01
    assert np.abs(a).max() <= ACCELERATION * 1.01
    assert np.abs(v[-10:]).max() == 0.0
    brake_port = np.array(rig.monitor.GetOutputPort("brake").Eval(rig.context))
    assert brake_port[0] == 1.0
    np.testing.assert_array_equal(brake_port[1:], rig.command())


def test_an_arm_that_something_else_moves_is_looked_at_where_it_goes(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    """It is told to stay, and goes on into a thing all the same."""
    row = box_at(model, steady(0.7))

    def pushed(t: float) -> Array:
        return np.concatenate([steady(t), SIDE * 2.0 * min(t, 0.25)])

    rig = Rig(model, twin, library, lambda t: HOME, things=lambda t: things(row), arm_state=pushed)
    rig.run(0.7)
    brake = rig.brakes()[0]
    assert brake["cause"] == "clearance" and brake["object"] == "an unknown thing" and 0.0 < brake["distance_mm"] < 20.0


def test_the_older_the_image_the_sooner_it_stops(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    """What was seen 0.3 s ago may have come nearer by 6 mm since."""
    row, gaps = box_at(model, steady(1.0)), []
    near = DrakeDistances(ARM, twin.fixtures, library, scenario.Slots().further(1), scenario.Slots().unknown)
    for old in (0.0, 0.3):
        image = {"image_time": lambda t, old=old: np.array([t - old])}
        rig = Rig(model, twin, library, steady, things=lambda t: things(row), **image)
        gaps.append(gap(near, rig.run(1.2)[-1], row))
        assert [brake["cause"] for brake in rig.brakes()] == ["clearance"]
    assert gaps[1] - gaps[0] == pytest.approx(0.006, abs=0.006)
    assert gaps[1] > gaps[0]


def test_angles_that_count_anew_move_no_arm_that_is_held(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    rig = Rig(model, twin, library, lambda t: HOME, torque_commanded=lambda t: np.full(N, np.nan))
    rig.run(0.1)
    before, change = rig.command(), 0.01 * np.arange(1.0, N + 1.0)
    assert rig.monitor.standing(rig.context)["braking"]
    rig.monitor.recount(rig.context, change)
    np.testing.assert_allclose(rig.command(), before + change, atol=1e-12)


def test_it_goes_on_where_the_planner_is_when_the_way_is_clear(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    row = box_at(model, steady(1.0))

    def until_then(t: float) -> Array:
        return steady(min(t, 1.0))

    rig = Rig(model, twin, library, until_then, things=lambda t: things(row) if t < 1.5 else things())
    commands = rig.run(4.0)
    events = rig.monitor.told(rig.context)
    assert [event["event"] for event in events] == ["brake", "resume"]
    brake, resume = events
    patience = twin.stop_monitor.resume_after  # type: ignore[union-attr]
    assert 1.5 + patience - 0.02 <= resume["time"] <= 1.5 + patience + 0.05
    assert resume["after_s"] == pytest.approx(resume["time"] - brake["time"])
    np.testing.assert_allclose(commands[-1], until_then(4.0), atol=1e-12)
    assert np.abs(np.diff(commands, 2, axis=0)).max() / 1e-4 < 11.0, "smoothly"
    standing = rig.monitor.standing(rig.context)
    assert standing == {"count": 1, "seconds": resume["after_s"], "braking": False}


def test_an_arm_in_contact_may_leave_but_not_press_on(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    beside = np.array([0.0, 0.055, 0.0])
    row = box_at(model, HOME, beside)  # 5 mm into the box's side
    away = Rig(model, twin, library, lambda t: HOME - (steady(t) - HOME), things=lambda t: things(row))
    away.run(0.5)
    assert away.brakes() == []
    into = Rig(model, twin, library, steady, things=lambda t: things(row))
    commands = into.run(0.5)
    assert into.brakes()[0]["cause"] == "clearance"
    assert np.abs(commands[-1] - HOME).max() < 0.03


def test_it_does_not_set_off_towards_what_touches_it_because_the_plan_is_elsewhere(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    row = box_at(model, HOME, np.array([0.0, 0.055, 0.0]))

    def on_its_way_back(t: float) -> Array:
        return HOME - SIDE * max(0.0, 0.4 - 1.5 * max(0.0, t - 0.7) ** 2) * (t > 0.5)

    rig = Rig(model, twin, library, on_its_way_back, things=lambda t: things(row))
    commands = rig.run(1.2)
    assert [brake["cause"] for brake in rig.brakes()] == ["jump"]
    assert np.diff(commands[55:, 0]).max() < 1e-9, "it stands"


def test_what_comes_is_stopped_for_sooner_than_what_stands(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    place = model.tool_pose(steady(1.6)).translation()

    def can(velocity: Array) -> Callable[[float], Array]:
        def tracks(t: float) -> Array:
            pose = np.array([1.0, 0, 0, 0, *(place + velocity * (t - 1.0))])
            status = ObjectStatus.MOVING if velocity.any() else ObjectStatus.TRACKED
            return Track(status, t, pose, np.array([0, 0, 0, *velocity]), 1e-8 * np.eye(6)).pack()

        return tracks

    times = []
    for velocity in (np.zeros(3), np.array([0.0, -0.2, 0.0])):
        rig = Rig(model, twin, library, steady, tracks=can(velocity))
        rig.run(1.6)
        times.append(rig.brakes()[0])
    assert all(brake["object"] == "can" for brake in times)
    assert times[1]["time"] < times[0]["time"]


def test_what_is_held_or_may_be_touched_is_no_obstacle(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    pose = np.array([1.0, 0, 0, 0, *model.tool_pose(steady(0.8)).translation()])
    track = Track(ObjectStatus.TRACKED, 0.0, pose, np.zeros(6), 1e-8 * np.eye(6)).pack()
    caught = Rig(model, twin, library, steady, tracks=lambda t: track)
    caught.run(1.0)
    assert caught.brakes()
    for hand in (Hand(touched=0), Hand(held=0)):
        rig = Rig(model, twin, library, steady, tracks=lambda t: track, hand=lambda t, h=hand: h.pack())  # type: ignore[misc]
        rig.run(1.0)
        assert rig.brakes() == []


def test_what_is_held_is_kept_from_what_stands_about(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    below = np.array([0.0, 0.0, -0.15])
    row = box_at(model, steady(1.3), below)
    X_TO = np.array([1.0, 0, 0, 0, 0, 0, 0.08])
    free = Rig(model, twin, library, steady, things=lambda t: things(row))
    free.run(1.4)
    assert free.brakes() == []
    full = Rig(
        model, twin, library, steady, things=lambda t: things(row), hand=lambda t: Hand(held=0, X_TO=X_TO).pack()
    )
    full.run(1.4)
    assert full.brakes() and full.brakes()[0]["cause"] == "clearance"


# It stops for what it cannot trust, and says so.

NAN = np.full(N, np.nan)


def late(start: float, stop: float) -> Asked:
    """A clock that stands still for a while."""
    return lambda t: np.array([min(t, start) if t < stop else t])


@pytest.mark.parametrize(
    ("cause", "ports", "seen"),
    [
        (Cause.STALE_STATE, {"measurement_time": late(0.5, 1.2)}, 0.5 + 10 / scenario.Driver().rate),
        (
            Cause.STALE_STATE,
            {"message_time": late(0.5, 1.2)},
            0.5 + 10 / scenario.Driver().rate + 1 / scenario.Filter().rate,
        ),
        (
            Cause.STALE_SCENE,
            {"image_time": late(0.5, 1.2)},
            0.5 + scenario.Camera().latency + 5 / scenario.Camera().rate,
        ),
        (Cause.HANGING_PLANNER, {"plan_time": late(0.5, 1.2)}, 0.5 + 5 / scenario.Planner().rate),
        (Cause.NOT_A_NUMBER, {"torque_commanded": lambda t: NAN if 0.5 < t < 1.2 else np.zeros(N)}, 0.5),
    ],
)
def test_what_fails_stops_the_arm_until_it_is_back(
    model: Model, twin: scenario.Twin, library: dict[str, Asset], cause: Cause, ports: dict[str, Asked], seen: float
) -> None:
    rig = Rig(model, twin, library, steady, **ports)
    commands = rig.run(1.15)
    (brake,) = rig.brakes()
    assert brake["cause"] == cause.name.lower()
    assert seen <= brake["time"] <= seen + 0.021
    assert np.abs(commands[-1] - commands[-10]).max() == 0.0, "it stands"
    rig.run(1.5)
    assert rig.monitor.told(rig.context)[-1]["event"] == "resume"
    rig.run(6.0)
    np.testing.assert_allclose(rig.command(), steady(6.0), atol=1e-9)


@pytest.mark.parametrize("port", ["measurement_time", "message_time", "image_time"])
def test_what_ceases_while_its_clock_is_ahead_of_a_slow_loop_stops_the_arm_at_once(
    model: Model, twin: scenario.Twin, library: dict[str, Asset], port: str
) -> None:
    """The last message of an arm 2 s ahead was new for 2 s more."""
    rig = Rig(model, twin, library, steady, **{port: lambda t: np.array([2.0 + min(t, 0.5)])})
    rig.run(0.48)
    assert rig.brakes() == [], "to be ahead is no fault"
    rig.run(0.9)
    (brake,) = rig.brakes()
    assert brake["cause"] == ("stale_scene" if port == "image_time" else "stale_state")
    bound = scenario.Camera().latency + 5 / scenario.Camera().rate if port == "image_time" else 0.03
    assert brake["time"] <= 0.5 + bound + 0.021


def test_a_heavy_load_takes_longer_to_stop(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    """An arm that reaches out sinks: without the 3 kg in its hand it would be asked for a third more than it has."""
    mass, com = 3.0, np.array([0.0, 0.0, 0.2])
    carries = scenario.EffectSpec(name="payload", parameters={"mass": [mass], "com": com.tolist()})
    truth = Model.load(replace(ARM, effects=[carries]))
    start, v = np.array([0.0, 0.9, 0.0, -1.2, 0.0, 2.1, 0.785]), 0.6 * np.eye(N)[1]
    share = []
    for learnt, corrected in ((True, False), (False, True), (False, False)):
        payload = learnt * np.array([mass, *(mass * com)])
        given = {"plan_time": late(0.1, 5.0), "parameters": lambda t, payload=payload: payload}
        rig = Rig(model, twin, library, lambda t: start + v * t, **given)
        if corrected:
            rig.monitor.use_model(rig.context, rig.monitor.add_model(truth))
        rig.run(0.3)
        stop = rig.monitor.remembered(rig.context).stop
        np.testing.assert_allclose(stop.v0, v, atol=1e-6)
        torque = truth.inverse_dynamics(stop.q0, stop.v0, -stop.v0 / stop.time)
        share.append(float(np.max(np.abs(torque) / model.effort_limit)))
    assert twin.stop_monitor is not None and share[2] > 1.25
    assert share[:2] == pytest.approx([twin.stop_monitor.torque_share] * 2, abs=0.005)


def test_a_clock_may_begin_at_any_time(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    """From 100 s on: no image for two periods is no stale scene, though none is a hundred seconds old."""
    camera = scenario.Camera()
    first = 100.0 + camera.latency + 2 / camera.rate
    rig = Rig(
        model, twin, library, lambda t: steady(t - 100.0), image_time=lambda t: np.array([t if t > first else -1])
    )
    rig.simulator.get_mutable_context().SetTime(100.0)
    rig.simulator.Initialize()
    rig.simulator.AdvanceTo(100.6)
    assert rig.brakes() == []


def test_no_number_ever_reaches_the_arm_but_numbers(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    def asked(t: float) -> Array:
        return NAN if 0.503 < t < 1.0 else steady(t)

    torques = lambda t: NAN if t > 0.5 else 3.0 * np.ones(N)  # noqa: E731
    rig = Rig(model, twin, library, asked, torque_commanded=torques)
    commands = rig.run(0.9, step=0.0025)
    assert np.isfinite(commands).all()
    assert np.abs(np.diff(commands, axis=0)).max() <= 0.5 * 0.0025 * 1.01, "no jump either"
    assert rig.brakes()[0]["cause"] == "not_a_number"
    torque = np.array(rig.monitor.GetOutputPort("torque_commanded").Eval(rig.context))
    np.testing.assert_array_equal(torque, 3.0 * np.ones(N))


def test_torques_beyond_the_motors_are_cut(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    rig = Rig(model, twin, library, lambda t: HOME, torque_commanded=lambda t: np.full(N, -1e6))
    rig.run(0.1)
    torque = rig.monitor.GetOutputPort("torque_commanded").Eval(rig.context)
    np.testing.assert_array_equal(torque, -model.effort_limit)


def test_a_state_that_is_no_number_stops_the_arm(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    state = np.concatenate([HOME, np.zeros(N)])
    rig = Rig(model, twin, library, steady, arm_state=lambda t: np.full(2 * N, np.nan) if t > 0.4 else state)
    commands = rig.run(0.8)
    assert rig.brakes()[0]["cause"] == "not_a_number"
    assert np.isfinite(commands).all() and np.abs(commands[-1] - commands[-5]).max() == 0.0


def test_a_command_that_jumps_is_held_back_at_once_and_taken_up_slowly(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    rig = Rig(model, twin, library, lambda t: HOME + SIDE * (0.6 if t > 0.505 else 0.0))
    commands = rig.run(6.0, step=0.0025)
    limit = twin.stop_monitor.jump  # type: ignore[union-attr]
    assert np.abs(np.diff(commands, axis=0)).max() <= limit + 1e-12
    assert rig.brakes()[0]["cause"] == "jump"
    assert len(rig.brakes()) == 1
    after = commands[np.argmax(np.abs(commands[:, 0]) > 0) + 100 :]
    assert np.abs(np.diff(after, axis=0)).max() / 0.0025 < 0.26 * model.velocity_limit.min()
    np.testing.assert_allclose(commands[-1], HOME + 0.6 * SIDE, atol=1e-12)


def test_a_jump_is_braked_from_the_speed_before_it(
    model: Model, twin: scenario.Twin, library: dict[str, Asset]
) -> None:
    """Of an arm at rest what was let through is all the way: 20 mrad within a look are no speed of 1 rad/s."""
    limit = twin.stop_monitor.jump  # type: ignore[union-attr]
    for at in (0.502, 0.511, 0.519):
        rig = Rig(model, twin, library, lambda t, at=at: HOME + SIDE * (0.6 if t > at else 0.0))  # type: ignore[misc]
        commands = rig.run(0.7, step=0.0025)
        assert rig.brakes()[0]["cause"] == "jump"
        assert limit - 1e-9 <= np.abs(commands - HOME).max() <= limit + 1e-9


def test_untold_it_brakes_a_quarter_harder_than_plans_do(model: Model, library: dict[str, Asset]) -> None:
    own = scenario.Twin(arm=ARM, home=HOME.tolist(), planner=scenario.Planner(acceleration=2.0))
    rig = Rig(model, own, library, steady, torque_commanded=lambda t: NAN if t > 0.5 else np.zeros(N))
    commands = rig.run(0.9)
    a = np.diff(commands, 2, axis=0) / 1e-4
    assert a[60:, 0].min() == pytest.approx(-2.5, abs=0.05)


# What it remembers, and what is refused.


def test_memory_survives_packing() -> None:
    rng = np.random.default_rng(3)
    state = BrakeState.initial(rng.standard_normal(3))
    vector = rng.standard_normal(len(state.pack()))
    np.testing.assert_array_equal(BrakeState.unpack(vector, 3).pack(), vector)
    mode, looked, asked, rate = BrakeState.passing(vector, 3)
    whole = BrakeState.unpack(vector, 3)
    assert (mode, looked) == (whole.mode, whole.looked)
    np.testing.assert_array_equal(asked, whole.asked)
    np.testing.assert_array_equal(rate, whole.asked_rate)


def test_notes_are_told_oldest_first_and_the_oldest_go() -> None:
    state = BrakeState.initial(np.zeros(2))
    assert told(state.notes, {}, ()) == []
    for k in range(40):
        state = replace(state, notes=state.noting(float(k), 1.0, float(Cause.CLEARANCE), 7.0, 1.0, 0.0123, 0.4))
    events = told(state.notes, {7: "hand"}, ("table", "can"))
    assert len(events) == 32 and events[0]["time"] == 8.0 and events[-1]["time"] == 39.0
    assert (events[0]["link"], events[0]["object"], events[0]["distance_mm"]) == ("hand", "can", 12.3)
    assert BrakeMode(int(state.mode)) is BrakeMode.WAIT


def test_a_look_asks_how_fast_its_own_hand_holds(
    model: Model, twin: scenario.Twin, library: dict[str, Asset], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shapes are shared by all Contexts: another's hand, or none, may have been looked at in between."""
    out = rotations.matrix(from_matrix(model.tool_pose(HOME).GetAsMatrix4())[:4]).T @ np.array([0.5, 0.0, 0.0])
    X_TO = np.array([1.0, 0, 0, 0, *out])  # far out, it is faster than the arm
    rig = Rig(model, twin, library, steady, hand=lambda t: Hand(held=0, X_TO=X_TO).pack())
    rig.run(0.5)
    near, fast = rig.monitor._near, []
    speed = near.speed

    def asked(q: Array, v: Array) -> float:
        fast.append((speed(q, v), q, v))
        return fast[-1][0]

    near.hold(NOTHING, None)
    monkeypatch.setattr(near, "speed", asked)
    rig.run(0.55)
    assert fast
    near.hold(0, X_TO)
    assert all(found == speed(q, v) for found, q, v in fast)


def test_two_contexts_do_not_know_of_each_other(model: Model, twin: scenario.Twin, library: dict[str, Asset]) -> None:
    """One is about to meet a thing that the other, of the same Diagram, does not have."""
    row = box_at(model, steady(1.0))
    rig = Rig(model, twin, library, steady, things=lambda t: things(row) if 0.5 < t < 1.2 else things())
    other = Simulator(rig.diagram)
    other.Initialize()
    rig.run(0.45)
    seen = []
    for t in np.arange(0.47, 1.3, 0.02):
        rig.simulator.AdvanceTo(float(t))
        other.AdvanceTo(min(float(t - 0.45), 0.5))
        seen.append(rig.command())
    again = Rig(model, twin, library, steady, things=lambda t: things(row) if 0.5 < t < 1.2 else things())
    again.run(0.45)
    for t, command in zip(np.arange(0.47, 1.3, 0.02), seen, strict=True):
        again.simulator.AdvanceTo(float(t))
        assert again.command().tobytes() == command.tobytes()
    assert rig.brakes()
    assert rig.monitor.told(rig.monitor.GetMyContextFromRoot(other.get_context())) == []
