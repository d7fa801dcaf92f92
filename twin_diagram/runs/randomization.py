"""Draws a scenario afresh from a seed: where objects stand, how they look, what the arm carries, who gets in its way.

Only sizes and the task stay. Used by trials over many seeds; the twin is told the new textures (they are its library),
never the poses, the payload, the friction or the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_diagram.assets.asset import Asset
from twin_diagram.assets.retexture import retexture
from twin_diagram.errors import ScenarioError
from twin_diagram.model.model import Model
from twin_diagram.runs.goal_room import HandShape, kept_at_goal
from twin_diagram.scenario import Pose, Scenario, WayPoint
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.scenario.poses import pose
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals.arrays import Array

REGION = ((0.30, -0.46), (0.80, 0.46))
"""Lowest and highest corner (x, y) of where objects stand [m]."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    spacing: float = 0.03
    """Free table between any two objects [m]."""

    free_around_tool: float = 0.10
    """Objects stand no nearer than this to where the tool starts and where it goes [m]; see also `goal_room`."""

    payload_mass: tuple[float, float] = (0.2, 1.5)
    """Between these the payload is drawn [kg]; a Panda may carry 3."""

    friction_error: float = 0.1
    """The world's friction differs from what the twin is told by up to this share."""


TUNING = Tuning()


def vary(base: Scenario, seed: int, folder: str | Path) -> Scenario:
    """Return a new scenario from `base`.

    Args:
        base: a simulated scenario.
        seed: of everything that is drawn.
        folder: where the newly textured assets are written.

    Raises:
        ScenarioError: the objects find no room.
    """
    rng = np.random.default_rng(seed)
    scenario = copy_scenario(base)
    scenario.seed = seed
    world, twin = scenario.world, scenario.twin
    for name, item in world.objects.items():
        source = resolve(item.asset, scenario.packages)
        item.asset = str(retexture(source, Path(folder).resolve() / name, int(rng.integers(1, 2**31))))
        if name in twin.library:
            twin.library[name] = item.asset
    _draw_dynamics(scenario, rng)
    model = Model.load(twin.arm, scenario.packages)
    start = model.tool_pose(np.array(twin.home or np.zeros(len(model.joints)))).translation()[:2]
    goal = np.array(twin.task.X_WG.translation[:2]) if twin.task.X_WG else start
    sizes = {item.asset: Asset.load(item.asset).size for item in world.objects.values()}
    hand = HandShape.of(twin.arm, scenario.packages) if twin.task.X_WG else None
    for _ in range(400):
        # Whole draws are rejected, so that those that leave the hand its room are what they were without the rule.
        if _draw_places(scenario, sizes, start, goal, rng) and (hand is None or _has_room(scenario, sizes, hand)):
            return scenario
    raise ScenarioError("world.objects", f"{len(world.objects)} objects find no room on the table (seed {seed})")


def _draw_dynamics(scenario: Scenario, rng: np.random.Generator) -> None:
    told = {effect.name: effect for effect in scenario.twin.arm.effects}
    for effect in scenario.world.arm.effects:
        if effect.name == "payload":
            effect.parameters["mass"] = [float(rng.uniform(*TUNING.payload_mass))]
            effect.parameters["com"] = [*rng.uniform(-0.03, 0.03, 2).tolist(), float(rng.uniform(0.12, 0.2))]
        elif effect.name in told:
            for name, values in told[effect.name].parameters.items():
                factors = rng.uniform(1 - TUNING.friction_error, 1 + TUNING.friction_error, len(values))
                effect.parameters[name] = (np.array(values) * factors).tolist()


def _draw_places(
    scenario: Scenario, sizes: dict[str, Array], start: Array, goal: Array, rng: np.random.Generator
) -> bool:
    """Put every object somewhere new; False where one finds no room."""
    taken: list[tuple[Array, float]] = []  # centres (m, 2) and radii
    low, high = np.array(REGION)
    # Whoever needs the most room is placed first.
    objects = sorted(
        scenario.world.objects.values(), key=lambda item: (not item.path, -float(np.hypot(*sizes[item.asset][:2])))
    )
    for item in objects:
        size = sizes[item.asset]
        radius, height = float(np.hypot(size[0], size[1])) / 2, float(size[2])
        for _ in range(100):
            yaw = float(rng.uniform(-np.pi, np.pi))
            if item.path:
                way = _draw_way(start, goal, rng)
            else:
                way = rng.uniform(low + radius, high - radius)[None, :]
            room = all(
                np.min(np.linalg.norm(way[:, None] - centre[None], axis=-1)) > radius + other + TUNING.spacing
                for centre, other in taken
            )
            ends = min(float(np.min(np.linalg.norm(way - point, axis=-1))) for point in (start, goal))
            if room and ends > radius + TUNING.free_around_tool:
                break
        else:
            return False
        taken.append((way, radius))
        if item.path:
            turn = float(rng.uniform(-0.8, 0.8))
            begin, duration = float(rng.uniform(0.5, 2.0)), float(rng.uniform(1.5, 3.5))
            item.path = [
                WayPoint(begin, Pose([float(way[0, 0]), float(way[0, 1]), height / 2], [0.0, 0.0, yaw])),
                WayPoint(
                    begin + duration, Pose([float(way[-1, 0]), float(way[-1, 1]), height / 2], [0, 0, yaw + turn])
                ),
            ]
        else:
            item.X_WO = Pose([float(way[0, 0]), float(way[0, 1]), height / 2], [0.0, 0.0, yaw])
    return True


def _has_room(scenario: Scenario, sizes: dict[str, Array], hand: HandShape) -> bool:
    """Tell whether objects, where they end, leave the hand at its goal what the planner always keeps."""
    goal = scenario.twin.task.X_WG
    if goal is None:
        return True
    X_WG, kept = pose(goal).GetAsMatrix4(), kept_at_goal(scenario.twin.planner)
    ends = [(item.path[-1].X_WO if item.path else item.X_WO, item.asset) for item in scenario.world.objects.values()]
    return all(hand.distance(X_WG, pose(X_WO).GetAsMatrix4(), sizes[asset]) >= kept for X_WO, asset in ends)


def _draw_way(start: Array, goal: Array, rng: np.random.Generator) -> Array:
    """Return a straight way (m, 2) from the far side of the table into the middle third between start and goal."""
    end = start + (goal - start) * rng.uniform(0.35, 0.65) + rng.uniform(-0.03, 0.06) * np.array([1.0, 0.0])
    away = np.array([rng.uniform(0.18, 0.28), rng.uniform(-0.2, 0.2)])
    return end + np.linspace(1.0, 0.0, 20)[:, None] * away
