"""What makes one excitation better than another, and its slope."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.estimation.weighing.bound import friction_columns, wanted
from twin_diagram.estimation.weighing.carried_motion import CarriedMotion
from twin_diagram.estimation.weighing.grip import Grip
from twin_diagram.estimation.weighing.harmonics import Harmonics
from twin_diagram.estimation.weighing.motion_limits import MotionLimits
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    per_harmonic: float = 10.0
    """Samples per period of the fastest harmonic: torques have twice and three times its frequency in them."""

    target: float = 0.95
    """Of each limit, at these samples: between them it is a little more."""

    slow: float = 0.1
    """Dry friction's width here [rad/s]: wide enough to have a slope."""

    mass: float = 0.001
    """What the relative standard error of the mass is measured by: reached at 0.05 N·m and 100 Hz in 10 s."""

    centre: float = 0.0005
    """The same of the centre, along each axis [m]."""

    moment: float = 0.12
    """The same of a principal moment, relative: what plain designs reach with 0.5 kg."""

    noise: float = 0.05
    """Of torques for which these hold [N·m]."""

    rate: float = 100.0
    """Of their samples [1/s]."""

    norm: int = 4
    """Of the norm over the seven: the worst counts most."""

    finer: int = 3
    """Times as many samples tell how near it comes to what stands about: a hand goes 3 cm from one to the next then."""

    spare: float = 0.01
    """Room asked for beyond what must be left, for what is between these [m]."""

    near: float = 0.05
    """What is missing of room counts like a limit passed by all of it where it is this much [m]."""

    step: float = 1e-5
    """Of finite differences of room [rad]."""


TUNING = Tuning()
Room = Callable[[Array], Array]
"""Tells of postures (N, n) [rad] the room to each thing beyond what must be left (N, B) [m]; below zero is too near."""
KINDS = ("position", "velocity", "acceleration", "torque")
"""Of limits per joint, in the order in which shares of them are told."""


@dataclass(frozen=True)
class ExcitationCost:
    """A function of one vector: posture (m,), then coefficients (size · m).

    Attributes:
        carried: arm and object.
        limits: of the joints that move, (m,) each.
        grip: or None.
        harmonics: of the motion.
        time: (N,) samples at which it is looked at.
        functionals: (7, 10) what is to be known, each over what it is to reach.
        room: to what stands about; None: nothing does.
    """

    carried: CarriedMotion
    limits: MotionLimits
    grip: Grip | None
    harmonics: Harmonics
    time: Array
    functionals: Array
    room: Room | None = None

    @staticmethod
    def of(
        carried: CarriedMotion,
        limits: MotionLimits,
        grip: Grip | None,
        harmonics: Harmonics,
        room: Room | None = None,
    ) -> ExcitationCost:
        """Return the cost; `limits` (n,) are those of all joints."""
        count = int(np.ceil(TUNING.per_harmonic * harmonics.count))
        time = np.arange(count) * harmonics.period / count
        scale = np.array([TUNING.mass, *3 * [TUNING.centre], *3 * [TUNING.moment]])
        rows = carried.held.rows
        functionals = wanted(carried.parameters) / scale[:, None]
        return ExcitationCost(carried, limits.of_joints(rows), grip, harmonics, time, functionals, room)

    def parts(self, x: Array) -> tuple[Array, Array]:
        """Return posture (m,) and coefficients (size, m)."""
        m = len(self.limits.lower)
        return x[:m], x[m:].reshape(self.harmonics.size, m)

    def finer(self, times: int) -> ExcitationCost:
        """Return the same at so many times as many samples."""
        count = times * len(self.time)
        return replace(self, time=np.arange(count) * self.harmonics.period / count)

    def scaled(self, x: Array, factor: float) -> Array:
        """Return the same with the motion scaled about its posture."""
        m = len(self.limits.lower)
        return np.concatenate([x[:m], factor * x[m:]])

    def shrunk(self, x: Array, factor: float) -> Array:
        """Return the same with motion and posture scaled towards the posture first given."""
        middle = self.carried.others[self.carried.held.rows]
        m = len(middle)
        return np.concatenate([middle + factor * (x[:m] - middle), factor * x[m:]])

    def drawn(self, random: np.random.Generator) -> Array:
        """Return a random start: each harmonic as fast as the others, the whole below the speed limits."""
        m = len(self.limits.lower)
        coefficients = random.normal(size=(self.harmonics.size, m))
        q, v, a = (part @ coefficients for part in self.harmonics.at(self.time))
        posture = self.carried.others[self.carried.held.rows]
        room = np.maximum(np.minimum(self.limits.upper - posture, posture - self.limits.lower), 0.05)
        over = np.stack(
            [np.max(np.abs(part), axis=0) / bound for part, bound in
             ((q, room), (v, self.limits.velocity), (a, self.limits.acceleration))]
        )  # fmt: skip
        return np.concatenate([posture, (0.8 * coefficients / over.max(axis=0)).ravel()])

    def motion(self, x: Array, time: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations (N, m) at times (N,)."""
        posture, coefficients = self.parts(x)
        q, v, a = self.harmonics.at(time)
        return posture + q @ coefficients, v @ coefficients, a @ coefficients

    def use(self, x: Array, time: Array) -> dict[str, float]:
        """Return the largest share of each limit that the motion takes at times (N,)."""
        q, v, a = self.motion(x, time)
        asked = self.carried.asked(q, v, a)
        shares = self._shares(q, v, a, asked.torque)
        result = {kind: float(np.max(np.abs(share))) for kind, (share, _) in zip(KINDS, shares, strict=False)}
        if self.grip is not None:
            result["grip"] = float(np.max(self.grip.use(asked.wrench)))
        return result

    def _shares(self, q: Array, v: Array, a: Array, torque: Array) -> list[tuple[Array, Array]]:
        """Return, of positions, velocities, accelerations and torques, shares (N, m) of limits, and slopes (m,)."""
        limits = self.limits
        half = 0.5 * (limits.upper - limits.lower)
        pairs = ((q - 0.5 * (limits.upper + limits.lower), half), (v, limits.velocity))
        return [(x / bound, 1.0 / bound) for x, bound in (*pairs, (a, limits.acceleration), (torque, limits.torque))]

    def value_and_slope(self, x: Array, weight: float) -> tuple[float, Array]:
        """Return the cost of a motion and its slope (the size of x).

        It is the logarithm of the norm of standard errors, and `weight` times the squares of what goes over limits.
        """
        q, v, a = self.motion(x, self.time)
        asked, slopes = self.carried.with_slopes(q, v, a)
        value, by_Y, by_v = self._told(asked.Y, v)
        m = q.shape[1]
        direct = [np.zeros_like(q), by_v, np.zeros_like(q)]
        indirect = np.einsum("knji,nji->kn", slopes.Y, by_Y)
        for k, (share, slope) in enumerate(self._shares(q, v, a, asked.torque)):
            over = np.maximum(np.abs(share) - TUNING.target, 0.0)
            value += weight * float(np.sum(over**2))
            by_share = 2.0 * weight * over * np.sign(share) * slope
            if k < 3:
                direct[k] = direct[k] + by_share
            else:
                indirect += np.einsum("knj,nj->kn", slopes.torque, by_share)
        if self.grip is not None:
            over = np.maximum(self.grip.use(asked.wrench) - TUNING.target, 0.0)
            value += weight * float(np.sum(over**2))
            by_wrench = 2.0 * weight * over[:, None] * self.grip.slope(asked.wrench)
            indirect += np.einsum("knc,nc->kn", slopes.wrench, by_wrench)
        gradients = [direct[k] + indirect[k * m : (k + 1) * m].T for k in range(3)]
        by_coefficients = np.asarray(
            sum(basis.T @ gradient for basis, gradient in zip(self.harmonics.at(self.time), gradients, strict=True))
        )
        by_posture = gradients[0].sum(axis=0)
        if self.room is not None:
            missing, slope = self._missing(x)
            value += weight * missing
            by_posture = by_posture + weight * slope[: len(by_posture)]
            by_coefficients = by_coefficients + weight * slope[len(by_posture) :].reshape(by_coefficients.shape)
        return value, np.concatenate([by_posture, by_coefficients.ravel()])

    def _missing(self, x: Array) -> tuple[float, Array]:
        """Return the squares of what is missing of room, as a mean over samples times their number, and its slope."""
        assert self.room is not None
        count = TUNING.finer * len(self.time)
        basis = self.harmonics.at(np.arange(count) * self.harmonics.period / count)[0]
        posture, coefficients = self.parts(x)
        rows, q = self.carried.held.rows, posture + basis @ coefficients
        full = np.tile(self.carried.others, (count, 1))
        full[:, rows] = q
        short = np.maximum(TUNING.spare - self.room(full), 0.0) / TUNING.near
        close = np.flatnonzero((short > 0.0).any(axis=1))
        value = float(np.sum(short**2)) / TUNING.finer
        if not len(close):
            return value, np.zeros_like(x)
        moved = np.tile(full[close], (len(rows), 1, 1))
        moved[np.arange(len(rows)), :, rows] += TUNING.step
        other = np.maximum(TUNING.spare - self.room(moved.reshape(-1, full.shape[1])), 0.0) / TUNING.near
        change = (other.reshape(len(rows), len(close), -1) - short[close]) / TUNING.step
        by_q = 2.0 * np.einsum("nb,jnb->nj", short[close], change) / TUNING.finer
        return value, np.concatenate([by_q.sum(axis=0), (basis[close].T @ by_q).ravel()])

    def _told(self, Y: Array, v: Array) -> tuple[float, Array, Array]:
        """Return the logarithm of the norm of standard errors, and its slopes by Y (N, m, 10) and by v (N, m).

        With S = Σ YᵀPY and P what takes out a joint's offset and frictions N: d tr(W S⁻¹) = −tr(S⁻¹ W S⁻¹ dS), and
        dS = 2 sym(YᵀP dY) − 2 sym(YᵀP dN N⁺Y).
        """
        per_sample = TUNING.noise**2 * len(v) / (TUNING.rate * self.harmonics.period)
        width = TUNING.slow
        S, left, fitted = np.zeros((10, 10)), [], []
        for j in range(v.shape[1]):
            N = np.column_stack([friction_columns(v[:, j])[:, :2], np.tanh(v[:, j] / width)])
            L = np.linalg.lstsq(N, Y[:, j], rcond=None)[0]
            rest = Y[:, j] - N @ L
            S += rest.T @ rest
            left.append(rest)
            fitted.append(L)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-30))
        C = scale[:, None] * np.linalg.pinv(S * np.outer(scale, scale), rcond=1e-13, hermitian=True) * scale
        C *= per_sample
        variance = np.einsum("ki,ij,kj->k", self.functionals, C, self.functionals)
        half = TUNING.norm // 2
        total = float(np.sum(variance**half))
        weights = variance ** (half - 1) / (2.0 * total)  # of d log(total) / norm by each variance
        G = np.einsum("ai,ki,k,kj,jb->ab", C, self.functionals, weights, self.functionals, C) / per_sample
        by_Y, by_v = np.empty_like(Y), np.empty_like(v)
        for j, (rest, L) in enumerate(zip(left, fitted, strict=True)):
            by_Y[:, j] = -2.0 * rest @ G
            by_N = 2.0 * rest @ G @ L.T
            by_v[:, j] = by_N[:, 1] + by_N[:, 2] * (1.0 - np.tanh(v[:, j] / width) ** 2) / width
        return float(np.log(total) / TUNING.norm), by_Y, by_v
