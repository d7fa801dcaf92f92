"""Candidates made of effects that a user registered: where the law is linear in its parameters, nothing else is needed.

    @register
    class QuadraticDrag(Effect):
        name = "quadratic_drag"
        kinds = {"drag": ParameterKind("N·m·s²/rad²", lower=0.0)}

        def torque(self, model, q, v, a, tau):
            return self.spread(model.joints, self.value("drag")) * v * abs(v)

is then looked for on every joint, beside the catalogue. Effects with a value per joint, one number each, count; a law
that is not linear in its parameters takes part in models, but is not searched for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.records import RECORDS
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import REGISTRY, Effect
from twin_diagram.model.effects.parameter_vector import with_values
from twin_diagram.model.effects.serialisation import effect_of
from twin_diagram.model.effects.users_modules import load_installed
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array

COME_ALONG = "twin_diagram.model.effects."
"""Effects of these modules have candidates of their own."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    samples: int = 200
    """On which a law is tried."""


TUNING = Tuning()


def own_candidates(terms: Terms) -> list[Candidate]:
    """Return those of every registered effect that does not come along with this package, on every joint."""
    made = []
    load_installed()
    for cls in REGISTRY.values():
        if cls.__module__.startswith(COME_ALONG) or not cls.per_joint or not _plain(cls):
            continue
        if cls.name in RECORDS and RECORDS[cls.name].effect is cls:  # its record makes them
            continue
        for j in range(terms.records.n):
            candidate = _candidate(terms, cls, j)
            if candidate is not None:
                made.append(candidate)
    return made


def _plain(cls: type[Effect]) -> bool:
    return bool(cls.kinds) and all(kind.size == 1 for kind in cls.kinds.values())


def _candidate(terms: Terms, cls: type[Effect], j: int) -> Candidate | None:
    records, keys = terms.records, list(cls.kinds)
    units = np.eye(len(keys))
    if not _linear(terms, cls, j):
        return None
    parts = [
        np.stack([_torque(terms, cls, j, record, load, unit) for unit in units], axis=-1)
        for record, load in zip(records.records, terms.load, strict=True)
    ]
    columns = terms.reduce(tuple(parts))
    size = np.sqrt(np.mean(columns**2, axis=0))
    rows = tuple(int(row) for row in np.flatnonzero(np.any(size > 1e-12, axis=1)))
    if not rows or not np.all(np.any(size > 1e-12, axis=0)):
        return None
    return Candidate(
        name=cls.name,
        joints=(j,),
        links=(),
        rows=rows,
        columns=columns[:, rows, :],
        spread=terms.torque_size[j] / np.max(size, axis=0),
        lower=np.array([kind.lower for kind in cls.kinds.values()]),
        upper=np.array([kind.upper for kind in cls.kinds.values()]),
        parameters=linear(*keys),
    )


def _torque(terms: Terms, cls: type[Effect], j: int, record: Record, load: Array, values: Array) -> Array:
    """Return (N, n) of an effect with such values; bounds do not matter here."""
    model = terms.records.model
    inside = [min(max(1.0, kind.lower), kind.upper) for kind in cls.kinds.values()]
    parameters = {key: [value] for key, value in zip(cls.kinds, inside, strict=True)}
    effect = effect_of(cls, EffectSpec(cls.name, [model.joints[j]], [], parameters))
    effect = with_values(effect, {key: [value] for key, value in zip(cls.kinds, values, strict=True)}, check=False)
    return effect.torque(model.bodies, model.true_position(record.q), record.v, record.a, load)


def _linear(terms: Terms, cls: type[Effect], j: int) -> bool:
    """Return whether torques add up and scale with the parameters, on some samples."""
    record, load = terms.records.records[0], terms.load[0]
    chosen = np.linspace(0, len(record.time) - 1, min(TUNING.samples, len(record.time))).astype(int)
    some = _Some(record.q[chosen], record.v[chosen], record.a[chosen])
    count = len(cls.kinds)
    mixture = 0.3 + 0.4 * np.arange(1, count + 1)
    parts = [_torque(terms, cls, j, some, load[chosen], unit) for unit in np.eye(count)]  # type: ignore[arg-type]
    whole = _torque(terms, cls, j, some, load[chosen], mixture)  # type: ignore[arg-type]
    summed = sum(weight * part for weight, part in zip(mixture, parts, strict=True))
    return bool(np.all(np.isfinite(whole)) and np.allclose(whole, summed, rtol=1e-9, atol=1e-12))


class _Some:
    """A few samples of a record's motion."""

    def __init__(self, q: Array, v: Array, a: Array) -> None:
        self.q, self.v, self.a = q, v, a
