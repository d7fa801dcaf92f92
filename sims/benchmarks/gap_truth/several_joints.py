"""Draws several effects that sit on several joints each: friction of both kinds on most of an arm, and mixtures of it.

Sizes are those of joints that are plainly worn or badly described, none of them hidden in the noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gap_truth.chain import Chain
from gap_truth.hidden import Hidden, Scale, log_uniform, places

MIXTURES = ("viscous on all", "mostly viscous", "mostly dry", "a pair", "friction and another")
"""What a case may be, in turn by its seed."""

PAIRED = (
    "viscous_friction",
    "coulomb_friction",
    "load_dependent_friction",
    "reflected_inertia",
    "torque_bias",
    "torque_constant",
)
"""Names that may come in a pair."""


def draw(seed: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> list[Hidden]:
    """The effects of a case."""
    n = chain.n

    def on(name: str, low: int, high: int) -> Hidden:
        return _draw(name, int(rng.integers(low, high + 1)), chain, scale, rng)

    mixture = MIXTURES[seed % len(MIXTURES)]
    if mixture == "viscous on all":
        things = [on("viscous_friction", n, n), on("coulomb_friction", 3, 3)]
    elif mixture == "mostly viscous":
        things = [on("viscous_friction", n - 2, n), on("coulomb_friction", 2, 4)]
    elif mixture == "mostly dry":
        things = [on("coulomb_friction", n - 2, n), on("viscous_friction", 2, 4)]
    elif mixture == "a pair":
        names = rng.choice(PAIRED, 2, replace=False)
        things = [on(str(name), 2, 4) for name in names]
    else:
        more = str(rng.choice(PAIRED[2:]))
        things = [on("viscous_friction", 3, n), on("coulomb_friction", 2, n), on(more, 1, 3)]
    return sorted(things, key=lambda thing: thing.name)


def _draw(name: str, count: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    possible = places(name, chain, scale)
    joints = tuple(sorted(int(j) for j in rng.choice(possible, min(count, len(possible)), replace=False)))
    key, value = _VALUES[name]
    return Hidden(name, joints, None, {key: [value(j, chain, scale, rng) for j in joints]})


def _level(j: int, chain: Chain, rng: np.random.Generator) -> float:
    """A torque, as a part of what the joint is rated for [N·m]."""
    return log_uniform(rng, 0.02, 0.08) * float(chain.links[j].effort)


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1, 1]))


_VALUES: dict[str, tuple[str, Callable[[int, Chain, Scale, np.random.Generator], float]]] = {
    "viscous_friction": ("damping", lambda j, c, s, rng: _level(j, c, rng) / max(float(s.speed[j]), 0.1)),
    "coulomb_friction": ("torque", lambda j, c, s, rng: _level(j, c, rng)),
    "load_dependent_friction": ("coefficient", lambda j, c, s, rng: log_uniform(rng, 0.04, 0.25)),
    "reflected_inertia": (
        "inertia",
        lambda j, c, s, rng: min(
            _level(j, c, rng) / max(float(s.acceleration[j]), 0.3), 2.0 * float(s.inertia[j]) + 0.2
        ),
    ),
    "torque_bias": ("torque", lambda j, c, s, rng: _sign(rng) * _level(j, c, rng)),
    "torque_constant": ("gain", lambda j, c, s, rng: 1.0 + _sign(rng) * log_uniform(rng, 0.03, 0.25)),
}
