"""Draws a table on which two things go to and fro, at up to 0.5 m/s, between where the arm is and where it is to go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.model.model import Model
from twin_diagram.scenario import Pose, Scenario, WayPoint
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """What is drawn; chosen by hand."""

    movers: tuple[str, ...] = ("mover", "sugar_box")
    """What goes to and fro."""

    speed: tuple[float, float] = (0.1, 0.5)
    """Their highest speed, between these [m/s]."""

    way: tuple[float, float] = (0.15, 0.35)
    """How far they go, between these [m]."""

    until: float = 0.6
    """They move for this share of the run: then each stands, and the goal is free."""

    region: tuple[tuple[float, float], tuple[float, float]] = ((0.30, -0.46), (0.82, 0.46))
    """Lowest and highest x, y [m]: the table before the arm."""

    goals: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0.40, 0.22, 0.14), (0.60, 0.36, 0.26))
    """Where the tool is to go, on the side away from home (y mirrored) [m]."""

    room: float = 0.12
    """Between the edge of anything and where the tool starts or ends [m]."""

    spacing: float = 0.03
    """Between the edges of any two things, wherever they are [m]."""

    goals_tried: int = 20
    """So many goals are drawn, one of ten leaves the things no room; …"""

    draws: int = 200
    """… so many times places are drawn about each."""


TUNING = Tuning()


def draw_reach(base: Scenario, seed: int) -> Scenario:
    """Return the scenario with goal, places and ways drawn afresh.

    Args:
        base: with one goal, and `Tuning.movers` among its objects.
        seed: of the draw and the sensors' noise.

    Raises:
        ScenarioError: the things find no room.
    """
    scenario, rng = copy_scenario(base), np.random.default_rng([922, seed])
    scenario.seed = seed
    twin, objects = scenario.twin, scenario.world.objects
    model = Model.load(twin.arm, scenario.packages)
    start = model.tool_pose(np.array(twin.home)).translation()
    sizes = {name: np.array(Asset.load(resolve(item.asset, base.packages)).size) for name, item in objects.items()}
    for _ in range(TUNING.goals_tried):
        goal = rng.uniform(*np.array(TUNING.goals))
        goal[1] *= -np.sign(start[1])
        twin.task.X_WG = Pose(goal.tolist(), [float(np.pi), 0.0, float(rng.uniform(-0.8, 0.8))])
        tried = (_ways(sizes, start[:2], goal[:2], rng) for _ in range(TUNING.draws))
        ways = next((one for one in tried if one is not None), None)
        if ways is not None:
            break
    else:
        raise ScenarioError("world.objects", f"{len(objects)} objects find no room on the table (seed {seed})")
    for name, way in ways.items():
        height, yaw = float(sizes[name][2]) / 2, float(rng.uniform(-np.pi, np.pi))
        poses = [Pose([float(x), float(y), height], [0.0, 0.0, yaw]) for x, y in way]
        if name in TUNING.movers:
            objects[name].path = _to_and_fro(poses, rng, TUNING.until * scenario.duration)
        else:
            objects[name].X_WO = poses[0]
    return scenario


def _ways(sizes: dict[str, Array], start: Array, goal: Array, rng: np.random.Generator) -> dict[str, Array] | None:
    """Return for each thing where it stands, (1, 2), or between which two points it goes, (2, 2); None: no room."""
    found: dict[str, Array] = {}
    taken: list[tuple[Array, float]] = []
    low, high = np.array(TUNING.region)
    for name in sorted(sizes, key=lambda name: name not in TUNING.movers):
        radius = float(np.hypot(*sizes[name][:2])) / 2
        for _ in range(60):
            way = _way(name in TUNING.movers, low + radius, high - radius, start, goal, rng)
            line = np.linspace(way[0], way[-1], 20)
            near = min(float(np.linalg.norm(line - end, axis=1).min()) for end in (start, goal))
            clear = all(
                np.linalg.norm(line[:, None] - other[None], axis=-1).min() > radius + there + TUNING.spacing
                for other, there in taken
            )
            if near > radius + TUNING.room and clear and (way > low).all() and (way < high).all():
                break
        else:
            return None
        taken.append((line, radius))
        found[name] = way
    return found


def _way(moves: bool, low: Array, high: Array, start: Array, goal: Array, rng: np.random.Generator) -> Array:
    """Return a point within bounds, (1, 2), or two between which something goes, between start and goal, (2, 2)."""
    if not moves:
        return np.asarray(rng.uniform(low, high)[None])
    middle = start + (goal - start) * rng.uniform(0.3, 0.7) + rng.uniform(-0.05, 0.1, 2)
    angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(*TUNING.way)
    along = np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(middle + far / 2 * np.array([along, -along]))


def _to_and_fro(poses: list[Pose], rng: np.random.Generator, until: float) -> list[WayPoint]:
    """Return way points between two poses, rest to rest, at the same highest speed, until a time [s]."""
    far = float(np.linalg.norm(np.subtract(poses[0].translation, poses[1].translation)))
    took = 1.5 * far / float(rng.uniform(*TUNING.speed))  # the highest speed on a way is 1.5 times the mean
    times = [float(rng.uniform(0.2, 1.0))]
    while times[-1] + took < until:
        times.append(times[-1] + took)
    return [WayPoint(time, poses[k % 2]) for k, time in enumerate(times if len(times) > 1 else [*times, until])]
