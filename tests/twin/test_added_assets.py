"""An asset that the twin was not built with comes into use in the running Diagram."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from tests.small_loop import estimates, same, small_scenario
from twin_diagram.errors import AssetError, TwinError
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.planning.collision.convex_solids import solid_of
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.planning.paths.guide import Question
from twin_diagram.runs.object_watch import ObjectWatch
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop

CAN = models_dir() / "objects" / "can"
END = 0.6


def loop_without_can(*overrides: str) -> ClosedLoop:
    """The can stands on the table, and the library knows the sugar box alone."""
    scenario = small_scenario(*overrides)
    del scenario.twin.library["can"]
    return make_closed_loop(scenario)


def own(loop: ClosedLoop, context: Context) -> Context:
    return loop.twin.diagram.GetMyMutableContextFromRoot(context)


def further(loop: ClosedLoop, context: Context) -> Array:
    rows = np.array(loop.twin.diagram.GetOutputPort("further_tracks").Eval(own(loop, context)))
    return rows.reshape(-1, FURTHER_TRACK_SIZE)


class Run:
    """A context of a loop, run in pieces and watched."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop, self.simulator = loop, Simulator(loop.diagram)
        self.simulator.Initialize()
        self.events: list[Any] = []
        self.watch = ObjectWatch(loop.twin, self.events.append)
        self.looks: list[dict[str, Array]] = []
        self.guide = b""

    @property
    def context(self) -> Context:
        return self.simulator.get_mutable_context()

    @property
    def own(self) -> Context:
        return own(self.loop, self.context)

    def go(self, until: float) -> None:
        for time in np.arange(round(self.context.get_time() / 0.1) + 1, round(until / 0.1) + 1) * 0.1:
            self.simulator.AdvanceTo(float(time))
            self.watch.poll(self.context)
            self.looks.append(estimates(self.loop, self.context))

    def happened(self) -> list[tuple[str, str]]:
        return [(event["event"], event["object"]) for event in self.events]


@pytest.fixture(scope="module")
def runs(egl: None) -> Iterator[tuple[Run, Run, Run]]:
    """One that takes the can in, one of the same Diagram that does not, and one of a Diagram that never heard of it."""
    loop = loop_without_can()
    first, other, alone = Run(loop), Run(loop), Run(loop_without_can())
    for run in (first, other, alone):
        run.go(0.3)
    assert loop.twin.mpc is not None
    first.guide = pickle.dumps(loop.twin.mpc.planner.guide)
    number = loop.twin.add_asset(CAN)
    loop.twin.use_asset(first.own, number)
    loop.twin.use_asset(first.own, number)  # once more changes nothing
    for run in (first, other, alone):
        run.go(END)
    yield first, other, alone


@pytest.mark.long
def test_it_is_found_and_told_of_by_its_name(runs: tuple[Run, Run, Run]) -> None:
    first, _, _ = runs
    happened = first.happened()
    assert happened.index(("new", "unknown#1")) < happened.index(("new", "can"))
    assert ("gone", "unknown#1") in happened
    told = first.watch.told(first.context)
    assert list(told) == ["can"] and told["can"]["status"] == "tracked"
    true = first.loop.scenario.world.objects["can"].X_WO.translation
    np.testing.assert_allclose(told["can"]["place"], true, atol=0.005)


@pytest.mark.long
def test_other_contexts_go_on_as_if_nothing_had_come(runs: tuple[Run, Run, Run]) -> None:
    _, other, alone = runs
    assert same(other.looks, alone.looks) == []
    assert other.happened() == alone.happened()
    assert list(other.watch.told(other.context)) == ["unknown#1"]


@pytest.mark.long
def test_scene_planner_and_monitor_have_its_shape(runs: tuple[Run, Run, Run]) -> None:
    first, _, _ = runs
    twin, rows = first.loop.twin, further(first.loop, first.context)
    (slot,) = np.flatnonzero(rows[:, 0] > 0)
    assert rows[slot, 1] == len(twin.library) and rows[slot, OWNER_SIZE] == ObjectStatus.TRACKED
    graph = twin.scene.scene_graph
    query: Any = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(first.context))
    assert query.inspector().GetGeometries(twin.scene.slots.further[slot], Role.kProximity)
    place = rows[slot, OWNER_SIZE + 6 : OWNER_SIZE + 9]

    assert twin.mpc is not None and twin.monitor is not None
    planned = twin.mpc.planner.scene
    tracks = np.array(twin.diagram.GetOutputPort("tracks").Eval(first.own))
    forecast = planned.forecast(tracks, rows.ravel())
    assert forecast.present[-1] and len(forecast.beside) == 1
    np.testing.assert_allclose(forecast.p_WO[-1], place)
    solids = [solid_of(piece) for piece in twin.added.assets["can"].convex_pieces]
    np.testing.assert_array_equal(forecast.beside[0].surface_O, Body.of("can", solids, True).surface_O)

    # What searches in another process has a copy of the scene from before: it is told with each question.
    q = np.array(twin.diagram.GetOutputPort("arm_state").Eval(first.own))
    home, nowhere = q[: len(q) // 2], np.zeros(7)
    question = Question((1,), home, nowhere, home[None], False, tracks, rows.ravel(), added=tuple(planned.added))
    answers = [guide.answer(question) for guide in (twin.mpc.planner.guide, pickle.loads(first.guide))]
    np.testing.assert_array_equal(answers[0].points, answers[1].points)
    with pytest.raises(IndexError):
        pickle.loads(first.guide).answer(replace(question, added=()))

    monitor = twin.diagram.GetSubsystemContext(twin.monitor, first.own)
    scene = twin.monitor._scene(monitor, first.context.get_time(), q)
    assert scene.shapes.present[len(twin.library) + slot] and scene.shapes.assets[slot] == len(twin.library)
    assert scene.radii[len(twin.library) + slot] == pytest.approx(
        0.5 * np.linalg.norm(twin.added.assets["can"].size), rel=1e-9
    )


@pytest.mark.long
def test_one_that_is_told_where_it_is_is_tracked_from_the_next_image_on(egl: None) -> None:
    run = Run(loop_without_can())
    number = run.loop.twin.add_asset(CAN, "tin")
    place = np.array(run.loop.scenario.world.objects["can"].X_WO.translation)
    run.loop.twin.use_asset(run.own, number, RigidTransform(place + [0.004, -0.004, 0.002]))
    run.go(0.3)
    assert list(run.watch.told(run.context)) == ["tin"]
    np.testing.assert_allclose(run.watch.told(run.context)["tin"]["place"], place, atol=0.004)
    assert ("new", "unknown#1") not in run.happened()


def test_what_cannot_be_taken_in_is_refused() -> None:
    twin = loop_without_can("twin.slots.instances=2").twin
    number = twin.add_asset(CAN)
    with pytest.raises(TwinError, match="asset can: the twin knows an object of this name already"):
        twin.add_asset(CAN)
    with pytest.raises(TwinError, match=r"asset sugar_box: .* already"):
        twin.add_asset(CAN, "sugar_box")
    with pytest.raises(AssetError):
        twin.add_asset(CAN / "no_such")
    with pytest.raises(TwinError, match="must have a name, not ''"):
        twin.add_asset(CAN, "")
    context = twin.diagram.CreateDefaultContext()
    with pytest.raises(TwinError, match=f"asset {number}: X_WO is not finite"):
        twin.use_asset(context, number, RigidTransform([0.5, 0.0, np.nan]))
    twin.use_asset(context, number)
    assert twin.names(context).of(1, 1, number) == "can" and twin.names(context).of(1, 2, number) == "can#3"
    with pytest.raises(TwinError, match=r"no slot is free .* all 1 beside the library's .*twin\.slots\.instances"):
        twin.use_asset(context, twin.add_asset(models_dir() / "objects" / "mug"))
    with pytest.raises(IndexError, match="asset 7: 2 were added, from 1 on"):
        twin.use_asset(context, 7)


@pytest.mark.long
def test_without_eyes_or_slots_nothing_comes_into_use() -> None:
    with pytest.raises(TwinError, match="no perception of its own"):
        loop_without_can("twin.camera=null").twin.add_asset(CAN)
    with pytest.raises(TwinError, match=r"no slots for further objects: twin\.slots\.instances"):
        loop_without_can("twin.slots.instances=1").twin.add_asset(CAN)


def test_an_asset_that_cannot_be_looked_for_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = loop_without_can()
    whole = ModelCloud.of

    def fails(asset: Any, view_points: int) -> ModelCloud:
        raise AssetError("no cloud")

    monkeypatch.setattr(ModelCloud, "of", fails)
    with pytest.raises(AssetError, match="no cloud"):
        loop.twin.add_asset(CAN)
    monkeypatch.setattr(ModelCloud, "of", whole)
    assert loop.twin.add_asset(CAN) == 1  # after the sugar box
