"""The draws of SyncTwin's Table II: an arm that goes to and fro between two targets, and a box in its way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.procedural import write_box
from twin_diagram.scenario import CameraDefects, Pose, Scenario, TaskStep, WayPoint, WorldObject
from twin_diagram.scenario.file import load_scenario

Array = npt.NDArray[np.float64]

BOXES = {"box1": (0.1, 0.1, 0.1), "box2": (0.2, 0.2, 0.2), "box3": (0.1, 0.2, 0.3), "box4": (0.2, 0.22, 0.35)}
"""The paper's [m]."""
DENSITY = 120.0
"""Of a filled carton [kg/m³]."""
PUSH = 15.0
"""What an obstacle gives way to [N]."""
MOTIONS = ("SelfRot", "EnterTraj")
DURATION = 15.0
"""[s]"""
START = 0.5
"""When the arm sets off [s]."""
SMALL = ("twin.camera.width=320", "twin.camera.height=240", "twin.camera.focal=300", "twin.perception.stride=1")
TARGETS = ((0.50, 0.34, 0.30), (0.50, -0.34, 0.30)), ((0.46, 0.36, 0.22), (0.46, -0.36, 0.22)), (
    (0.54, 0.32, 0.25), (0.44, -0.36, 0.30)), ((0.44, 0.36, 0.30), (0.54, -0.32, 0.25))  # fmt: skip
"""Pairs of places for the tool, which points down [m]; a seed's is its number's rest by four."""
HOME = (0.6, -0.1, 0.0, -2.1, 0.0, 2.0, 1.4)
"""Beside the first target [rad]."""


@dataclass(frozen=True)
class Draw:
    """One draw: which box, how it moves, which targets."""

    seed: int
    motion: str
    box: str
    targets: int
    path: list[WayPoint]


def drawn(seed: int, motion: str) -> Draw:
    """Return the draw of a seed; boxes come in turn, targets too."""
    rng = np.random.default_rng([2, MOTIONS.index(motion), seed])
    names = list(BOXES)
    box, targets = names[seed % 4], (seed // 4) % 4
    half = BOXES[box][2] / 2
    middle = np.array([rng.uniform(0.45, 0.65), rng.uniform(-0.08, 0.08)])
    yaw = rng.uniform(-np.pi, np.pi)

    def at(time: float, p: Array, turn: float) -> WayPoint:
        return WayPoint(float(time), Pose([float(p[0]), float(p[1]), half], [0.0, 0.0, float(turn)]))

    if motion == "SelfRot":
        rate = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.2)
        return Draw(
            seed, motion, box, targets, [at(t, middle, yaw + rate * t) for t in np.arange(0.0, DURATION + 1.6, 1.5)]
        )
    # It waits far from the base, comes into the way, stays, and goes again, until the time is over.
    away = np.array([rng.uniform(0.92, 1.0), rng.uniform(-0.15, 0.15)])
    points, time = [at(0.0, away, yaw)], rng.uniform(1.0, 2.5)
    while time < DURATION:
        turn = yaw + rng.uniform(-0.6, 0.6)
        takes = float(np.linalg.norm(middle - away)) / rng.uniform(0.1, 0.3)
        stays = rng.uniform(2.0, 4.0)
        points += [at(time, away, yaw), at(time + takes, middle, turn), at(time + takes + stays, middle, turn)]
        time += 2 * takes + stays
        points.append(at(time, away, yaw))
        time += rng.uniform(0.8, 2.0)
    return Draw(seed, motion, box, targets, points)


def library(folder: Path) -> dict[str, Path]:
    """Return the boxes' assets, written where they are not there yet."""
    for k, (name, size) in enumerate(BOXES.items()):
        if not (folder / name / "asset.yaml").is_file():
            write_box(folder / name, name, size, texture_seed=40 + k, mass=DENSITY * float(np.prod(size)))
    return {name: folder / name for name in BOXES}


def scenario_of(
    draw: Draw,
    assets: dict[str, Path],
    row: str,
    profile: str = "ideal",
    present: bool = True,
    seconds: float = DURATION,
) -> Scenario:
    """Return the scenario of a draw.

    Args:
        draw: box, motion and targets.
        assets: the boxes.
        row: `seen` (the boxes are in the library), `unseen`, `ignore all` (no camera, no monitor), `stand still`.
        profile: of the camera.
        present: whether the box is there; without it the visits are counted that a row is held to.
        seconds: how long it runs.
    """
    scenario = load_scenario("tabletop", [f"duration={seconds}", f"seed={draw.seed}", *SMALL])
    scenario.twin.home = list(HOME)
    scenario.twin.library = {name: str(path) for name, path in assets.items()} if row == "seen" else {}
    scenario.world.objects = {}
    if present:
        scenario.world.objects[draw.box] = WorldObject(asset=str(assets[draw.box]), path=draw.path, push=PUSH)
    scenario.world.camera_defects = CameraDefects(profile=profile)
    scenario.twin.planner.velocity_share = 0.4
    if row == "ignore all" or not present:
        scenario.twin.camera = None
    if row == "ignore all":
        scenario.twin.stop_monitor = None
    scenario.twin.task.X_WG = None
    scenario.twin.task.start = START
    if row != "stand still":
        pair = TARGETS[draw.targets]
        steps = [
            TaskStep(goal=Pose(list(pair[k % 2]), [np.pi, 0.0, 0.0]), position_tolerance=0.02, time_limit=2 * DURATION)
            for k in range(40)
        ]
        scenario.twin.task.steps = steps
    return scenario
