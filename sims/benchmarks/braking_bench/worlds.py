"""Drawn tables for the stop monitor: things that lie, one that creeps, and an arm that would drive into them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from braking_bench.rogues import Rogue
from twin_diagram.model.model import Model
from twin_diagram.scenario import Scenario, WayPoint, WorldObject
from twin_diagram.scenario.file import load_scenario
from twin_diagram.scenario.models import Pose

Array = npt.NDArray[np.float64]

TINY = ("twin.camera.width=32", "twin.camera.height=24", "twin.camera.focal=30")
"""Nobody looks at these images."""
LYING = ("cracker_box", "can", "mug", "sugar_box")
HEIGHT = {"cracker_box": 0.105, "can": 0.051, "mug": 0.05, "sugar_box": 0.0875, "mover": 0.12}
"""Of the origins above the table [m]."""
HOME = [0.0, -0.2, 0.0, -2.0, 0.0, 1.9, 0.8]
"""The hand is 0.45 m above the table [rad]."""


def draw(seed: int, duration: float, speed: float, share: float = 0.4) -> Scenario:
    """Return a table with four things that lie and one that creeps.

    Args:
        seed: of all that is drawn.
        duration: [s]
        speed: of what creeps [m/s].
        share: of the joints' speed limits that a planner uses.
    """
    rng = np.random.default_rng([20, seed])
    scenario = load_scenario("tabletop", [f"duration={duration}", f"seed={seed}", *TINY])
    scenario.twin.home = list(HOME)
    scenario.twin.planner.velocity_share = share
    spots = _spots(rng, 5)
    objects: dict[str, WorldObject] = {}
    for name, (x, y) in zip(LYING, spots, strict=False):
        X = Pose(translation=[x, y, HEIGHT[name]], rpy=[0.0, 0.0, float(rng.uniform(-np.pi, np.pi))])
        objects[name] = WorldObject(asset=f"objects/{name}", X_WO=X)
    x, y = spots[4]
    yaw, angle = rng.uniform(-1.0, 1.0), rng.uniform(-np.pi, np.pi)
    far = speed * duration / 1.5  # a cubic from rest to rest peaks at 1.5 times its mean speed
    ends = [(x, y), (x + far * np.cos(angle), y + far * np.sin(angle))]
    path = [
        WayPoint(time=t, X_WO=Pose(translation=[*(float(c) for c in end), HEIGHT["mover"]], rpy=[0.0, 0.0, float(yaw)]))
        for t, end in zip((0.0, duration), ends, strict=True)
    ]
    objects["mover"] = WorldObject(asset="objects/mover", path=path)
    scenario.world.objects = objects
    scenario.twin.library = {name: f"objects/{name}" for name in objects}
    scenario.twin.task.X_WG = None
    return scenario


def _spots(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    while len(found) < count:
        x, y = float(rng.uniform(0.32, 0.72)), float(rng.uniform(-0.42, 0.42))
        if all(np.hypot(x - a, y - b) > 0.2 for a, b in found):
            found.append((x, y))
    return found


def towards(model: Model, p_W: Array, q: Array) -> Array:
    """Return joint angles (n,) that bring the tool to a place, as near as damped steps from `q` come."""
    for _ in range(200):
        X = model.tool_pose(q)
        J = model.tool_jacobian(q)[3:]
        error = p_W - X.translation()
        q = q + J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), np.clip(error, -0.05, 0.05))
        q = np.clip(q, model.lower + 0.05, model.upper - 0.05)
    return np.asarray(q)


def rogue(kind: str, scenario: Scenario, model: Model, seed: int) -> Rogue:
    """Return a planner that drives from one thing into the next."""
    rng = np.random.default_rng([21, seed])
    start = np.array(scenario.twin.home)
    places = []
    for each in scenario.world.objects.values():
        X = each.path[-1].X_WO if each.path else each.X_WO
        places.append(np.array([*X.translation[:2], rng.uniform(0.0, X.translation[2])]))
    order = rng.permutation(len(places))
    targets = [
        q for k in order for q in (towards(model, places[k], start), start + 0.2 * rng.standard_normal(len(start)))
    ]
    share = rng.uniform(0.2, 0.5)
    return Rogue(kind, start, targets, share * model.velocity_limit, float(rng.uniform(0.8, 1.6)))
