"""A thing that no library knows turns once before the twin's camera; what the twin makes of it, beside the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from scipy.spatial import cKDTree

from twin_diagram.assets import Asset
from twin_diagram.scenario import Growing, Pose, Scenario, WayPoint, WorldObject, load_scenario, resolve
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE
from twin_diagram.station import ports
from twin_diagram.twin import make_closed_loop
from twin_diagram.twin.growing import Grower

TURN = 8.0
"""Seconds of a little more than a turn."""
POLLS = 30
"""Looks of the grower in a second."""


@dataclass(frozen=True)
class Grown:
    """What became of a thing.

    Attributes:
        events: of the grower.
        ready: when its pictures were enough [s]; None: never.
        off: mean distance of the tracked asset's surface from the true one, and of that from it [m]; None: no asset.
        milliseconds: that the grower took for images in which it looked at things.
        wall: seconds of the clock on the wall.
    """

    events: list[dict[str, Any]]
    ready: float | None
    off: tuple[float, float] | None
    milliseconds: Array
    wall: float


def scene(name: str, thing: str, seed: int) -> Scenario:
    """Return a scenario in which `thing` stands at a drawn place and turns; the library knows a can alone."""
    scenario = load_scenario(name, [f"seed={seed}", "twin.task.X_WG=null"])
    true, rng = Asset.load(resolve(f"objects/{thing}")), np.random.default_rng(seed)
    x, y, yaw = 0.5 + 0.08 * rng.random(), 0.1 + 0.1 * rng.random(), 2.0 * np.pi * rng.random()
    z = -float(true.points_O[:, 2].min())
    path = [WayPoint(0.3 + TURN * k / 8, Pose([x, y, z], [0.0, 0.0, yaw + 1.05 * k * np.pi / 4])) for k in range(9)]
    moved = WorldObject(asset=f"objects/{thing}", X_WO=path[0].X_WO, path=path)
    scenario.world.objects = {"can": scenario.world.objects["can"], "thing": moved}
    scenario.twin.library = {"can": scenario.twin.library["can"]}
    return scenario


def run(name: str, thing: str, seed: int, seconds: float) -> Grown:
    """Run a scene and hold what grew against what is there."""
    loop = make_closed_loop(scene(name, thing, seed))
    simulator, begin = Simulator(loop.diagram), time.perf_counter()
    simulator.Initialize()
    events: list[dict[str, Any]] = []
    spent: list[float] = []
    with TemporaryDirectory() as library:
        with Grower(loop.twin, Growing(library=library, answer_after=1.0), events.append) as grower:
            for k in range(1, round(seconds * POLLS) + 1):
                simulator.AdvanceTo(k / POLLS)
                before, told = time.process_time(), len(events)
                grower.poll(simulator.get_mutable_context())
                spent += [time.process_time() - before] if len(events) == told else []
        off = None
        if grower.grown:
            root = simulator.get_context()
            twin, station = (system.GetMyContextFromRoot(root) for system in (loop.twin.diagram, loop.station))
            rows = np.array(loop.twin.diagram.GetOutputPort("further_tracks").Eval(twin))
            row = next(row for row in rows.reshape(-1, FURTHER_TRACK_SIZE) if row[0] > 0)
            poses = np.array(loop.station.GetOutputPort(ports.OBJECT_POSES).Eval(station)).reshape(-1, 7)
            mine = _placed(next(iter(loop.twin.added.assets.values())), row[OWNER_SIZE + 2 : OWNER_SIZE + 9])
            off = _apart(mine, _placed(Asset.load(resolve(f"objects/{thing}")), poses[1]))
    ready = next((float(one["time"]) for one in events if one["event"] == "growth_started"), None)
    looked = 1e3 * np.array([one for one in spent if one > 0.004])
    return Grown(events, ready, off, looked, time.perf_counter() - begin)


def _placed(asset: Asset, pose: Array) -> Array:
    return np.asarray(asset.points_O @ rotations.matrix(pose[None, :4])[0].T + pose[4:])


def _apart(mine: Array, true: Array) -> tuple[float, float]:
    """Return mean distances [m] of points from the others, above what stands on the table."""
    over = [points[points[:, 2] > 0.008] for points in (mine, true)]
    return float(cKDTree(true).query(over[0])[0].mean()), float(cKDTree(mine).query(over[1])[0].mean())


def samples_apart(thing: str) -> float:
    """Return the mean distance of a thing's own points from one another [m]: what two samples of one surface show."""
    points = Asset.load(resolve(f"objects/{thing}")).points_O
    half = len(points) // 2
    return float(cKDTree(points[:half]).query(points[half:])[0].mean() / np.sqrt(2.0))
