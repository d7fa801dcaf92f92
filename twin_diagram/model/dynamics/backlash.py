"""How gears twist of which some have play: steps with impulses at the gaps' ends, in plain numbers.

Springs beside them swing in the same steps; springs alone are `elastic_gears`' own.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from operator import mul
from typing import Any

import numpy as np

from twin_diagram.signals.arrays import Array

Rows = list[list[list[float]]]
"""Of a matrix per sample."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    longest_step: float = 0.001
    """Samples farther apart than this are integrated in several steps where there is play [s]."""

    followed: float = 0.5
    """Springs that swing through less than this in a step are followed [rad]."""


TUNING = Tuning()


def play(
    mass: Array,
    load: Array,
    stiffness: Array,
    half: Array,
    loss: Array,
    period: float,
    begin: Array | None = None,
    slope: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return twists of gears of which some have play, by steps with impulses, in plain numbers.

    With K the stiffness of the gears that press against their springs, a step is linear: v ← A⁻¹ (M v − h push), with
    A = M + h θ (loss + θ h) diag(K) and push = load + K e + K (1 − θ) (loss + θ h) v. Springs whose swing the steps can
    follow have θ = ½, which does not damp it, the others θ = 1, which does not let it grow. Which gears press changes,
    but seldom: each choice is inverted once for all samples. What impulses change in a sample's speed is shared by the
    two samples about it.

    Args:
        mass: (N, s, s) inertia of what the gears move [kg·m²].
        load: (N, s) torque that moves it [N·m].
        stiffness: (s,), infinite where there is play alone [N·m/rad].
        half: (s,) of the gaps, zero where there is a spring alone [rad].
        loss: (s,) of the springs [s].
        period: between samples [s].
        begin: (2, s) angle and rate at the first sample; NaN, or None: at rest where the load has pushed them.
        slope: (N, s, s) of the load over the gears' angles [N·m/rad]; None: it is given as it is there.

    Returns:
        angle, rate and acceleration, each (N, s).
    """
    samples, s = load.shape
    if s == 1 and not np.isfinite(stiffness[0]):
        alone = play_alone(mass[:, 0, 0], load[:, 0], float(half[0]), period)
        return alone[0][:, None], alone[1][:, None], alone[2][:, None]
    parts = max(1, int(np.ceil(period / TUNING.longest_step - 1e-9)))
    h = period / parts
    shares = [(part + 0.5) / parts for part in range(parts)]
    gears = _Gears.of(mass, stiffness, half, loss, h)
    loads, slopes = load.tolist(), None if slope is None else slope.tolist()
    e, v = gears.at_rest(loads[0]), [0.0] * s
    if begin is not None:
        e, v = np.where(np.isnan(begin), [e, v], begin).tolist()
    angle, rate = [e], [v]
    for k in range(1, samples):
        for share in shares:
            push = [(1.0 - share) * x + share * y for x, y in zip(loads[k - 1], loads[k], strict=True)]
            if slopes is not None:
                middle = [x + 0.5 * h * y for x, y in zip(e, v, strict=True)]
                push = [x + sum(map(mul, row, middle)) for x, row in zip(push, slopes[k], strict=True)]
            e, v = gears.step(k, push, e, v)
        angle.append(e)
        rate.append(v)
    rates = np.array(rate)
    return np.array(angle), rates, _between(np.diff(rates, axis=0) / period)


@dataclass(frozen=True)
class _Gears:
    """What `play` knows of gears, in plain numbers.

    Attributes:
        mass: (N, s, s) of `play`.
        h: the step [s].
        springs, both, bounded: which gears have a spring alone, a spring behind play, play alone.
        stiffness: per gear, zero where there is play alone.
        gap: half of each.
        theta: how far each step is implicit.
        loss: (s,) of the springs.
        lossy: what a gear's rate adds to its spring's push.
        tables: steps' matrices per choice of gears with play that press against their springs.
    """

    mass: Array
    h: float
    springs: list[int]
    both: list[int]
    bounded: list[int]
    stiffness: list[float]
    gap: list[float]
    theta: list[float]
    loss: Array
    lossy: list[float]
    tables: dict[int, tuple[Rows, Rows]] = field(default_factory=dict)

    @staticmethod
    def of(mass: Array, stiffness: Array, half: Array, loss: Array, h: float) -> _Gears:
        """Return them from the arguments of `play`."""
        hard = ~np.isfinite(stiffness)
        soft = np.where(hard, 0.0, stiffness)
        fastest = soft / np.min(np.diagonal(mass, axis1=1, axis2=2), axis=0)
        theta = np.where((half == 0.0) & (h * np.sqrt(fastest) < TUNING.followed), 0.5, 1.0)
        return _Gears(
            mass,
            h,
            springs=np.flatnonzero(~hard & (half == 0.0)).tolist(),
            both=np.flatnonzero(~hard & (half > 0.0)).tolist(),
            bounded=np.flatnonzero(hard).tolist(),
            stiffness=soft.tolist(),
            gap=half.tolist(),
            theta=theta.tolist(),
            loss=loss,
            lossy=(soft * (1.0 - theta) * (loss + theta * h)).tolist(),
        )

    def at_rest(self, load: list[float]) -> list[float]:
        """Return the angles to which a load has pushed them."""
        each = zip(load, self.stiffness, self.gap, strict=True)
        return [-x / k - np.sign(x) * g if k else -np.sign(x) * g for x, k, g in each]

    def table(self, pressing: int) -> tuple[Rows, Rows]:
        """Return A⁻¹ M and h A⁻¹ per sample; `pressing` has a bit per gear with play that presses."""
        if pressing not in self.tables:
            chosen = [j in self.springs or bool(pressing >> j & 1) for j in range(len(self.gap))]
            firm, theta = np.where(chosen, self.stiffness, 0.0), np.array(self.theta)
            inverse: Any = np.linalg.inv(self.mass + np.diag(self.h * theta * (self.loss + theta * self.h) * firm))
            self.tables[pressing] = (inverse @ self.mass).tolist(), (self.h * inverse).tolist()
        return self.tables[pressing]

    def step(self, k: int, push: list[float], e: list[float], v: list[float]) -> tuple[list[float], list[float]]:
        """Return angles and rates after a step before sample k, under a load `push`, which is overwritten."""
        h, K, gap = self.h, self.stiffness, self.gap
        for j in self.springs:
            push[j] += K[j] * e[j] + self.lossy[j] * v[j]
        pressing = 0
        for j in self.both:
            ahead = e[j] + h * v[j]
            if abs(ahead) > gap[j]:
                push[j] += K[j] * (e[j] - (gap[j] if ahead > 0.0 else -gap[j]))
                pressing |= 1 << j
        onward, driven = self.table(pressing)
        new = [
            sum(map(mul, row, v)) - sum(map(mul, other, push)) for row, other in zip(onward[k], driven[k], strict=True)
        ]
        _keep_within(driven[k], new, [(j, (-gap[j] - e[j]) / h, (gap[j] - e[j]) / h) for j in self.bounded])
        return [x + h * (t * y + (1.0 - t) * z) for x, y, z, t in zip(e, new, v, self.theta, strict=True)], new


def _between(steps: Array) -> Array:
    """Return means of the steps (N − 1, s) before and after each of N samples."""
    whole = np.concatenate([steps[:1], steps, steps[-1:]])
    return np.asarray(0.5 * (whole[1:] + whole[:-1]))


def play_alone(mass: Array, load: Array, half: float, period: float) -> tuple[Array, Array, Array]:
    """Return the twist of one gear with play alone: plain numbers, which are twenty times as fast.

    While its load presses it to an end it rests there, and nothing is worked out.

    Args:
        mass: (N,) inertia of what the gear moves [kg·m²].
        load: (N,) torque that moves it [N·m].
        half: of the gap [rad].
        period: between samples [s].

    Returns:
        angle, rate and acceleration, each (N,).
    """
    parts = max(1, int(np.ceil(period / TUNING.longest_step - 1e-9)))
    h = period / parts
    shares = (np.arange(parts) + 0.5) / parts
    pull = -h * load / mass
    steps = (pull[:-1, None] + np.diff(pull)[:, None] * shares).ravel()
    lifts = [_lifting(steps, h, end) for end in (half, -half)]
    pulls, count, half = steps.tolist(), len(steps), float(half)  # numpy's own numbers take several times as long
    e, v = (-half if load[0] > 0.0 else half), 0.0
    angle, rate, k = [e] * (count + 1), [v] * (count + 1), 0
    while k < count:
        if v == 0.0 and (e == half or e == -half):
            lift = lifts[0] if e == half else lifts[1]
            at = bisect_left(lift, k)
            free = lift[at] if at < len(lift) else count
            angle[k + 1 : free + 1] = [e] * (free - k)
            if free == count:
                break
            k = free
        v += pulls[k]
        ahead = e + h * v
        if ahead > half:
            v, ahead = (half - e) / h, half
        elif ahead < -half:
            v, ahead = (-half - e) / h, -half
        e, k = ahead, k + 1
        angle[k], rate[k] = e, v
    rates = np.array(rate[::parts])
    return np.array(angle[::parts]), rates, _between(np.diff(rates[:, None], axis=0) / period)[:, 0]


def _lifting(steps: Array, h: float, end: float) -> list[int]:
    """Return which changes of speed (N,) move a gear that rests at an end of its gap; the others press it there."""
    ahead = end + h * steps
    return np.flatnonzero((steps != 0.0) & ((ahead <= end) if end > 0.0 else (ahead >= end))).tolist()


def _keep_within(inverse: list[list[float]], v: list[float], bounds: list[tuple[int, float, float]]) -> None:
    """Change speeds by the impulses that keep each bounded one within its bounds.

    Args:
        inverse: of the inertia, or a multiple of it.
        v: speeds.
        bounds: joints with their least and greatest speeds.
    """
    if all(low <= v[j] <= high for j, low, high in bounds):
        return
    impulses = [0.0] * len(bounds)
    for _ in range(30):
        before = impulses.copy()
        for place, (j, low, high) in enumerate(bounds):
            alone = v[j] - inverse[j][j] * impulses[place]
            wanted = (min(max(alone, low), high) - alone) / inverse[j][j]
            for i, row in enumerate(inverse):
                v[i] += row[j] * (wanted - impulses[place])
            impulses[place] = wanted
        if len(bounds) == 1 or impulses == before:
            return
