"""Candidates of gears that yield, worked out for the measured motion: springs that swing, play that knocks.

Neither is linear in anything but the rotor's inertia: a spring's stiffness says at which frequency the link swings, a
gap when it knocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.residuals.log_noise import TUNING as LOG_NOISE
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.dynamics.elastic_gears import Untwisted
from twin_diagram.model.effects import REGISTRY, Effect, make
from twin_diagram.model.effects.elasticity import YieldingGear
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    about_one: tuple[float, ...] = (0.6, 1.5)
    """A shape's torque fits the residual as it stands, or the shape is wrong."""

    edge: float = 1.25
    """Whitened, noise counts evenly up to so many times the band."""


TUNING = Tuning()


@dataclass(frozen=True)
class GearShape:
    """Of a gear: what it is called, and the numbers on which its torque depends otherwise than linearly."""

    name: str
    joint: int
    values: tuple[tuple[str, float], ...]


def gear(
    terms: Terms, shape: GearShape, bare: Mapping[int, Untwisted] | None = None, *, roughly: bool = False
) -> Candidate | None:
    """Return the candidate of one shape: its torque, whose coefficient is about 1, and the rotor's inertia.

    None where the shape is not within what the effect allows, or its torque not finite.

    Args:
        terms: of the logs.
        shape: of the gear.
        bare: by the `id` of each record, where other shapes are tried on the same logs.
        roughly: a spring is worked out by one pass alone.
    """
    kinds = REGISTRY[shape.name].kinds
    if not all(kinds[key].lower <= value <= kinds[key].upper for key, value in shape.values):
        return None
    records = terms.records
    j = shape.joint
    given = records.model
    model = given.with_effects([*(e for e in given.present if not isinstance(e, YieldingGear)), _effect(given, shape)])
    rate = records.reduce_once("acceleration", 0, lambda r: r.a)[:, j]

    def law(record: Record) -> Array:
        beyond, known = record.torque - record.given, bare[id(record)] if bare is not None else Untwisted()
        known = known.rough() if roughly else known
        motion = records.angles(record), record.v, record.a
        return model.law.twist(motion, 1.0 / record.rate, beyond, known).torque

    with np.errstate(all="ignore"):
        torque = records.reduce(law)
    if not np.all(np.isfinite(torque)):
        return None
    columns = np.zeros((*torque.shape, 2))
    columns[..., 0] = torque
    columns[:, j, 1] = rate
    size = max(float(np.sqrt(np.mean(rate**2))), 1e-9)
    values = dict(shape.values)

    def parameters(c: Array) -> dict[str, Array]:
        told = {key: np.array([value]) for key, value in values.items() if key != "loss"}
        return {**told, "rotor_inertia": np.maximum(c[1:2], 0.0)}

    return Candidate(
        name=shape.name,
        joints=(j,),
        links=(),
        rows=tuple(range(records.n)),
        columns=columns,
        spread=np.array([1.0, terms.torque_size[j] / size]),
        lower=np.array([TUNING.about_one[0], -1.05 * terms.present.rotor[j] - 1e-9]),
        upper=np.array([TUNING.about_one[1], np.inf]),
        parameters=transformed(parameters),
        shape=values,
        cost=record_of(shape.name).shape_cost + rattled(terms, j),
        variant="swinging",
    )


def rattled(terms: Terms, j: int) -> float:
    """Return evidence that a gear may find in an encoder's noise alone [nats].

    The given model answers the noise of positions with inertial torque, which a gear that yields takes back. The band
    keeps that small beside the torque's noise; where it does not, because most of the log says nothing of it (a joint
    rests), the share x/(1 + x) of the noise's power goes to any gear, x growing with the frequency's fourth power.
    """
    u = np.linspace(0.0, TUNING.edge, 40)
    lost = 0.0
    for record in terms.records.records:
        x = max(0.0, record.shaken[j] ** 2 - LOG_NOISE.noise_share**2) * u**4
        lost += 0.5 * len(record.kept) * float(np.mean(x / (1.0 + x)))
    return lost


def _effect(model: Model, shape: GearShape) -> Effect:
    parameters = {**{key: [value] for key, value in shape.values}, "rotor_inertia": [0.0]}
    return make(EffectSpec(name=shape.name, joints=[model.joints[shape.joint]], parameters=parameters))


def swinging(*searched: tuple[str, float, float]) -> Callable[[Terms, Candidate], list[tuple[str, float, float]]]:
    """Return what is searched about the shapes of a gear that swings; one that follows its load has none."""

    def shapes(terms: Terms, candidate: Candidate) -> list[tuple[str, float, float]]:
        del terms
        return list(searched) if candidate.variant == "swinging" else []

    return shapes


def rebuilt(terms: Terms, candidate: Candidate, key: str, value: float) -> Candidate | None:
    """Return the candidate of another shape."""
    shape = {**candidate.shape, key: value}
    return gear(terms, GearShape(candidate.name, candidate.joints[0], tuple(shape.items())))
