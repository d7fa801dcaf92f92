"""The arm's own messages, whatever they hold: what is to become of each, a fresh start, and what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from twin_diagram.estimation.dynamics.positive_definite import solve_positive, whiten
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.disturbance import disturbance_std
from twin_diagram.estimation.filter.fault_isolation import keep_score
from twin_diagram.estimation.filter.noise_adaptation import Update
from twin_diagram.estimation.filter.outlier_streaks import forget
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.estimation.filter.update import TUNING as UPDATE
from twin_diagram.estimation.sensors import Sensor
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """What a message of the arm may be: chosen by hand, generous on purpose."""

    longest_gap: float = 0.25
    """After a longer silence the state is taken anew from the message; parameters are kept [s]."""

    absurd: float = 1e4
    """No joint angle, speed or torque share of the effort limit is larger than this."""

    nis_time: float = 0.1
    """Over which the normalised innovations are averaged [s]."""

    start_std: float = 3.0
    """A fresh state's standard deviation, in those of its sensors."""


TUNING = Tuning()


def start(core: Core, q: Array, v: Array, tau: Array, t: float) -> None:
    """Take the state from a message; θ, its covariance and the counters are kept, at the first set to the prior.

    Args:
        core: its belief and history are changed.
        q: (n,) [rad].
        v: (n,) [rad/s].
        tau: (n,) [N·m].
        t: [s].

    Raises:
        FilterError: q, v or τ are not n finite numbers, or t is not finite.
    """
    q, v, tau = (sized(core.terms.n, name, value) for name, value in (("q", q), ("v", v), ("torque", tau)))
    if not np.all(np.isfinite([*q, *v, *tau, t])):
        raise FilterError(f"no state can be taken from q {q.tolist()}, v {v.tolist()}, torque {tau.tolist()} at {t} s")
    belief, n = core.belief, core.terms.n
    if belief.valid:
        kept = belief.P[3 * n :, 3 * n :].copy()
    else:
        p = belief.p
        kept = np.zeros((belief.size - 3 * n, belief.size - 3 * n))
        kept[:p, :p] = core.parameters.covariance if core.params.rule == "covariance" else 0.0
        kept[p:, p:] = np.diag(core.declared.prior())
        belief.theta[:], belief.freed[:] = core.parameters.mean, 0.0
    belief.model[:], belief.gradient[:], belief.score[:] = belief.theta, 0.0, 0.0
    belief.q[:], belief.v[:], belief.disturbance[:] = q, v, 0.0
    belief.torque[:], belief.drift[:], belief.regime[:] = tau, v, 0.0
    belief.innovation[:], belief.before[:], belief.acceleration[:] = 0.0, v, 0.0
    if t < belief.time:  # a clock that was set back: what was told there lasts no longer, and lies ahead no more
        belief.header[[Entry.ALARM, Entry.HEEDED]] = np.minimum(belief.header[[Entry.ALARM, Entry.HEEDED]], t)
    belief.header[Entry.TIME] = t
    belief.header[Entry.NIS] = 2.0 * n
    belief.header[Entry.NIS_MEAN] = 1.0
    belief.header[Entry.STREAK] = 0.0
    belief.header[Entry.QUIET] = min(belief.header[Entry.QUIET], t)
    belief.header[Entry.FRESH] = 1.0
    belief.header[Entry.SPAN] = 0.0
    forget(belief)
    belief.header[[Entry.RELEASED, Entry.HEARD, Entry.MESSAGE]] = t
    belief.P[:] = 0.0
    belief.P[3 * n :, 3 * n :] = kept
    dry = core.terms.dry(core.terms.true_position(belief.q), belief.v, belief.torque)
    diagonal = np.concatenate(
        [
            (TUNING.start_std * core.params.encoder_std) ** 2 * np.exp(belief.noise[0]),
            (TUNING.start_std * core.params.velocity_std) ** 2 * np.exp(belief.noise[1]),
            disturbance_std(core.params, np.zeros(n, dtype=bool), 0.5 * (dry[0] + dry[1])) ** 2,
        ]
    )
    belief.P[np.arange(3 * n), np.arange(3 * n)] = diagonal
    core.by_torque = None
    core.declared.start(belief, t)
    core.history.begin(t, belief.x, belief.P)


class Course(Enum):
    """What is to become of a message."""

    NONE = "there is no message"
    INVALID = "it holds a NaN, an infinity or an absurd value"
    STALE = "it was seen before"
    TOO_OLD = "it lies before all that the filter remembers"
    LATE = "it is fused at its own time"
    FIRST = "the state is taken from it"
    RESTART = "the state is taken anew from it, after a gap in time or a run of refusals"
    NEXT = "the filter moves on to it"


def course_of(core: Core, q: Array, v: Array, t: float, heard: bool) -> Course:
    """Return what is to become of a message.

    Args:
        core: not changed.
        q: (n,) [rad].
        v: (n,) [rad/s].
        t: [s].
        heard: whether its torques can be used.
    """
    belief, history = core.belief, core.history
    if not np.isfinite(t):
        return Course.INVALID
    if t < 0.0:
        return Course.NONE
    usable = bool(np.all(np.abs(q) < TUNING.absurd) and np.all(np.abs(v) < TUNING.absurd))  # NaN compares false
    if not usable or not (heard or belief.valid):
        return Course.INVALID
    if not belief.valid:
        return Course.FIRST
    dt, streak = t - belief.time, float(belief.header[Entry.STREAK])
    if dt <= 1e-9:
        # The same message seen again is no sign of trouble. A step may have ended there for another sensor's sake.
        if not follows(belief, t) and history.knows(t):
            return Course.STALE
        # A run of messages that go back in time is a clock that was set back.
        if streak + 1.0 < UPDATE.refusals:
            return Course.LATE if t >= history.oldest else Course.TOO_OLD
        return Course.RESTART
    return Course.NEXT if dt <= TUNING.longest_gap and streak < UPDATE.refusals else Course.RESTART


def follows(belief: Belief, t: float) -> bool:
    """Return whether a message of time t [s] is newer than all of the arm's before it, if not than the state.

    A further sensor that is quicker than the arm's own brings the state to its own time, ahead of the arm's messages.
    """
    return bool(t > belief.header[Entry.MESSAGE] + 1e-9)


def count(belief: Belief, course: Course, heard: bool) -> None:
    """Count a message that is not as it should be.

    Args:
        belief: its header is changed.
        course: what is to become of the message.
        heard: whether its torques can be used.
    """
    header = belief.header
    if course is Course.INVALID or (not heard and course in (Course.NEXT, Course.RESTART)):
        header[Entry.INVALID] += 1
    if course in (Course.STALE, Course.TOO_OLD):
        header[Entry.STALE] += 1
    if course in (Course.LATE, Course.TOO_OLD):
        header[Entry.STREAK] += 1
    if course is Course.RESTART:
        header[Entry.RESTARTS] += 1


def sized(n: int, name: str, values: Array) -> Array:
    """Return n numbers as an array, whatever their values.

    Raises:
        FilterError: they are not n numbers.
    """
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise FilterError(f"{name} {values!r} is not {n} numbers") from None
    if array.shape != (n,):
        raise FilterError(f"{name} has shape {array.shape} where {n} numbers are expected")
    return array


def heard(tau: Array, effort_limit: Array) -> bool:
    """Return whether torques (n,) are such as a motor can have."""
    return bool(np.all(np.abs(tau) < TUNING.absurd * effort_limit))


def within_own_gate(core: Core, refused: Update, q: Array, v: Array) -> tuple[Sensor, Array] | None:
    """Return of a refused message the one sensor that is within its own gate, with its reading.

    If both are, they contradict, and none is to be trusted.
    """
    n = core.terms.n
    good: list[tuple[Sensor, Array]] = []
    for sensor, z, part in ((core.encoder, q, slice(0, n)), (core.velocity, v, slice(n, 2 * n))):
        innovation = refused.innovation[part]
        if innovation @ solve_positive(refused.covariance[part, part], innovation) <= sensor.gate:
            good.append((sensor, z))
    return good[0] if len(good) == 1 else None


def keep_record(core: Core, whole: Update, dt: float, trusted: bool) -> None:
    """Keep what a message said: how well it agreed, as torque and by parameter, and how it was used.

    Args:
        core: its belief is changed.
        whole: what became of the message.
        dt: since the one before [s].
        trusted: whether the torques over that time were known.
    """
    belief, header, n = core.belief, core.belief.header, core.terms.n
    header[Entry.NIS] = whole.nis
    if whole.accepted:  # what was refused says something of a sensor, nothing of the parameters
        header[Entry.NIS_MEAN] += min(dt / TUNING.nis_time, 1.0) * (
            min(whole.nis / (2 * n), 50.0) - header[Entry.NIS_MEAN]
        )
    momentum = core.step_mass @ whole.innovation[n:]
    spread = core.step_mass @ whole.covariance[n:, n:] @ core.step_mass.T
    belief.innovation[:] = whiten(spread, momentum)
    if belief.p and trusted:
        # Momentum's innovations by θ: what the step's velocity owes to it.
        by_theta = core.step_mass @ core.F[n : 2 * n, 3 * n : 3 * n + belief.p]
        keep_score(belief.score, whiten(spread, by_theta), belief.innovation)
    header[Entry.ACCEPTED if whole.accepted else Entry.REFUSED] += 1
    header[Entry.STREAK] = 0.0 if whole.accepted else header[Entry.STREAK] + 1
    header[Entry.SURPRISES] += float(whole.surprise)
