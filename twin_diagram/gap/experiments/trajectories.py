"""Experiments as motions that an arm can be asked to make, so that the next log tells two names apart.

Nothing is known of what stands around the arm. A motion therefore stays within the box of angles that the measured
runs visited, moves no faster and accelerates no harder than they did (a joint that crawled, or was only ever set down
elsewhere, at twice `TUNING.slow`), and holds the joints that are not asked about at a pose that was visited. The
straight way between two visited poses may still be blocked: look before it runs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.experiments import advice
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import motion
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    period: float = 0.01
    """Between samples [s]."""

    slow: float = 0.02
    """Speed of slow reversals [rad/s, or m/s where the joint is prismatic]."""

    half: float = 0.02
    """Half of the way between two of them [rad, or m]."""

    turning: float = 0.06
    """Shortest time in which one turns [s]; longer where the arm was not seen to accelerate so hard."""

    at_rest: float = 0.02
    """A run that begins and ends below this share of its highest speed does so at rest."""

    lead: float = 1.0
    """Shortest time in which one that does not is brought to its speed, and from it [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Visited:
    """What the measured runs did, and so what the arm may do again.

    Attributes:
        joints: names of the n columns.
        poses: (K, n) poses that were visited [rad].
        lower: (n,) [rad].
        upper: (n,) [rad].
        speed: (n,) highest that may be asked [rad/s].
        acceleration: (n,) likewise [rad/s²].
        run: (N, n) the first run's own motion, every `PERIOD`.
        prismatic: which of the joints are; what is theirs is in m, m/s and m/s².
    """

    joints: tuple[str, ...]
    poses: Array
    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    run: Array
    prismatic: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Experiment:
    """One motion to make next.

    Attributes:
        title: the experiment, in words.
        slug: for its file's name.
        joints: names of the n columns.
        moved: those that it is about.
        time: (N,) [s].
        position: (N, n) commanded [rad].
    """

    title: str
    slug: str
    joints: tuple[str, ...]
    moved: tuple[str, ...]
    time: Array
    position: Array

    def columns(self) -> dict[str, Array]:
        """Return the columns as the log format names them."""
        return {"time": self.time} | {
            f"position_commanded.{joint}": self.position[:, k] for k, joint in enumerate(self.joints)
        }


def visited(model: Model, logs: Sequence[Log]) -> Visited:
    """Look at measured runs; limits of the description count where they are tighter."""
    runs = [motion(log) for log in logs]
    poses = np.concatenate([run.position for run in runs])
    speed = np.max([np.abs(run.velocity).max(axis=0) for run in runs], axis=0)
    acceleration = np.max([np.quantile(np.abs(run.acceleration), 0.99, axis=0) for run in runs], axis=0)
    first = runs[0]
    time = np.arange(first.log.time[0], first.log.time[-1], TUNING.period)
    again = np.stack([np.interp(time, first.log.time, x) for x in first.position.T], axis=1)
    return Visited(
        joints=model.joints,
        poses=np.clip(poses[:: max(1, len(poses) // 2000)], model.lower, model.upper),
        lower=np.maximum(poses.min(axis=0), model.lower),
        upper=np.minimum(poses.max(axis=0), model.upper),
        speed=np.minimum(np.maximum(speed, 2.0 * TUNING.slow), 0.9 * model.velocity_limit),
        acceleration=np.maximum(acceleration, 0.2),
        run=np.clip(again, model.lower, model.upper),
        prismatic=model.prismatic,
    )


def design(text: str, seen: Visited, moved: Sequence[str]) -> Experiment | None:
    """Return the motion of an experiment of `gap.experiments.advice`; None where it has none.

    Args:
        text: the experiment's sentence.
        seen: what the arm may do.
        moved: joints that it is about; none: all.
    """
    make = MAKERS.get(text)
    if make is None:
        return None
    names = tuple(joint for joint in seen.joints if joint in moved) or seen.joints
    chosen = [seen.joints.index(joint) for joint in names]
    position = np.clip(make(seen, chosen), seen.lower, seen.upper)
    title = advice.worded(text, names, seen.prismatic)
    slug = re.sub(r"[^a-z0-9]+", "_", title.split(":")[0].split(",")[0].lower()).strip("_")[:32]
    time: Array = TUNING.period * np.arange(len(position), dtype=float)
    return Experiment(title, slug, seen.joints, names, time, position)


def static_poses(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return visited poses far from one another, each held twice: reached from above and from below."""
    step = 0.05 * (seen.upper - seen.lower)
    path = [_middle(seen)]
    for pose in spread_poses(seen.poses, 12):
        for side in (1.0, -1.0):
            path += [np.clip(pose + side * step, seen.lower, seen.upper), pose]
    parts = [path[0][None]]
    for k, (a, b) in enumerate(zip(path, [*path[1:], path[0]], strict=True)):
        parts.append(_move(seen, a, b, 0.4))
        if k % 2:
            parts.append(np.repeat(b[None], round(1.0 / TUNING.period), axis=0))
    del chosen
    return np.concatenate(parts)


def slow_reversals(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return the motion to and fro at a crawl about several angles of each joint."""
    here = _middle(seen)
    parts = [here[None]]
    for j in chosen:
        # A short or slow slide has less room than a revolute joint.
        half = max(min(TUNING.half, 0.15 * (seen.upper[j] - seen.lower[j])), 1e-6)
        slow = min(TUNING.slow, seen.speed[j])
        turns = np.linspace(0.0, 10.0, int(np.ceil(10.0 * half / (slow * TUNING.period))) + 1)  # quarters of the wave
        turning = max(TUNING.turning, 2.0 * slow / seen.acceleration[j])
        wave = _soften(half * 2.0 / np.pi * np.arcsin(np.sin(0.5 * np.pi * turns)), turning)
        for share in np.linspace(0.15, 0.85, 5):
            there = _middle(seen)
            there[j] = seen.lower[j] + share * (seen.upper[j] - seen.lower[j])
            parts.append(_move(seen, here, there, 0.5))
            crawl = np.repeat(there[None], len(wave), axis=0)
            crawl[:, j] += wave
            parts.append(crawl)
            here = there
    return np.concatenate([*parts, _move(seen, here, _middle(seen), 0.5)])


def speed_steps(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return each joint there and back at constant speeds, from a crawl to the highest that was seen."""
    middle = _middle(seen)
    parts = [middle[None]]
    for j in chosen:
        centre = middle.copy()
        centre[j] = 0.5 * (seen.lower[j] + seen.upper[j])
        parts.append(_move(seen, middle, centre, 0.5))
        for speed in np.geomspace(min(TUNING.slow, 0.5 * seen.speed[j]), seen.speed[j], 7):
            half = min(0.45 * (seen.upper[j] - seen.lower[j]), 2.0 * speed)
            ends = [centre.copy(), centre.copy()]
            ends[0][j], ends[1][j] = centre[j] - half, centre[j] + half
            for a, b in ((centre, ends[0]), (ends[0], ends[1]), (ends[1], ends[0]), (ends[0], centre)):
                parts.append(_cruise(a, b, float(speed), float(seen.acceleration[j]), j))
        parts.append(_move(seen, centre, middle, 0.5))
    return np.concatenate(parts)


def fast_sines(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return small sines of 1 to 4 Hz about one pose, as hard as the arm was seen to accelerate."""
    middle = _middle(seen)
    parts = [middle[None]]
    time = np.arange(0.0, 4.0, TUNING.period, dtype=np.float64)
    envelope = _ease(time / 0.8) * _ease((4.0 - time) / 0.8)
    for j in chosen:
        w = 2.0 * np.pi * np.array([1.0, 2.0, 4.0])
        most = 0.3 * (seen.upper[j] - seen.lower[j])
        sizes = np.minimum(np.minimum(0.8 * seen.acceleration[j] / w**2, 0.9 * seen.speed[j] / w), most)
        centre = middle.copy()  # with room to both sides
        centre[j] = np.clip(middle[j], seen.lower[j] + sizes[0], seen.upper[j] - sizes[0])
        parts.append(_move(seen, middle, centre, 0.5))
        for speed, size in zip(w, sizes, strict=True):
            part = np.repeat(centre[None], len(time), axis=0)
            part[:, j] += size * envelope * np.sin(speed * time)
            parts.append(part)
        parts.append(_move(seen, centre, middle, 0.5))
    return np.concatenate(parts)


def run_again(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return the first run's own motion."""
    del chosen
    return _from_rest(seen)


def run_many(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return the first run's own motion, over and over for three minutes."""
    run = _from_rest(seen)
    once = np.concatenate([run, _move(seen, run[-1], run[0], 0.5)])
    del chosen
    return np.concatenate([once] * max(2, int(np.ceil(180.0 / (TUNING.period * len(once))))))


def run_with_rests(seen: Visited, chosen: Sequence[int]) -> Array:
    """Return the first run's own motion between ten seconds of rest."""
    still = round(10.0 / TUNING.period)
    del chosen
    run = _from_rest(seen)
    return np.concatenate([np.repeat(run[:1], still, axis=0), run, np.repeat(run[-1:], still, axis=0)])


MAKERS: dict[str, Callable[[Visited, Sequence[int]], Array]] = {
    advice.STATIC: static_poses,
    advice.SLOW: slow_reversals,
    advice.SPEEDS: speed_steps,
    advice.LOAD: run_again,
    advice.FAST: fast_sines,
    advice.LONG: run_many,
    advice.STILL: run_with_rests,
}
"""What makes the motion (N, n) of each piece of advice [rad], from what was visited and the joints it is about."""


def spread_poses(poses: Array, count: int) -> Array:
    """Return the poses (count, n) that are far from one another: each next one is the farthest from those before."""
    size = np.ptp(poses, axis=0) + 1e-9
    scaled = poses / size
    chosen = [int(np.argmin(np.linalg.norm(scaled - np.median(scaled, axis=0), axis=1)))]
    distance = np.linalg.norm(scaled - scaled[chosen[0]], axis=1)
    while len(chosen) < min(count, len(poses)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(scaled - scaled[chosen[-1]], axis=1))
    return poses[chosen]


def _middle(seen: Visited) -> Array:
    """Return the visited pose that is nearest to the middle of all."""
    centre = 0.5 * (seen.lower + seen.upper)
    size = seen.upper - seen.lower + 1e-9
    return np.array(seen.poses[int(np.argmin(np.linalg.norm((seen.poses - centre) / size, axis=1)))])


def _from_rest(seen: Visited) -> Array:
    """Return the first run's path, begun and ended at rest, no harder than it was, where the log was cut in motion."""
    run = seen.run
    steps = np.abs(np.diff(run, axis=0))
    if np.all(np.maximum(steps[0], steps[-1]) <= TUNING.at_rest * np.max(steps, axis=0)):
        return run
    own = np.max(np.abs(np.diff(run, 2, axis=0)), axis=0, initial=0.0)
    hardest = 1.02 * np.maximum(own, TUNING.period**2 * seen.acceleration)
    whole, lead = TUNING.period * (len(run) - 1), TUNING.lead
    while True:
        again = _with_leads(run, lead)
        if lead >= whole or np.all(np.abs(np.diff(again, 2, axis=0)) <= hardest):
            return again
        lead = min(1.3 * lead, whole)


def _with_leads(run: Array, lead: float) -> Array:
    """Return a path that comes to its speed, and from it, in so long [s]."""
    time = np.arange(0.0, TUNING.period * (len(run) - 1) + lead, TUNING.period)
    rate = np.minimum(_ease(time / lead), _ease((time[-1] - time) / lead))
    along = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    along *= (len(run) - 1) / along[-1]
    return np.stack([np.interp(along, np.arange(len(run)), x) for x in run.T], axis=1)


def _ease(s: Array) -> Array:
    """Return a rise from 0 to 1 with speed and acceleration zero at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _move(seen: Visited, a: Array, b: Array, share: float) -> Array:
    """Return the motion from a pose to another, at a share of the speeds and accelerations that were seen."""
    away = np.abs(b - a)
    needed = np.maximum(1.875 * away / seen.speed, np.sqrt(5.78 * away / seen.acceleration)) / share
    count = max(2, int(np.ceil(float(np.max(needed)) / TUNING.period)))
    return a + (b - a) * _ease(np.arange(1, count + 1) / count)[:, None]


def _cruise(a: Array, b: Array, speed: float, acceleration: float, j: int) -> Array:
    """Return the way along one joint at a constant speed, with ramps at both ends."""
    away = float(abs(b[j] - a[j]))
    if away < 1e-9:
        return a[None]
    speed = min(speed, np.sqrt(away * acceleration))
    ramp, whole = speed / acceleration, away / speed + speed / acceleration
    count = max(2, int(np.ceil(whole / TUNING.period)))
    time = np.minimum(TUNING.period * np.arange(1, count + 1), whole)
    up, down = np.minimum(time, ramp), np.maximum(time - (whole - ramp), 0.0)
    travelled = acceleration * (0.5 * up**2) + speed * np.maximum(time - ramp, 0.0) - 0.5 * acceleration * down**2
    result = np.repeat(a[None], count, axis=0)
    result[:, j] += np.sign(b[j] - a[j]) * np.clip(travelled, 0.0, away)
    return result


def _soften(wave: Array, duration: float) -> Array:
    """Return a wave with round corners, its first and last among them; it starts and ends where it did, at rest."""
    width = max(3, int(np.ceil(duration / TUNING.period)))
    padded = np.pad(wave, width - 1, mode="edge")
    return np.asarray(np.convolve(padded, np.ones(width) / width, mode="valid"), dtype=np.float64)
