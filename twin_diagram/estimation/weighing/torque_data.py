"""Logs as regressions: what an arm's torques tell of itself and of what it holds, filtered alike on both sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint
from scipy.interpolate import make_interp_spline

from twin_diagram.estimation.weighing.held import Held, WeighingError, as_pose
from twin_diagram.logs.differentiation import differentiate, inner, lowpass, motion
from twin_diagram.logs.measured_log import Log
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body import from_plant
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    cutoff: float = 8.0
    """Torques and what is to explain them are low-passed alike [Hz]: five times the fastest harmonic of 1.5 Hz, so that
    the turning of frictions stays, and below what differentiated encoders spoil."""

    rate: float = 25.0
    """Kept samples [1/s]: a little more than twice the cutoff."""

    least: float = 3.0
    """A log shorter than this [s] tells no inertia."""

    slow: float = 0.02
    """Dry friction turns round between minus and plus this [rad/s]."""

    step: float = 1e-3
    """Of differences by the lag of speeds [s]."""

    stribeck: float = 0.1
    """What dry friction has more at low speed fades within this [rad/s]."""


TUNING = Tuning()
COLUMNS = ("offset", "viscous", "dry", "stribeck", "load", "rotor")
"""What a joint's torque has beside the rigid bodies: N·m per unit of each in `TorqueRun.beside`; load: per N·m."""


@dataclass(frozen=True)
class LoadedRun:
    """A log of an arm that moves with an object in its hand.

    Attributes:
        log: of the arm's joints, each message of its driver, which should get a command for each: where commands come
            more seldom, torques jump with them, and messages taken at the same rate show only one side of the jumps.
        X_TO: the object's frame O in the tool frame, all the time; a matrix (4, 4) is made one of Drake's.
        fingers: positions of joints outside the arm by name [m], [rad]; those not named are as described.
        way: (N,) where the object was at each sample of the log, from -1 to 1, on the way that it crept or slipped in
            the hand, whose middle X_TO is; None: it crept steadily.
    """

    log: Log
    X_TO: RigidTransform
    fingers: Mapping[str, float] = field(default_factory=dict)
    way: Array | None = None

    def __post_init__(self) -> None:
        """Take a matrix for a pose; refuse what is none."""
        object.__setattr__(self, "X_TO", as_pose(self.X_TO))
        if self.way is not None and np.shape(self.way) != (len(self.log),):
            raise WeighingError(f"way: {np.shape(self.way)} numbers for a log of {len(self.log)} samples")


@dataclass(frozen=True)
class EmptyRun:
    """The same with nothing in the hand; `fingers` as of `LoadedRun`."""

    log: Log
    fingers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TorqueRun:
    """A log's torques at K kept times, of the m joints that move the hand.

    Attributes:
        name: of the log.
        torque: (K, m) measured, as they reach the joints [N·m].
        arm: (K, m) of the arm without object, as the model has it.
        late: (K, m) by what the torque changes where it is logged later than the motion, per second of that.
        lagging: (K, m) by what the arm's torque changes where its terms of speed are those of earlier speeds, per
            second of that; and `Y_lagging` (K, m, 10) of the hand's or object's, per unit of its parameters in M.
        beside: (K, m, len(COLUMNS)).
        Y_hand: (K, m, 10) per unit of the hand's own parameters in M.
        held: where the object is; None: nothing is held.
        way: (K,) see `LoadedRun`.
    """

    name: str
    torque: Array
    arm: Array
    late: Array
    lagging: Array
    beside: Array
    Y_hand: Array
    Y_lagging: Array
    held: Held | None
    way: Array


def read_run(model: Model, run: LoadedRun | EmptyRun, delay: float = 0.0) -> TorqueRun:
    """Return a log as regression.

    Args:
        model: the arm.
        run: its log.
        delay: by which torques are logged later than the motion that they belong to [s]; they are moved back by it.

    Raises:
        LogError: it lacks joints or torques.
        WeighingError: it is too short, too slow, not finite, or the fingers are no joints.
    """
    log = run.log.select(model.joints)
    if np.any(np.diff(log.time) <= 0.0):
        raise WeighingError(f"{log.source}: its times do not rise; sort them")
    if len(log) < 8 or log.time[-1] - log.time[0] < TUNING.least:
        raise WeighingError(f"{log.source}: shorter than {TUNING.least:g} s, which tells no inertia; move for longer")
    torque = log.motor_torque
    for name, values in (("time", log.time), ("position", log.position), ("torque", torque)):
        if not np.all(np.isfinite(values)):
            raise WeighingError(f"{log.source}: {name} holds values that are not finite; cut them out")
    if 1.0 / log.period < 2.0 * TUNING.cutoff:
        raise WeighingError(
            f"{log.source}: {1.0 / log.period:.3g} samples a second; at least {2 * TUNING.cutoff:g} are needed"
        )
    moved = motion(log)
    regular, q, v, a = moved.log, model.true_position(moved.position), moved.velocity, moved.acceleration
    held = Held.in_tool(model, run.X_TO if isinstance(run, LoadedRun) else RigidTransform())
    rows, time = held.rows, regular.time
    applied = model.applied(regular.motor_torque, time)
    change = hand_change(model, run.fingers)[held.body]

    def rigid(speed: Array) -> tuple[Array, Array]:
        Y = model.tree.regressor(q, speed, a, held.body)[:, rows]
        own = model.applied(model.inverse_dynamics(moved.position, speed, a, time=time), time)
        return own[:, rows] + Y @ change, Y

    arm, Y_hand = rigid(v)
    earlier = rigid(v - TUNING.step * a)
    direction, fading = np.tanh(v[:, rows] / TUNING.slow), np.exp(-((v[:, rows] / TUNING.stribeck) ** 2))
    beside = [np.ones_like(arm), v[:, rows], direction, direction * fading, direction * np.abs(arm), a[:, rows]]
    rate = 1.0 / regular.period
    kept = np.flatnonzero(inner(time))[:: max(1, int(rate / TUNING.rate))]

    def below(signal: Array) -> Array:
        return lowpass(signal, rate, TUNING.cutoff)[kept]

    moved_back = make_interp_spline(time, lowpass(applied[:, rows], rate, TUNING.cutoff), k=3)(time[kept] + delay)
    return TorqueRun(
        log.source,
        moved_back,
        below(arm),
        -differentiate(lowpass(arm, rate, TUNING.cutoff), time, 1)[kept],
        below((earlier[0] - arm) / TUNING.step),
        np.stack([below(column) for column in beside], axis=-1),
        below(Y_hand.reshape(len(time), -1)).reshape(len(kept), len(rows), 10),
        below(((earlier[1] - Y_hand) / TUNING.step).reshape(len(time), -1)).reshape(len(kept), len(rows), 10),
        held if isinstance(run, LoadedRun) else None,
        _way_at(run, time[kept]),
    )


def _way_at(run: LoadedRun | EmptyRun, time: Array) -> Array:
    """Return where on its way the object was at some times (K,) [s], see `LoadedRun`; steadily where nobody knows."""
    if isinstance(run, EmptyRun) or run.way is None:
        return np.linspace(-1.0, 1.0, len(time))
    return np.asarray(np.interp(time, run.log.time, run.way))


def hand_change(model: Model, fingers: Mapping[str, float]) -> Array:
    """Return (bodies, 10): by what the bodies' parameters differ from the tree's with fingers elsewhere.

    Raises:
        WeighingError: a name is no joint outside the arm, or its position not finite.
    """
    if not fingers:
        return np.zeros_like(model.tree.inertia)
    context = model.make_context()
    for name, position in fingers.items():
        if not np.isfinite(position):
            raise WeighingError(f"fingers: {name} stands at {position}")
        if name in model.joints or not model.plant.HasJointNamed(name):
            raise WeighingError(f"fingers: {name!r} is no joint outside the arm, whose positions the log tells")
        joint = model.plant.GetJointByName(name)
        if isinstance(joint, PrismaticJoint):
            joint.set_translation(context, position)
        elif isinstance(joint, RevoluteJoint):
            joint.set_angle(context, position)
    moved = from_plant.from_plant(model.plant, context, model.arm).inertia
    before = from_plant.from_plant(model.plant, model.make_context(), model.arm).inertia
    return np.asarray(moved - before)
