"""A push from outside: its candidates, which act once they have a span of time, and its record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, Values, transformed
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.candidates.merging import Parameters, beside
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.whole_arm import mass_scale, reach
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.environment import ExternalForce
from twin_diagram.model.rigid_body.kinematic_tree import Kinematics
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    places: float = 2.0
    """Places on a link at which a force is looked for: its origin, and its centre of mass, at which simulators push."""

    near: float = 0.35
    """Share of the arm's length within which a force acts about its link's origin: as a payload's centre."""

    steps: int = 6
    """Of Gauss and Newton from that origin to the point where a force acts."""


TUNING = Tuning()


def external_forces(terms: Terms) -> list[Candidate]:
    """Return a constant wrench at each link's origin, world axes, force first.

    They act once they have a span of time.
    """
    result = []
    for body in range(terms.records.n):
        wrench = _wrench(terms, body, np.zeros(3))
        result += [_force(wrench, np.zeros(3)), wrench]
    return result


def forces_at_centres(terms: Terms) -> list[Candidate]:
    """Return a constant force at the centre of mass of each link that has one, world axes.

    Where a link turns while it is pushed, that is no constant wrench at its origin.
    """
    model = terms.records.model
    result = []
    for body in range(terms.records.n):
        mass, centre, _ = link_inertia(model, model.tree.link[body])
        if mass > 0.0 and np.any(centre):
            force = _force(_wrench(terms, body, centre), centre)
            result.append(replace(force, cost=float(np.log(TUNING.places))))
    return result


def turned(terms: Terms, body: int) -> Array:
    """Return (N, 3, 3) how a body's link is turned in the world at the samples that are left."""
    model = terms.records.model
    R_ML = model.bodies.body_of(model.tree.link[body])[1].rotation().matrix()
    motions = (Kinematics.of(model.tree, terms.records.angles(r)[r.kept].T) for r in terms.records.records)
    return np.concatenate([np.einsum("abn,bc->nac", motion.R[:, :, body], R_ML) for motion in motions])


def force_at(wrench: Candidate, R_WL: Array, point: Array) -> Candidate:
    """Return a constant force at a point of a link, world axes.

    Args:
        wrench: at the link's origin.
        R_WL: (N, 3, 3) see `turned`.
        point: (3,) in the link's frame [m].
    """
    arms = np.cross((R_WL @ point)[:, None], np.eye(3))
    columns = wrench.columns[..., :3] + np.einsum("njm,nkm->njk", wrench.columns[..., 3:], arms)
    return _force(replace(wrench, columns=np.concatenate([columns, columns], axis=2)), point)


def with_its_point(wrench: Candidate, R_WL: Array, point: Array, force: Array, far: float) -> Candidate:
    """Return a force at a point of a link, and how that point moves: six coefficients, for Gauss-Newton steps.

    Args:
        wrench: at the link's origin.
        R_WL: (N, 3, 3) see `turned`.
        point: (3,) in the link's frame [m].
        force: (3,) that acts there, world axes [N]: as the link turns, so does its lever.
        far: by which the point may move, one standard deviation [m].
    """
    moved = np.einsum("njm,nim->nji", wrench.columns[..., 3:], np.cross(R_WL.transpose(0, 2, 1), force))
    columns = np.concatenate([force_at(wrench, R_WL, point).columns, moved], axis=2)
    return replace(wrench, columns=columns, spread=np.concatenate([wrench.spread[:3], np.full(3, far)]))


def near(terms: Terms) -> float:
    """Return how far from its link's origin a force may act [m]."""
    return TUNING.near * reach(terms)


def placed(force: Candidate, errors: Array) -> Candidate:
    """Return a force whose point was found, too, with the errors (6,) that force and point have beside each other."""

    def parameters(c: Array, covariance: Array) -> Values:
        told = force.parameters(c, covariance)
        (wrench, std), (point, _) = told["wrench"], told["point"]
        wider = np.concatenate([np.maximum(std[:3], errors[:3]), std[3:]])
        return {**told, "wrench": (wrench, wider), "point": (point, errors[3:])}

    return replace(force, parameters=parameters)


def _wrench(terms: Terms, body: int, point: Array) -> Candidate:
    """Return a constant wrench at a point (3,) of a body's link, in the link's frame."""
    model = terms.records.model
    tree = model.tree
    weight = 9.81 * mass_scale(terms)
    # Where a joint is not at its link's origin, as in MJCF, the body's own frame is not the link's.
    p_MP = np.asarray(model.bodies.body_of(tree.link[body])[1].multiply(cast(Any, point))).ravel()

    def law(record: Record) -> Array:
        motion = Kinematics.of(tree, terms.records.angles(record).T)
        moved = motion.ancestors[body][:, None]
        place = (np.einsum("abn,b->an", motion.R[:, :, body], p_MP) + motion.p[:, body]).T
        columns = np.empty((*record.q.shape, 6))
        for k, axis in enumerate(np.eye(3)):
            arm = np.cross(place, axis)
            columns[..., k] = -(moved * (motion.linear[k] + np.einsum("na,ain->in", arm, motion.angular))).T
            columns[..., 3 + k] = -(moved * motion.angular[k]).T
        return columns

    at_origin = not np.any(point)
    records = terms.records
    return Candidate(
        name=ExternalForce.name,
        joints=(),
        links=(tree.link[body],),
        rows=tuple(range(records.n)),
        columns=records.reduce_once(ExternalForce.name, body, law) if at_origin else records.reduce(law),
        spread=np.concatenate([np.full(3, weight), np.full(3, 0.2 * weight * reach(terms))]),
        lower=np.full(6, -np.inf),
        upper=np.full(6, np.inf),
        parameters=transformed(lambda c: {"wrench": c, "point": point}),
    )


def _force(wrench: Candidate, point: Array) -> Candidate:
    """Return a wrench's force alone."""
    return replace(
        wrench,
        columns=wrench.columns[..., :3],
        spread=wrench.spread[:3],
        lower=wrench.lower[:3],
        upper=wrench.upper[:3],
        parameters=transformed(lambda c: {"wrench": np.concatenate([c, np.zeros(3)]), "point": point}),
    )


def fixed(parameters: Parameters) -> dict[str, Sequence[int]]:
    """Return what of a push is not refined: a force's moment where its point was found; else the point."""
    alone = np.any(parameters.get("point", [])) and not np.any(parameters["wrench"][3:])
    return {"wrench": range(3, 6)} if alone else {"point": range(3)}


def sentence(effect: Effect) -> str:
    """Return its wrench, and when it acts."""
    fx, fy, fz, mx, my, mz = effect.value("wrench")
    point = effect.value("point")
    where = f" at ({', '.join(f'{x:.4g}' for x in point)}) m" if np.any(point) else ""
    when = "" if effect.onset is None else f" from {effect.onset:.4g} s on"
    when += "" if effect.end is None else f" until {effect.end:.4g} s"
    turns = f" and turns it with ({mx:.4g}, {my:.4g}, {mz:.4g}) N·m" if any((mx, my, mz)) else ""
    return (
        f"something pushes {effect.links[0]}{where} with ({fx:.4g}, {fy:.4g}, {fz:.4g}) N{turns}, in world axes{when}"
    )


register(
    EffectRecord(
        effect=ExternalForce,
        title="A push from outside",
        explanation="Something pushed or pulled at a link for a while.",
        sentence=sentence,
        keys={"point": "where it is told of, in the link's frame"},
        once=True,
        merge=beside,
        per_joint=False,
        fixed=fixed,
        wakes=frozenset({Wakes.TIME}),
    )
)
