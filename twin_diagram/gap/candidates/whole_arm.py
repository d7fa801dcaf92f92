"""Candidates that change the torque of several joints at once: bodies, base, encoders, gears, time, forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RollPitchYaw

from twin_diagram.gap.candidates.candidate import Candidate, Values, linear, transformed
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms, rate_of
from twin_diagram.model.effects.link_inertia import about_centre, about_origin
from twin_diagram.model.rigid_body import rigid_tree
from twin_diagram.model.rigid_body.kinematic_tree import Kinematics
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    held: float = 2.5e-4

    within: float = 0.1
    """How far apart torque and position are usually stamped: a held command [s], and this share of a log's sample."""

    longest_delay: float = 0.05
    """Delay that is thought possible [s]."""

    ten: float = 5.0
    """Price of a link's ten numbers: of so many combinations some always suits the noise [nats]; by clean logs."""


TUNING = Tuning()


def arm_candidates(terms: Terms) -> list[Candidate]:
    """Return all of them."""
    made: list[Candidate | None] = [
        payload(terms),
        bulky_payload(terms),
        tilt(terms),
        delay(terms, TUNING.longest_delay),
    ]
    made += inertial_parameters(terms)
    made += encoder_offsets(terms)
    made += elasticities(terms)
    return [candidate for candidate in made if candidate is not None]


def reach(terms: Terms) -> float:
    """Return the length of the arm [m]."""
    return float(np.sum(np.linalg.norm(terms.records.model.tree.p_PF, axis=1))) + 0.1


def mass_scale(terms: Terms) -> float:
    """Return what a mass that is missing may weigh [kg]."""
    return 0.3 * float(np.max(terms.records.model.tree.inertia[:, 0])) + 0.5


def inertia_spread(terms: Terms) -> Array:
    """Return (10,) prior of inertial parameters."""
    m, length = mass_scale(terms), reach(terms)
    return np.concatenate([[m], np.full(3, 0.1 * m * length), np.full(6, m * (0.12 * length) ** 2)])


def link_spread(terms: Terms, body: int) -> Array:
    """Return (10,) prior of what is wrong with one link's inertia: of the order of that inertia."""
    own = np.array(terms.records.model.tree.inertia[body], dtype=float)
    mass = 0.5 * own[0] + 0.02 * mass_scale(terms)
    size = float(np.sqrt(max(float(np.sum(own[4:7])), 0.0) / max(own[0], 1e-9)))
    length = max(size, 0.05 * reach(terms))
    return np.concatenate([[mass], np.full(3, mass * length), np.full(6, mass * length**2)])


def in_link_frame(terms: Terms, body: int) -> Array:
    """Return (ΣD, n, 10) torque per inertial parameter in the frame of the body's own link."""
    model = terms.records.model
    _, X_ML = model.bodies.body_of(model.tree.link[body])
    return terms.rigid_all[body] @ rigid_tree.transform_inertia(X_ML)


def last_body(terms: Terms) -> int:
    """Return which body carries the last link."""
    return int(terms.records.model.bodies.body_of(terms.records.model.last_link)[0])


def payload(terms: Terms, centre: Array | None = None) -> Candidate:
    """Return a mass at the last link: coefficients m and m·c; `centre` sets the inertia that a unit mass brings."""
    body = last_body(terms)
    full = in_link_frame(terms, body)
    columns = full[..., :4].copy()
    if centre is not None:
        tensor = centre @ centre * np.eye(3) - np.outer(centre, centre)
        unit = np.array([*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])
        columns[..., 0] += full[..., 4:] @ unit
    spread = inertia_spread(terms)[:4]
    far = 0.35 * reach(terms)

    def admits(c: Array) -> bool:
        return bool(np.linalg.norm(c[1:]) <= far * abs(c[0]))

    def values(c: Array) -> dict[str, Array]:
        return {"mass": c[0:1], "com": c[1:4] / c[0]}

    least = -1.05 * terms.present.mass
    return Candidate(
        name="payload",
        joints=(),
        links=(terms.records.model.last_link,),
        rows=tuple(range(terms.records.n)),
        columns=columns,
        spread=spread,
        lower=np.array([least, -np.inf, -np.inf, -np.inf]),
        upper=np.full(4, np.inf),
        parameters=transformed(values),
        admits=admits,
    )


def bulky_payload(terms: Terms) -> Candidate:
    """Return a payload that is no point: its inertia is free, and not reported."""
    point = payload(terms)
    columns = in_link_frame(terms, last_body(terms))
    return replace(
        point,
        columns=columns,
        spread=inertia_spread(terms),
        lower=np.concatenate([point.lower, np.full(6, -np.inf)]),
        upper=np.full(10, np.inf),
        admits=lambda c: bool(np.linalg.norm(c[1:4]) <= 0.35 * reach(terms) * abs(c[0])),
        variant="bulky",
    )


def inertial_parameters(terms: Terms) -> list[Candidate]:
    """Return ten differences per link; at the last one only what is no payload."""
    model = terms.records.model
    far = 0.35 * reach(terms)
    result = []
    for body in range(terms.records.n):
        full = in_link_frame(terms, body)
        present = np.array(model.tree.inertia[body], dtype=float)

        def admits(c: Array, present: Array = present) -> bool:
            now = present + c
            return bool(now[0] > 0.0 and np.linalg.norm(now[1:4]) <= far * now[0])

        if np.sqrt(np.mean(full**2)) < 1e-9 or turns_only(full):
            continue
        last = body == last_body(terms)
        result.append(
            Candidate(
                name="inertial_parameters",
                joints=(),
                links=(model.tree.link[body],),
                rows=tuple(range(terms.records.n)),
                columns=full,
                spread=link_spread(terms, body),
                lower=np.full(10, -np.inf),
                upper=np.concatenate([[0.0 if last else np.inf], np.full(9, np.inf)]),
                parameters=_inertia_values(*link_inertia(model, model.tree.link[body])),
                admits=admits,
                cost=TUNING.ten,
                # What hangs on the last link changes the torques of most motions as if it hung on the one before.
                excludes=frozenset({"payload"}) if body == last_body(terms) - 1 else frozenset(),
            )
        )
    return result


def turns_only(full: Array) -> bool:
    """Return whether a body shows one number only.

    Then it turns about one axis, like a rotor, which is the better name.
    """
    columns = full.reshape(-1, full.shape[2])
    return int(np.linalg.matrix_rank(columns.T @ columns, tol=1e-9 * float(np.sum(columns**2)), hermitian=True)) < 2


def _inertia_values(mass: float, centre: Array, inertia: Array) -> Callable[[Array, Array], Values]:
    """Return the effect's differences, about the link's centre, from those about its origin."""
    present = about_origin(mass, centre, inertia)

    def values(c: Array) -> dict[str, Array]:
        if present[0] + c[0] <= 0.0:
            return {"mass": c[0:1], "com": np.zeros(3), "inertia": c[4:10]}
        _, after, turning = about_centre(present + c)
        return {"mass": c[0:1], "com": after - centre, "inertia": turning - inertia}

    return transformed(values)


def tilt(terms: Terms, about: Array | None = None) -> Candidate:
    """Base rolled about x, pitched about y: gravity turns the other way, to first order about half of `about`."""
    model = terms.records.model
    tree = model.tree
    roll, pitch = np.zeros(2) if about is None else 0.5 * about
    g = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix().T @ tree.gravity
    # d/dε of Rᵀ g for a rotation about an axis e by ε is g × e.
    turns = [np.cross(g, axis) for axis in np.eye(3)[:2]]

    def law(record: Record) -> Array:
        zero = np.zeros_like(record.q)
        parts = [
            replace(tree.bare(tree.inertia), gravity=turn).inverse_dynamics(record.q, zero, zero) for turn in turns
        ]
        return np.stack(parts, axis=-1)

    return Candidate(
        name="gravity_tilt",
        joints=(),
        links=(),
        rows=tuple(range(terms.records.n)),
        columns=terms.records.reduce(law),
        spread=np.full(2, 0.15),
        lower=np.full(2, -1.0),
        upper=np.full(2, 1.0),
        parameters=linear("roll", "pitch"),
    )


def delay_columns(terms: Terms, about: float = 0.0) -> Array:
    """Return (ΣD, n, 1) rate of the transmitted torque.

    What a delay of a second would add, to first order about `about`/2.
    """
    parts = []
    for load, record in zip(terms.load, terms.records.records, strict=True):
        if about == 0.0:
            parts.append(rate_of(load, record))
        else:
            ahead = np.stack([np.interp(record.time + about, record.time, x) for x in load.T], axis=1)
            parts.append((ahead - load) / about)
    return terms.reduce(tuple(parts))[..., None]


def delay(terms: Terms, longest: float, about: float = 0.0) -> Candidate:
    """Return the logged torque that acts later: applied(t) = logged(t − d), so logged(t) = needed(t + d)."""
    period = max(record.period for record in terms.records.records)
    return Candidate(
        name="time_delay",
        joints=(),
        links=(),
        rows=tuple(range(terms.records.n)),
        columns=delay_columns(terms, about),
        spread=np.array([0.3 * longest]),
        lower=np.array([1.0 * period]),
        upper=np.array([longest * 2.0]),
        parameters=linear("delay"),
    )


def timing_nuisance(terms: Terms) -> Candidate:
    """Return a delay below a log sample: a held command and an integrator's step look like one, and it is no effect."""
    period = max(record.period for record in terms.records.records)
    return replace(
        delay(terms, TUNING.longest_delay),
        name="",
        spread=np.array([TUNING.held + TUNING.within * period]),
        lower=np.array([-np.inf]),
        upper=np.array([np.inf]),
    )


def encoder_offsets(terms: Terms) -> list[Candidate]:
    """Return true position = measured − offset, on each joint."""
    made = (encoder_offset(terms, j) for j in range(terms.records.n))
    return [candidate for candidate in made if candidate is not None]


def encoder_offset(terms: Terms, j: int, about: float = 0.0) -> Candidate | None:
    """On one joint, to first order about half of `about`; none where it makes no difference."""
    model = terms.records.model

    def law(record: Record) -> Array:
        step = np.zeros(terms.records.n)
        step[j] = 1e-4
        q = record.q - 0.5 * about * (step > 0.0)
        ahead = model.inverse_dynamics(q + step, record.v, record.a)
        behind = model.inverse_dynamics(q - step, record.v, record.a)
        return -(ahead - behind) / 2e-4

    columns = terms.records.reduce(law)[..., None]
    if np.max(np.sqrt(np.mean(columns**2, axis=0))) < 1e-6:
        return None
    return Candidate(
        name="encoder_offset",
        joints=(j,),
        links=(),
        rows=tuple(range(terms.records.n)),
        columns=columns,
        spread=np.array([0.1]),
        lower=np.array([-0.6]),
        upper=np.array([0.6]),
        parameters=linear("offset"),
    )


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

        def law(record: Record, body: int = body) -> Array:
            motion = Kinematics.of(tree, record.q.T)
            moved = motion.ancestors[body][:, None]
            columns = np.empty((*record.q.shape, 6))
            for k, axis in enumerate(np.eye(3)):
                arm = np.cross(motion.p[:, body].T, axis)
                columns[..., k] = -(moved * (motion.linear[k] + np.einsum("na,ain->in", arm, motion.angular))).T
                columns[..., 3 + k] = -(moved * motion.angular[k]).T
            return columns

        wrench = Candidate(
            name="external_force",
            joints=(),
            links=(tree.link[body],),
            rows=tuple(range(terms.records.n)),
            columns=terms.records.reduce(law),
            spread=spread,
            lower=np.full(6, -np.inf),
            upper=np.full(6, np.inf),
            parameters=transformed(lambda c: {"wrench": c}),
        )
        force = replace(
            wrench,
            columns=wrench.columns[..., :3],
            spread=spread[:3],
            lower=wrench.lower[:3],
            upper=wrench.upper[:3],
            parameters=transformed(lambda c: {"wrench": np.concatenate([c, np.zeros(3)])}),
        )
        result += [force, wrench]
    return result


def elasticities(terms: Terms) -> list[Candidate]:
    """Link angle = motor angle − transmitted torque / stiffness; coefficients 1/stiffness and rotor inertia."""
    model = terms.records.model
    tree = model.tree
    result = []
    for j in range(terms.records.n):
        others = np.arange(terms.records.n)

        def law(record: Record, load: Array, j: int = j) -> Array:
            twist = load[:, j]
            rate = rate_of(twist[:, None], record)[:, 0]
            second = rate_of(rate[:, None], record)[:, 0]
            unit = 1e-7 * np.eye(terms.records.n)[j]
            q = record.q - np.outer(twist, unit)
            v = record.v - np.outer(rate, unit)
            a = record.a - np.outer(second, unit)
            bare = replace(tree, rotor=np.zeros_like(tree.rotor), damping=np.zeros_like(tree.damping))
            there = bare.inverse_dynamics(q, v, a) - bare.inverse_dynamics(record.q, record.v, record.a)
            columns = np.zeros((*record.q.shape, 2))
            columns[..., 0] = there / 1e-7
            columns[:, j, 1] = record.a[:, j]
            return columns

        columns = terms.reduce(tuple(law(r, load) for r, load in zip(terms.records.records, terms.load, strict=True)))

        def values(c: Array) -> dict[str, Array]:
            return {"stiffness": 1.0 / c[0:1], "rotor_inertia": c[1:2]}

        size = max(float(np.sqrt(np.mean(columns[:, j, 1] ** 2))), 1e-9)
        result.append(
            Candidate(
                name="joint_elasticity",
                joints=(j,),
                links=(),
                rows=tuple(int(i) for i in others),
                columns=columns,
                spread=np.array([3e-4, terms.torque_size[j] / size]),
                lower=np.array([1e-6, -1.05 * terms.present.rotor[j]]),
                upper=np.array([1e-1, np.inf]),
                parameters=transformed(values),
                cost=3.0,
            )
        )
    return result
