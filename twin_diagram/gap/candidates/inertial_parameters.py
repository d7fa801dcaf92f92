"""A link of other mass than described: its candidates and its record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, Values, transformed
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.whole_arm import in_link_frame, last_body, link_spread, mass_scale, reach
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.link_inertia import InertialParameters, about_centre, about_origin
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    heaviest: float = 3.0
    """Times its described mass, and a load that such an arm may carry, that a link weighs at most."""

    ten: float = 5.0
    """Price of a link's ten numbers: of so many combinations some always suits the noise [nats]; by clean logs."""


TUNING = Tuning()


def on_arm(terms: Terms) -> list[Candidate]:
    """Return ten differences per link; at the last one only what is no payload."""
    model = terms.records.model
    far = 0.35 * reach(terms)
    result = []
    for body in range(terms.records.n):
        full = in_link_frame(terms, body)
        present = np.array(model.tree.inertia[body], dtype=float)

        def admits(c: Array, present: Array = present) -> bool:
            now = present + c
            heaviest = TUNING.heaviest * present[0] + mass_scale(terms)
            return bool(0.0 < now[0] < heaviest and np.linalg.norm(now[1:4]) <= far * now[0])

        if np.sqrt(np.mean(full**2)) < 1e-9 or turns_only(full):
            continue
        last = body == last_body(terms)
        result.append(
            Candidate(
                name=InertialParameters.name,
                joints=(),
                links=(model.tree.link[body],),
                rows=tuple(range(terms.records.n)),
                columns=full,
                spread=link_spread(terms, body),
                lower=np.full(10, -np.inf),
                upper=np.concatenate([[0.0 if last else np.inf], np.full(9, np.inf)]),
                parameters=inertia_values(*link_inertia(model, model.tree.link[body])),
                admits=admits,
                cost=TUNING.ten,
                # What hangs on the last link changes the torques of most motions as if it hung on the one before.
                excludes=frozenset({Payload.name}) if body == last_body(terms) - 1 else frozenset(),
            )
        )
    return result


def turns_only(full: Array) -> bool:
    """Return whether a body shows one number only.

    Then it turns about one axis, like a rotor, which is the better name.
    """
    columns = full.reshape(-1, full.shape[2])
    return int(np.linalg.matrix_rank(columns.T @ columns, tol=1e-9 * float(np.sum(columns**2)), hermitian=True)) < 2


def inertia_values(mass: float, centre: Array, inertia: Array) -> Callable[[Array, Array], Values]:
    """Return the effect's differences, about the link's centre, from those about its origin."""
    present = about_origin(mass, centre, inertia)

    def values(c: Array) -> dict[str, Array]:
        if present[0] + c[0] <= 0.0:
            return {"mass": c[0:1], "com": np.zeros(3), "inertia": c[4:10]}
        _, after, turning = about_centre(present + c)
        return {"mass": c[0:1], "com": after - centre, "inertia": turning - inertia}

    return transformed(values)


def sentence(effect: Effect) -> str:
    """Return what its link has more of."""
    x, y, z = effect.value("com")
    return (
        f"{effect.links[0]} has {effect.value('mass')[0]:+.4g} kg, its centre is shifted by ({x:.4g}, {y:.4g}, {z:.4g})"
        f" m and its inertia about it differs by {np.array2string(effect.value('inertia'), precision=4)} kg·m²"
    )


register(
    EffectRecord(
        effect=InertialParameters,
        title="A link of other mass",
        explanation="A link is heavier, lighter or balanced elsewhere than described.",
        sentence=sentence,
        keys={"com": "centre of mass"},
        on_arm=on_arm,
        once=True,
        rivals_on_link=frozenset({Payload.name}),
        wider_than=frozenset({Payload.name}),
        merge=summed,
        per_joint=False,
        of_link=True,
        wakes=frozenset({Wakes.POSE, Wakes.ACCELERATION}),
    )
)
