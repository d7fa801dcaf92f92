"""Samples that say nothing about a joint because dry friction holds it.

A joint that sticks is held by whatever torque it takes, up to the friction's level; no law of speed tells which. Where
friction is dry, samples at rest and about reversals are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import scipy
from scipy.ndimage import binary_opening, maximum_filter1d, uniform_filter1d

from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import TUNING as REGRESSORS
from twin_diagram.gap.residuals.regressors import Terms, levers, spread_of, turns
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.model.effects.friction_stribeck_load import CoupledFriction
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    dwell: float = 0.004
    """A joint that turns back sooner than this does not stick [s]."""

    spread: float = 0.9
    """Over how many periods of the band's edge the low-pass spreads what happens at rest."""

    after: int = 2
    """Thinned samples that the prediction-error filter spreads it further."""

    creeps: tuple[float, ...] = (0.024, 0.036, 0.054)
    """Where a joint that is held creeps, samples below these speeds are left out too, as far as they show it
    [rad/s]."""

    fast: float = 0.1
    """A joint that moves faster certainly slides [rad/s]."""

    few: int = 6
    """Samples that show creep at least."""

    thinned: float = 2.0
    """Neighbouring samples that know about as much as one."""

    sure: float = 4.0
    """Standard errors by which friction must fall short."""

    doubt_turn: float = 0.7
    """Share of dry friction that may be missed where a joint turns: how it is held is a guess."""

    doubt_time: float = 0.6
    """Over which that share counts [s]."""

    fewest: float = 0.3
    """Joints that move for less than this share of the time keep all their samples, unless they are known to stick."""

    gives: float = 0.02
    """A joint that is held gives way by less than this, all in all [rad]."""

    least: float = 0.1
    """The same of two joints and the sum of their speeds, which is known to stick."""


TUNING = Tuning()


def sliding(
    records: Records,
    terms: Terms,
    joints: Iterable[int],
    slowest: Array | None = None,
    turning: bool = False,
    coupled: Iterable[tuple[int, int]] = (),
    many: float = np.inf,
) -> Array:
    """Return (ΣD, n) weights of reduced samples: 0 where one of `joints` may be sticking, else 1.

    Args:
        records: of the fit.
        terms: made of them.
        joints: columns.
        slowest: (n,) speed below which each may be sticking, see `creep`; None: `regressors.TUNING.rest` [rad/s].
        turning: whether a joint counts as sliding while it turns, see `regressors.turns`; not where the given model has
            dry
            friction, whose law knows of no such moments.
        coupled: pairs of joints with friction on the sum of their speeds, beside the given model's.
        many: samples that slide, from which on a joint needs no others, for however small a share of the time it moves.
    """
    result = np.ones((sum(records.lengths), records.n))
    sticks = dry_joints(records)
    for j in joints:
        least = REGRESSORS.rest * float(levers(records)[j]) if slowest is None else float(slowest[j])
        rests = [_at_rest(record, record.v[:, j], max(least, 2.0 * float(terms.slow[j]))) for record in records.records]
        if turning and j not in sticks:
            for record, still in zip(records.records, rests, strict=True):
                for first, last in turns(record, j, terms.resting(j)):
                    still[first:last] = False
        weights = _away(records, rests)
        if np.mean(weights) > TUNING.fewest or np.sum(weights) >= many or j in sticks:
            result[:, j] = weights
    for i, j in {*coupled, *coupled_pairs(records)}:
        unit = max(float(levers(records)[i]), float(levers(records)[j]))
        slow = max(REGRESSORS.rest * unit, 2.0 * float(np.hypot(terms.slow[i], terms.slow[j])))
        rests = [_at_rest(record, record.v[:, i] + record.v[:, j], slow) for record in records.records]
        weights = _away(records, rests)
        if np.mean(weights) > TUNING.least:
            result[:, [i, j]] *= weights[:, None]
    return result


def _away(records: Records, rests: Sequence[npt.NDArray[np.bool_]]) -> Array:
    """Return (ΣD,) 0 where the filters spread what happens at rest, else 1."""
    parts = []
    for record, still in zip(records.records, rests, strict=True):
        width = 2 * round(TUNING.spread * record.rate / record.band) + 1
        thinned = maximum_filter1d(still.astype(float), width)[record.kept]
        after = thinned.copy()
        for k in range(1, TUNING.after + 1):
            after[k:] = np.maximum(after[k:], thinned[:-k])
        parts.append(after)
    return 1.0 - np.concatenate(parts)


def turning(records: Records, terms: Terms, whitener: Whitener, dry: Array, joints: Iterable[int]) -> Array:
    """Return (n, R) weights of whitened samples about the moments at which a joint turns; 0 elsewhere.

    Args:
        records: of the fit.
        terms: made of them.
        whitener: of the noise.
        dry: (ΣD, n) torque of dry friction as it is known so far [N·m].
        joints: columns.
    """
    whole = sliding(records, terms, joints)
    about = sliding(records, terms, joints, turning=True) - whole
    white = whitener.all(dry)
    width = max(1, round(TUNING.doubt_time * records.rate))
    believed = 1.0 / np.sqrt(1.0 + TUNING.doubt_turn**2 * uniform_filter1d(white**2, width, axis=1))
    return np.ascontiguousarray(np.maximum(about, 0.0)[whitener.rows].T) * believed


def stuck(records: Records, terms: Terms, j: int) -> npt.NDArray[np.bool_]:
    """Return (ΣD,) where a joint may be sticking, the low-pass left out of account."""
    slow = terms.resting(j)
    return np.concatenate([_at_rest(record, record.v[:, j], slow)[record.kept] for record in records.records])


def slides(records: Records) -> npt.NDArray[np.bool_]:
    """Return (n,) whether a joint ever moves faster than one that is held may give way."""
    fastest = np.max([np.max(np.abs(record.v), axis=0) for record in records.records], axis=0)
    return np.asarray(fastest > REGRESSORS.rest * levers(records))


def unmoved(records: Records) -> npt.NDArray[np.bool_]:
    """Return (n,) which joints no run moves: friction may hold any torque there, and no run tells it from another.

    Where no joint moves farther, motion is small, and all of it counts.
    """
    way = np.max([np.ptp(record.q, axis=0) for record in records.records], axis=0)
    still = ~slides(records) & (way < TUNING.gives * levers(records))
    return np.asarray(still & ~np.all(still))


def one_way(records: Records) -> npt.NDArray[np.bool_]:
    """Return (n,) which joints slide one way only in all runs: dry friction there is a constant, as an offset is.

    The other way they go no farther than a joint that is held may give way.
    """
    ways = np.zeros((2, records.n))
    for record in records.records:
        ways += [np.sum(np.maximum(side * record.v, 0.0), axis=0) / record.rate for side in (1.0, -1.0)]
    return np.asarray(slides(records) & (np.min(ways, axis=0) < TUNING.gives * levers(records)))


def clear(records: Records, terms: Terms, j: int) -> Array:
    """Return (ΣD,) 0 where a joint may be sticking, and where the filters spread that, else 1."""
    slow = terms.resting(j)
    return _away(records, [_at_rest(record, record.v[:, j], slow) for record in records.records])


def reach(records: Records, terms: Terms, j: int) -> tuple[Array, Array]:
    """Return what friction that slides on one level, and holds at most as much, can be after the low-pass.

    Returns:
        (ΣD,) what slides, in units of the level; (ΣD,) how much beside it what is held may add or take, likewise.
    """
    slow = terms.resting(j)
    slid, held = [], []
    for record in records.records:
        still = _at_rest(record, record.v[:, j], slow)
        response = record.response
        slid.append(scipy.signal.convolve(np.where(still, 0.0, np.sign(record.v[:, j])), response, "same")[record.kept])
        held.append(scipy.signal.convolve(still.astype(float), np.abs(response), "same")[record.kept])
    return np.concatenate(slid), np.concatenate(held)


def creep(records: Records, terms: Terms, left: Array, joints: Iterable[int]) -> Array:
    """Return (n,) speed below which each joint may be held [rad/s].

    A joint that is held gives way a little, the faster the harder it is pushed. Friction then falls short of the level
    that it has while the joint slides; the laws of the catalogue have at least that level at any speed.

    Args:
        records: of the fit.
        terms: made of them.
        left: (ΣD, n) torque that a hypothesis leaves [N·m].
        joints: columns that are looked at.
    """
    unit = levers(records)
    result = REGRESSORS.rest * unit
    speed = records.reduce(lambda r: r.v)
    for j in joints:
        weights = sliding(records, terms, [j])[:, j] > 0.0
        size = np.abs(speed[:, j])
        against = np.sign(speed[:, j]) * left[:, j]
        fast = weights & (size > TUNING.fast * unit[j])
        if np.sum(fast) < TUNING.few:
            continue
        level = float(np.median(against[fast]))
        noise = float(spread_of(against[fast]))
        for low, high in pairwise(unit[j] * np.array([REGRESSORS.rest, *TUNING.creeps])):
            slow = weights & (size >= low) & (size < high)
            many = int(np.sum(slow))
            if many < TUNING.few:
                continue
            if np.mean(against[slow]) - level > -TUNING.sure * noise / np.sqrt(many / TUNING.thinned):
                break
            result[j] = high
    return result


def _at_rest(record: Record, speed: Array, slow: float) -> npt.NDArray[np.bool_]:
    return np.asarray(binary_opening(np.abs(speed) < slow, np.ones(max(1, round(TUNING.dwell * record.rate)))))


def moving(
    records: Records,
    terms: Terms,
    whitener: Whitener,
    joints: Iterable[int],
    slowest: Array | None = None,
    coupled: Iterable[tuple[int, int]] = (),
) -> Array:
    """Return (n, R) the same for whitened samples."""
    return np.ascontiguousarray(sliding(records, terms, joints, slowest, coupled=coupled)[whitener.rows].T)


def coupled_pairs(records: Records) -> set[tuple[int, int]]:
    """Return pairs of joints on the sum of whose speeds the given model has friction."""
    effects = [effect for effect in records.model.effects if isinstance(effect, CoupledFriction)]
    pairs = [[records.model.joints.index(joint) for joint in effect.joints] for effect in effects]
    return {(pair[0], pair[1]) for pair in pairs if len(pair) == 2}


def dry_joints(records: Records) -> set[int]:
    """Return the joints on which the given model has dry friction."""
    return {
        records.model.joints.index(joint)
        for effect in records.model.effects
        if effect.dry or isinstance(effect, CoupledFriction)
        for joint in effect.joints
    }
