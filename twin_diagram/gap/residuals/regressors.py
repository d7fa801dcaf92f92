"""What candidates are made of: signals and rigid-body torques of the fit logs, computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin_diagram.gap.residuals.log_noise import TUNING as LOG_NOISE
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.friction_stribeck_load import LoadDependentFriction, StribeckFriction
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    sharp: float = 4.0
    """Where a torque jumps, it is smoothed at this many times the band."""

    jumps: float = 6.0
    """A torque jumps where smoothing ever takes away this many times more than it usually does."""

    rest: float = 0.016
    """Speed below which a joint may be sticking [rad/s]."""

    lever: float = 0.25
    """Metres that a prismatic joint slides where a revolute one would turn by a radian: gears and rims are so large."""

    load_band: float = 4.0
    """What arms carry changes more slowly than this [Hz]."""

    brief: float = 0.08
    """A joint that turns within this time sticks for a moment at most [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Present:
    """What the given model already has, which a change may take away again.

    Attributes:
        damping: (n,) [N·m·s/rad].
        coulomb: (n,) [N·m].
        rotor: (n,) [kg·m²].
        mass: kg of payload.
        stiffness: (n,) [N·m/rad].
        load: (n,) coefficient of load-dependent friction.
        names: effects that it has, per joint.
    """

    damping: Array
    coulomb: Array
    rotor: Array
    stiffness: Array
    load: Array
    mass: float
    names: frozenset[str]


@dataclass(frozen=True)
class Terms:
    """Everything that candidates are built from.

    Attributes:
        records: of the fit.
        load: per record (N, n), the torque that the joints transmit, free of the log's noise [N·m].
        slow: (n,) speed below which the sign of a velocity is not known [rad/s].
        moved: per record (N, n), `load` without dry friction, None: the given model's [N·m].
    """

    records: Records
    load: tuple[Array, ...]
    slow: Array
    moved: tuple[Array, ...] | None = None

    @cached_property
    def passed_on(self) -> tuple[Array, ...]:
        """Per record (N, n): what the gears pass on, the torque that friction may depend on [N·m]."""
        return self.moved or tuple(record.passed for record in self.records.records)

    @cached_property
    def signs(self) -> tuple[Array, ...]:
        """Return per record (N, n) the direction of motion, from smooth velocities, before any filter.

        A joint that turns sticks for a moment: the torque that holds it goes evenly from one side to the other.
        """
        return tuple(self._turned(record) for record in self.records.records)

    def resting(self, j: int) -> float:
        """Return the speed below which a joint may be sticking, as far as its velocity is known [rad/s]."""
        return max(TUNING.rest * float(levers(self.records)[j]), 2.0 * float(self.slow[j]))

    def _turned(self, record: Record) -> Array:
        signs = np.tanh(record.v / self.slow)
        for j in range(self.records.n):
            for first, last in turns(record, j, self.resting(j)):
                signs[first:last, j] = np.linspace(signs[first - 1, j], signs[last, j], last - first + 2)[1:-1]
        return signs

    @cached_property
    def reduced_signs(self) -> Array:
        """Direction of motion (ΣD, n), reduced."""
        return self.reduce(self.signs)

    @cached_property
    def smooth_torque(self) -> tuple[Array, ...]:
        """Per record (N, n): the logged torque, with little noise [N·m]."""
        return tuple(lowpass(r.torque, r.rate, 0.6 * r.band) for r in self.records.records)

    @cached_property
    def asked_torque(self) -> tuple[Array, ...]:
        """Return per record (N, n) what a motor was asked for, before any limit [N·m].

        A controller whose motor saturates may jump from limit to limit: what is smoothed first is clipped too little.
        Where smoothing takes away more than noise, less is smoothed.
        """
        pairs = zip(self.records.records, self.smooth_torque, strict=True)
        taken = np.concatenate([lowpass(r.torque, r.rate, r.band) - s for r, s in pairs])
        jumps = np.max(np.abs(taken), axis=0) > TUNING.jumps * spread_of(taken)
        if not np.any(jumps):
            return self.smooth_torque
        pairs = zip(self.records.records, self.smooth_torque, strict=True)
        return tuple(np.where(jumps, lowpass(r.torque, r.rate, TUNING.sharp * r.band), s) for r, s in pairs)

    @cached_property
    def torque_noise(self) -> Array:
        """(n,) of smoothed torque: what smoothing usually takes away [N·m]."""
        pairs = zip(self.records.records, self.smooth_torque, strict=True)
        return spread_of(np.concatenate([lowpass(r.torque, r.rate, r.band) - s for r, s in pairs]))

    @cached_property
    def dry_level(self) -> Array:
        """(n,) of dry friction that is known so far [N·m]."""
        pairs = zip(self.load, self.passed_on, strict=True)
        return np.asarray(np.median(np.abs(np.concatenate([load - passed for load, passed in pairs])), axis=0))

    @cached_property
    def unneeded(self) -> Array:
        """(ΣD, n) what was asked for beyond the transmitted torque, reduced [N·m]."""
        return self.reduce(tuple(s - load for load, s in zip(self.load, self.asked_torque, strict=True)))

    def unexplained(self, j: int, limit: float = np.inf) -> float:
        """Return what is usually left of a joint's smoothed torque, clipped, beside the transmitted one [N·m]."""
        parts = zip(self.load, self.asked_torque, strict=True)
        left = self.reduce(tuple(np.clip(s[:, j : j + 1], -limit, limit) - load[:, j : j + 1] for load, s in parts))
        return float(spread_of(left)[0])

    def reduce(self, parts: tuple[Array, ...]) -> Array:
        """Return full-rate arrays, one per record, thinned and put end to end."""
        return np.concatenate([record.reduce(part) for record, part in zip(self.records.records, parts, strict=True)])

    @cached_property
    def torque_size(self) -> Array:
        """(n,) root mean square of the logged torque, or of the model's where the log has none [N·m]."""
        logged, given = (
            np.sqrt(np.mean(x**2, axis=0))
            for x in (self.records.torque, self.reduce(tuple(r.given for r in self.records.records)))
        )
        return np.where(logged > 0.0, logged, np.maximum(given, 1e-6))

    @cached_property
    def present(self) -> Present:
        """Return what the given model has already."""
        return present(self.records)

    def rigid(self, body: int) -> Array:
        """Return (ΣD, n, 10) torque per inertial parameter of a body, in its moving frame."""
        tree = self.records.model.tree
        return self.records.reduce_once("rigid", body, lambda r: tree.regressor(self.records.angles(r), r.v, r.a, body))


def spread_of(samples: Array) -> Array:
    """Return the standard deviation of samples (N, …) along their first axis, had they no outliers."""
    return np.asarray(1.4826 * np.median(np.abs(samples - np.median(samples, axis=0)), axis=0))


def turns(record: Record, j: int, slow: float) -> list[tuple[int, int]]:
    """Return the spans of samples in which a joint turns and may be sticking, for `TUNING.brief` at most."""
    rests = stretches(np.abs(record.v[:, j]) < slow)
    inside = [(a, b) for a, b in rests if 0 < a and b < len(record.v)]
    brief = [(a, b) for a, b in inside if b - a <= TUNING.brief * record.rate]
    return [(int(a), int(b)) for a, b in brief if record.v[a - 1, j] * record.v[b, j] < 0.0]


def slow_speed(records: Records) -> Array:
    """Return (n,) twice the noise of smoothed velocities, at least 1 mrad/s, or 0.25 mm/s [rad/s]."""
    result = np.zeros(records.n)
    for record in records.records:
        noise = np.std(record.v - lowpass(record.v, record.rate, 2.0 * record.band), axis=0)
        result = np.maximum(result, 2.0 * noise)
    return np.clip(result, 1e-3 * levers(records), 1e-2 * levers(records))


def levers(records: Records) -> Array:
    """Return (n,) what of a joint's unit is as much as a radian: of a prismatic joint, `TUNING.lever` metres."""
    model = records.model
    return np.array([TUNING.lever if joint in model.prismatic else 1.0 for joint in model.joints])


def present(records: Records) -> Present:
    """Read off the given model what it has; what ended in another run is over."""
    model = records.model
    n = records.n
    coulomb, stiffness, load = np.zeros(n), np.array(model.tree.stiffness, dtype=float), np.zeros(n)
    mass = 0.0
    for effect in model.present:
        columns = [model.joints.index(joint) for joint in effect.joints]
        values = {key: parameter.value for key, parameter in effect.parameters.items()}
        if isinstance(effect, CoulombFriction):
            levels = values.get("torque")
            if levels is None:
                levels = np.minimum(values["torque_positive"], values["torque_negative"])
            coulomb[columns] += levels
        elif isinstance(effect, StribeckFriction):
            coulomb[columns] += values["coulomb"]
        elif isinstance(effect, LoadDependentFriction):
            load[columns] += values["coefficient"]
        elif isinstance(effect, JointSpring) and "stiffness" in values:
            stiffness[columns] += values["stiffness"]
        elif isinstance(effect, Payload):
            mass += float(values["mass"][0])
    return Present(
        damping=np.array(model.tree.damping, dtype=float),
        coulomb=coulomb,
        rotor=np.array(model.tree.rotor, dtype=float),
        stiffness=stiffness,
        load=load,
        mass=mass,
        names=frozenset(effect.name for effect in model.present),
    )


def given_load(records: Records) -> tuple[Array, ...]:
    """Return the given model's torques, as a first guess of the transmitted ones, free of position noise.

    Coarse encoders at slow rates shake accelerations by more than torques tell. The residual holds the same noise, so
    that it would seem to follow the load.
    """
    return tuple(_unshaken(record) for record in records.records)


def _unshaken(record: Record) -> Array:
    """Return (N, n) a record's given torque below the frequency to which its noise stays well below the torque's."""
    shaken = np.flatnonzero(record.shaken > LOG_NOISE.noise_share)
    result = record.given.copy() if len(shaken) else record.given
    for j in shaken:
        trusted = record.band * float(np.sqrt(LOG_NOISE.noise_share / record.shaken[j]))
        result[:, j] = lowpass(record.given[:, j], record.rate, max(TUNING.load_band, trusted))
    return result


def rate_of(signal: Array, record: Record) -> Array:
    """Return the time derivative of a full-rate signal (N, …)."""
    return np.gradient(signal, 1.0 / record.rate, axis=0)


def with_load(terms: Terms, load: tuple[Array, ...], moved: tuple[Array, ...]) -> Terms:
    """Return the same with another transmitted torque."""
    return replace(terms, load=load, moved=moved)
