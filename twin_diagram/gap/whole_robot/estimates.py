"""What was fitted of a whole robot, as effects with standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.payload import ALIKE, SOLID, carried_always
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.correction.physical_coordinates import from_log_cholesky
from twin_diagram.gap.findings import Estimate, Finding, Moment
from twin_diagram.gap.verdict.posterior import unit_of
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.model.effects.actuation import TorqueBias
from twin_diagram.model.effects.friction import CoulombFriction, ViscousFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction
from twin_diagram.model.effects.inertia import ReflectedInertia
from twin_diagram.model.effects.link_inertia import InertialParameters
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

NAMES = {
    "viscous": (ViscousFriction.name, "damping"),
    "coulomb": (CoulombFriction.name, "torque"),
    "bias": (TorqueBias.name, "torque"),
    "rotor": (ReflectedInertia.name, "inertia"),
}
"""Effect and parameter of each of `OWN`."""

FRICTION = ("viscous", "coulomb")
"""Which of `OWN` are friction's."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    step: float = 1e-5
    """Of finite differences of a link's coordinates."""

    third: float = 1.0 / 3.0
    """Share of its value up to which an own term's error counts what has no name: nothing is named beyond that."""

    rough: float = 0.05
    """Share of its value by which friction is off whatever a fit says: no drive's is quite the law's. Chosen on 135
    joints of `sims/benchmarks/gap_whole_robots.py`, seeds 40000 to 41016: 95 % of joints are within two errors."""

    crawl: float = 0.2
    """Of its level, by which dry friction at a crawl is off where it changes with speed: its share is not fitted."""

    speed: float = 0.25
    """Share of the speed about which it changes by which that is off: a few speeds are tried."""

    held: float = 1e-3
    """Share of its mass by which a load held for a while is off whatever a fit says, as it is no point: without,
    of eight made arms' loads a mass was three errors off, and two centres five and ten."""

    grip: float = 5e-4
    """The same of its centre [m]."""

    own_mass: float = 0.1
    """Of the last link's mass, by which any description may be off: a payload is known no better."""


TUNING = Tuning()


def covariance(problem: RobotProblem, z: Array) -> Array:
    """Return (Z, Z) of coordinates: the larger of the model's own and the sandwich over stretches of motion.

    The laws are rough, so what is left hangs together within a stretch; the prior is in both.
    """
    H, _ = problem.system(z, problem.sums.whole)
    moving = np.flatnonzero(problem.free)
    own = np.zeros_like(H)
    own[np.ix_(moving, moving)] = np.linalg.inv(H[np.ix_(moving, moving)])
    pulls = problem.pulls(z)
    meat = pulls.T @ pulls + problem.precision
    sandwich = own @ meat @ own
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(own), 1e-300), 1.0))
    return own * np.outer(ratio, ratio)


def widened(spread: Array, fits: Array) -> Array:
    """Return a covariance (Z, Z) that is no smaller than what fits without one kind of motion each differ by.

    Where a law is only rough, each kind of motion has numbers of its own: a jackknife over kinds.

    Args:
        spread: of the model, see `covariance`.
        fits: (F, Z) coordinates.
    """
    count = len(fits)
    apart = (count - 1.0) / count * np.sum((fits - np.mean(fits, axis=0)) ** 2, axis=0)
    ratio = np.sqrt(np.maximum(apart / np.maximum(np.diag(spread), 1e-300), 1.0))
    ratio[np.diag(spread) <= 0.0] = 1.0
    return np.asarray(spread * np.outer(ratio, ratio))


def beside_all(spread: Array, every: RobotProblem, z: Array) -> Array:
    """Return a covariance (Z, Z) that is no smaller than if all that was not named were there, too.

    Friction whose damping had no name may have some yet: its level is known the less.

    Args:
        spread: of what is named, 0 elsewhere.
        every: the same problem with everything free.
        z: (Z,) coordinates.
    """
    wide, own = np.sqrt(np.diag(covariance(every, z))), np.sqrt(np.maximum(np.diag(spread), 0.0))
    terms = slice(10 * every.n, 14 * every.n)
    most = np.sqrt(TUNING.third**2 - TUNING.rough**2)  # friction's own roughness comes on top
    wide[terms] = np.minimum(wide[terms], most * np.abs(z[terms]))
    ratio = np.where(own > 0.0, np.maximum(wide / np.maximum(own, 1e-300), 1.0), 1.0)
    return np.asarray(spread * np.outer(ratio, ratio))


def by_evidence(wide: Array, least: Array, size: Array, brought: Array) -> Array:
    """Return a covariance (Z, Z) of which joints' drives' is no larger than what left-out motion loses without it says.

    One kind of motion may carry a term alone: fits without it then differ by far more than the term is unsure. A term
    of n standard errors brings n² / 2 nats.

    Args:
        wide: with what fits without one kind of motion each differ by, see `widened`.
        least: without that; no error is less.
        size: (Z,) by which coordinates differ from the description.
        brought: (n, 4) by how much joints' own terms make left-out motion of the joint likelier [nats].
    """
    n = len(brought)
    told = np.full((n, len(OWN)), np.inf)
    k = [OWN.index(term) for term in (*FRICTION, "rotor")]
    told[:, k] = np.abs(size[10 * n : 14 * n].reshape(n, -1)[:, k]) / np.sqrt(2.0 * np.maximum(brought[:, k], 1e-9))
    error, own = np.sqrt(np.diag(wide)), np.sqrt(np.maximum(np.diag(least), 0.0))
    ratio = np.ones(len(error))
    terms = slice(10 * n, 14 * n)
    most = np.maximum(own[terms], told.ravel())
    ratio[terms] = np.minimum(most / np.maximum(error[terms], 1e-300), 1.0)
    return np.asarray(wide * np.outer(ratio, ratio))


def findings(
    problem: RobotProblem, z: Array, spread: Array, model: Model, sure: dict[str, float]
) -> tuple[Finding, ...]:
    """Return one finding per name.

    Args:
        problem: what was fitted.
        z: (Z,) its coordinates.
        spread: (Z, Z) their covariance.
        model: the given one.
        sure: confidence per name.
    """
    solid = [k for k, candidate in enumerate(problem.sums.further) if candidate.variant == SOLID]
    result = [_of_links(problem, z, spread, sure)] if np.any(problem.links_free) or solid else []
    for k, term in enumerate(OWN):
        name, key = NAMES[term]
        chosen = [j for j in range(problem.n) if problem.said[j, k] and name_of(problem, j, k) == name]
        if term == "coulomb":
            result += _changing(problem, z, spread, model, sure)
        if not chosen:
            continue
        places = [10 * problem.n + len(OWN) * j + k for j in chosen]
        joints = [model.joints[j] for j in chosen]
        errors = [error_of(problem, z, spread, i) for i in places]
        values = {
            joint: Estimate(float(z[i]), error, unit_of(name, key, joint in model.prismatic))
            for joint, i, error in zip(joints, places, errors, strict=True)
        }
        result.append(Finding(name, tuple(joints), (), {key: values}, sure[name]))
    return tuple(result) + _further(problem, z, spread, model, sure)


def name_of(problem: RobotProblem, joint: int, term: int) -> str:
    """Return the effect that one of `OWN` is on a joint: dry friction that falls with speed has its own.

    What rises to its level is no Stribeck effect: it is Coulomb's friction, as what builds up over a way is.
    """
    falls = OWN[term] == "coulomb" and problem.sums.shapes[joint].speed and problem.sums.shapes[joint].crawl > 1.0
    return StribeckFriction.name if falls else NAMES[OWN[term]][0]


def _changing(problem: RobotProblem, z: Array, spread: Array, model: Model, sure: dict[str, float]) -> list[Finding]:
    """Return the finding of dry friction that falls as joints get under way, if there is any."""
    k, name = OWN.index("coulomb"), StribeckFriction.name
    chosen = [j for j in range(problem.n) if problem.said[j, k] and name_of(problem, j, k) == name]
    if not chosen:
        return []
    parameters: dict[str, dict[str, Estimate]] = {"coulomb": {}, "static": {}, "stribeck_velocity": {}}
    for j in chosen:
        joint, shape, place = model.joints[j], problem.sums.shapes[j], 10 * problem.n + len(OWN) * j + k
        level, error = float(z[place]), error_of(problem, z, spread, place)
        values = {
            "coulomb": (level, error),
            "static": (shape.crawl * level, float(np.hypot(shape.crawl * error, TUNING.crawl * level))),
            "stribeck_velocity": (shape.speed, TUNING.speed * shape.speed),
        }
        for key, (value, doubt) in values.items():
            parameters[key][joint] = Estimate(value, doubt, unit_of(name, key, joint in model.prismatic))
    return [Finding(name, tuple(model.joints[j] for j in chosen), (), dict(parameters), sure[name])]


def _further(
    problem: RobotProblem, z: Array, spread: Array, model: Model, sure: dict[str, float]
) -> tuple[Finding, ...]:
    """Return one finding per name, and span of a load, of what is there beyond links and joints' own terms."""
    found: dict[object, Finding] = {}
    step = 1.0 / problem.sums.records.rate
    there = sorted(enumerate(problem.sums.further), key=lambda item: item[1].joints)
    for at, candidate in there:
        name, s = candidate.name, problem.place(at)
        told = candidate.parameters(z[s], spread[s, s])
        joints = tuple(model.joints[j] for j in candidate.joints)
        vague = candidate.vague or ((step, step),) * max(len(candidate.spans), 1)
        when = [x and Moment(*x, error) for x, error in zip((candidate.onset, candidate.end), vague[0], strict=True)]
        nothing = Finding(name, (), candidate.links, {}, sure[name], onset=when[0], end=when[1])
        claim = candidate.place if candidate.spans else name  # one per load that is held for a while
        before = found.get(claim, nothing)
        parameters = dict(before.parameters)
        for key, (value, error) in told.items():
            if not record_of(name).per_joint:
                if carried_always(candidate) and key == "mass":
                    error = np.hypot(error, own_doubt(problem))
                if candidate.spans:
                    error = np.hypot(error, TUNING.held * np.abs(value) if key == "mass" else TUNING.grip)
                parameters[key] = _estimate(value, error, unit_of(name, key))
                continue
            mine = {j: _estimate(value, error, unit_of(name, key, j in model.prismatic)) for j in joints}
            others = parameters.get(key, {})
            assert isinstance(others, dict)
            parameters[key] = {**others, **mine}
        found[claim] = replace(before, joints=(*before.joints, *joints), parameters=parameters)
        for k, span in enumerate(candidate.spans[1:]):  # the same load again
            when = [x and Moment(*x, error) for x, error in zip(span, vague[k + 1], strict=True)]
            found[(claim, k)] = replace(found[claim], onset=when[0], end=when[1])
    return tuple(found.values())


def own_doubt(problem: RobotProblem) -> float:
    """Return by how much the last link's described mass may be off, which no motion tells from a payload [kg].

    Of an arm that was measured before, whatever its mass is: what changed since is the payload.
    """
    if problem.told is not None:
        return 0.0
    heavy = problem.links.described[problem.links.heavy, 0]
    return TUNING.own_mass * float(heavy[-1])


def error_of(problem: RobotProblem, z: Array, spread: Array, place: int) -> float:
    """Return a joint's own term's standard error.

    Of what the description states and is all taken away, no more than if nothing were known but that it is too much.
    """
    error = float(np.sqrt(spread[place, place]))
    joint, term = divmod(place - 10 * problem.n, len(OWN))
    if OWN[term] in FRICTION:
        error = float(np.hypot(error, TUNING.rough * z[place]))
    if OWN[term] == "coulomb":
        error = float(np.hypot(error, falls_short(problem, joint) * z[place]))
    most = abs(problem.lower[place]) / np.sqrt(12.0)
    if z[place] > problem.lower[place] or not np.isfinite(most):
        return error
    return float(min(error, most)) if error > 0.0 else float(most)


def falls_short(problem: RobotProblem, joint: int) -> float:
    """Return by which share of its level dry friction that rises with speed falls short, RMS over the logs' motion.

    A joint that hardly gets under way tells little of the level that its friction would rise to.
    """
    shape, sums = problem.sums.shapes[joint], problem.sums
    if not shape.speed or shape.crawl >= 1.0:
        return 0.0
    v = np.concatenate([record.v[record.kept, joint] for record in sums.records.records])
    short = (1.0 - shape.crawl) * np.exp(-((v[sums.weights[:, joint] > 0.0] / shape.speed) ** 2))
    return float(np.sqrt(np.mean(short**2)))


def _of_links(problem: RobotProblem, z: Array, spread: Array, sure: dict[str, float]) -> Finding:
    name = InertialParameters.name
    parameters: dict[str, dict[str, Estimate]] = {key: {} for key in InertialParameters.kinds}
    links = [k for k in range(problem.n) if problem.links_free[k]]
    for k in links:
        s = slice(10 * k, 10 * k + 10)
        value = _stated(z[s]) - _stated(problem.links.mean[k])
        steps = TUNING.step * np.eye(10)
        J = np.stack([(_stated(z[s] + d) - _stated(z[s] - d)) / (2.0 * TUNING.step) for d in steps], axis=1)
        error = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", J, spread[s, s], J), 0.0))
        for key, part in (("mass", slice(0, 1)), ("com", slice(1, 4)), ("inertia", slice(4, 10))):
            parameters[key][problem.links.names[k]] = _estimate(value[part], error[part], unit_of(name, key))
    names, confidence = [problem.links.names[k] for k in links], sure.get(name, 1.0)
    for k, load in enumerate(problem.sums.further):
        if load.variant != SOLID:
            continue
        # A payload's own moment of inertia is its link's, as an effect it is a point.
        given, place = problem.sums.records.model, problem.place(k).stop - 1
        link = problem.links.names[given.bodies.body_of(given.last_link)[0]]  # a tool's frame may have no mass
        names.append(link)
        confidence = min(confidence, sure[load.name])
        own = ((np.zeros(1), "mass"), (np.zeros(3), "com"), (ALIKE, "inertia"))
        for weights, key in own:
            error = np.sqrt(max(float(spread[place, place]), 0.0)) * weights
            parameters[key][link] = _estimate(z[place] * weights, error, unit_of(name, key))
    if len(names) == 1:
        alone = {key: values[names[0]] for key, values in parameters.items()}
        return Finding(name, (), tuple(names), dict(alone), confidence)
    return Finding(name, (), tuple(names), dict(parameters), confidence)


def _stated(z: Array) -> Array:
    """Return (10,) mass, centre and inertia about it, as descriptions state them."""
    mass, centre, inertia = from_log_cholesky(z)
    return np.concatenate([[mass], centre, inertia])


def _estimate(value: Sequence[float] | Array, error: Array, unit: str) -> Estimate:
    if len(value) == 1:
        return Estimate(float(value[0]), float(error[0]), unit)
    return Estimate([float(x) for x in value], [float(x) for x in error], unit)
