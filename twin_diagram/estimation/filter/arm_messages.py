"""The arm's own messages, whatever they hold: used, fused late, refused in part or in whole, or a fresh start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.dynamics.positive_definite import solve_positive, whiten
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.disturbance import disturbance_std
from twin_diagram.estimation.filter.fault_isolation import alarming, keep_score
from twin_diagram.estimation.filter.outlier_streaks import forget, gather, take_for_noise
from twin_diagram.estimation.filter.parameter_adaptation import open_up, refute
from twin_diagram.estimation.filter.predict import propagate
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.estimation.filter.update import TUNING as UPDATE
from twin_diagram.estimation.filter.update import Update, fuse, take
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

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
    q, v, tau = (_sized(core, name, value) for name, value in (("q", q), ("v", v), ("torque", tau)))
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
    belief.header[Entry.TIME] = t
    belief.header[Entry.NIS] = 2.0 * n
    belief.header[Entry.NIS_MEAN] = 1.0
    belief.header[Entry.STREAK] = 0.0
    belief.header[Entry.QUIET] = min(belief.header[Entry.QUIET], t)
    belief.header[Entry.FRESH] = 1.0
    belief.header[Entry.SPAN] = 0.0
    forget(belief)
    belief.header[[Entry.RELEASED, Entry.HEARD]] = t
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


def observe(core: Core, q: Array, v: Array, tau: Array, t: float) -> bool:
    """Take in one message of the arm, whatever it holds; the belief is never poisoned.

    Args:
        core: its belief and history are changed.
        q: (n,) measured positions [rad].
        v: (n,) estimated velocities [rad/s].
        tau: (n,) measured motor torques [N·m].
        t: measurement time [s]; `NEVER` or any negative, stale or non-finite time means that there is no message.

    Returns:
        Whether the message was used.

    Raises:
        FilterError: q, v or τ are not n numbers, whatever their values.
    """
    q, v, tau = (_sized(core, name, value) for name, value in (("q", q), ("v", v), ("torque", tau)))
    belief, header = core.belief, core.belief.header
    if not np.isfinite(t):
        header[Entry.INVALID] += 1
        return False
    if t < 0.0:
        return False
    usable = bool(np.all(np.abs(q) < TUNING.absurd) and np.all(np.abs(v) < TUNING.absurd))  # NaN compares false
    heard = bool(np.all(np.abs(tau) < TUNING.absurd * core.terms.effort_limit))
    if not usable or not (heard or belief.valid):
        header[Entry.INVALID] += 1
        return False
    if not belief.valid:
        start(core, q, v, tau, t)
        return True
    dt = t - belief.time
    if dt <= 1e-9:
        if core.history.knows(t):  # the same message seen again is no sign of trouble
            header[Entry.STALE] += 1
            return False
        # A run of messages that go back in time is a clock that was set back.
        header[Entry.STREAK] += 1
        if header[Entry.STREAK] < UPDATE.refusals:
            if t >= core.history.oldest:
                return fuse(core, core.joints, np.concatenate([q, v]), t).accepted
            header[Entry.STALE] += 1
            return False
    if not heard:
        header[Entry.INVALID] += 1
        tau = belief.torque
    if not 0.0 < dt <= TUNING.longest_gap or header[Entry.STREAK] >= UPDATE.refusals:
        header[Entry.RESTARTS] += 1
        start(core, q, v, tau, t)
        return True
    kept = belief.vector.copy()
    try:
        with np.errstate(all="ignore"):
            _next(core, q, v, tau, t, dt, heard)
        sound = bool(np.all(np.isfinite(belief.vector))) and bool(np.all(np.abs(belief.x) < 2.0 * TUNING.absurd))
    except (np.linalg.LinAlgError, FilterError):
        sound = False
    if not sound:
        # The model ran away, as it may under absurd torques: parameters as before, state from the sensors.
        belief.vector[:] = kept
        header[Entry.RESTARTS] += 1
        start(core, q, v, tau, t)
    return True


def _sized(core: Core, name: str, values: Array) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise FilterError(f"{name} {values!r} is not {core.terms.n} numbers") from None
    if array.shape != (core.terms.n,):
        raise FilterError(f"{name} has shape {array.shape} where {core.terms.n} numbers are expected")
    return array


def _next(core: Core, q: Array, v: Array, tau: Array, t: float, dt: float, heard: bool) -> None:
    belief, header, n = core.belief, core.belief.header, core.terms.n
    # The first torque after a start may be a placeholder, so the first step's torque is as good as unknown.
    trusted = heard and header[Entry.FRESH] == 0.0
    header[Entry.FRESH] = 0.0
    propagate(core, 0.5 * (belief.torque + tau), dt, core.params.torque_std if trusted else core.terms.effort_limit)
    header[Entry.TIME] = t
    core.history.retime(t)
    belief.torque[:] = tau
    whole = take(core, core.joints, np.concatenate([q, v]), None, None, True)
    if not whole.accepted:
        _salvage(core, whole, q, v)
    nis = whole.nis
    header[Entry.NIS] = nis
    blend = min(dt / TUNING.nis_time, 1.0)
    if whole.accepted:  # what was refused says something of a sensor, nothing of the parameters
        header[Entry.NIS_MEAN] += blend * (min(nis / (2 * n), 50.0) - header[Entry.NIS_MEAN])
    momentum = core.step_mass @ whole.innovation[n:]
    spread = core.step_mass @ whole.covariance[n:, n:] @ core.step_mass.T
    belief.innovation[:] = whiten(spread, momentum)
    if belief.p and trusted:
        # Momentum's innovations by θ: what the step's velocity owes to it.
        by_theta = core.step_mass @ core.F[n : 2 * n, 3 * n : 3 * n + belief.p]
        keep_score(belief.score, whiten(spread, by_theta), belief.innovation)
    if whole.accepted:
        header[Entry.ACCEPTED] += 1
        header[Entry.STREAK] = 0.0
    else:
        header[Entry.REFUSED] += 1
        header[Entry.STREAK] += 1
    gather(belief, whole.innovation, whole.surprise or not whole.accepted)
    if header[Entry.GATHERED] >= UPDATE.refusals and header[Entry.CALM] == 0.0:
        # Where it is no noise, ten refusals make the next message begin anew.
        if take_for_noise(belief, core.params, whole.covariance.diagonal()):
            core.history.begin(t, belief.x, belief.P)
    header[Entry.SURPRISES] += float(whole.surprise)
    if t >= header[Entry.QUIET] and (
        header[Entry.NIS_MEAN] > core.params.opening
        or (header[Entry.STREAK] == 0.0 and alarming(belief.score, core.parameters.groups))
    ):
        open_up(core, t)
    elif t >= header[Entry.QUIET]:
        refute(core, t)


def _salvage(core: Core, whole: Update, q: Array, v: Array) -> None:
    """Of a refused message, takes the one sensor that is within its own gate; if both are, they contradict."""
    n = core.terms.n
    good = []
    for sensor, z, part in ((core.encoder, q, slice(0, n)), (core.velocity, v, slice(n, 2 * n))):
        innovation = whole.innovation[part]
        if innovation @ solve_positive(whole.covariance[part, part], innovation) <= sensor.gate:
            good.append((sensor, z))
    if len(good) == 1:
        take(core, *good[0], None, None, False)
