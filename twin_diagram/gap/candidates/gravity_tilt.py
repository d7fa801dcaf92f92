"""A base that does not stand level: its candidates and its record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydrake.math import RollPitchYaw

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.environment import GravityTilt
from twin_diagram.signals.arrays import Array


def on_arm(terms: Terms) -> list[Candidate]:
    """Return the tilt about level."""
    return [tilt(terms)]


def tilt(terms: Terms, about: Array | None = None) -> Candidate:
    """Return a base rolled about x, pitched about y: gravity turns the other way; to first order from level on.

    Where `about` (2,) is told, by the mean of what gravity changes by on the straight way there: exact in its place.
    """
    tree = terms.records.model.tree
    roll, pitch = (0.0, 0.0) if about is None else about.tolist()
    start, middle, end = (slopes(share * roll, share * pitch, tree.gravity) for share in (0.0, 0.5, 1.0))
    turns = (start + 4.0 * middle + end) / 6.0  # Simpson's rule

    def law(record: Record) -> Array:
        q, zero = terms.records.angles(record), np.zeros_like(record.q)
        parts = [replace(tree.bare(tree.inertia), gravity=turn).inverse_dynamics(q, zero, zero) for turn in turns]
        return np.stack(parts, axis=-1)

    return Candidate(
        name=GravityTilt.name,
        joints=(),
        links=(),
        rows=tuple(range(terms.records.n)),
        columns=terms.records.reduce(law),
        spread=np.full(2, 0.15),
        lower=np.full(2, -1.0),
        upper=np.full(2, 1.0),
        parameters=linear("roll", "pitch"),
    )


def slopes(roll: float, pitch: float, gravity: Array) -> Array:
    """Return (2, 3) derivatives of gravity in a base that is rolled and pitched [rad] by both angles."""
    g = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix().T @ gravity
    # d/dε of Rᵀ g for a rotation about an axis e of the base by ε is g × e; a roll turns the axis of pitch.
    axes = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(roll), -np.sin(roll)]])
    return np.cross(g, axes)


def recentred(terms: Terms, candidate: Candidate, coefficients: Array) -> Candidate | None:
    """Return it on the way to a tilt."""
    del candidate
    return tilt(terms, coefficients)


def sentence(effect: Effect) -> str:
    """Return both angles."""
    roll, pitch = np.degrees([effect.value("roll")[0], effect.value("pitch")[0]])
    return f"the base is tilted by {roll:.3g}° about x and {pitch:.3g}° about y"


register(
    EffectRecord(
        effect=GravityTilt,
        title="A tilted base",
        explanation="The base does not stand level, so gravity pulls from another side.",
        sentence=sentence,
        on_arm=on_arm,
        recentred=recentred,
        once=True,
        merge=summed,
        starts=True,
        per_joint=False,
        wakes=frozenset({Wakes.POSE}),
    )
)
