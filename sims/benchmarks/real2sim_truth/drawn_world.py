"""Draws how sensors and joints of a cell fall short: what the score of learning sets, and the twin is not told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram import Scenario
from twin_diagram.scenario import EffectSpec
from twin_diagram.scenario.file import copy_scenario


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units; each is the issue's."""

    gain: float = 0.01
    """Error of each joint's measured torque, as a share of it, RMS."""

    bias: float = 0.2
    """Constant error of it, RMS [N·m]."""

    viscous: float = 0.5
    """Most damping of a joint [N·m·s/rad]."""

    dry: float = 0.5
    """Most dry friction of a joint [N·m]."""

    camera: tuple[float, float] = (0.002, float(np.radians(0.3)))
    """By how much each camera stands otherwise than it is told [m], [rad]."""


TUNING = Tuning()


def fall_short(scenario: Scenario, joints: tuple[str, ...]) -> Scenario:
    """Return a scenario whose sensors and joints fall short as the scorer has it; draws are of its seed.

    What the scenario says of the cameras' defects stays, but for how they stand.

    Args:
        scenario: of a cell.
        joints: names of the arm's.
    """
    drawn, n = copy_scenario(scenario), len(joints)
    rng, world = np.random.default_rng([923, scenario.seed]), drawn.world
    world.arm_defects.torque_gain = (1.0 + TUNING.gain * rng.normal(size=n)).tolist()
    world.arm_defects.torque_bias = (TUNING.bias * rng.normal(size=n)).tolist()
    for name, parameter, most in (
        ("viscous_friction", "damping", TUNING.viscous),
        ("coulomb_friction", "torque", TUNING.dry),
    ):
        world.arm.effects.append(EffectSpec(name, list(joints), [], {parameter: rng.uniform(0.0, most, n).tolist()}))
    world.camera_defects.X_WC_error = list(TUNING.camera)
    return drawn
