"""Draws tables for pick-and-place: what is taken, how heavy it is, what stands about, where it is to go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Pose, Scenario
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    targets: tuple[str, ...] = ("can", "gelatin_box")
    """What is taken, one or the other: what the Panda's hand can take from above."""

    heaviest: float = 2.0
    """Masses are drawn from the asset's own up to this, evenly in their logarithm [kg]."""

    reach: tuple[float, float] = (0.40, 0.58)
    """x of where things are taken and put [m]: where the arm reaches down on either side."""

    side: tuple[float, float] = (0.30, 0.38)
    """Their distance from the middle, on opposite sides [m]: 0.6 m apart at least."""

    region: tuple[tuple[float, float], tuple[float, float]] = ((0.36, -0.42), (0.78, 0.42))
    """Lowest and highest x, y of other objects' middles [m]: the table before the arm."""

    room: float = 0.09
    """Between the edge of an object and where another is taken or put, so that an open hand finds room [m]."""

    spacing: float = 0.03
    """Between the edges of other objects [m]."""

    draws: int = 20_000
    """Of all others' places, until all have room: ten in the median, but one of 1,000 seeds over 200."""


TUNING = Tuning()


def draw_picks(base: Scenario, seed: int) -> Scenario:
    """Return a scenario with one `pick` and one `place`, all its places drawn afresh.

    Args:
        base: with `Tuning.targets` among its objects, and a task of those two steps.
        seed: of the draw and the sensors' noise.

    Raises:
        ScenarioError: the objects find no room, or the task is another one.
    """
    scenario, rng = copy_scenario(base), np.random.default_rng([911, seed])
    scenario.seed = seed
    steps = scenario.twin.task.steps
    if [step.kind for step in steps] != ["pick", "place"]:
        raise ScenarioError("twin.task.steps", "only a pick and a place after it are drawn")
    name = TUNING.targets[int(rng.integers(len(TUNING.targets)))]
    side = float(rng.choice([-1.0, 1.0]))
    ends = np.array([[rng.uniform(*TUNING.reach), s * rng.uniform(*TUNING.side)] for s in (side, -side)])
    assets = {key: Asset.load(resolve(item.asset, base.packages)) for key, item in scenario.world.objects.items()}
    own = scenario.world.objects[name]
    half = 0.5 * float(assets[name].size[2])
    own.mass = float(np.exp(rng.uniform(np.log(assets[name].mass), np.log(TUNING.heaviest))))
    own.X_WO = Pose([*ends[0].tolist(), half], [0.0, 0.0, float(rng.uniform(-np.pi, np.pi))])
    for _ in range(TUNING.draws):
        places = _places(
            [key for key in assets if key != name], assets, ends, float(np.hypot(*assets[name].size[:2])), rng
        )
        if places is not None:
            break
    else:
        raise ScenarioError("world.objects", f"{len(assets)} objects find no room on the table (seed {seed})")
    for key, (x, y) in places.items():
        yaw = float(rng.uniform(-np.pi, np.pi))
        scenario.world.objects[key].X_WO = Pose([x, y, 0.5 * float(assets[key].size[2])], [0.0, 0.0, yaw])
    steps[0].object = steps[1].object = name
    steps[1].goal = Pose([*ends[1].tolist(), half], [0.0, 0.0, own.X_WO.rpy[2]])
    return scenario


def _places(
    names: list[str], assets: dict[str, Asset], ends: Array, wide: float, rng: np.random.Generator
) -> dict[str, tuple[float, float]] | None:
    """Return where other objects stand; None where one finds no room beside two ends that are `wide` [m]."""
    found: dict[str, tuple[float, float]] = {}
    for name in names:
        radius = 0.5 * float(np.hypot(*assets[name].size[:2]))
        place = rng.uniform(*np.array(TUNING.region))
        apart = np.linalg.norm(ends - place, axis=1).min() > radius + 0.5 * wide + TUNING.room
        for other, there in found.items():
            both = radius + 0.5 * float(np.hypot(*assets[other].size[:2]))
            apart = apart and float(np.linalg.norm(np.array(there) - place)) > both + TUNING.spacing
        if not apart:
            return None
        found[name] = (float(place[0]), float(place[1]))
    return found
