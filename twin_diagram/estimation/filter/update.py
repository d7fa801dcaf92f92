"""The update: gates a reading, fuses it now or at its own past time, and keeps its sensor's record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.dynamics.positive_definite import joseph, solve_positive, whiten
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Entry, SensorTrack
from twin_diagram.estimation.filter.noise_adaptation import Update, adapt, noise_now
from twin_diagram.estimation.filter.parameter_adaptation import gather
from twin_diagram.estimation.filter.predict import TUNING as PREDICT
from twin_diagram.estimation.filter.predict import propagate, unmodelled
from twin_diagram.estimation.filter.sensor_registry import FilterError, note
from twin_diagram.estimation.sensors import Linear, Sensor, WristWrench
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When the state is taken anew: chosen by hand."""

    refusals: int = 10
    """After as many refused or stale messages in a row the state is taken anew from the message."""


TUNING = Tuning()


def fuse(
    core: Core, sensor: Sensor, z: Array, t: float | None = None, noise: Array | None = None, explain: bool = True
) -> Update:
    """Take in a reading: see `Ekf.update`. Where that fails the filter is as it was before.

    Raises:
        FilterError: as there.
    """
    kept = core.belief.vector.copy()
    try:
        with np.errstate(all="ignore"):
            result = take(core, sensor, z, t, noise, explain)
        sound = bool(np.all(np.isfinite(core.belief.vector)))
    except np.linalg.LinAlgError:
        sound = False
    if not sound:
        core.load(kept)
        raise FilterError(f"{sensor.name}: the reading {np.asarray(z).tolist()} cannot be fused; it is left out")
    return result


def take(core: Core, sensor: Sensor, z: Array, t: float | None, noise: Array | None, explain: bool) -> Update:
    """Take in a reading; a filter that fails over it is left as it then is: see `fuse`.

    Raises:
        FilterError: as there.
    """
    belief = core.belief
    if not belief.valid:
        raise FilterError(f"{sensor.name}: there is no state to update: start the filter from a message")
    z = np.asarray(z, dtype=float)
    if z.shape != (sensor.length,):
        raise FilterError(f"{sensor.name}: {z.shape} numbers where {sensor.length} are expected")
    if noise is not None:
        noise = covariance_of(sensor, noise)
    track = core.declared.track(belief, sensor) if sensor.name in core.declared.sensors else None
    back, ahead = 0, 0.0
    if t is not None:
        ahead = t - belief.time
        if not np.isfinite(t):
            raise FilterError(f"{sensor.name}: its time {t} is not a finite number of seconds")
        if ahead < -1e-9:
            found = core.history.find(t)
            if found is None:
                if track is not None:
                    track[SensorTrack.STALE] += 1
                raise FilterError(
                    f"{sensor.name}: its time {t} s lies before all that the filter remembers, "
                    f"{min(core.history.oldest, belief.time)} to {belief.time} s"
                )
            back = found
        elif ahead > PREDICT.longest_prediction:
            raise FilterError(
                f"{sensor.name}: its time {t} s lies {ahead} s ahead: start the filter anew from a message"
            )
        elif ahead > 1e-9:
            propagate(core, belief.torque, ahead, core.params.torque_std)
            belief.header[Entry.TIME] = t
            core.history.retime(t)
    if not sensor.sound(z):
        if track is None:
            belief.header[Entry.INVALID] += 1
        else:
            track[SensorTrack.INVALID] += 1
        return Update(False, False, 0.0, np.zeros(sensor.size), np.eye(sensor.size))
    if back or (ahead < -1e-9 and core.history.count):
        assert t is not None
        return _late(core, sensor, z, t, noise, track, back)
    at = core.linear(sensor, belief.x, belief.P, 0)
    # It is for the joints themselves to say that a torque threw the arm. What else jumps may be a load, a contact or a
    # fault of its own, and must not move the state by all that an effort limit allows.
    gated = gate(core, sensor, z, at, noise_now(core, sensor, track, at, noise), explain and track is None)
    result = gated.result
    if result.accepted:
        absorb(core, gated)
    adapt(core, sensor, track, at, noise, result, belief.time)
    if track is not None:
        _record(core, sensor, track, result, belief.time)
    elif result.accepted:
        belief.header[Entry.HEARD] = belief.time
    return result


@dataclass(frozen=True)
class Gated:
    """A reading beside what was expected of it, and what it would change.

    Attributes:
        result: whether it is accepted, and why.
        H: (m, N) derivative of the sensor's model.
        R: (m, m) its noise.
        gain: (N, m) K.
        weighted: (m,) S⁻¹ y.
        added: (N, N) covariance of the unmodelled torque that explains it; None where none is needed.
    """

    result: Update
    H: Array
    R: Array
    gain: Array
    weighted: Array
    added: Array | None = None


def gate(core: Core, sensor: Sensor, z: Array, at: Linear, R: Array, explain: bool) -> Gated:
    """Return what a reading would do now: refused, accepted, or accepted for an unmodelled torque alone.

    Args:
        core: not changed.
        sensor: that gave it.
        z: (length,).
        at: the sensor's model now.
        R: (m, m) noise.
        explain: whether an unmodelled torque may explain it.
    """
    innovation, H = sensor.innovation(z, at.reading), at.jacobian
    S, solved = _solved(core.belief.P, H, R, innovation)
    nis = float(innovation @ solved[:, -1])
    surprise, added = nis > sensor.gate, None
    accepted = not surprise
    if surprise and explain and core.by_torque is not None:
        added = unmodelled(core, innovation[core.terms.n :] if sensor is core.joints else 0.0)
        _, solved = _solved(core.belief.P + added, H, R, innovation)
        accepted = float(innovation @ solved[:, -1]) <= sensor.gate
    result = Update(accepted, surprise and accepted, nis, innovation, S)
    return Gated(result, H, R, solved[:, :-1].T, solved[:, -1], added)


def _solved(P: Array, H: Array, R: Array, innovation: Array) -> tuple[Array, Array]:
    """Return S (m, m) and S⁻¹ [H P, y] (m, N + 1)."""
    HP = H @ P
    S = HP @ H.T + R
    return S, solve_positive(S, np.concatenate([HP, innovation[:, None]], axis=1))


def absorb(core: Core, gated: Gated) -> None:
    """Update the belief by a reading that its gate let pass.

    Args:
        core: its belief and history are changed.
        gated: the reading.
    """
    belief, H, R, K, innovation = core.belief, gated.H, gated.R, gated.gain, gated.result.innovation
    if gated.added is not None:
        belief.P += gated.added
        core.history.widen(gated.added)
    core.history.read(H, R, innovation + H @ belief.x)
    belief.x += K @ innovation
    A = K @ -H
    A.flat[:: belief.size + 1] += 1.0
    P = A @ belief.P @ A.T + K @ R @ K.T
    belief.P[:] = 0.5 * (P + P.T)
    if core.params.rule == "gradient" and not gated.result.surprise and core.by_torque is not None:
        gather(core, H, gated.weighted)
    core.parameters.clip(belief.theta)
    core.history.settle(belief.x, belief.P)


def _late(
    core: Core, sensor: Sensor, z: Array, t: float, noise: Array | None, track: Array | None, back: int
) -> Update:
    """Fuse a reading at an earlier step, and run the steps after it again."""
    belief, n = core.belief, core.terms.n
    time, x, P = core.history.state(back)
    # From the step's end to the reading's own time the state moves by its speed: half a step at most.
    lead = t - time
    moved = x.copy()
    moved[:n] += lead * x[n : 2 * n]
    at = core.linear(sensor, moved, P, back)
    H = at.jacobian.copy()
    H[:, n : 2 * n] += lead * H[:, :n]
    R = noise_now(core, sensor, track, at, noise)
    innovation = sensor.innovation(z, at.reading)
    S = H @ P @ H.T + R
    nis = float(innovation @ solve_positive(S, innovation))
    accepted = nis <= sensor.gate
    result = Update(accepted, False, nis, innovation, S, late=True)
    if accepted:
        core.history.read(H, R, innovation + H @ x, back)
        x, P = joseph(x, P, H, R, innovation)
        belief.x[:], P = core.history.rerun(back, x, P, core.parameters.opening, core.parameters.clip)
        belief.P[:] = P
        core.parameters.clip(belief.theta)
    adapt(core, sensor, track, at, noise, result, t)
    if track is not None:
        _record(core, sensor, track, result, t)
        track[SensorTrack.LATE] += accepted
    else:
        belief.header[Entry.LATE] += accepted
    return result


def _record(core: Core, sensor: Sensor, track: Array, result: Update, t: float) -> None:
    """Keep a further sensor's record; a run of refusals opens what only this sensor tells."""
    belief = core.belief
    note(track, whiten(result.covariance, result.innovation), result.nis, t, result.accepted)
    if track[SensorTrack.STREAK] < TUNING.refusals:
        return
    track[SensorTrack.STREAK] = 0.0
    track[SensorTrack.REACQUIRED] += 1
    prior = sensor.own_std() ** 2
    if len(prior):
        belief.P[sensor.own, :] = 0.0
        belief.P[:, sensor.own] = 0.0
        belief.P[sensor.own, sensor.own] = np.diag(prior)
    _open_payload(core, sensor, result)
    if not core.declared.vouched(belief, sensor, t):
        # Nobody else tells of the state: it, and not the sensor, must be wrong.
        wider = np.sqrt(max(2.0 * result.nis / sensor.size, 1.0))
        belief.P[: 2 * belief.n, :] *= wider
        belief.P[:, : 2 * belief.n] *= wider
        core.bound()
    core.history.begin(belief.time, belief.x, belief.P)


def _open_payload(core: Core, sensor: Sensor, result: Update) -> None:
    """Where a changed payload explains what a sensor of it insists on, the payload is open again: friction hides it."""
    at, n, belief = core.parameters.payload, core.terms.n, core.belief
    if at is None or not isinstance(sensor, WristWrench) or core.params.rule == "gradient":
        return
    where = slice(3 * n + at.start, 3 * n + at.stop)
    H = core.linear(sensor, belief.x, belief.P, 0).jacobian[:, where]
    room = core.parameters.opening[at, at]
    innovation = result.innovation
    if innovation @ solve_positive(result.covariance + H @ room @ H.T, innovation) > sensor.gate:
        return
    belief.P[where, where] += room
    belief.header[Entry.OPENINGS] += 1


def covariance_of(sensor: Sensor, noise: Array) -> Array:
    """Return R (m, m) from a covariance or from standard deviations.

    Raises:
        FilterError: it is neither.
    """
    noise, m = np.asarray(noise, dtype=float), sensor.size
    if noise.shape == (m,):
        noise = np.diag(np.square(noise))
    sound = noise.shape == (m, m) and bool(np.all(np.isfinite(noise)))
    if sound:
        noise = 0.5 * (noise + noise.T)
        scale = np.sqrt(np.abs(noise.diagonal()))
        sound = bool(np.all((scale > 1e-9) & (scale < 1e9))) and bool(
            np.linalg.eigvalsh(noise / np.outer(scale, scale)).min() > 0.0
        )
    if not sound:
        raise FilterError(f"{sensor.name}: its noise is neither a positive covariance ({m}, {m}) nor {m} deviations")
    return noise
