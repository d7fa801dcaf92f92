"""Candidates that sit on one joint and change its torque alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from twin_diagram.gap.candidates.candidate import Candidate, Values, linear, transformed
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.signals.arrays import Array

STRIBECK_SPEEDS = np.geomspace(0.016, 0.5, 8)
"""[rad/s]"""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    slowest: float = 0.014
    """Below this, a joint that sticks and one that creeps look the same [rad/s]."""

    narrow: float = 0.03

    narrowest: float = 10.0
    """A dip below this speed [rad/s] lies where a joint may be held and laws of dry friction are the least exact; one
    at `SLOWEST` must bring this much more [nats]."""

    curve_pieces: tuple[int, ...] = (3, 6, 10)
    """Pieces of the cubic splines that stand for a torque as a function of the angle."""

    most_cycles: float = 320.0
    """Ripples per turn of the joint that are looked for."""

    lowest: float = 0.6
    """A count that is moved to where data want it stays above this share of the lowest one tried."""

    saturation_shares: tuple[float, ...] = (
        0.99,
        0.97,
        0.95,
        0.92,
        0.88,
        0.83,
        0.77,
        0.7,
        0.62,
        0.53,
        0.44,
        0.35,
        0.27,
        0.2,
        0.14,
        0.09,
        0.05,
    )
    """Limits that are tried, as quantiles of the absolute torque."""

    of_the_peak: tuple[float, ...] = (0.95, 0.9, 0.84, 0.78, 0.72, 0.66, 0.6, 0.54)
    """And as shares of the largest: where torque peaks seldom, quantiles leave gaps."""

    most_saturated: float = 0.96
    """Share of the time that a torque may be beyond its limit."""

    least_limit: float = 0.06
    """A limit is at least this share of the largest torque that is logged."""

    clear: float = 3.0
    """Torque must exceed a limit by this many times its noise to show that it is one."""

    unneeded: float = 0.5
    """Share of the torque beyond a limit that the motion must not have needed: what moved the arm was no limit."""

    plain: float = 6.0

    selected: float = 40.0
    """Below `PLAIN` times the noise, picking the samples beyond a limit picks their noise too: worth this much
    [nats]."""

    small: float = 0.05
    """A coefficient may cross zero by this share of what the given model has, where it takes that away."""


TUNING = Tuning()


def joint_candidates(terms: Terms) -> list[Candidate]:
    """Return all of them but ripples (`ripples`), which are many."""
    builder = _Builder(terms)
    for part in (
        builder.friction,
        builder.stribeck,
        builder.inertia,
        builder.spring,
        builder.motor,
        builder.saturation,
        builder.coupled,
    ):
        part()
    return builder.made


def single(
    terms: Terms,
    name: str,
    j: int,
    columns: list[Array],
    parameters: Callable[[Array, Array], Values],
    lower: list[float],
    upper: list[float] | None = None,
    **others: Any,
) -> Candidate | None:
    """Return a candidate on one joint; none where its columns, (ΣD,) each, vanish."""
    stacked = np.stack(columns, axis=-1)
    size = np.sqrt(np.mean(stacked**2, axis=0))
    if not np.all(size > 1e-12):
        return None
    return Candidate(
        name=name,
        joints=(j,),
        links=(),
        rows=(j,),
        columns=stacked[:, None, :],
        spread=terms.torque_size[j] / size,
        lower=np.array(lower),
        upper=np.array(upper if upper is not None else [np.inf] * len(columns)),
        parameters=parameters,
        **others,
    )


def stribeck(terms: Terms, j: int, speed: float) -> Candidate | None:
    """Coulomb's level, and what breaking loose takes beyond it."""
    if speed < TUNING.slowest:
        return None
    parts = zip(terms.signs, terms.records.records, strict=True)
    bump = terms.reduce(tuple(s[:, j] * np.exp(-((r.v[:, j] / speed) ** 2)) for s, r in parts))

    def values(c: Array) -> dict[str, Array]:
        return {"coulomb": c[0:1], "static": c[0:1] + c[1:2], "stribeck_velocity": np.array([speed])}

    low = -terms.present.coulomb[j]
    return single(
        terms,
        "stribeck_friction",
        j,
        [terms.reduced_signs[:, j], bump],
        transformed(values),
        [low, -np.inf if "stribeck_friction" in terms.present.names else 0.0],
        shape={"stribeck_velocity": speed},
        cost=float(
            np.log(4.0)
            + TUNING.narrowest * max(0.0, np.log(TUNING.narrow / speed) / np.log(TUNING.narrow / TUNING.slowest))
        ),
    )


def saturation(terms: Terms, j: int, limit: float) -> Candidate | None:
    """Return the torque logged beyond a limit."""
    asked = [tau[:, j] for tau in terms.asked_torque]
    beyond = np.concatenate([np.abs(tau) - limit for tau in asked])
    share = float(np.mean(beyond > 0.0))
    if not 0.0 < share < TUNING.most_saturated or limit < TUNING.least_limit * (limit + float(np.max(beyond))):
        return None
    # Where a torque is mostly beyond its limit, what is left without the limit is no noise.
    noise = max(terms.torque_noise[j], min(terms.unexplained(j), terms.unexplained(j, limit)), 1e-12)
    clear = float(np.sqrt(np.mean(beyond[beyond > 0.0] ** 2)) / noise)
    if clear < TUNING.clear:
        return None
    over = terms.reduce(tuple(tau - np.clip(tau, -limit, limit) for tau in asked))
    if float(over @ terms.unneeded[:, j]) < TUNING.unneeded * float(over @ over):
        return None
    # Beyond the limit what was logged does not count, nor does its noise: such samples seem to fit better than any can.
    free = -0.5 * len(over) * float(np.log(1.0 - share))

    def values(c: Array) -> dict[str, Array]:
        return {"limit": np.array([limit])}

    return single(
        terms,
        "torque_saturation",
        j,
        [over],
        transformed(values),
        [0.75],
        [1.25],
        shape={"limit": limit},
        cost=free + float(np.log(5.0)) + (TUNING.selected if clear < TUNING.plain else 0.0),
    )


class _Builder:
    def __init__(self, terms: Terms) -> None:
        self.terms = terms
        self.n = terms.records.n
        self.made: list[Candidate] = []

    def take(self, candidate: Candidate | None) -> None:
        """Those that do not vary enough to matter are none."""
        if candidate is not None:
            self.made.append(candidate)

    def add(self, *arguments: Any, **others: Any) -> None:
        """As `single`."""
        self.take(single(self.terms, *arguments, **others))

    def friction(self) -> None:
        t, had = self.terms, self.terms.present
        speed = t.records.reduce(lambda r: r.v)
        sign = t.reduced_signs
        ahead = t.reduce(tuple(np.maximum(s, 0.0) for s in t.signs))
        back = t.reduce(tuple(np.minimum(s, 0.0) for s in t.signs))
        loaded = t.reduce(tuple(np.abs(load) * s for load, s in zip(t.passed_on, t.signs, strict=True)))
        for j in range(self.n):
            self.add("viscous_friction", j, [speed[:, j]], linear("damping"), [-(1 + TUNING.small) * had.damping[j]])
            lowest = -(1 + TUNING.small) * had.coulomb[j]
            self.add("coulomb_friction", j, [sign[:, j]], linear("torque"), [lowest])
            self.add(
                "coulomb_friction",
                j,
                [ahead[:, j], back[:, j]],
                linear("torque_positive", "torque_negative"),
                [lowest] * 2,
                variant="two-sided",
            )
            self.add(
                "load_dependent_friction",
                j,
                [loaded[:, j]],
                linear("coefficient"),
                [-(1 + TUNING.small) * had.load[j]],
                [0.9],
            )

    def stribeck(self) -> None:
        for j in range(self.n):
            for speed in STRIBECK_SPEEDS:
                self.take(stribeck(self.terms, j, float(speed)))

    def inertia(self) -> None:
        a = self.terms.records.reduce(lambda r: r.a)
        for j in range(self.n):
            least = -(1 + TUNING.small) * self.terms.present.rotor[j]
            self.add("reflected_inertia", j, [a[:, j]], linear("inertia"), [least])

    def spring(self) -> None:
        t = self.terms
        q = t.records.reduce(lambda r: r.q)
        for j in range(self.n):
            angle = q[:, j]
            middle = float(np.mean(angle))

            def values(c: Array, middle: float = middle) -> dict[str, Array]:
                return {"stiffness": c[0:1], "rest_angle": middle - c[1:2] / c[0]}

            least = -(1 + TUNING.small) * t.present.stiffness[j]
            columns = [angle - middle, np.ones_like(angle)]
            self.add("joint_spring", j, columns, transformed(values), [least, -np.inf], shape={"middle": middle})
            self.curves(j)

    def curves(self, j: int) -> None:
        """Splines of the angle, over the range that the joint has gone through."""
        t = self.terms
        everything = np.concatenate([r.q[:, j] for r in t.records.records])
        low, high = float(everything.min()), float(everything.max())
        if high - low < 0.05:
            return
        for pieces in TUNING.curve_pieces:
            inner = np.linspace(low, high, pieces + 1)
            knots = np.concatenate([[low] * 3, inner, [high] * 3])
            count = len(knots) - 4

            def basis(q: Array, knots: Array = knots, low: float = low, high: float = high) -> Array:
                return BSpline.design_matrix(np.clip(q, low, high), knots, 3).toarray()

            columns = t.reduce(tuple(basis(r.q[:, j]) for r in t.records.records))
            size = np.sqrt(np.mean(columns**2, axis=0))
            if np.any(size < 1e-4):
                continue
            angles: Array = np.linspace(low, high, 2 * pieces + 1, dtype=np.float64)
            at = basis(angles)

            def values(c: Array, angles: Array = angles, at: Array = at) -> dict[str, Array]:
                return {"curve": np.concatenate([angles, at @ c])}

            self.add(
                "joint_spring",
                j,
                list(columns.T),
                transformed(values),
                [-np.inf] * count,
                shape={"pieces": float(pieces)},
                variant="curve",
                cost=1.0,
            )

    def motor(self) -> None:
        t = self.terms
        load = t.reduce(t.load)
        one = np.ones(len(load))

        def gain(c: Array) -> dict[str, Array]:
            return {"gain": 1.0 / (1.0 + c[0:1])}

        for j in range(self.n):
            self.add("torque_constant", j, [load[:, j]], transformed(gain), [-0.75], [4.0])
            self.add("torque_bias", j, [one], linear("torque", scale=-1.0), [-np.inf])

    def saturation(self) -> None:
        for j in range(self.n):
            everything = np.abs(np.concatenate([tau[:, j] for tau in self.terms.asked_torque]))
            limits = [
                *np.quantile(everything, TUNING.saturation_shares),
                *(float(np.max(everything)) * np.array(TUNING.of_the_peak)),
            ]
            for limit in limits:
                self.take(saturation(self.terms, j, float(limit)))

    def coupled(self) -> None:
        t = self.terms
        for i in range(self.n - 1):
            pair = (i, i + 1)
            speed = t.records.reduce(lambda r, pair=pair: r.v[:, pair[0]] + r.v[:, pair[1]])  # type: ignore[misc]
            slow = float(np.hypot(t.slow[i], t.slow[i + 1]))
            sign = t.records.reduce(
                lambda r, pair=pair, slow=slow: np.tanh((r.v[:, pair[0]] + r.v[:, pair[1]]) / slow)  # type: ignore[misc]
            )
            size = np.sqrt([np.mean(speed**2), np.mean(sign**2)])
            if not np.all(size > 1e-12):
                continue
            both = np.repeat(np.stack([speed, sign], axis=-1)[:, None, :], 2, axis=1)
            scale = float(np.min(t.torque_size[list(pair)]))
            self.made.append(
                Candidate(
                    name="coupled_friction",
                    joints=pair,
                    links=(),
                    rows=pair,
                    columns=both,
                    spread=scale / size,
                    lower=np.array([0.0, 0.0]),
                    upper=np.full(2, np.inf),
                    parameters=linear("damping", "torque"),
                )
            )


def count_step(terms: Terms, j: int) -> float:
    """Difference of counts that the joint's range just tells apart, nearly halved."""
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
        angle = record.q[:, j, None] * counts
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
        "torque_ripple",
        j,
        list(ripple_columns(terms, j, np.array([count])).T),
        transformed(values),
        [-np.inf] * 2,
        shape={"cycles": count},
        cost=float(np.log(0.4 * max(len(tried), 3))),
    )
