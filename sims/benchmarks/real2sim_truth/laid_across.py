"""Lays a cracker box, too wide for a hand, flat across one other thing, mostly as high as the bin's rim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram import Scenario
from twin_diagram.assets import Asset
from twin_diagram.runs.learning.drawn_bins import drawn_object, filled_bin
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.scenario.resources import resolve


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    below: tuple[str, ...] = ("ring", "can", "gelatin_box", "sugar_box", "angle")
    """What it lies across, on one of two sides."""

    inside: float = 0.06
    """Of the walls the middle of what is below stays [m]: half of most things."""

    off: float = 0.06
    """How far beside that, along each wall, it is let fall at the most [m]: it comes to lie askew, or on the rim."""

    turned: float = 0.4
    """By which it is turned against the walls at the most [rad]."""

    over_rim: float = 0.7
    """Share of draws in which it falls from over the rim, whatever is below."""

    rim: float = 0.125
    """Height of that [m]."""

    falls: tuple[float, float] = (0.005, 0.05)
    """Heights from which what is below falls to the bottom, and its middle then to that [m]."""


TUNING = Tuning()


def lay_across(base: Scenario, seed: int) -> Scenario:
    """Return a scenario with one thing in the bin and a cracker box across it, both drawn from a seed.

    Args:
        base: with ``twin.learning``.
        seed: of the draw and the sensors' noise.

    Raises:
        ScenarioError: nothing is learned there.
    """
    low, high = filled_bin(base)
    scenario, rng = copy_scenario(base), np.random.default_rng([923, seed])
    scenario.seed = seed
    kind = str(rng.choice(TUNING.below))
    below, box = (Asset.load(resolve(f"objects/{one}", base.packages)) for one in (kind, "cracker_box"))
    place = rng.uniform(low[:2] + TUNING.inside, high[:2] - TUNING.inside)
    roll = (0.0, np.pi / 2)[int(rng.integers(2))]
    beside = rng.uniform(-TUNING.off, TUNING.off, 2)
    half = 0.5 * float(below.size[1 if roll else 2])
    yaw = float(rng.choice(np.arange(4) * np.pi / 2) + rng.uniform(-TUNING.turned, TUNING.turned))
    lies = np.array([*place, low[2] + half + TUNING.falls[0]]), [roll, 0.0, float(rng.uniform(-3, 3))]
    scenario.world.objects = {"below": drawn_object(kind, below, lies, rng)}
    top = max(low[2] + 2 * half, TUNING.rim if rng.uniform() < TUNING.over_rim else 0.0)
    across = np.array([*(place + beside), top + TUNING.falls[1]]), [0.0, np.pi / 2, yaw]
    scenario.world.objects["across"] = drawn_object("cracker_box", box, across, rng)
    return scenario
