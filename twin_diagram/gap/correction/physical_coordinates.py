"""Coordinates in which effects are refined: any real vector is a physical effect.

A link's ten inertial parameters are physical where its pseudo-inertia is positive definite; the logarithms of its
Cholesky factor's diagonal and its other elements are free (Rucker and Wensing 2022, "Smooth parameterization of rigid
body inertia"). Angles of a curve, onsets and ends are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.correction.onset_times import ALWAYS, When
from twin_diagram.model.effects import REGISTRY
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    link_spread: float = 0.5
    """Prior standard deviation of a link's logarithmic coordinates, about the given link."""

    smallest: float = 1e-9
    """Of which a logarithm is taken, in the parameter's own unit: below it a value is 0."""

    about: float = 10.0
    """Prior deviation over the size of rough values."""

    least_spread: float = 0.1
    """Rough values count as at least this large for it."""

    logarithm_spread: float = 1.0
    """Prior deviation of a logarithm of which a rough value is known."""

    untold_spread: float = 1.5
    """Prior deviation of the logarithm of what no rough value is known of."""


TUNING = Tuning()


@dataclass(frozen=True)
class Coordinates:
    """One effect's.

    Attributes:
        spec: whose values are replaced.
        link: (10,) inertial parameters of the given link about its centre, for an effect that is refined as one.
        when: its onset and end, with their standard errors.
    """

    spec: EffectSpec
    link: tuple[float, Array, Array] | None = None
    when: When = ALWAYS

    @staticmethod
    def of(model: Model, spec: EffectSpec) -> Coordinates:
        """Return the coordinates of an effect that is added to a model."""
        if not record_of(spec.name).of_link:
            for key in sorted(record_of(spec.name).untold - set(spec.parameters)):
                default = REGISTRY[spec.name].kinds[key].default
                assert default is not None
                spec = replace(spec, parameters={**spec.parameters, key: [default] * len(spec.joints)})
            return Coordinates(spec, None, When(spec.onset, spec.end))
        return Coordinates(spec, link_inertia(model, spec.links[0]), When(spec.onset, spec.end))

    def started(self, spec: EffectSpec) -> Coordinates:
        """Return the same, started from other values."""
        own = self.spec
        timed = replace(spec, onset=own.onset, end=own.end, log=own.log, elsewhere=own.elsewhere)
        return replace(self, spec=timed)

    def at(self, when: When) -> Coordinates:
        """Return the same, with an onset and end of their own."""
        return replace(self, spec=replace(self.spec, onset=when.onset, end=when.end), when=when)

    def start(self) -> Array:
        """Return the coordinates of the specification itself."""
        if self.link is not None:
            mass, centre, inertia = self.link
            values = self.spec.parameters
            return log_cholesky(
                max(mass + values["mass"][0], 0.05 * mass),
                centre + values.get("com", np.zeros(3)),
                _physical(inertia + np.array(values.get("inertia", np.zeros(6))), inertia),
            )
        parts = []
        for key, (numbers, free) in zip(self.spec.parameters, self._free(), strict=True):
            chosen = np.array(numbers, dtype=float)[free]
            parts.append(np.log(np.maximum(chosen, TUNING.smallest)) if self.logarithmic(key) else chosen)
        return np.concatenate(parts)

    def prior(self) -> tuple[Array, Array]:
        """Return the mean and standard deviation of the coordinates.

        Wide, but what the data say nothing of stays what it was.
        """
        if self.link is not None:
            mean = log_cholesky(*self.link)
            scale = np.concatenate([np.ones(4), np.full(6, np.exp(np.mean(mean[:4])))])
            return mean, TUNING.link_spread * scale
        start = self.start()
        mean, spread = start.copy(), np.zeros(len(start))
        begin = 0
        for key, (_, free) in zip(self.spec.parameters, self._free(), strict=True):
            end = begin + int(np.sum(free))
            spread[begin:end] = TUNING.about * max(float(np.linalg.norm(start[begin:end])), TUNING.least_spread)
            if self.logarithmic(key):
                spread[begin:end] = TUNING.logarithm_spread
            if key in record_of(self.spec.name).untold:
                mean[begin:end] = np.log(REGISTRY[self.spec.name].kinds[key].default or 1.0)
                spread[begin:end] = TUNING.untold_spread
            begin = end
        return mean, spread

    def logarithmic(self, key: str) -> bool:
        """Return whether a parameter's coordinates are logarithms."""
        return key in record_of(self.spec.name).logarithmic

    def effect(self, vector: Array) -> EffectSpec:
        """Return the effect at other coordinates; bounds of the catalogue are kept where values are absolute."""
        if self.link is not None:
            mass, centre, inertia = self.link
            now = from_log_cholesky(vector)
            return replace(
                self.spec,
                parameters={
                    "mass": [now[0] - mass],
                    "com": (now[1] - centre).tolist(),
                    "inertia": (now[2] - inertia).tolist(),
                },
            )
        law = record_of(self.spec.name)
        parameters, begin = {}, 0
        for (key, values), (_, free) in zip(self.spec.parameters.items(), self._free(), strict=True):
            changed = np.array(values, dtype=float)
            count = int(np.sum(free))
            kind = REGISTRY[self.spec.name].kinds[key]
            chosen = vector[begin : begin + count]
            if self.logarithmic(key):
                chosen = np.exp(np.clip(chosen, -25.0, 25.0))
            if key not in law.adds:
                lower = kind.lower
                if key in law.held:
                    # A motor that gives next to nothing explains any torque that is logged: what was found must hold.
                    lower = max(lower, 0.5 * float(np.min(values)))
                chosen = np.clip(chosen, lower, kind.upper)
            changed[free] = chosen
            parameters[key] = changed.tolist()
            begin += count
        return replace(self.spec, parameters=parameters)

    def _free(self) -> list[tuple[list[float], Any]]:
        result, fixed = [], record_of(self.spec.name).fixed(self.spec.parameters)
        for key, values in self.spec.parameters.items():
            free = np.full(len(values), True)
            free[list(fixed.get(key, ()))] = False
            if key == "curve":
                free[: len(values) // 2] = False
            result.append((values, free))
        return result


def log_cholesky(mass: float, centre: Array, inertia: Array) -> Array:
    """Return (10,) of a body: mass, centre (3,), inertia about the centre (6,) xx, yy, zz, xy, xz, yz."""
    tensor = _tensor(inertia)
    second = 0.5 * np.trace(tensor) * np.eye(3) - tensor + mass * np.outer(centre, centre)
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3], pseudo[:3, 3], pseudo[3, :3], pseudo[3, 3] = second, mass * centre, mass * centre, mass
    values, vectors = np.linalg.eigh(pseudo)
    pseudo = (vectors * np.maximum(values, 1e-6 * values[-1])) @ vectors.T
    factor = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]  # upper triangular, so that mass is one coordinate
    return np.concatenate([np.log(np.diag(factor)), factor[np.triu_indices(4, 1)]])


def from_log_cholesky(vector: Array) -> tuple[float, Array, Array]:
    """Return the inverse of `log_cholesky`."""
    factor = np.diag(np.exp(np.clip(vector[:4], -20.0, 10.0)))
    factor[np.triu_indices(4, 1)] = vector[4:]
    pseudo = factor @ factor.T
    mass = float(pseudo[3, 3])
    centre = pseudo[:3, 3] / mass
    second = pseudo[:3, :3] - mass * np.outer(centre, centre)
    tensor = np.trace(second) * np.eye(3) - second
    return mass, centre, np.array([*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])


def _tensor(inertia: Array) -> Array:
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _physical(wanted: Array, present: Array) -> Array:
    """Return the wanted inertia, or as much of the way from the present one to it as is physical."""
    for share in np.linspace(1.0, 0.0, 21):
        inertia = share * wanted + (1.0 - share) * present
        moments = np.linalg.eigvalsh(_tensor(inertia))
        if moments[0] > 0.0 and moments[0] + moments[1] > moments[2] * (1.0 + 1e-6):
            return np.asarray(inertia)
    return present
