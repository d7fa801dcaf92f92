"""Torque that depends on a joint's angle alone: its candidates and its record."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.joint_candidate import below_zero, single, those_there
from twin_diagram.gap.candidates.merging import TUNING as MERGING
from twin_diagram.gap.candidates.merging import Parameters
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import effort
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms, levers
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.actuation import TorqueBias
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    curve_pieces: tuple[int, ...] = (3, 6, 10)
    """Pieces of the cubic splines that stand for a torque as a function of the angle."""

    least_piece: float = 0.045
    """What a piece must span at least [rad]: dry friction builds up over up to 15 mrad, and is whole after three times
    that. A curve whose pieces are shorter follows what friction does about the joint's turns."""


TUNING = Tuning()


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return a straight spring and a few curves for each joint."""
    q = terms.records.reduce(terms.records.angles)
    return [those_there([_straight(terms, j, q[:, j]), *_curves(terms, j)]) for j in range(terms.records.n)]


def _straight(terms: Terms, j: int, angle: Array) -> Candidate | None:
    middle = float(np.mean(angle))

    def values(c: Array) -> dict[str, Array]:
        return {"stiffness": c[0:1], "rest_angle": middle - c[1:2] / c[0]}

    least = below_zero(terms.present.stiffness[j])
    columns = [angle - middle, np.ones_like(angle)]
    return single(terms, JointSpring.name, j, columns, transformed(values), [least, -np.inf], shape={"middle": middle})


def _curves(terms: Terms, j: int) -> Iterator[Candidate | None]:
    """Return splines of the angle, over the range that the joint has gone through."""
    everything = np.concatenate([terms.records.angles(r)[:, j] for r in terms.records.records])
    low, high = float(everything.min()), float(everything.max())
    least = TUNING.least_piece * float(levers(terms.records)[j])
    for pieces in TUNING.curve_pieces:
        if high - low < pieces * least:
            return
        inner = np.linspace(low, high, pieces + 1)
        knots = np.concatenate([[low] * 3, inner, [high] * 3])
        count = len(knots) - 4

        def basis(q: Array, knots: Array = knots) -> Array:
            return scipy.interpolate.BSpline.design_matrix(np.clip(q, low, high), knots, 3).toarray()

        def law(record: Record, basis: Callable[[Array], Array] = basis) -> Array:
            return basis(terms.records.angles(record)[:, j])

        columns = terms.records.reduce_once(f"{JointSpring.name} of {pieces} pieces", j, law)
        size = np.sqrt(np.mean(columns**2, axis=0))
        if np.any(size < 1e-4):
            continue
        angles: Array = np.linspace(low, high, 2 * pieces + 1, dtype=np.float64)
        at = basis(angles)

        def values(c: Array, angles: Array = angles, at: Array = at) -> dict[str, Array]:
            return {"curve": np.concatenate([angles, at @ c])}

        yield single(
            terms,
            JointSpring.name,
            j,
            list(columns.T),
            transformed(values),
            [-np.inf] * count,
            shape={"pieces": float(pieces)},
            variant="curve",
            cost=1.0,
        )


def merge(here: Parameters, more: Parameters) -> Parameters | None:
    """Return the spring that two straight ones are; None for curves."""
    if "curve" in here:
        return None
    k = here["stiffness"][0] + more["stiffness"][0]
    moment = here["stiffness"][0] * here["rest_angle"][0] + more["stiffness"][0] * more["rest_angle"][0]
    return {"stiffness": [k], "rest_angle": [moment / k if abs(k) > MERGING.nothing else 0.0]}


def sentence(effect: Effect) -> str:
    """Return its stiffness and rest on each joint, or what its curve spans."""
    if "curve" in effect.parameters:
        angles, torques = np.split(effect.value("curve"), 2)
        along, unit = effect.unit("curve", effect.joints[0]).split(", ")
        return (
            f"a spring on {effect.joints[0]} whose {effort(effect)} follows a curve of the "
            f"{'position' if effect.prismatic else 'angle'}, {torques.min():.4g} to {torques.max():.4g} {unit} "
            f"between {angles[0]:.4g} and {angles[-1]:.4g} {along}"
        )
    parts = (
        f"{k:.4g} {effect.unit('stiffness', joint)} on {joint}, at rest at {rest:.4g} "
        f"{effect.unit('rest_angle', joint)}"
        for joint, k, rest in zip(effect.joints, effect.value("stiffness"), effect.value("rest_angle"), strict=True)
    )
    return f"a spring of {'; '.join(parts)}"


register(
    EffectRecord(
        effect=JointSpring,
        title="A spring or counterbalance",
        explanation="A torque that depends on the joint's angle alone: a spring, a balancer, a stiff hose.",
        sentence=sentence,
        on_joints=on_joints,
        rivals=frozenset({TorqueBias.name}),
        merge=merge,
        joint_by_joint=True,
        leading=("stiffness",),
        starts=True,
        adds=frozenset({"stiffness"}),
        wakes=frozenset({Wakes.POSE}),
    )
)
