"""An arm inside of a guessed shape: planner and stop monitor together let it out, slowly, and on to its goal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.planning.braking.test_stop_monitor import ARM, BOX, HOME, Rig, things
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.collision_scene import Scene, load_scene
from twin_diagram.planning.mpc.backing_out import TUNING, proved_wrong, way_out
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.paths.situation import INSIDE
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.things import Thing

GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.3, 0.3])
LIBRARY = {"can": Asset.load(models_dir() / "objects" / "can")}
NOBODY = np.zeros(TRACK_SIZE)
TWIN = scenario.Twin(arm=ARM, home=HOME.tolist(), fixtures=[scenario.Fixture()], stop_monitor=scenario.Braking())


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(ARM)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(ARM, TWIN.fixtures, LIBRARY)


def guess(model: Model, low: tuple[float, float], high: tuple[float, float, float]) -> Array:
    """A thing about the tool at home: from the table up, its corners off the tool by so much [m]."""
    p = model.tool_pose(HOME).translation()
    least, most = np.array([p[0] + low[0], p[1] + low[1], 0.0]), p + high
    corners = (least + most) / 2 + BOX / 0.05 * (most - least) / 2
    return things(Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, (least + most) / 2, (corners,)).pack())


def loop(model: Model, scene: Scene, row: Array, until: float) -> tuple[Array, Any]:
    """Return where the arm was (k, n), and how the monitor stands in the end; planner and monitor take turns."""
    planner = MotionPlanner(scene, model.velocity_limit, TWIN.planner)
    memory, planned = planner.hold(planner.initial(HOME), 0.0, HOME), 0.0
    rig = Rig(
        model, TWIN, LIBRARY, lambda t: memory.trajectory.position(t), things=lambda t: row,
        plan_time=lambda t: np.array([planned]),
    )  # fmt: skip
    rows = []
    for planned in np.arange(round(until * TWIN.planner.rate)) / TWIN.planner.rate:
        rig.simulator.AdvanceTo(planned)
        arm: Any = np.array(rig.monitor.GetInputPort("arm_state").Eval(rig.context))
        brake: Any = np.array(rig.monitor.GetOutputPort("brake").Eval(rig.context))
        if brake[0]:
            memory = replace(planner.hold(memory, planned, brake[1:]), stay=memory.stay)
        memory, _ = planner.tick(memory, planned, arm, NOBODY, GOAL, None, row)
        rows.append(arm[:7])
    return np.array(rows), rig.monitor.standing(rig.context)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((-0.05, -0.05), (0.05, 0.05, 0.0)),
        ((-0.12, -0.12), (0.12, 0.12, 0.1)),
        ((-0.1, -0.03), (0.1, 0.12, 0.15)),
        ((-0.15, -0.06), (0.03, 0.06, 0.12)),
    ],
)
def test_an_arm_inside_a_guess_gets_out_of_it_slowly_and_to_its_goal(
    model: Model, scene: Scene, low: tuple[float, float], high: tuple[float, float, float]
) -> None:
    row = guess(model, low, high)
    q, standing = loop(model, scene, row, 6.0)
    assert not standing["braking"] and standing["seconds"] < 1.0
    p = np.array([model.tool_pose(each).translation() for each in q])
    assert np.linalg.norm(p[-1] - GOAL[4:]) < 0.01
    around = scene.around(scene.forecast(NOBODY, None, row), np.zeros(len(q)))
    inside = scene.clearance.distances(q, around, 0.1, own=False)[:, 2] < -INSIDE
    went = np.linalg.norm(np.diff(p, axis=0), axis=1) * TWIN.planner.rate
    assert went[inside[1:]].max(initial=0.0) < 1.2 * TUNING.speed


def test_only_what_is_guessed_can_be_proved_wrong(model: Model, scene: Scene) -> None:
    planner = MotionPlanner(scene, model.velocity_limit, TWIN.planner)
    p = model.tool_pose(HOME).translation()
    can = Track(ObjectStatus.TRACKED, 0.0, np.array([1.0, 0, 0, 0, *p]), np.zeros(6), 1e-8 * np.eye(6)).pack()
    row = guess(model, (-0.1, -0.1), (0.1, 0.1, 0.1))
    forecast = scene.forecast(can, None, row)
    now = planner.guide.margins_at(HOME, forecast, HOME[None])
    assert (now.here[1:3] < -INSIDE).all(), "it is inside of both"
    assert proved_wrong(now).tolist() == [False, False, True]
    beside = guess(model, (-0.1, 0.12), (0.1, 0.2, 0.1))
    assert not proved_wrong(planner.guide.margins_at(HOME, scene.forecast(NOBODY, None, beside), HOME[None])).any()


def test_the_way_out_leads_up_to_where_all_is_free_and_is_slow(model: Model, scene: Scene) -> None:
    planner = MotionPlanner(scene, model.velocity_limit, TWIN.planner)
    forecast = scene.forecast(NOBODY, None, guess(model, (-0.1, -0.1), (0.1, 0.1, 0.12)))
    now = planner.guide.margins_at(HOME, forecast, HOME[None])
    way = way_out(scene, planner.router.lifted, now, planner.limits.velocity)
    assert way is not None
    times = np.linspace(0.0, way.duration, 50)
    p = np.array([model.tool_pose(q).translation() for q in way.at(times)])
    assert p[-1, 2] - p[0, 2] > 0.1 and np.abs(p[:, :2] - p[0, :2]).max() < 0.05
    assert (np.linalg.norm(np.diff(p, axis=0), axis=1) / np.diff(times)).max() < 1.5 * TUNING.speed
    around = scene.around(forecast, np.zeros(1))
    assert scene.clearance.distances(way.at(times)[-1:], around, 0.1).min() >= TUNING.free


def test_where_nothing_up_there_is_free_there_is_no_way_out(model: Model, scene: Scene) -> None:
    planner = MotionPlanner(scene, model.velocity_limit, TWIN.planner)
    everywhere = scene.forecast(NOBODY, None, guess(model, (-0.4, -0.4), (0.4, 0.4, 0.7)))
    now = planner.guide.margins_at(HOME, everywhere, HOME[None])
    assert way_out(scene, planner.router.lifted, now, planner.limits.velocity) is None
