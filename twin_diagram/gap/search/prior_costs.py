"""What a hypothesis costs before it has explained anything, and which names do not go together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from twin_diagram.gap.candidates.candidate import Candidate


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    new_name: float = 6.0
    """Price of naming one more effect [nats]: some twenty names, some seven places."""

    further_joint: float = 3.0
    """Price of naming it on one more joint."""

    mixed: float = 4.0
    """Price of saying that dry friction is of one kind on some joints and of another on others."""

    harmonic: float = 6.0
    """Price of a further ripple on a joint that has one [nats]: a few sines follow any curve of the angle."""


TUNING = Tuning()


EXCLUSIVE = (
    frozenset({"coulomb_friction", "stribeck_friction"}),
    frozenset({"torque_bias", "joint_spring"}),
    frozenset({"reflected_inertia", "joint_elasticity"}),
    frozenset({"reflected_inertia", "backlash"}),
    frozenset({"joint_elasticity", "backlash"}),
)
"""Names of which only one is said of a joint."""

ONCE = frozenset({"external_force", "payload", "inertial_parameters", "gravity_tilt", "time_delay"})
"""Names that are said once; several forces in a row follow any curve of time, several links' inertias any arm's."""


def price(members: Iterable[Candidate]) -> float:
    """Of names, joints and searched shapes [nats]."""
    counts: dict[str, int] = {}
    total = 0.0
    rippled: set[int] = set()
    for candidate in members:
        if candidate.name == "torque_ripple":
            total += TUNING.harmonic if candidate.joints[0] in rippled else 0.0
            rippled.add(candidate.joints[0])
        counts[candidate.name] = counts.get(candidate.name, 0) + 1
        total += candidate.cost
    mixed = TUNING.mixed if {"coulomb_friction", "stribeck_friction"} <= counts.keys() else 0.0
    return total + mixed + sum(TUNING.new_name + TUNING.further_joint * (count - 1) for count in counts.values())


def compatible(members: Iterable[Candidate], new: Candidate) -> bool:
    """Return whether a candidate may join others."""
    for old in members:
        if (
            new.name == old.name
            and (new.joints == old.joints and new.links == old.links)
            and not (new.name == "torque_ripple" and abs(new.shape["cycles"] - old.shape["cycles"]) > 2.0)
        ):
            return False
        if new.name == old.name and new.name in ONCE:
            return False
        if new.name in old.excludes or old.name in new.excludes:
            return False
        if set(new.joints) & set(old.joints) and frozenset({new.name, old.name}) in EXCLUSIVE:
            return False
        if new.links and new.links == old.links and {new.name, old.name} == {"payload", "inertial_parameters"}:
            return False
    return True
