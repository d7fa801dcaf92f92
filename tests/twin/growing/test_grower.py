"""A thing that no library knows turns before the camera: it becomes an asset, followed under its name and avoided."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from tests.small_loop import estimates, same, small_scenario
from twin_diagram.assets.library import check
from twin_diagram.errors import TwinError
from twin_diagram.runs.object_watch import ObjectWatch
from twin_diagram.runs.run import run_scenario
from twin_diagram.scenario import Growing, Pose, Scenario, WayPoint
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE
from twin_diagram.station import ports
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.growing import Grower

pytestmark = pytest.mark.slow

TURN = 6.0
"""Seconds in which the box turns once."""
EDGES = np.array([0.09, 0.045, 0.175])


def scenario_of(turns: bool = True, duration: float = 9.0) -> Scenario:
    """A sugar box that the library does not know, turning where it stands."""
    scenario = small_scenario("twin.task.X_WG=null", f"duration={duration}")
    del scenario.twin.library["sugar_box"]
    box = scenario.world.objects["sugar_box"]
    x, y, z = box.X_WO.translation
    if turns:
        box.path = [
            WayPoint(0.3 + TURN * k / 8, Pose([x, y, z], [0.0, 0.0, box.X_WO.rpy[2] + k * np.pi / 4])) for k in range(9)
        ]
    return scenario


class Run:
    """A context of a loop with a grower of its own, polled as a run does."""

    def __init__(self, loop: ClosedLoop, params: Growing | None = None) -> None:
        self.loop, self.simulator = loop, Simulator(loop.diagram)
        self.simulator.Initialize()
        self.events: list[Any] = []
        self.watch = ObjectWatch(loop.twin, self.events.append)
        self.grower = None if params is None else Grower(loop.twin, params, self.events.append)
        self.looks: list[dict[str, Array]] = []

    @property
    def context(self) -> Context:
        return self.simulator.get_mutable_context()

    def go(self, until: float) -> None:
        step = 1.0 / 30.0
        for k in range(round(self.context.get_time() / step) + 1, round(until / step) + 1):
            self.simulator.AdvanceTo(k * step)
            if self.grower is not None:
                self.grower.poll(self.context)
            self.watch.poll(self.context)
        self.looks.append(estimates(self.loop, self.context))

    def tell(self, event: str) -> list[dict[str, Any]]:
        return [one for one in self.events if one["event"] == event]

    def track(self) -> Array:
        twin = self.loop.twin.diagram
        rows = np.array(twin.GetOutputPort("further_tracks").Eval(twin.GetMyContextFromRoot(self.context)))
        (row,) = [row for row in rows.reshape(-1, FURTHER_TRACK_SIZE) if row[0] > 0]
        return np.asarray(row)


@pytest.fixture(scope="module")
def runs(egl: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Run, Run, Run]]:
    """One that lets things grow, one of the same Diagram that does not, and another that does, of its own Diagram."""
    library = tmp_path_factory.mktemp("grown")
    loop = make_closed_loop(scenario_of())
    params = [Growing(library=str(library / name), answer_after=1.0) for name in "ab"]
    first, other, again = Run(loop, params[0]), Run(loop), Run(make_closed_loop(scenario_of()), params[1])
    for until in (3.0, 6.0, 9.0):
        for run in (first, other, again):
            run.go(until)
    yield first, other, again
    for run in (first, again):
        assert run.grower is not None
        run.grower.close()


def test_what_turned_is_an_asset_and_in_use_a_declared_time_later(runs: tuple[Run, Run, Run]) -> None:
    first, _, _ = runs
    (started,), (grown,) = first.tell("growth_started"), first.tell("grown")
    assert started["object"] == grown["object"] == "unknown#1" and grown["asset"] == "thing_1"
    assert grown["time"] == pytest.approx(started["time"] + 1.0, abs=0.035)
    asset, _ = check(Path(grown["folder"]))
    edges = np.sort(np.ptp(asset.points_O, axis=0))
    np.testing.assert_array_less(edges, np.sort([0.11, 0.11, 0.19]))
    spec = (asset.folder / "asset.yaml").read_text()
    assert "unseen" in spec
    happened = [(one["event"], one["object"]) for one in first.events if "object" in one]
    assert happened.index(("grown", "unknown#1")) < happened.index(("new", "thing_1"))
    assert ("gone", "unknown#1") in happened


def test_it_is_then_tracked_under_its_name(runs: tuple[Run, Run, Run]) -> None:
    first, _, _ = runs
    assert list(first.watch.told(first.context)) == ["thing_1"]
    row = first.track()
    assert row[OWNER_SIZE] == ObjectStatus.TRACKED
    names = list(first.loop.scenario.world.objects)
    station = first.loop.station
    own = station.GetMyContextFromRoot(first.context)
    poses = np.array(station.GetOutputPort(ports.OBJECT_POSES).Eval(own)).reshape(-1, 7)
    true = poses[names.index("sugar_box")]
    np.testing.assert_allclose(row[OWNER_SIZE + 6 : OWNER_SIZE + 9], true[4:], atol=0.006)


def test_it_is_planned_around(runs: tuple[Run, Run, Run]) -> None:
    first, _, _ = runs
    twin = first.loop.twin
    assert twin.mpc is not None
    own = twin.diagram.GetMyContextFromRoot(first.context)
    tracks, further, things = (
        np.array(twin.diagram.GetOutputPort(name).Eval(own)) for name in ("tracks", "further_tracks", "things")
    )
    forecast = twin.mpc.planner.scene.forecast(tracks, further, things)
    assert len(forecast.beside) == 1 and forecast.present.all()  # the asset alone: no unknown thing any more
    solid = sum(float(np.prod(np.ptp(piece, axis=0))) for piece in twin.added.assets["thing_1"].convex_pieces)
    assert solid > 0.9 * np.prod(EDGES)


def test_a_context_without_a_grower_keeps_the_unknown_thing(runs: tuple[Run, Run, Run]) -> None:
    _, other, _ = runs
    assert list(other.watch.told(other.context)) == ["unknown#1"]


def test_a_second_diagram_grows_the_same_to_the_bit(runs: tuple[Run, Run, Run]) -> None:
    first, _, again = runs
    assert same(first.looks, again.looks) == []

    def plain(run: Run) -> list[dict[str, Any]]:
        return [{k: v for k, v in one.items() if k != "folder"} for one in run.events]

    assert plain(first) == plain(again)
    np.testing.assert_array_equal(first.track(), again.track())


def test_a_killed_child_is_told_and_tried_again(egl: None, tmp_path: Path) -> None:
    run = Run(make_closed_loop(scenario_of()), Growing(library=str(tmp_path / "library"), answer_after=0.5, attempts=2))
    grower, killed = run.grower, 0
    assert grower is not None
    with grower:
        while run.context.get_time() < 8.0 and not run.tell("grown"):
            run.go(run.context.get_time() + 1.0 / 30.0)
            job = grower._job
            if job is not None and not killed:
                killed = job.process.pid
                os.kill(killed, signal.SIGKILL)
        (failed,) = run.tell("growth_failed")
        assert failed["object"] == "unknown#1" and "ended by a signal: Killed" in failed["why"]
        assert len(run.tell("growth_started")) == 2 and len(run.tell("grown")) == 1
    assert sorted(path.name for path in (tmp_path / "library").iterdir()) == ["thing_1"]


def test_from_one_side_it_stays_partial_and_is_marked_so(egl: None, tmp_path: Path) -> None:
    scenario = scenario_of(turns=False, duration=0.8)
    scenario.twin.growth = Growing()
    summary = run_scenario(scenario, out=tmp_path / "out", pictures=False, quiet=True, say=lambda text: None)
    told = summary["growth"]
    assert told["grown"] == {} and told["partial"]["unknown#1"]["pictures"] == 1
    assert 0.2 < told["partial"]["unknown#1"]["seen"] < 0.6
    events = [json.loads(line) for line in (tmp_path / "out" / "events.jsonl").read_text().splitlines()]
    assert not any(one["event"].startswith("gr") for one in events)
    with np.load(tmp_path / "out" / "grown" / "unknown_1.partial.npz") as data:
        assert bool(data["partial"])
        points, normals = data["points"], data["normals"]
    eye = np.array(scenario.twin.camera.X_WC.translation)  # type: ignore[union-attr]
    x, y, _ = scenario.world.objects["sugar_box"].X_WO.translation
    away = eye - [x, y, 0.0875]
    # In T, about its middle: of the sides that face away from the camera nothing is claimed.
    assert (normals @ away > -0.1 * np.linalg.norm(away)).mean() > 0.99
    assert len(points) > 100


def test_without_eyes_nothing_grows() -> None:
    with pytest.raises(TwinError, match=r"twin\.growth: .* twin\.camera is null"):
        scenario = small_scenario("twin.camera=null", "twin.growth={}")
        make_closed_loop(scenario)
