"""Draws tables for Table III: a thing that clutter half hides, with friction and mass that nobody tells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from zlib import crc32

import numpy as np
import numpy.typing as npt
from pose_truth import raycast
from pose_truth.things import Thing

from twin_diagram.assets import Asset
from twin_diagram.assets.mesh import read_obj, read_png
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.scenario import Pose, Scenario, TaskStep, WorldObject, load_scenario
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]

THINGS = {"bottle": "bottle", "cup": "mug", "box": "gelatin_box", "can": "can"}
"""The paper's things, and which of the project's objects stand for them; the cup is a mug, with its handle."""
HIDES = ("cracker_box", "sugar_box")
"""What stands before them: tall enough to hide a half."""
HIDDEN = (0.3, 0.6)
"""Share of the thing's pixels."""
FRICTION = (0.4, 0.9)
MASS = 1.0
"""Masses are drawn from the asset's own up to this, evenly in their logarithm [kg]."""
ASIDE = (0.07, 0.13)
"""How far to either side of the line of sight what hides it stands, at most [m]: at first, and where `TRIES` draws were
in vain, for behind a broad box a low thing is hidden whole or not at all, unless that stands farther aside."""
TRIES = 200
"""Draws with each of `ASIDE`."""
LIFTED = (0.42, 0.0, 0.36)
"""Where the tool takes it to be held for three seconds [m]."""


@dataclass(frozen=True)
class Draw:
    """One table.

    Attributes:
        name: the thing's, among the scenario's objects.
        scenario: complete.
        share: of the thing that is hidden.
    """

    name: str
    scenario: Scenario
    share: float


def _yaw(angle: float) -> Array:
    return rotations.matrix(rotations.exp(np.array([0.0, 0.0, angle])))


def drawn(kind: str, seed: int, profile: str = "ideal") -> Draw:
    """Draw a table: the thing, what hides it, and one thing more that stands about.

    Raises:
        RuntimeError: in 400 draws nothing hid as much as it should.
    """
    name = THINGS[kind]
    rng = np.random.default_rng([crc32(kind.encode()), seed])
    scenario = load_scenario("pick_and_place", [f"world.camera_defects.profile={profile}"])
    camera = Pinhole.from_scenario(scenario.twin.camera)
    hider = HIDES[int(rng.integers(len(HIDES)))]
    others = [n for n in ("can", "gelatin_box") if n != name]
    about = others[int(rng.integers(len(others)))]
    for attempt in range(len(ASIDE) * TRIES):
        aside = ASIDE[attempt // TRIES]
        p = np.array([rng.uniform(0.40, 0.52), rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.28), 0.0])
        towards = camera.p_WC - p
        ahead = float(np.arctan2(towards[1], towards[0]))
        u = np.array([np.cos(ahead), np.sin(ahead), 0.0])
        across = np.array([-u[1], u[0], 0.0])
        own, before = thing_of(name), thing_of(hider)
        gap = rng.uniform(0.04, 0.10)
        q = p + u * (_half(own) + 0.5 * min(before.asset.size[:2]) + gap) + across * rng.uniform(-aside, aside)
        # Its broad side to the camera, give or take.
        broad = ahead + (0.0 if before.asset.size[0] < before.asset.size[1] else np.pi / 2) + rng.uniform(-0.3, 0.3)
        r = np.array([rng.uniform(0.38, 0.70), -np.sign(p[1]) * rng.uniform(0.15, 0.35), 0.0])
        placed = {name: (p, rng.uniform(-np.pi, np.pi)), hider: (q, broad), about: (r, rng.uniform(-np.pi, np.pi))}
        share = hidden_share(camera, placed, name)
        if HIDDEN[0] <= share <= HIDDEN[1]:
            break
    else:
        raise RuntimeError(f"{kind} {seed}: nothing hides {HIDDEN[0]:.0%} to {HIDDEN[1]:.0%} of it")
    scenario.seed, scenario.duration = seed, 16.0
    scenario.world.objects = {}
    for one, (at, turn) in placed.items():
        height = 0.5 * float(thing_of(one).asset.size[2])
        pose = Pose([float(at[0]), float(at[1]), height], [0.0, 0.0, float(turn)])
        scenario.world.objects[one] = WorldObject(asset=f"objects/{one}", X_WO=pose)
    lightest = own_mass(name)
    scenario.world.objects[name].mass = float(np.exp(rng.uniform(np.log(lightest), np.log(max(MASS, lightest)))))
    scenario.world.objects[name].friction = float(rng.uniform(*FRICTION))
    scenario.twin.library = {one: f"objects/{one}" for one in placed}
    scenario.twin.task.steps = [
        TaskStep(kind="pick", object=name, force=60.0, tries=1),
        TaskStep(kind="reach", goal=Pose(list(LIFTED), [np.pi, 0.0, 0.0]), rotation_tolerance=0.5),
        TaskStep(kind="hold", seconds=3.0),
    ]
    return Draw(name, scenario, share)


def own_mass(name: str) -> float:
    """Return what an object's asset weighs [kg]."""
    return float(Asset.load(resolve(f"objects/{name}", {})).mass)


def hidden_share(camera: Pinhole, placed: dict[str, tuple[Array, float]], name: str) -> float:
    """Return which share of a thing's pixels others hide."""
    laid = {
        one: (thing_of(one), _yaw(turn), at + [0.0, 0.0, thing_of(one).asset.size[2] / 2])
        for one, (at, turn) in placed.items()
    }
    alone = np.count_nonzero(raycast.take(camera, [laid[name]]).label == 0)
    order = [name, *(one for one in laid if one != name)]
    both = np.count_nonzero(raycast.take(camera, [laid[one] for one in order]).label == 0)
    return 1.0 - both / max(alone, 1)


@cache
def thing_of(name: str) -> Thing:
    """Return one of the project's objects as the casting of rays sees it."""
    folder = resolve(f"objects/{name}", {})
    mesh = read_obj(folder / "visual.obj")
    texture = read_png(folder / "visual.png")
    asset = Asset.load(folder)
    return Thing(asset, mesh, texture, asset.symmetric_axis)


def _half(one: Thing) -> float:
    return 0.5 * float(np.hypot(*one.asset.size[:2]))
