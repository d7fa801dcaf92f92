"""Draws bins full of objects: kinds, poses, masses, hidden loads and friction, from a seed. The world's side alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Pose, Scenario, WorldObject
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    kinds: tuple[str, ...] = (
        *("angle", "ring", "flask", "bottle", "can", "sugar_box", "gelatin_box"),
        "cracker_box",
    )
    """What may lie in a bin: four of eight are not convex. The mug, hollow to fingers too, is not
    among them: with it every seed would draw another bin."""

    heaviest: float = 1.5
    """Masses are drawn from the asset's own up to this, evenly in their logarithm [kg]."""

    loaded: float = 0.5
    """Share of the objects in which a load is hidden off the centre."""

    off: float = 0.25
    """How far off the centre of mass may be, as a share of the size along each axis."""

    friction: tuple[float, float] = (0.4, 0.9)
    """Of objects' surfaces."""

    spacing: float = 0.01
    """Between the balls about objects where they are let go [m]."""

    fall: float = 0.01
    """Height over the bottom from which they fall [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Lying:
    """Room that something takes as it is let go: a cylinder about the vertical, up to its top [m]."""

    middle: Array
    radius: float
    top: float


def draw_bin(base: Scenario, seed: int, count: int) -> Scenario:
    """Return a scenario with a bin drawn afresh: what lies in it, and all that the twin is not told.

    Objects that find no room beside the others are let fall upon them.

    Args:
        base: with ``twin.learning``.
        seed: of the draw and the sensors' noise.
        count: of objects.

    Raises:
        ScenarioError: nothing is learned there.
    """
    low, high = filled_bin(base)
    scenario, rng = copy_scenario(base), np.random.default_rng([922, seed])
    scenario.seed = seed
    scenario.world.objects = {}
    lying: list[Lying] = []
    kinds = rng.permutation(np.resize(TUNING.kinds, max(count, len(TUNING.kinds))))[:count]
    for number, kind in enumerate(kinds):
        asset = Asset.load(resolve(f"objects/{kind}", base.packages))
        place = _place(asset, low, high, lying, rng)
        scenario.world.objects[f"thing_{number}"] = drawn_object(str(kind), asset, place, rng)
    return scenario


def filled_bin(base: Scenario) -> tuple[Array, Array]:
    """Return the lowest and the highest corner (3,) of the inside of the bin that objects are drawn into, in W [m].

    Raises:
        ScenarioError: nothing is learned there.
    """
    if base.twin.learning is None:
        raise ScenarioError("twin.learning", "is missing: it tells the bin that is filled with objects")
    low, high = (np.array(corner) for corner in base.twin.learning.from_bin)
    return low, high


def drawn_object(kind: str, asset: Asset, place: tuple[Array, list[float]], rng: np.random.Generator) -> WorldObject:
    """Return an object of a kind with a mass, a hidden load or none, and a friction drawn.

    Args:
        kind: of `objects/`.
        asset: of it.
        place: where it is let go in W [m], and its roll, pitch and yaw [rad].
        rng: that draws.
    """
    mass = float(np.exp(rng.uniform(np.log(asset.mass), np.log(max(TUNING.heaviest, asset.mass * 1.01)))))
    load = None
    if rng.uniform() < TUNING.loaded:
        more = mass - asset.mass
        # The whole centre is off by the load's share of where it sits.
        wanted = rng.uniform(-TUNING.off, TUNING.off, 3) * asset.size
        load = np.clip(wanted * mass / more, -0.35 * asset.size, 0.35 * asset.size).tolist()
    rpy = place[1]
    return WorldObject(
        asset=f"objects/{kind}",
        X_WO=Pose(place[0].tolist(), rpy),
        mass=mass,
        load_at=load,
        friction=float(rng.uniform(*TUNING.friction)),
    )


def _place(
    asset: Asset, low: Array, high: Array, lying: list[Lying], rng: np.random.Generator
) -> tuple[Array, list[float]]:
    """Return where an object is let go, and how it is turned: on a side, as it comes to rest."""
    sides = ((0.0, 0.0), (np.pi / 2, 0.0), (0.0, np.pi / 2), (-np.pi / 2, 0.0))
    roll, pitch = sides[int(rng.integers(len(sides)))]
    half = 0.5 * np.asarray(asset.size)
    if abs(roll) > 0.1:
        half = half[[0, 2, 1]]
    if abs(pitch) > 0.1:
        half = half[[2, 1, 0]]
    radius = float(np.hypot(half[0], half[1]))
    reach = np.minimum(radius, 0.48 * (high - low)[:2])
    for _ in range(300):
        xy = rng.uniform(low[:2] + reach, high[:2] - reach)
        below = [one for one in lying if np.linalg.norm(xy - one.middle) < one.radius + radius + TUNING.spacing]
        if not below:
            break
    # Where there is no room beside the others it falls upon those that are below its last place.
    lowest = max((one.top for one in below), default=float(low[2])) + TUNING.fall
    lying.append(Lying(xy, radius, float(lowest + 2.0 * half[2])))
    return np.array([*xy, lowest + half[2]]), [float(roll), float(pitch), float(rng.uniform(-np.pi, np.pi))]
