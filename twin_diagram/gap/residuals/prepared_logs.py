"""Logs made ready for regression: uniform, smooth, filtered alike, without ends, at the rate that the filter leaves.

A regression of torque on motion is unbiased where both sides went through the same filter. Positions are smoothed well
above the band (`MOTION` times its edge), so that within the band they are as measured; every regressor is computed from
them at the log's own rate, non-linear ones too, and only then low-passed and thinned, exactly as the torque is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import LogError, expect
from twin_diagram.gap.residuals.log_noise import noise_above, roughness, shaken, trusted_band
from twin_diagram.logs import Log, fingerprint, uniform
from twin_diagram.logs.dejittering import dejittered
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.differentiation import inner, lowpass, motion
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    band: float = 20.0
    """Torques are compared below this [Hz]; above it, position noise drowns inertial torques."""

    motion: float = 2.5
    """Positions are smoothed at this many times the band."""

    thin: float = 2.5
    """Samples kept per second, times the band."""

    laws: float = 240.0
    """Samples per second that are enough where laws are worked out in full [1/s]."""

    dies_away: float = 15.0
    """Periods of the low-pass's edge within which its answer to a step is over: what is left is below rounding."""

    spare: float = 2.5
    """Times that rate that is not yet too much."""

    shortest: float = 2.0
    """A log that is fitted must have this much left after its ends are cut [s]."""

    beyond_noise: float = 12.0
    """Noise of a joint at rest reaches from end to end over so many deviations at most, in a million samples."""

    least_motion: float = 1e-5
    """What no encoder tells from rest [rad or m]."""

    shortest_held: float = 1.0
    """A log that is held out must have this much left [s]: five rollouts."""


TUNING = Tuning()


@dataclass(frozen=True)
class Record:
    """One log. Full-rate arrays are (N, n), thinned ones (D, n).

    Attributes:
        index: of the log.
        source: what to call it.
        mark: its log's fingerprint.
        time: (N,) regular [s].
        rate: [1/s].
        band: edge of the low-pass [Hz].
        q: positions [rad].
        v: velocities [rad/s].
        a: accelerations [rad/s²].
        torque: logged, unfiltered [N·m].
        given: the given model's torque for this motion [N·m].
        passed: the same without dry friction: what the gears pass on [N·m].
        shaken: (n,) inertial torque of a joint's position noise over the torque's own noise, at the band's edge.
        kept: (D,) indices of the samples that are left.
        period: the log's own median time between samples [s].
        compared: edge of a closer low-pass, at which what is reduced is compared [Hz].
        above: (n,) see `noise_above` [N·m].
    """

    index: int
    source: str
    mark: str
    time: Array
    rate: float
    band: float
    q: Array
    v: Array
    a: Array
    torque: Array
    given: Array
    passed: Array
    shaken: Array
    kept: npt.NDArray[np.int64]
    period: float
    compared: float = np.inf
    above: Array | float = 0.0

    def reduce(self, signal: Array) -> Array:
        """Return a full-rate signal (N, …) filtered and thinned to (D, …)."""
        shape = signal.shape[1:]
        filtered = lowpass(signal.reshape(len(signal), -1), self.rate, min(self.band, self.compared))
        return filtered[self.kept].reshape(-1, *shape)

    @cached_property
    def step_response(self) -> Array:
        """(2 k,) what `reduce` makes of a step from 0 to 1 at sample k, at the full rate, until it is all over."""
        band = min(self.band, self.compared)
        far = int(np.ceil(TUNING.dies_away * self.rate / band))
        return lowpass((np.arange(2 * far) >= far).astype(float), self.rate, band)

    @cached_property
    def response(self) -> Array:
        """(2 k + 1,) of the low-pass to an impulse, at the full rate."""
        impulse = np.zeros(2 * int(np.ceil(4.0 * self.rate / self.band)) + 1)
        impulse[len(impulse) // 2] = 1.0
        return lowpass(impulse, self.rate, self.band)

    @cached_property
    def residual(self) -> Array:
        """(D, n) logged less given torque [N·m]."""
        return self.reduce(self.torque - self.given)

    @cached_property
    def times(self) -> Array:
        """(D,) [s]."""
        return self.time[self.kept]

    @cached_property
    def motion(self) -> tuple[Array, Array, Array]:
        """Thinned q, v and a, each (D, n)."""
        return self.q[self.kept], self.v[self.kept], self.a[self.kept]


@dataclass(frozen=True)
class Records:
    """All fit logs of one arm, of the same band.

    Attributes:
        model: the given one.
        records: one per log.
    """

    model: Model
    records: tuple[Record, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.model.joints)

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Thinned samples per record."""
        return tuple(len(record.kept) for record in self.records)

    @property
    def rate(self) -> float:
        """Thinned samples per second."""
        record = self.records[0]
        return record.rate / float(record.kept[1] - record.kept[0])

    def white(self, order: int) -> Array:
        """Return (order + 1,) autocorrelation, after filter and thinning, of noise that was white in the log."""
        record = self.records[0]
        stride = int(record.kept[1] - record.kept[0])
        whole = np.correlate(record.response, record.response, "full")[len(record.response) - 1 :: stride]
        result = np.zeros(order + 1)
        result[: min(len(whole), order + 1)] = whole[: order + 1]
        return result / result[0]

    def reduce(self, law: Callable[[Record], Array]) -> Array:
        """Return a law's full-rate answers (N, …) for every record, thinned and put end to end (ΣD, …)."""
        return np.concatenate([record.reduce(law(record)) for record in self.records])

    def full(self, law: Callable[[Record], Array]) -> Array:
        """Return a law's full-rate answers put end to end."""
        return np.concatenate([law(record) for record in self.records])

    def angles(self, record: Record) -> Array:
        """Return (N, n) a record's positions behind the encoder offsets that the given model knows of [rad]."""
        return self.model.true_position(record.q)

    @cached_property
    def residual(self) -> Array:
        """(ΣD, n) logged less given torque [N·m]."""
        return np.concatenate([record.residual for record in self.records])

    @cached_property
    def torque(self) -> Array:
        """(ΣD, n) logged torque [N·m]."""
        return self.reduce(lambda record: record.torque)

    @cached_property
    def motion(self) -> tuple[Array, Array, Array]:
        """Thinned q, v and a end to end, each (ΣD, n)."""
        parts = [record.motion for record in self.records]
        q, v, a = (np.concatenate([part[k] for part in parts]) for k in range(3))
        return q, v, a

    @cached_property
    def times(self) -> Array:
        """(ΣD,) each on its own log's clock [s]."""
        return np.concatenate([record.times for record in self.records])

    @cached_property
    def above(self) -> Array:
        """(n,) see `noise_above`, of the log that has most [N·m]."""
        return np.max([np.broadcast_to(record.above, self.n) for record in self.records], axis=0)

    @cached_property
    def _known(self) -> dict[tuple[str, int], Array]:
        return {}

    def reduce_once(self, what: str, place: int, law: Callable[[Record], Array]) -> Array:
        """Return `reduce` of a law that depends on these records and a joint or body alone; searches ask for it again.

        Args:
            what: names the law.
            place: the joint or body.
            law: as of `reduce`.
        """
        if (what, place) not in self._known:
            self._known[what, place] = self.reduce(law)
            self._known[what, place].setflags(write=False)
        return self._known[what, place]

    @cached_property
    def owner(self) -> npt.NDArray[np.int64]:
        """(ΣD,) which record each sample is of."""
        return np.repeat(np.arange(len(self.records)), self.lengths)


def prepare(model: Model, logs: Sequence[Log]) -> Records:
    """Make logs ready.

    Args:
        model: the given one, with the logs' joints in the logs' order.
        logs: checked (`logs.check`).

    Raises:
        LogError: no log, one that is too short, or without torque.
    """
    expect(model, Model, "model", "a Model (as Model.load(PATH) returns it)")
    expect(logs, Sequence, "logs", "a list of Logs")
    for log in logs:
        expect(log, Log, "logs", "a list of Logs (as read_log returns each)")
    if not logs:
        raise LogError("no log to fit: give at least one")
    regular = [uniform(dejittered(log)) for log in logs]
    rate = min(1.0 / log.period for log in regular)
    band = min(TUNING.band, 0.2 * rate, *(trusted_band(model, log) for log in regular))
    kept = zip(regular, strides(regular, band), strict=True)
    return Records(model, tuple(_record(model, log, index, band, every) for index, (log, every) in enumerate(kept)))


def usable(log: Log, shortest: float = TUNING.shortest) -> float:
    """Return how long a log lasts [s].

    Args:
        log: checked.
        shortest: it must have this much left after its ends are cut [s].

    Raises:
        LogError: it is too short, or logs no torque at all, or one that never changes.
    """
    duration = float(log.time[-1] - log.time[0])
    if duration - 2.0 * DIFFERENTIATION.residual_cut < shortest:
        needed = shortest + 2.0 * DIFFERENTIATION.residual_cut
        raise LogError(f"{log.source}: lasts {duration:.3g} s; at least {needed:g} s are needed")
    if not np.any(log.motor_torque):
        raise LogError(f"{log.source}: all torques are zero throughout, so there is nothing to compare a model with")
    if not np.any(np.ptp(log.motor_torque, axis=0)):
        raise LogError(f"{log.source}: no torque ever changes, so there is nothing to compare a model with")
    return duration


def moves(log: Log) -> bool:
    """Return whether any joint of a log moves by more than its encoder's noise."""
    noise = roughness(log.position, log.period)
    return bool(np.any(np.ptp(log.position, axis=0) > np.maximum(TUNING.beyond_noise * noise, TUNING.least_motion)))


def round_stride(rate: float, stride: int) -> int:
    """Return a stride of thinning, lowered where no rate near `TUNING.laws` lies between a log's and the thinned one.

    A prime one would have laws worked out at the log's own rate.
    """
    most = TUNING.spare * TUNING.laws
    if any(stride % k == 0 and TUNING.laws <= rate / k <= most for k in range(1, stride + 1)) or rate <= most:
        return stride
    every = max(1, int(rate / TUNING.laws + 1e-6))
    return every * max(1, stride // every)


def strides(logs: Sequence[Log], band: float) -> list[int]:
    """Return every how many samples of each log are kept: one noise's colour holds at one rate, so rates are alike.

    Args:
        logs: of regular times.
        band: edge of the low-pass [Hz].

    Raises:
        LogError: one is too short, or without torque.
    """
    rates = [(len(log) - 1) / usable(log) for log in logs]
    own = [round_stride(rate, max(1, int(rate / (TUNING.thin * band) + 1e-6))) for rate in rates]
    fastest = max(rate / stride for rate, stride in zip(rates, own, strict=True))
    return [round_stride(rate, max(1, round(rate / fastest))) for rate in rates]


def slick(model: Model) -> Model:
    """Return a model without dry friction, its description's own included."""
    arm = replace(model.arm, stated=replace(model.arm.stated, friction={}))
    return Model(model.plant, arm, [effect for effect in model.effects if not effect.dry])


def _record(model: Model, log: Log, index: int, band: float, stride: int) -> Record:
    rate = (len(log) - 1) / float(log.time[-1] - log.time[0])
    smooth = motion(log, TUNING.motion * band)
    kept = np.flatnonzero(inner(log.time, DIFFERENTIATION.residual_cut))[::stride]
    mark = fingerprint(log)
    model = model.for_run(mark)
    # Torque that is logged and never arrives cannot be told from the motion.
    seen = smooth.log.motor_torque if any(effect.loses for effect in model.effects) else None
    q, v, a = smooth.position, smooth.velocity, smooth.acceleration
    given = model.inverse_dynamics(q, v, a, time=log.time, seen=seen)
    if any(effect.dry for effect in model.effects):
        passed = slick(model).inverse_dynamics(q, v, a, time=log.time, seen=seen)
    else:
        passed = given
    return Record(
        index=index,
        source=log.source,
        mark=mark,
        time=log.time,
        rate=rate,
        band=band,
        q=q,
        v=v,
        a=a,
        torque=smooth.log.motor_torque,
        given=given,
        passed=passed,
        shaken=shaken(model, smooth.log, band),
        kept=kept,
        period=log.period,
        above=noise_above(model, smooth.log, band),
    )
