"""Torque that repeats with a joint's angle: its candidates, of which there are too many to keep, and its record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.joint_candidate import single
from twin_diagram.gap.candidates.merging import beside
from twin_diagram.gap.candidates.records import EffectRecord, register
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.ripple import TorqueRipple
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    most_cycles: float = 320.0
    """Ripples per turn of the joint that are looked for."""

    lowest: float = 0.6
    """A count that is moved to where data want it stays above this share of the lowest one tried."""

    apart: float = 2.0
    """Counts of one joint that differ by no more are one ripple."""

    harmonic: float = 6.0
    """Price of a further ripple on a joint that has one [nats]: a few sines follow any curve of the angle."""


TUNING = Tuning()


def count_step(terms: Terms, j: int) -> float:
    """Return the difference of counts that the joint's range just tells apart, nearly halved."""
    travelled = float(np.ptp(np.concatenate([r.q[:, j] for r in terms.records.records])))
    return 0.4 * 2.0 * np.pi / max(travelled, 1e-3)


def ripple_counts(terms: Terms, j: int) -> Array:
    """Count that are tried.

    They begin above one ripple in the joint's range, and end where its speed takes most of a ripple out of the band.
    """
    step = count_step(terms, j)
    if step > 10.0:
        return np.zeros(0)
    speed = float(np.median(np.concatenate([np.abs(r.v[:, j]) for r in terms.records.records])))
    most = min(TUNING.most_cycles, 2.0 * np.pi * terms.records.records[0].band / max(speed, 1e-3))
    return np.arange(max(4.0, 3.75 * step), most, step, dtype=np.float64)


def ripple_columns(terms: Terms, j: int, counts: Array) -> Array:
    """Return (ΣD, 2 M): sines, then cosines."""
    parts = []
    for record in terms.records.records:
        angle = terms.records.angles(record)[:, j, None] * counts
        parts.append(np.concatenate([np.sin(angle), np.cos(angle)], axis=1))
    return terms.reduce(tuple(parts))


def ripple(terms: Terms, j: int, count: float) -> Candidate | None:
    """Return the candidate of one count; none below those that are tried."""
    tried = ripple_counts(terms, j)
    if len(tried) and count < TUNING.lowest * tried[0]:
        return None

    def values(c: Array) -> dict[str, Array]:
        return {
            "amplitude": np.array([np.hypot(c[0], c[1])]),
            "cycles": np.array([count]),
            "phase": np.array([np.arctan2(c[1], c[0])]),
        }

    return single(
        terms,
        TorqueRipple.name,
        j,
        list(ripple_columns(terms, j, np.array([count])).T),
        transformed(values),
        [-np.inf] * 2,
        shape={"cycles": count},
        cost=float(np.log(0.4 * max(len(tried), 3))),
    )


def shapes(terms: Terms, candidate: Candidate) -> list[tuple[str, float, float]]:
    """Return the count, as far as the joint's range leaves it open."""
    width = min(0.3, count_step(terms, candidate.joints[0]) / candidate.shape["cycles"])
    return [("cycles", 1.0 - width, 1.0 + width)]


def rebuilt(terms: Terms, candidate: Candidate, key: str, value: float) -> Candidate | None:
    """Return the candidate of another count."""
    del key
    return ripple(terms, candidate.joints[0], value)


def apart(one: Candidate, other: Candidate) -> bool:
    """Return whether two ripples have counts of their own."""
    return abs(one.shape["cycles"] - other.shape["cycles"]) > TUNING.apart


def sentence(effect: Effect) -> str:
    """Return its amplitude and how often it comes, on each joint."""
    parts = (
        f"{a:.4g} {effect.unit('amplitude', joint)}, {_often(effect, joint, c)}, on {joint}"
        for joint, a, c in zip(effect.joints, effect.value("amplitude"), effect.value("cycles"), strict=True)
    )
    return f"torque ripple of {'; '.join(parts)}"


def _often(effect: Effect, joint: str, cycles: float) -> str:
    if joint not in effect.prismatic:
        return f"{cycles:.4g} times per revolution"
    return f"again every {2.0 * np.pi / cycles:.4g} m" if cycles > 0.0 else "the same everywhere"


register(
    EffectRecord(
        effect=TorqueRipple,
        title="Torque ripple",
        explanation="A torque that repeats with the joint's angle, from teeth, magnets or poles.",
        sentence=sentence,
        keys={"cycles": "cycles per revolution of the joint"},
        keys_on_prismatic={"cycles": "phase per length"},
        shapes=shapes,
        rebuilt=rebuilt,
        apart=apart,
        again=TUNING.harmonic,
        merge=beside,
        unseen=0.006,  # set on training logs
    )
)
