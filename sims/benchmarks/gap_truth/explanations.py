"""What every name of the catalogue, at every place, could add to the torque of a known motion.

Columns are linear in the parameters that are left free; shape parameters are on a grid. All is worked out from
noise-free motion and by `gap_truth.tree`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from gap_truth import tree
from gap_truth.chain import GRAVITY, Chain
from gap_truth.hidden import Hidden
from gap_truth.phenomena import spring_torque

Array = npt.NDArray[np.float64]

REST = 0.005
"""Dry friction has turned round within this speed [rad/s]."""

DELAYS = (0.002, 0.005, 0.01, 0.016)
STRIBECK = (0.025, 0.05, 0.1, 0.2, 0.4)
CURVE = 6
"""Columns of a spring whose torque is any smooth function of the angle."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A name at a place.

    Attributes:
        name: of the catalogue.
        place: joint indices, or (−1 − link,) for a link, or () for the whole arm.
        rows: joints whose torque it changes.
        columns: (N, len(rows), k) torque per unit parameter.
        parameters: how many numbers it is free to choose, shapes included.
        positive: whether each of the k may not be negative.
        quadratic: the k + 6 columns of a point mass, whose inertia follows from mass and centre.
    """

    name: str
    place: tuple[int, ...]
    rows: tuple[int, ...]
    columns: Array
    parameters: int
    positive: tuple[bool, ...]
    quadratic: bool = False

    def during(self, active: Array) -> Explanation:
        """The same where `active` (N,) is 1."""
        return replace(self, columns=self.columns * active[:, None, None])


@dataclass(frozen=True, eq=False)
class Setting:
    """A known motion: times (N,), q, v, a and logged torque (N, n), at regular samples."""

    chain: Chain
    time: Array
    q: Array
    v: Array
    a: Array
    torque: Array

    @property
    def period(self) -> float:
        """[s]."""
        return float(self.time[1] - self.time[0])

    @cached_property
    def frames(self) -> tree.Frames:
        """Of the described arm."""
        return tree.frames(self.chain, self.q, self.v, self.a)

    @cached_property
    def links_load(self) -> Array:
        """(N, n) torque of the described arm without its rotors."""
        return tree.inverse_dynamics(self.chain, self.frames)

    @cached_property
    def load(self) -> Array:
        """(N, n) torque of the described arm."""
        return self.links_load + self.a * self.chain.column("rotor")

    @cached_property
    def pushes(self) -> list[Array]:
        """(N, n, 6) per link, of unit wrenches."""
        return [tree.pushes(self.chain, self.frames, k) for k in range(self.chain.n)]

    def rate(self, signal: Array, width: float = 0.006) -> Array:
        """Derivative of a signal (N,), smoothed over `width` seconds."""
        return np.asarray(gaussian_filter1d(signal, width / self.period, order=1, mode="nearest") / self.period)

    def twisted(self, j: int, twist: Array) -> Array:
        """(N, n) change of the links' torque where link j's angle is ahead of the motor's by a small twist (N,)."""
        rate = self.rate(twist)
        q, v, a = self.q.copy(), self.v.copy(), self.a.copy()
        q[:, j] += twist
        v[:, j] += rate
        a[:, j] += self.rate(rate)
        return tree.inverse_dynamics(self.chain, tree.frames(self.chain, q, v, a)) - self.links_load

    @cached_property
    def sign(self) -> Array:
        """(N, n) of the speeds, smooth about rest."""
        return np.tanh(self.v / REST)


def on_joint(s: Setting, j: int, name: str, shape: dict[str, float] | None = None) -> Iterator[Explanation]:
    """One name on one joint, for every shape on the grid, or for one that is known."""
    v, sign, q = s.v[:, j], s.sign[:, j], s.q[:, j]
    shape = shape or {}
    alone = (j,)

    def made(columns: list[Array], parameters: int, positive: tuple[bool, ...]) -> Explanation:
        return Explanation(name, alone, alone, np.stack(columns, axis=-1)[:, None], parameters, positive)

    if name == "viscous_friction":
        yield made([v], 1, (True,))
    elif name == "coulomb_friction":
        yield made([np.maximum(sign, 0.0), np.minimum(sign, 0.0)], 2, (True, True))
    elif name == "stribeck_friction":
        for speed in [shape["stribeck_velocity"]] if shape else STRIBECK:
            yield made([sign, sign * np.exp(-((v / speed) ** 2))], 3, (True, True))
    elif name == "load_dependent_friction":
        yield made([np.abs(s.load[:, j]) * sign], 1, (True,))
    elif name == "reflected_inertia":
        yield made([s.a[:, j]], 1, (True,))
    elif name == "joint_spring":
        yield made([q, np.ones_like(q)], 2, (True, False))
        span = (q - q.min()) / max(float(np.ptp(q)), 1e-6)
        yield made([np.cos(np.pi * k * span) for k in range(CURVE)], CURVE, (False,) * CURVE)
    elif name == "torque_ripple":
        for cycles in [shape["cycles"]] if shape else range(1, 71):
            yield made([np.sin(cycles * q), np.cos(cycles * q)], 3, (False, False))
    elif name == "torque_constant":
        yield made([s.torque[:, j]], 1, (False,))
    elif name == "torque_bias":
        yield made([np.ones_like(q)], 1, (False,))
    elif name == "torque_saturation":
        size = np.abs(s.torque[:, j])
        for limit in [shape["limit"]] if shape else np.quantile(size, [0.3, 0.6, 0.8, 0.9, 0.95, 0.98, 0.995]):
            yield made([s.torque[:, j] - np.clip(s.torque[:, j], -limit, limit)], 1, (True,))
    elif name == "joint_elasticity":
        everywhere = tuple(range(s.chain.n))
        columns = np.zeros((len(q), s.chain.n, 2))
        columns[..., 0] = s.twisted(j, -1e-5 * s.links_load[:, j]) / 1e-5
        columns[:, j, 1] = s.a[:, j]
        yield Explanation(name, alone, everywhere, columns, 2, (True, True))
    elif name == "backlash":
        everywhere = tuple(range(s.chain.n))
        load = s.links_load[:, j]
        side = np.tanh(load / max(0.02 * float(np.sqrt(np.mean(load**2))), 1e-6))
        columns = np.zeros((len(q), s.chain.n, 2))
        columns[..., 0] = s.twisted(j, -5e-5 * side) / 1e-4
        columns[:, j, 1] = s.a[:, j]
        yield Explanation(name, alone, everywhere, columns, 2, (True, True))
    elif name == "encoder_offset":
        moved = s.q.copy()
        moved[:, j] -= 1e-4
        there = tree.inverse_dynamics(s.chain, tree.frames(s.chain, moved, s.v, s.a))
        change = (there - s.links_load)[..., None] / 1e-4
        yield Explanation(name, alone, tuple(range(s.chain.n)), change, 1, (False,))
    elif name == "actuator_fault":
        span = s.time[-1] - s.time[0]
        for onset in [shape["onset"]] if shape else s.time[0] + span * np.linspace(0.1, 0.9, 9):
            yield made([s.torque[:, j] * (s.time >= onset)], 2, (True,))
    else:
        raise KeyError(name)


JOINT_NAMES = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "reflected_inertia",
    "joint_spring",
    "torque_ripple",
    "torque_constant",
    "torque_bias",
    "torque_saturation",
    "joint_elasticity",
    "backlash",
    "encoder_offset",
    "actuator_fault",
)


def coupled(s: Setting, i: int, j: int) -> Explanation:
    """Friction on a sum of two speeds."""
    speed = s.v[:, i] + s.v[:, j]
    columns = np.stack([speed, np.tanh(speed / REST)], axis=-1)
    return Explanation("coupled_friction", (i, j), (i, j), np.repeat(columns[:, None], 2, axis=1), 2, (True, True))


def of_link(s: Setting, k: int) -> Explanation:
    """Ten inertial parameters of a link."""
    everywhere = tuple(range(s.chain.n))
    return Explanation(
        "inertial_parameters", (-1 - k,), everywhere, tree.regressor(s.chain, s.frames, k), 10, (False,) * 10
    )


def payload(s: Setting) -> Explanation:
    """A point mass at the last link."""
    k = s.chain.n - 1
    columns = tree.regressor(s.chain, s.frames, k)
    return Explanation("payload", (-1 - k,), tuple(range(s.chain.n)), columns, 4, (False,) * 10, quadratic=True)


def tilt(s: Setting) -> Explanation:
    """Gravity turned the other way, to first order: d(Rᵀ g)/dε = g × e."""
    parts = []
    for axis in np.eye(3)[:2]:
        turned = tree.frames(s.chain, s.q, np.zeros_like(s.v), np.zeros_like(s.a), np.cross(GRAVITY, axis))
        parts.append(tree.inverse_dynamics(s.chain, turned))
    columns = np.stack(parts, axis=-1)
    return Explanation("gravity_tilt", (), tuple(range(s.chain.n)), columns, 2, (False, False))


def delays(s: Setting, shape: float | None = None) -> Iterator[Explanation]:
    """Torque logged ahead of its effect: logged(t) = needed(t + d)."""
    for delay in DELAYS if shape is None else (shape,):
        ahead = np.stack([np.interp(s.time + delay, s.time, x) for x in s.load.T], axis=1)
        columns = (ahead - s.load)[..., None]
        yield Explanation("time_delay", (), tuple(range(s.chain.n)), columns, 1, (True,))


def push(s: Setting, k: int, first: float, last: float) -> Explanation:
    """A wrench on a link for a while."""
    active = ((s.time >= first) & (s.time < last)).astype(float)
    columns = s.pushes[k] * active[:, None, None]
    return Explanation("external_force", (-1 - k,), tuple(range(s.chain.n)), columns, 8, (False,) * 6)


def windows(s: Setting, things: list[Hidden]) -> list[tuple[float, float]]:
    """Stretches of time that pushes are tried for: thirds, halves, and those that are true."""
    first, span = float(s.time[0]), float(s.time[-1] - s.time[0])
    parts = [(first + span * i / m, first + span * (i + 1) / m) for m in (2, 3) for i in range(m)]
    return parts + sorted({_window(s, thing) for thing in things if thing.onset is not None})


def _window(s: Setting, thing: Hidden) -> tuple[float, float]:
    return (
        -np.inf if thing.onset is None else thing.onset,
        float(s.time[-1]) + 1.0 if thing.end is None else thing.end,
    )


def everything(s: Setting, things: list[Hidden]) -> list[Explanation]:
    """Every name at every place; where something true starts or ends within the log, also within its times."""
    whole = [e for j in range(s.chain.n) for name in JOINT_NAMES for e in on_joint(s, j, name)]
    whole += [coupled(s, j, j + 1) for j in range(s.chain.n - 1)]
    whole += [of_link(s, k) for k in range(s.chain.n)]
    whole += [payload(s), tilt(s), *delays(s)]
    result = list(whole)
    for first, last in sorted({_window(s, thing) for thing in things if thing.onset is not None}):
        active = ((s.time >= first) & (s.time < last)).astype(float)
        # A gain that changes within the log is a fault by definition.
        result += [e.during(active) for e in whole if e.name not in ("actuator_fault", "torque_constant")]
        result += [e for j in range(s.chain.n) for e in on_joint(s, j, "actuator_fault", {"onset": first})]
    result += [push(s, k, *window) for window in windows(s, things) for k in range(s.chain.n)]
    return result


def of_truth(s: Setting, thing: Hidden) -> list[tuple[tuple[int, ...], Explanation]]:
    """The true effect as columns, per joint where it has joints, with its true shape: (place, explanation)."""
    result: list[tuple[tuple[int, ...], Explanation]] = []
    if thing.name == "coupled_friction":
        result = [(thing.joints, coupled(s, *thing.joints))]
    elif thing.name == "payload":
        result = [((-s.chain.n,), payload(s))]
    elif thing.name == "inertial_parameters":
        assert thing.link is not None
        result = [((-1 - thing.link,), of_link(s, thing.link))]
    elif thing.name == "gravity_tilt":
        result = [((), tilt(s))]
    elif thing.name == "time_delay":
        result = [((), next(delays(s, thing.values["delay"][0])))]
    elif thing.name == "external_force":
        assert thing.link is not None
        return [((-1 - thing.link,), push(s, thing.link, *_window(s, thing)))]
    else:
        for k, j in enumerate(thing.joints):
            if thing.name == "joint_spring" and "amplitude" in thing.values:
                torque = spring_torque(thing, k, s.q[:, j])[:, None, None]
                result.append(((j,), Explanation(thing.name, (j,), (j,), torque, CURVE, (True,))))
                continue
            shape = {key: value[k] for key, value in thing.values.items()}
            if thing.name == "actuator_fault":
                shape["onset"] = float(thing.onset or 0.0)
            found = next(on_joint(s, j, thing.name, shape))
            symmetric = thing.name == "coulomb_friction" and "torque" in thing.values
            result.append(((j,), replace(found, parameters=1) if symmetric else found))
    if thing.onset is not None and thing.name != "actuator_fault":
        first, last = _window(s, thing)
        active = ((s.time >= first) & (s.time < last)).astype(float)
        result = [(place, explanation.during(active)) for place, explanation in result]
    return result
