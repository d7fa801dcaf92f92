"""What is hidden in an arm: its name, place, size and times, drawn before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gap_truth.chain import Chain

Array = npt.NDArray[np.float64]

NAMES = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "coupled_friction",
    "payload",
    "inertial_parameters",
    "reflected_inertia",
    "gravity_tilt",
    "joint_spring",
    "joint_elasticity",
    "backlash",
    "torque_ripple",
    "torque_constant",
    "torque_bias",
    "torque_saturation",
    "time_delay",
    "encoder_offset",
    "external_force",
    "actuator_fault",
)
"""The catalogue."""

OUTSIDE = (
    "thermal_drift",
    "cable_coupling",
    "quadratic_drag",
    "hysteresis",
    "sloshing",
    "speed_dependent_constant",
    "position_dependent_friction",
    "loose_payload",
    "motor_lag",
)
"""Families that the catalogue lacks."""

STARTING = (
    "external_force",
    "actuator_fault",
    "coulomb_friction",
    "viscous_friction",
    "payload",
    "torque_bias",
    "joint_spring",
)
"""Names that a case may let start within the fit log; the first two always do."""

SEVERAL = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "reflected_inertia",
    "joint_spring",
    "joint_elasticity",
    "torque_ripple",
    "torque_constant",
    "torque_bias",
    "encoder_offset",
)
"""Names that a case may put on several joints."""


@dataclass(frozen=True)
class Hidden:
    """One effect.

    Attributes:
        name: of `NAMES` or `OUTSIDE`.
        joints: indices, for joint effects.
        link: index, for effects on a link.
        values: by the catalogue's keys; a list per joint for joint effects, otherwise the value itself as a list.
        onset, end: when it acts [s since the run's begin]; None: always, or from the onset on.
    """

    name: str
    joints: tuple[int, ...] = ()
    link: int | None = None
    values: dict[str, list[float]] = field(default_factory=dict)
    onset: float | None = None
    end: float | None = None

    def acts(self, t: float) -> bool:
        """Whether it does at a time."""
        return (self.onset is None or t >= self.onset) and (self.end is None or t < self.end)


@dataclass(frozen=True)
class Scale:
    """How large things are on the given motion, without anything hidden; each (n,)."""

    torque: Array  # RMS
    peak: Array  # largest
    speed: Array  # RMS
    acceleration: Array  # RMS
    spread: Array  # standard deviation of positions
    centre: Array  # mean position
    inertia: Array  # diagonal of the mass matrix


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def places(name: str, chain: Chain, scale: Scale) -> list[int]:
    """Joints on which an effect is more than nothing on this motion."""
    everywhere = list(range(chain.n))
    effort = chain.column("effort")
    if name in (
        "load_dependent_friction",
        "torque_constant",
        "actuator_fault",
        "torque_saturation",
        "speed_dependent_constant",
        "motor_lag",
    ):
        return [j for j in everywhere if scale.torque[j] > 0.03 * effort[j]] or [int(np.argmax(scale.torque / effort))]
    if name == "encoder_offset":  # about the vertical, an offset changes nothing
        return [j for j in everywhere[1:] if scale.torque[j] > 0.01 * effort[j]] or everywhere[1:]
    if name in ("joint_elasticity", "backlash"):
        loaded = [j for j in everywhere[: chain.n - 2] if scale.torque[j] > 0.03 * effort[j]]
        return loaded or everywhere[:2]
    return everywhere


def draw(name: str, chain: Chain, scale: Scale, rng: np.random.Generator, count: int = 1) -> Hidden:
    """An effect at a size and place.

    Args:
        name: of `NAMES` or `OUTSIDE`.
        chain: the arm.
        scale: of the motion that it will be asked for.
        rng: source of randomness.
        count: joints that it sits on, where it can sit on several.
    """
    if name in _WHOLE:
        return _WHOLE[name](chain, scale, rng)
    possible = places(name, chain, scale)
    joints = tuple(sorted(rng.choice(possible, min(count, len(possible)), replace=False).tolist()))
    each = [_JOINT[name](j, chain, scale, rng) for j in joints]
    keys = set(each[0]).intersection(*each)
    if name == "joint_spring" and len(joints) > 1:
        each = [_linear_spring(j, chain, scale, rng) for j in joints]
        keys = set(each[0])
    if name == "coulomb_friction" and len({len(x) for x in each}) > 1:
        each = [{"torque": x.get("torque", x.get("torque_positive", 0.0))} for x in each]
        keys = {"torque"}
    ordered = [key for key in each[0] if key in keys]
    return Hidden(name, joints, None, {key: [float(x[key]) for x in each] for key in ordered})


def _force(j: int, chain: Chain, rng: np.random.Generator, low: float = 0.001, high: float = 0.08) -> float:
    """A torque, as a part of what the joint is rated for: from hardly to plainly there."""
    return log_uniform(rng, low, high) * chain.links[j].effort


def _viscous(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"damping": _force(j, chain, rng) / max(float(scale.speed[j]), 0.1)}


def _coulomb(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    level = _force(j, chain, rng)
    if rng.random() < 0.75:
        return {"torque": level}
    ratio = rng.uniform(1.3, 2.0) ** rng.choice([-1, 1])
    return {"torque_positive": level, "torque_negative": level * ratio}


def _stribeck(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    level = _force(j, chain, rng, 0.003, 0.06)
    return {
        "coulomb": level,
        "static": level * rng.uniform(1.4, 2.4),
        "stribeck_velocity": log_uniform(rng, 0.03, 0.25),
    }


def _load_dependent(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"coefficient": log_uniform(rng, 0.01, 0.25)}


def _reflected(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    wanted = _force(j, chain, rng, 0.001, 0.06) / max(float(scale.acceleration[j]), 0.3)
    return {"inertia": min(wanted, 2.0 * float(scale.inertia[j]) + 0.2)}


def _linear_spring(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    stiffness = _force(j, chain, rng, 0.0015, 0.08) / max(float(scale.spread[j]), 0.1)
    rest = float(scale.centre[j] + rng.normal() * max(float(scale.spread[j]), 0.1))
    return {"stiffness": stiffness, "rest_angle": rest}


def _elasticity(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    rotor = log_uniform(rng, 0.02, 0.3) * max(float(scale.inertia[j]), 0.05)
    # The integrator's step bounds how fast a resonance may be.
    fastest = 0.25 / (5e-4) ** 2 / (1.0 / rotor + 1.0 / max(float(scale.inertia[j]) - chain.links[j].rotor, 1e-4))
    return {"stiffness": min(log_uniform(rng, 5.0, 80.0) * chain.links[j].effort, fastest), "rotor_inertia": rotor}


def _backlash(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {
        "gap": log_uniform(rng, 0.002, 0.03),
        "rotor_inertia": log_uniform(rng, 0.02, 0.3) * max(float(scale.inertia[j]), 0.05),
    }


def _ripple(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    fastest = 70.0 / max(float(scale.speed[j]), 0.1)  # 11 Hz at the usual speed
    slowest = 2.0 / max(float(scale.spread[j]), 0.05)  # more than a cycle on the way
    cycles = round(log_uniform(rng, max(2.0, slowest), max(3.0, min(60.0, fastest), 1.2 * slowest)))
    return {"amplitude": _force(j, chain, rng, 0.001, 0.05), "cycles": cycles, "phase": rng.uniform(-np.pi, np.pi)}


def _constant(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"gain": 1.0 + float(rng.choice([-1, 1])) * log_uniform(rng, 0.008, 0.25)}


def _bias(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"torque": float(rng.choice([-1, 1])) * _force(j, chain, rng, 0.0007, 0.06)}


def _saturation(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    low = max(0.7, 1.25 * float(scale.torque[j] / scale.peak[j]))
    return {"limit": float(scale.peak[j]) * rng.uniform(min(low, 0.85), 0.95)}


def _offset(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"offset": float(rng.choice([-1, 1])) * log_uniform(rng, 0.006, 0.2)}


def _fault(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"gain": 1.0 - log_uniform(rng, 0.02, 0.65)}


def _thermal(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    level = _force(j, chain, rng, 0.03, 0.1)
    return {"torque": level, "left": rng.uniform(0.2, 0.55), "time_constant": rng.uniform(5.0, 12.0)}


def _drag(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"drag": _force(j, chain, rng, 0.015, 0.08) / max(float(scale.speed[j]), 0.15) ** 2}


def _bouc_wen(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    travel = max(float(scale.spread[j]), 0.1) * rng.uniform(0.25, 0.7)
    return {"torque": _force(j, chain, rng, 0.02, 0.08), "travel": travel, "power": rng.uniform(1.0, 2.0)}


def _speed_constant(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"loss": rng.uniform(0.1, 0.3) / max(float(scale.speed[j]), 0.15)}


def _uneven_friction(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    turns = max(1.0, round(rng.uniform(1.0, 2.5) / max(float(scale.spread[j]), 0.1)))
    return {"torque": _force(j, chain, rng, 0.02, 0.07), "turns": turns, "phase": rng.uniform(-np.pi, np.pi)}


def _lag(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    return {"time_constant": rng.uniform(0.012, 0.04)}


def _coupled(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    first = int(rng.integers(chain.n - 3, chain.n - 1))
    weaker = min((first, first + 1), key=lambda j: chain.links[j].effort)
    damping = _force(weaker, chain, rng) / max(float(np.hypot(*scale.speed[[first, first + 1]])), 0.1)
    return Hidden(
        "coupled_friction",
        (first, first + 1),
        None,
        {"damping": [damping], "torque": [_force(weaker, chain, rng)]},
    )


def _point(rng: np.random.Generator) -> list[float]:
    return [*rng.uniform(-0.08, 0.08, 2).tolist(), float(rng.uniform(0.0, 0.16))]


def _payload(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    return Hidden(
        "payload", (), chain.n - 1, {"mass": [chain.capacity * log_uniform(rng, 0.008, 0.8)], "com": _point(rng)}
    )


def _inertial(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    """A lump welded to a link between the first and the last."""
    k = int(rng.integers(1, chain.n - 1))
    link = chain.links[k]
    mass = link.mass * log_uniform(rng, 0.015, 0.5)
    com = link.com + rng.normal(size=3) * np.maximum(0.5 * np.abs(link.com), 0.04)
    radius = rng.uniform(0.02, 0.05, 3)
    lump = np.diag(mass * (np.sum(radius**2) - radius**2) / 5.0)
    after = link.with_lump(mass, com, lump)
    difference = after.inertia - link.inertia
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return Hidden(
        "inertial_parameters",
        (),
        k,
        {
            "mass": [mass],
            "com": (after.com - link.com).tolist(),
            "inertia": [float(difference[p]) for p in pairs],
            "lump_com": com.tolist(),
            "lump_inertia": np.diag(lump).tolist(),
        },
    )


def _tilt(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    size, way = log_uniform(rng, 0.0015, 0.1), rng.uniform(0.0, 2.0 * np.pi)
    return Hidden("gravity_tilt", (), None, {"roll": [size * float(np.cos(way))], "pitch": [size * float(np.sin(way))]})


def _delay(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    return Hidden("time_delay", (), None, {"delay": [round(log_uniform(rng, 0.0025, 0.016) / 5e-4) * 5e-4]})


def _push(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    k = int(rng.integers(max(1, chain.n - 4), chain.n))
    way = rng.normal(size=3)
    force = way / np.linalg.norm(way) * log_uniform(rng, 0.015, 0.8) * chain.capacity * 9.81
    moment = rng.normal(size=3) * 0.03 * np.linalg.norm(force) if rng.random() < 0.3 else np.zeros(3)
    return Hidden("external_force", (), k, {"wrench": [*force.tolist(), *moment.tolist()]})


def _cable(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    i = int(rng.integers(0, chain.n - 1))
    j = int(rng.integers(i + 1, min(i + 3, chain.n)))
    stiffness = min(_force(i, chain, rng, 0.03, 0.1), _force(j, chain, rng, 0.03, 0.1) * 2.0)
    stiffness /= max(float(np.hypot(scale.spread[i], scale.spread[j])), 0.15)
    return Hidden("cable_coupling", (i, j), None, {"stiffness": [stiffness]})


def _slosh(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    return Hidden(
        "sloshing",
        (),
        chain.n - 1,
        {
            "mass": [chain.capacity * rng.uniform(0.35, 0.9)],
            "length": [rng.uniform(0.1, 0.25)],
            "damping_ratio": [rng.uniform(0.02, 0.1)],
            "at": [0.0, 0.0, 0.08],
        },
    )


def _loose(chain: Chain, scale: Scale, rng: np.random.Generator) -> Hidden:
    way = rng.normal(size=3)
    return Hidden(
        "loose_payload",
        (),
        chain.n - 1,
        {
            "mass": [chain.capacity * rng.uniform(0.35, 0.9)],
            "play": [rng.uniform(0.06, 0.15)],
            "way": (way / np.linalg.norm(way)).tolist(),
            "at": [0.0, 0.0, 0.08],
        },
    )


def _spring(j: int, chain: Chain, scale: Scale, rng: np.random.Generator) -> dict[str, float]:
    if rng.random() < 0.65:
        return _linear_spring(j, chain, scale, rng)
    # A counterbalance: a gas spring on a lever, which is no function of the catalogue but its curve.
    return {
        "amplitude": _force(j, chain, rng, 0.005, 0.15),
        "zero": float(scale.centre[j]) + rng.normal() * 0.6,
        "ratio": rng.uniform(0.35, 0.75),
    }


_JOINT: dict[str, Callable[[int, Chain, Scale, np.random.Generator], dict[str, float]]] = {
    "viscous_friction": _viscous,
    "coulomb_friction": _coulomb,
    "stribeck_friction": _stribeck,
    "load_dependent_friction": _load_dependent,
    "reflected_inertia": _reflected,
    "joint_spring": _spring,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "torque_ripple": _ripple,
    "torque_constant": _constant,
    "torque_bias": _bias,
    "torque_saturation": _saturation,
    "encoder_offset": _offset,
    "actuator_fault": _fault,
    "thermal_drift": _thermal,
    "quadratic_drag": _drag,
    "hysteresis": _bouc_wen,
    "speed_dependent_constant": _speed_constant,
    "position_dependent_friction": _uneven_friction,
    "motor_lag": _lag,
}

_WHOLE: dict[str, Callable[[Chain, Scale, np.random.Generator], Hidden]] = {
    "coupled_friction": _coupled,
    "payload": _payload,
    "inertial_parameters": _inertial,
    "gravity_tilt": _tilt,
    "time_delay": _delay,
    "external_force": _push,
    "cable_coupling": _cable,
    "sloshing": _slosh,
    "loose_payload": _loose,
}
