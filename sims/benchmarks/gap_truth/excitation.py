"""Motions that an arm is asked to make: multi-sines, moves between poses, slow reversals, a mixture, pick and place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from gap_truth.chain import Chain

Array = npt.NDArray[np.float64]

KINDS = ("multisine", "point_to_point", "slow_reversals", "mixed")
PICKING = "picking"
"""The same few poses again and again, with rests at each."""

RAMP = 1.2
"""In which a motion starts from rest and comes back to it [s]."""


@dataclass(frozen=True)
class Motion:
    """What is asked, at regular times: position, velocity and acceleration, each (N, n)."""

    q: Array
    v: Array
    a: Array


def draw(chain: Chain, kind: str, duration: float, period: float, speed: float, rng: np.random.Generator) -> Motion:
    """A motion about a pose near the arm's home.

    Args:
        chain: the arm.
        kind: one of `KINDS`, or `PICKING`.
        duration: [s].
        period: between samples [s].
        speed: part of the joints' speed limits that is used.
        rng: source of randomness.
    """
    lower, upper = chain.column("lower"), chain.column("upper")
    centre = np.clip(chain.home + rng.uniform(-0.3, 0.3, chain.n), lower + 0.2, upper - 0.2)
    room = np.minimum(0.9 * np.minimum(centre - lower, upper - centre), 1.3)
    count = round(duration / period) + 1
    if kind == "mixed":
        parts = [_part(k, chain, room, n, period, speed, rng) for k, n in zip(KINDS[:3], _thirds(count), strict=True)]
        away = np.concatenate([parts[k] for k in rng.permutation(3)])
    else:
        away = _part(kind, chain, room, count, period, speed, rng)
    q = gaussian_filter1d(centre + away, 0.012 / period, axis=0, mode="nearest")
    v = np.gradient(q, period, axis=0)
    return Motion(q, v, np.gradient(v, period, axis=0))


def _thirds(count: int) -> list[int]:
    return [count // 3, count // 3, count - 2 * (count // 3)]


def _part(
    kind: str, chain: Chain, room: Array, count: int, period: float, speed: float, rng: np.random.Generator
) -> Array:
    time = period * np.arange(count)
    make = {"multisine": _multisine, "point_to_point": _moves, "slow_reversals": _reversals, PICKING: _picking}[kind]
    return make(time, chain, room, speed, rng)


def _smoothstep(s: Array) -> Array:
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _window(time: Array) -> Array:
    return (_smoothstep(time / RAMP) * _smoothstep((time[-1] - time) / RAMP))[:, None]


def _multisine(time: Array, chain: Chain, room: Array, speed: float, rng: np.random.Generator) -> Array:
    base = 1.0 / rng.uniform(5.0, 11.0)
    harmonics = np.arange(1, int(rng.integers(4, 9)))
    size = rng.uniform(0.2, 1.0, (len(harmonics), chain.n)) / harmonics[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(harmonics), chain.n))
    angle = 2.0 * np.pi * base * harmonics[None, :, None] * time[:, None, None] + phase
    wave = np.einsum("thn,hn->tn", np.sin(angle), size)
    rate = np.abs(np.gradient(wave, time[1] - time[0], axis=0)).max(axis=0)
    scale = np.minimum(
        rng.uniform(0.5, 0.95) * room / np.abs(wave).max(axis=0), speed * chain.column("velocity") / rate
    )
    return np.asarray(wave * scale * _window(time))


def _moves(time: Array, chain: Chain, room: Array, speed: float, rng: np.random.Generator) -> Array:
    result = np.zeros((len(time), chain.n))
    here, now = np.zeros(chain.n), rng.uniform(0.1, 0.5)
    while now < time[-1] - 1.5:
        there = rng.uniform(-0.85, 0.85, chain.n) * room
        needed = 1.9 * np.max(np.abs(there - here) / (speed * chain.column("velocity")))
        last = now + max(needed, 0.3)
        if last > time[-1] - 1.5:
            break
        part = time > now
        result[part] = here + (there - here) * _smoothstep((time[part] - now) / (last - now))[:, None]
        here, now = there, last + (rng.uniform(0.0, 0.6) if rng.random() < 0.7 else 0.0)
    part = time > now
    result[part] = here * (1.0 - _smoothstep((time[part] - now) / max(time[-1] - now - 0.1, 0.5))[:, None])
    return result


def _picking(time: Array, chain: Chain, room: Array, speed: float, rng: np.random.Generator) -> Array:
    """Between places where something is taken and put, a little above each first, with rests of 0.3 to 1.5 s."""
    poses = rng.uniform(-0.85, 0.85, (int(rng.integers(2, 4)), chain.n)) * room
    above = poses + rng.uniform(-0.12, 0.12, poses.shape) * room
    result, here, now = np.zeros((len(time), chain.n)), np.zeros(chain.n), rng.uniform(0.2, 0.6)
    stops = [pose for one, other in zip(above, poses, strict=True) for pose in (one, other, one)]
    k = 0
    while True:
        there = stops[k % len(stops)] + 0.01 * room * rng.normal(size=chain.n)
        needed = 1.9 * np.max(np.abs(there - here) / (speed * chain.column("velocity")))
        last = now + max(needed, 0.35)
        if last > time[-1] - 0.4:
            return result
        result[time > now] = here + (there - here) * _smoothstep((time[time > now] - now) / (last - now))[:, None]
        here, now, k = there, last + (rng.uniform(0.3, 1.5) if k % 3 == 1 else rng.uniform(0.0, 0.3)), k + 1


def _reversals(time: Array, chain: Chain, room: Array, speed: float, rng: np.random.Generator) -> Array:
    result = np.zeros((len(time), chain.n))
    for j in range(chain.n):
        rate = float(np.exp(rng.uniform(np.log(0.03), np.log(max(0.05, 0.35 * speed)))))
        turn = rng.uniform(1.2, 4.0)
        turn = min(turn, room[j] / rate)
        wave = rate * turn * (2.0 / np.pi) * np.arcsin(np.sin(0.5 * np.pi * time / turn + rng.uniform(0.0, 6.28)))
        result[:, j] = gaussian_filter1d(wave, 0.04 / (time[1] - time[0]), mode="nearest")
    return np.asarray(result * _window(time))
