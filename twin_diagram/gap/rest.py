"""Samples that say nothing about a joint because dry friction holds it.

A joint that sticks is held by whatever torque it takes, up to the friction's level; no law of speed tells which. Where
friction is dry, samples at rest and about reversals are left out.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_opening, maximum_filter1d

from twin_diagram.gap.records import Record, Records
from twin_diagram.gap.terms import Terms
from twin_diagram.gap.whitening import Whitener

Array = npt.NDArray[np.float64]

REST = 0.016
"""Speed below which a joint may be sticking [rad/s]."""

DWELL = 0.004
"""A joint that turns back sooner than this does not stick [s]."""

SPREAD = 0.9
"""Over how many periods of the band's edge the low-pass spreads what happens at rest."""

AFTER = 2
"""Thinned samples that the prediction-error filter spreads it further."""

FEWEST = 0.3
"""Joints that move for less than this share of the time keep all their samples, unless they are known to stick."""

DRY = frozenset({"coulomb_friction", "stribeck_friction", "load_dependent_friction", "coupled_friction"})


def sliding(records: Records, terms: Terms, joints: Iterable[int]) -> Array:
    """(ΣD, n) weights of reduced samples: 0 where one of `joints` may be sticking, else 1."""
    result = np.ones((sum(records.lengths), records.n))
    sticks = dry_joints(records)
    for j in joints:
        parts = []
        for record in records.records:
            width = 2 * round(SPREAD * record.rate / record.band) + 1
            thinned = maximum_filter1d(_at_rest(record, terms, j).astype(float), width)[record.kept]
            after = thinned.copy()
            for k in range(1, AFTER + 1):
                after[k:] = np.maximum(after[k:], thinned[:-k])
            parts.append(after)
        weights = 1.0 - np.concatenate(parts)
        if np.mean(weights) > FEWEST or j in sticks:
            result[:, j] = weights
    return result


def stuck(records: Records, terms: Terms, j: int) -> npt.NDArray[np.bool_]:
    """(ΣD,) where a joint may be sticking, the low-pass left out of account."""
    return np.concatenate([_at_rest(record, terms, j)[record.kept] for record in records.records])


def _at_rest(record: Record, terms: Terms, j: int) -> npt.NDArray[np.bool_]:
    slow = np.abs(record.v[:, j]) < max(REST, 2.0 * terms.slow[j])
    return np.asarray(binary_opening(slow, np.ones(max(1, round(DWELL * record.rate)))))


def moving(records: Records, terms: Terms, whitener: Whitener, joints: Iterable[int]) -> Array:
    """(n, R) the same for whitened samples."""
    return np.ascontiguousarray(sliding(records, terms, joints)[whitener.rows].T)


def dry_joints(records: Records) -> set[int]:
    """Joints on which the given model has dry friction."""
    return {
        records.model.joints.index(joint)
        for effect in records.model.effects
        if effect.name in DRY
        for joint in effect.joints
    }
