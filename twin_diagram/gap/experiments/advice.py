"""What to measure next where two names fit the data nearly as well."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from twin_diagram.gap.candidates.records import Wakes, record_of
from twin_diagram.gap.findings import Separation
from twin_diagram.signals import units

STATIC = "static poses: hold many poses over the whole range, each reached once from above and once from below"
"""Shows what depends on pose alone: gravity, springs, offsets; both ways, so that friction cancels."""
SLOW = "reverse slowly at 0.02 rad/s, about many angles"
"""Shows what happens at reversals: dry friction, play."""
SPEEDS = "sweep each joint at constant speeds from 0.02 rad/s to its limit, both ways"
"""Shows friction over speed."""
LOAD = "repeat with a known payload"
"""Tells what grows with load from what does not."""
FAST = "accelerate hard about one pose: sines of small range at 1 to 4 Hz"
"""Shows inertia, delay and elasticity."""
LONG = "repeat the same motion for some minutes"
"""Shows what comes and goes with time."""
STILL = "hold still for 10 s at the begin and at the end"
"""Shows constant torque and noise."""

FRICTION = frozenset({Wakes.REVERSAL, Wakes.SPEED})
"""What friction is brought out by."""


def experiment(a: str, b: str) -> str:
    """Return the experiment that would tell two names apart."""
    both = [record_of(name).wakes for name in (a, b)]
    either = both[0] | both[1]
    if a == b:
        return SLOW if Wakes.REVERSAL in either else FAST if Wakes.ACCELERATION in either else STATIC
    if Wakes.TIME in either:
        return STILL
    if all(wakes & FRICTION for wakes in both):
        loaded = any({Wakes.REVERSAL, Wakes.LOAD} <= wakes for wakes in both)
        return LOAD if loaded else SPEEDS if Wakes.SPEED in either else SLOW
    if Wakes.LOAD in either:
        return LOAD
    if all(Wakes.POSE in wakes for wakes in both):
        return STATIC
    if Wakes.ACCELERATION in either:
        return FAST
    if Wakes.REVERSAL in either:
        return SLOW
    return STATIC if Wakes.POSE in either else SPEEDS


def worded(text: str, joints: Sequence[str], prismatic: Collection[str]) -> str:
    """Return an experiment's sentence as it is said of some joints: speeds and places of prismatic ones are m/s and m.

    Args:
        text: of this module.
        joints: that it is about.
        prismatic: which of the arm's joints are.
    """
    slide = [joint in prismatic for joint in joints]
    if not any(slide):
        return text
    for turning, other in ((units.SPEED, units.on_joint(units.SPEED)), ("angles", "positions")):
        text = text.replace(turning, other if all(slide) else f"{turning} or {other}")
    return text


def asked(pair: Separation, joints: Sequence[str], prismatic: Collection[str]) -> str:
    """Return the experiment of a near pair, worded for the joints that the pair names, or for all of the arm's."""
    places = {place for claim in (pair.a, pair.b) for place in claim.partition(" on ")[2].split(", ")}
    return worded(pair.experiment, [joint for joint in joints if joint in places] or joints, prismatic)
