"""A push from outside: its candidates, which act once they have a span of time, and its record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.merging import beside
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.whole_arm import mass_scale, reach
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.environment import ExternalForce
from twin_diagram.model.rigid_body.kinematic_tree import Kinematics
from twin_diagram.signals.arrays import Array


def external_forces(terms: Terms) -> list[Candidate]:
    """Return a constant wrench at each link's origin, world axes, force first.

    They act once they have a span of time.
    """
    model = terms.records.model
    tree = model.tree
    weight = 9.81 * mass_scale(terms)
    spread = np.concatenate([np.full(3, weight), np.full(3, 0.2 * weight * reach(terms))])
    result = []
    for body in range(terms.records.n):
        # Where a joint is not at its link's origin, as in MJCF, the body's own frame is not the link's.
        origin = np.asarray(model.bodies.body_of(tree.link[body])[1].translation())

        def law(record: Record, body: int = body, origin: Array = origin) -> Array:
            motion = Kinematics.of(tree, record.q.T)
            moved = motion.ancestors[body][:, None]
            place = (np.einsum("abn,b->an", motion.R[:, :, body], origin) + motion.p[:, body]).T
            columns = np.empty((*record.q.shape, 6))
            for k, axis in enumerate(np.eye(3)):
                arm = np.cross(place, axis)
                columns[..., k] = -(moved * (motion.linear[k] + np.einsum("na,ain->in", arm, motion.angular))).T
                columns[..., 3 + k] = -(moved * motion.angular[k]).T
            return columns

        wrench = Candidate(
            name=ExternalForce.name,
            joints=(),
            links=(tree.link[body],),
            rows=tuple(range(terms.records.n)),
            columns=terms.records.reduce(law),
            spread=spread,
            lower=np.full(6, -np.inf),
            upper=np.full(6, np.inf),
            parameters=transformed(lambda c: {"wrench": c, "point": np.zeros(3)}),
        )
        force = replace(
            wrench,
            columns=wrench.columns[..., :3],
            spread=spread[:3],
            lower=wrench.lower[:3],
            upper=wrench.upper[:3],
            parameters=transformed(lambda c: {"wrench": np.concatenate([c, np.zeros(3)]), "point": np.zeros(3)}),
        )
        result += [force, wrench]
    return result


def sentence(effect: Effect) -> str:
    """Return its wrench, and when it acts."""
    fx, fy, fz, mx, my, mz = effect.value("wrench")
    point = effect.value("point")
    where = f" at ({', '.join(f'{x:.4g}' for x in point)}) m" if np.any(point) else ""
    when = "" if effect.onset is None else f" from {effect.onset:.4g} s on"
    when += "" if effect.end is None else f" until {effect.end:.4g} s"
    return (
        f"something pushes {effect.links[0]}{where} with ({fx:.4g}, {fy:.4g}, {fz:.4g}) N and turns it with "
        f"({mx:.4g}, {my:.4g}, {mz:.4g}) N·m, in world axes{when}"
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
        fixed=frozenset({"point"}),
        wakes=frozenset({Wakes.TIME}),
    )
)
