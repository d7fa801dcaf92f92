"""Joint motions that tell most of a held object's inertia, within what arm, grip and surroundings allow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import scipy
from pydrake.math import RigidTransform

from twin_diagram.estimation.weighing.bound import Bound, crlb
from twin_diagram.estimation.weighing.carried_motion import CarriedMotion
from twin_diagram.estimation.weighing.excitation_cost import TUNING as COST
from twin_diagram.estimation.weighing.excitation_cost import ExcitationCost, Room
from twin_diagram.estimation.weighing.grip import Grip
from twin_diagram.estimation.weighing.harmonics import Harmonics
from twin_diagram.estimation.weighing.held import Held, WeighingError, as_pose
from twin_diagram.estimation.weighing.motion_limits import MotionLimits
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.mass_properties import is_physical
from twin_diagram.signals.arrays import Array

Clear = Callable[[Array], npt.NDArray[np.bool_]]
"""Tells of postures (N, n) [rad] which are clear of everything (N,)."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module; `sims/benchmarks/weighing_tables.py` prints what comes of them."""

    check_rate: float = 100.0
    """At which limits are checked in the end [1/s]."""

    clear_rate: float = 300.0
    """The same of clearance: a third of a degree at full speed. What is scaled until it is clear ends at its border."""

    narrower: float = 0.7
    """By which the reach shrinks where the motion is not clear."""

    tries: int = 6
    """Of that; after them a tenth of the reach is left."""

    least_scale: float = 0.2
    """A motion that must be scaled down below this tells too little: refused."""

    much: float = 0.8
    """One that must be scaled down below this is looked for anew, with limits that count for more: half the motion
    tells half, and where a grip hardly carries the object another posture leaves more of it."""

    strict: float = 300.0
    """Weight of limits then; it is 30 before."""

    strict_steps: int = 30
    """Of that search: 4 s of a core."""

    strict_samples: int = 3
    """Times as many samples as before, in that search."""


TUNING = Tuning()


class NotClear(WeighingError):
    """Surroundings that leave no motion about a posture: there may be one about another."""


@dataclass(frozen=True)
class ExcitationPlan:
    """What kind of motion is looked for.

    Attributes:
        period: its length, and that of its lowest harmonic [s].
        harmonics: how many; 15 of 0.1 Hz end at 1.5 Hz.
        rate: of the torques that the bound is told for [1/s].
        noise: of these torques [N·m].
        starts: random ones; the best is refined.
        trial_steps: of the optimiser for each start.
        steps: for the best.
        seed: of the starts.
    """

    period: float = 10.0
    harmonics: int = 15
    rate: float = 100.0
    noise: float = 0.05
    starts: int = 3
    trial_steps: int = 15
    steps: int = 90
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.period) and self.period > 0.0):
            raise WeighingError(f"period must be positive [s], not {self.period}")
        if self.harmonics < 3:
            raise WeighingError(f"harmonics must be at least 3, so that a motion can end at rest, not {self.harmonics}")


@dataclass(frozen=True)
class Excitation:
    """A motion that starts and ends at rest at one posture.

    Attributes:
        joints: the model's.
        posture: (n,) where it starts and ends [rad].
        rows: (m,) the joints that move.
        harmonics: of their motion.
        coefficients: (size, m) of each joint's.
        bound: of what it tells of the object as it was thought to be, with plan's rate and noise.
        use: the largest share of each limit that it takes: position, velocity, acceleration, torque, grip.
        scale: what it was scaled down by in the end, so that it kept limits at all times.
    """

    joints: tuple[str, ...]
    posture: Array
    rows: npt.NDArray[np.int64]
    harmonics: Harmonics
    coefficients: Array
    bound: Bound | None = None
    use: dict[str, float] = field(default_factory=dict)
    scale: float = 1.0

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations (N, n) at times (N,) [s]; at rest before and after it."""
        parts = self.harmonics.at(np.clip(np.asarray(time, dtype=float), 0.0, self.harmonics.period))
        result = []
        for k, part in enumerate(parts):
            whole = np.tile(self.posture if k == 0 else np.zeros_like(self.posture), (len(part), 1))
            whole[:, self.rows] += part @ self.coefficients
            result.append(whole)
        return result[0], result[1], result[2]

    def sampled(self, rate: float) -> tuple[Array, tuple[Array, Array, Array]]:
        """Return times (N,) [s] and the motion at them, at a rate [1/s], the period's end left out."""
        time = np.arange(round(self.harmonics.period * rate)) / rate
        return time, self.at(time)


def feed_forward(model: Model, X_TO: RigidTransform, parameters: Array, motion: tuple[Array, Array, Array]) -> Array:
    """Return the torques (N, n) that a motion takes beyond holding the arm without the object [N·m].

    For drivers that hold the arm by its own gravity and follow by a spring: with these they follow a fast motion, too.

    Args:
        model: the arm with its rotors (motor side).
        X_TO: the object's frame O in the tool frame.
        parameters: (10,) of the object in O, as far as known; zeros: an empty hand.
        motion: positions, velocities, accelerations (N, n).
    """
    q, v, a = motion
    still = np.zeros_like(v)
    result = model.inverse_dynamics(q, v, a) - model.inverse_dynamics(q, still, still)
    held = Held.in_tool(model, X_TO)
    result[:, held.rows] += held.regressor(model, q, v, a) @ parameters
    return result


def weight_torque(model: Model, X_TO: RigidTransform, parameters: Array, q: Array) -> Array:
    """Return the torques (N, n) that hold an object up at rest, beyond those that hold the arm [N·m].

    Args:
        model: the arm.
        X_TO: the object's frame O in the tool frame.
        parameters: (10,) of the object in O, of which mass and centre count.
        q: (N, n) [rad].
    """
    held, result = Held.in_tool(model, X_TO), np.zeros_like(q)
    result[:, held.rows] = held.regressor(model, q, np.zeros_like(q), np.zeros_like(q)) @ parameters
    return result


def optimise_excitation(
    model: Model,
    X_TO: RigidTransform,
    parameters: Array,
    posture: Array,
    limits: MotionLimits | None = None,
    grip: Grip | None = None,
    clear: Clear | None = None,
    plan: ExcitationPlan = ExcitationPlan(),
    room: Room | None = None,
) -> Excitation:
    """Return a motion that makes the Cramér–Rao bound of an object's ten parameters small.

    What is made small is the 4-norm of the standard errors of mass, centre and principal moments, each over what it
    is to reach, with every joint's offset and frictions fitted along (Swevers et al. 1997; Armstrong 1989).

    Args:
        model: the arm with its rotors (motor side): its motors' torques are limited.
        X_TO: the object's frame O in the tool frame.
        parameters: (10,) of the object in O as it is thought to be, such as `Shape.even(mass)`.
        posture: (n,) about which it moves [rad]; it may be moved within the limits of the joints.
        limits: None: `MotionLimits.of(model)`.
        grip: None: nothing slips.
        clear: tells which postures (N, n) are clear of everything, the object included; None: all are.
        plan: length, harmonics, and how long it is looked for.
        room: to everything, as `clear` asks for it; None: a motion that is not clear is narrowed as a whole.

    Raises:
        NotClear: surroundings that the posture is not clear of, or that leave no motion about it.
        WeighingError: arguments that do not fit, a posture outside the limits, or a grip that does not even hold the
            object at rest.
    """
    if np.shape(parameters) != (10,) or not is_physical(np.asarray(parameters)):
        raise WeighingError(f"parameters are not those of a body: {parameters}")
    X_TO, posture = as_pose(X_TO), np.asarray(posture, dtype=float)
    if posture.shape != (len(model.joints),) or not np.all(np.isfinite(posture)):
        raise WeighingError(f"posture must be {len(model.joints)} finite numbers, not {posture}")
    limits = MotionLimits.of(model) if limits is None else limits
    held = Held.in_tool(model, X_TO)
    outside = [model.joints[k] for k in held.rows if not limits.lower[k] <= posture[k] <= limits.upper[k]]
    if outside:
        raise WeighingError(f"posture: {', '.join(outside)} outside the limits; move it inside")
    if clear is not None and not clear(posture[None])[0]:
        raise NotClear("posture: not clear of its surroundings; begin elsewhere")
    X_TG = RigidTransform(np.array((0.0, 0.0, 0.0) if grip is None else grip.centre))
    carried = CarriedMotion(model, held, np.asarray(parameters), X_TO.inverse() @ X_TG, posture)
    reach = np.full(len(posture), np.pi)
    start: Array | None = None
    for _ in range(TUNING.tries):
        harmonics = Harmonics(plan.period, plan.harmonics)
        cost = ExcitationCost.of(carried, limits.near(posture, reach), grip, harmonics, room)
        start = _stricter(cost, _searched(cost, plan, start))
        found = _clear_of(_within(cost, carried, start), cost, carried, start, clear)
        if found is not None:
            motion = found.sampled(plan.rate)[1]
            return replace(found, bound=crlb(model, X_TO, carried.parameters, motion, plan.noise))
        reach, start = TUNING.narrower * np.minimum(reach, 1.5), cost.shrunk(start, TUNING.narrower)
    raise NotClear("no motion about this posture is clear of its surroundings; weigh elsewhere")


def _searched(cost: ExcitationCost, plan: ExcitationPlan, start: Array | None) -> Array:
    """Return the best numbers found (size): from some starts a little, from the best of them thoroughly."""
    random = np.random.default_rng(plan.seed)
    starts = [cost.drawn(random) for _ in range(plan.starts)] if start is None else [start]
    tried = [_improved(cost, x, plan.trial_steps, 3.0) for x in starts] if len(starts) > 1 else [(0.0, starts[0])]
    best = min(tried, key=lambda one: one[0])[1]
    for weight, share in ((3.0, 0.7), (30.0, 0.3)):
        best = _improved(cost, best, max(1, int(share * plan.steps)), weight)[1]
    return best


def _improved(cost: ExcitationCost, x: Array, steps: int, weight: float) -> tuple[float, Array]:
    """Return the least cost found from some numbers (size) in some steps, with limits of a weight, and where it is."""
    options = {"maxiter": steps, "maxcor": 20}
    done = scipy.optimize.minimize(
        cost.value_and_slope, x, args=(weight,), jac=True, method="L-BFGS-B", options=options
    )
    return float(done.fun), done.x


def _stricter(cost: ExcitationCost, x: Array) -> Array:
    """Return numbers (size) of whose motion limits leave more, where they leave little of that of some (size)."""
    share = _share_within(cost, x)
    if share >= TUNING.much:
        return x
    # What a grip carries at rest is most of what it may: a motion that asks for 2 % too much between two samples would
    # be scaled down to a third. So what is over is looked for there, too, and taken away where it is.
    finer, small = cost.finer(TUNING.strict_samples), cost.scaled(x, max(share, TUNING.least_scale))
    told = [(cost.value_and_slope(cost.scaled(x, max(share, 1e-3)), 0.0)[0], x)]
    for begin in (x, small):
        other = _improved(finer, begin, TUNING.strict_steps, TUNING.strict)[1]
        kept = _share_within(cost, other)
        told.append((cost.value_and_slope(cost.scaled(other, max(kept, 1e-3)), 0.0)[0], other))
        if kept >= TUNING.much:
            break
    return min(told, key=lambda one: one[0])[1]


def _share_within(cost: ExcitationCost, x: Array, most: float = 1.0 / COST.target) -> float:
    """Return what a motion may be scaled by, at the most, to keep every limit at all times; 0: it does not at rest.

    The search leaves some of each limit for what is between its samples: what is not asked for there is made use of.
    """
    time = np.arange(0.0, cost.harmonics.period, 1.0 / TUNING.check_rate)
    if max(cost.use(cost.scaled(x, most), time).values()) <= 1.0:
        return most
    low, high = 0.0, most
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if max(cost.use(cost.scaled(x, middle), time).values()) <= 1.0 else (low, middle)
    return low


def _within(cost: ExcitationCost, carried: CarriedMotion, x: Array, most: float = 1.0 / COST.target) -> Excitation:
    """Return the motion, scaled up, at the most, or down as keeps every limit at all times.

    Raises:
        WeighingError: not even a small one does.
    """
    time = np.arange(0.0, cost.harmonics.period, 1.0 / TUNING.check_rate)
    scale = _share_within(cost, x, most)
    if scale < TUNING.least_scale:
        use = cost.use(x, time)
        worst = max(use, key=lambda name: use[name])
        raise WeighingError(
            f"no motion keeps the limit of {worst}: at rest it takes "
            f"{cost.use(cost.scaled(x, 0.0), time)[worst]:.2f} of it; grip more firmly, or elsewhere"
        )
    x = x if scale == 1.0 else cost.scaled(x, scale)
    posture, coefficients = cost.parts(x)
    whole = carried.others.copy()
    whole[carried.held.rows] = posture
    use = cost.use(x, time)
    return Excitation(carried.model.joints, whole, carried.held.rows, cost.harmonics, coefficients, None, use, scale)


def _clear_of(
    found: Excitation, cost: ExcitationCost, carried: CarriedMotion, x: Array, clear: Clear | None
) -> Excitation | None:
    """Return a motion, of some numbers (size), scaled down as little as keeps it clear; None: a little does not."""

    def is_clear(factor: float) -> bool:
        q = found.posture + factor * (found.sampled(TUNING.clear_rate)[1][0] - found.posture)
        return clear is None or bool(np.all(clear(q)))

    if is_clear(1.0):
        return found
    low, high = TUNING.much, 1.0
    if not is_clear(low):
        return None
    for _ in range(6):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_clear(middle) else (low, middle)
    smaller = _within(cost, carried, cost.scaled(x, low * found.scale), most=1.0)
    return replace(smaller, scale=low * found.scale)
