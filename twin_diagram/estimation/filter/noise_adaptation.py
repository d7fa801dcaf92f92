"""Which readings speak for their sensor's noise, when, and how fast: see `noise_estimate` for what they say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.dynamics.positive_definite import solve_positive
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Entry, SensorTrack
from twin_diagram.estimation.filter.disturbance import TUNING as DISTURBANCE
from twin_diagram.estimation.filter.disturbance import follow_disturbance
from twin_diagram.estimation.filter.noise_estimate import (
    TUNING as NOISE_ESTIMATE,
)
from twin_diagram.estimation.filter.noise_estimate import (
    follow_sensor,
    follow_torque,
    gain,
    held,
    scaled,
)
from twin_diagram.estimation.filter.sensor_registry import TUNING as SENSOR_REGISTRY
from twin_diagram.estimation.sensors import Linear, Sensor
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Which readings speak for noise: chosen by hand.

    `tests/estimation/filter/test_noise_estimate.py` shows the noise found beside the noise put in.
    """

    creeping: float = 0.1
    """Share of a reading's variance that may be due to joints that rest or creep where it speaks for its sensor's
    noise."""

    run: int = 3
    """Readings refused in a row that are no outliers any more."""

    wrong: float = 3.0
    """Where surprises outlast a hold with innovations squared so many times their covariance, noise is found anew."""


TUNING = Tuning()


@dataclass(frozen=True)
class Update:
    """What became of a reading.

    Attributes:
        accepted: False where the gate refused it or it was not finite.
        surprise: it was accepted, but only an unmodelled torque explains it.
        nis: squared Mahalanobis distance of the innovation.
        innovation: (m,) z − h(x).
        covariance: (m, m) of the innovation.
        late: it was fused at a time before the filter's.
    """

    accepted: bool
    surprise: bool
    nis: float
    innovation: Array
    covariance: Array
    late: bool = False


def _levels(core: Core, sensor: Sensor, track: Array | None) -> Array | None:
    """Logarithms of the factors of a sensor's variances (m,), a view; None for one it does not know."""
    if track is not None:
        return next(
            level for level, other in zip(core.belief.levels, core.belief.tracks, strict=True) if other is track
        )
    own = {core.joints.name: slice(0, 2), core.encoder.name: slice(0, 1), core.velocity.name: slice(1, 2)}
    return core.belief.noise[own[sensor.name]].reshape(-1) if sensor.name in own else None


def noise_now(core: Core, sensor: Sensor, track: Array | None, at: Linear, noise: Array | None) -> Array:
    """Return R (m, m) as adapted: the sensor's own or that of this reading, and what its model adds."""
    base = sensor.noise(core.belief.x) if noise is None else noise
    levels = _levels(core, sensor, track)
    adapted = base if levels is None else scaled(base, levels)
    return adapted if noise is not None else at.noise + (adapted - base)


def adapt(
    core: Core, sensor: Sensor, track: Array | None, at: Linear, noise: Array | None, result: Update, t: float
) -> None:
    """Let a reading speak for its sensor's noise, and the arm's own for the torque that the model lacks.

    Args:
        core: its belief is changed.
        sensor: that gave it.
        track: its record; None for the arm's own.
        at: the sensor's model at the reading.
        noise: R of this reading; None: the sensor's own.
        result: what became of it.
        t: when it was taken [s].
    """
    belief, span = core.belief, core.params.noise_time
    levels = _levels(core, sensor, track)
    if span <= 0.0 or levels is None:
        return
    now = max(t, belief.time)
    streak = float(belief.header[Entry.STREAK] if track is None else track[SensorTrack.STREAK])
    trouble = result.surprise or (not result.accepted and (track is None or streak >= TUNING.run))
    # A message refused alone is an outlier; a run of them may well be noise that was thought too small. Of another
    # sensor it is a fault, as long as the joints vouch for the state.
    used = result.accepted or (track is None and streak >= TUNING.run)
    # Without the joints, what the model gets wrong would be taken for noise of the sensors that are left.
    blind = belief.header[Entry.HEARD] < now - SENSOR_REGISTRY.vouched
    if held(belief, now, trouble) or blind or not used:
        return
    counts, counted = (belief.header, Entry.COUNTED) if track is None else (track, SensorTrack.COUNTED)
    if trouble and (streak >= TUNING.run or belief.header[Entry.NIS_MEAN] > TUNING.wrong):
        counts[counted] = 0.0
    elapsed = float(belief.header[Entry.SPAN]) if track is None else t - float(track[SensorTrack.LAST])
    if not 0.0 < elapsed < np.inf:
        return
    step: Array | float = gain(elapsed, span, float(counts[counted]))
    counts[counted] += 1.0
    base = (sensor.noise(belief.x) if noise is None else noise).diagonal() * np.exp(levels)
    inverse = solve_positive(result.covariance, np.eye(sensor.size))
    weighted = inverse @ result.innovation
    if sensor is core.joints and core.by_torque is not None and not result.late:
        by, n = core.by_torque, belief.n
        variance = core.params.torque_std**2 * np.exp(belief.noise[2]) * (core.period / elapsed)
        # No haste here, at first either: what parameters have yet to learn looks like torque that no model gives, and a
        # push would hide in it later.
        follow_torque(belief, by, variance, inverse @ by, weighted, min(elapsed / span, NOISE_ESTIMATE.largest_step))
        follow_disturbance(belief, core.params, core.wander, elapsed)
        # What rests or creeps is known through its friction, and says little of a sensor.
        moving = np.tile((belief.regime != 0.0) & (np.abs(belief.v) > 2.0 * DISTURBANCE.creep), 2)[: 2 * n]
        follow_sensor(levels, base, inverse.diagonal(), weighted, np.where(moving, step, 0.0))
        return
    if core.by_torque is not None and not result.late:
        # What friction may do to joints that rest or creep is far more than it mostly does: beside it, a reading that
        # depends on it would seem to be finer than it is.
        creep = np.square(at.jacobian[:, : 2 * belief.n] @ core.by_torque) @ core.creep
        step = np.where(creep < TUNING.creeping * result.covariance.diagonal(), step, 0.0)
    follow_sensor(levels, base, inverse.diagonal(), weighted, step)
