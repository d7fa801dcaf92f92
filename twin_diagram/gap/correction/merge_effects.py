"""What a model has and what it lacks, made one: coefficients of the same law at the same place add up.

Findings are relative to the given model. Most laws are linear in their coefficients, so that adding the finding beside
what is there would do; it does not where something became less (a payload put down, a brake that wears), which no
effect can say alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.model.effects import Effect, make, spec_of
from twin_diagram.scenario import EffectSpec

Values = dict[str, float]

UNTOLD = frozenset({"loss"})
"""Parameters that an effect may leave to its default."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    rounded: float = 0.05
    """A payload may be told this much heavier when it is put down than it was when it was picked up, friction
    likewise."""

    nothing: float = 1e-9
    """What is left below this is nothing."""


TUNING = Tuning()

LEADING = (
    *("damping", "torque", "torque_positive", "torque_negative", "coulomb", "static"),
    *("inertia", "coefficient", "mass", "stiffness"),
)
"""Parameters whose sign says whether something was added or taken away."""


def merged(present: Iterable[Effect], added: Iterable[EffectSpec]) -> list[Effect]:
    """Return the effects of a model that had `present` and lacked `added`.

    Args:
        present: of the given model; those that its description states stay as they are.
        added: relative to it; coefficients may be negative where there is something to take away.

    Raises:
        ModelError: more is taken away than there is.
    """
    kept = [effect for effect in present if effect.given]
    specs = [spec_of(effect) for effect in present if not effect.given]
    for addition in added:
        for piece in _pieces(addition):
            specs = _put_down(specs, piece) if _is_loss(piece) else _add(specs, piece)
    return [*kept, *(make(spec) for spec in specs)]


def _is_loss(piece: EffectSpec) -> bool:
    """Return whether a payload became less throughout."""
    return piece.name == "payload" and piece.onset is None and piece.end is None and piece.parameters["mass"][0] < 0.0


def _put_down(specs: list[EffectSpec], piece: EffectSpec) -> list[EffectSpec]:
    """Return less of the lightest payload on a link that is enough, or of all of them together."""
    there = [
        spec
        for spec in specs
        if spec.name == "payload" and spec.links in ([], piece.links) and spec.onset is None and spec.end is None
    ]
    lost = -piece.parameters["mass"][0]
    enough = [spec for spec in there if spec.parameters["mass"][0] * (1.0 + TUNING.rounded) >= lost]
    chosen = [min(enough, key=lambda spec: spec.parameters["mass"][0])] if enough else there
    masses = np.array([spec.parameters["mass"][0] for spec in chosen])
    if not np.sum(masses) > 0.0:
        return [*specs, piece]
    com = masses @ np.array([spec.parameters["com"] for spec in chosen]) / np.sum(masses)
    remaining = _loads({"mass": [float(np.sum(masses))], "com": com.tolist()}, piece.parameters)
    if remaining is None:
        return [*specs, piece]
    left = EffectSpec("payload", [], list(piece.links), remaining)
    rest = [spec for spec in specs if not any(spec is one for one in chosen)]
    return [*rest, left] if _something(left) else rest


def _pieces(spec: EffectSpec) -> list[EffectSpec]:
    """Return one per joint, where the parameters are."""
    if spec.name not in PER_JOINT or len(spec.joints) < 2:
        return [spec]
    return [_on_joint(spec, k) for k in range(len(spec.joints))]


def _on_joint(spec: EffectSpec, k: int, keep: Callable[[int], bool] | None = None) -> EffectSpec:
    chosen = [i for i in range(len(spec.joints)) if (i == k if keep is None else keep(i))]
    parameters = {key: [values[i] for i in chosen] for key, values in spec.parameters.items()}
    return replace(spec, joints=[spec.joints[i] for i in chosen], links=list(spec.links), parameters=parameters)


def _add(specs: list[EffectSpec], piece: EffectSpec) -> list[EffectSpec]:
    timed = piece.onset is not None or piece.end is not None
    for place, spec in enumerate(specs):
        wears = _wears(spec, piece) and not any(_alike(other, piece) for other in specs)
        if not wears and (spec.name != piece.name or set(spec.parameters) - UNTOLD != set(piece.parameters) - UNTOLD):
            continue
        if spec.onset is not None or spec.end is not None:
            continue
        if piece.name in PER_JOINT:
            if len(piece.joints) != 1 or piece.joints[0] not in spec.joints or "curve" in piece.parameters:
                continue
            k = spec.joints.index(piece.joints[0])
            here = _on_joint(spec, k)
        elif spec.joints == piece.joints and (
            spec.links == piece.links or (spec.name == "payload" and not spec.links)  # the last link
        ):
            k, here = 0, replace(spec, links=list(piece.links))
        else:
            continue
        rule = _worn if wears else RULES.get(piece.name)
        sums = rule(here.parameters, piece.parameters) if rule else None
        if sums is None or (timed and not is_less(piece)):
            continue
        rest = [_on_joint(spec, 0, lambda i, k=k: i != k)] if piece.name in PER_JOINT else []  # type: ignore[misc]
        rest = [other for other in rest if other.joints]
        changed = EffectSpec(here.name, list(here.joints), list(here.links), sums)
        if timed:
            before = EffectSpec(here.name, list(here.joints), list(here.links), here.parameters, None, piece.onset)
            before.log = changed.log = piece.log
            before.elsewhere = changed.elsewhere = dict(piece.elsewhere)
            changed.onset, changed.end = piece.onset, piece.end
            if piece.end is not None:
                raise ModelError(f"effects.{piece.name}: became less for a while; that cannot be said")
            rest.append(before)
        now = [changed] if _something(changed) else []
        return [*specs[:place], *rest, *now, *specs[place + 1 :]]
    return [*specs, piece]


def _alike(spec: EffectSpec, piece: EffectSpec) -> bool:
    """Return whether there is friction of the same kind for a piece to be taken off."""
    return spec.name == piece.name and spec.onset is None and spec.end is None and piece.joints[0] in spec.joints


def _wears(spec: EffectSpec, piece: EffectSpec) -> bool:
    """Return whether dry friction that became less is that of a Stribeck curve, whose level it is."""
    dry = piece.name == "coulomb_friction" and set(piece.parameters) == {"torque"} and is_less(piece)
    return dry and spec.name == "stribeck_friction" and piece.joints[0] in spec.joints


def _worn(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]]:
    lost, level = more["torque"][0], here["coulomb"][0]
    left = level + lost
    return {
        **here,
        "coulomb": [0.0 if abs(left) < TUNING.rounded * level else left],
        "static": [here["static"][0] + lost],
    }


def is_less(piece: EffectSpec) -> bool:
    """Return whether a piece takes away, which no effect can do alone."""
    return any(value < 0.0 for key in LEADING for value in piece.parameters.get(key, [])) and piece.name in POSITIVE


def _something(spec: EffectSpec) -> bool:
    first = spec.parameters.get("static") or next(iter(spec.parameters.values()))
    return spec.name not in POSITIVE or bool(np.max(np.abs(first)) > TUNING.nothing)


def _sum(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]]:
    return {key: (np.array(here[key]) + np.array(more[key])).tolist() for key in here}


def _product(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]]:
    return {key: (np.array(here[key]) * np.array(more[key])).tolist() for key in here}


def _least(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]]:
    return {key: np.minimum(here[key], more[key]).tolist() for key in here}


def _springs(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]] | None:
    if "curve" in here:
        return None
    k = here["stiffness"][0] + more["stiffness"][0]
    moment = here["stiffness"][0] * here["rest_angle"][0] + more["stiffness"][0] * more["rest_angle"][0]
    return {"stiffness": [k], "rest_angle": [moment / k if abs(k) > TUNING.nothing else 0.0]}


def _loads(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]] | None:
    """Take a loss off a payload that was there.

    Two payloads weigh as one, but their inertia is not that of one point.
    """
    lost = more["mass"][0]
    if lost >= 0.0:
        return None
    mass = here["mass"][0] + lost
    if mass <= TUNING.nothing:
        return {"mass": [max(mass, 0.0)], "com": [0.0, 0.0, 0.0]} if mass > -TUNING.rounded * here["mass"][0] else None
    if mass < TUNING.rounded * here["mass"][0]:  # of so little, the centre is anywhere
        return {"mass": [mass], "com": list(here["com"])}
    moment = here["mass"][0] * np.array(here["com"]) + lost * np.array(more["com"])
    return {"mass": [mass], "com": (moment / mass).tolist()}


def _stribeck(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]] | None:
    if abs(here["stribeck_velocity"][0] / more["stribeck_velocity"][0] - 1.0) > 0.2:
        return None
    return {**_sum(here, more), "stribeck_velocity": list(here["stribeck_velocity"])}


def _in_series(here: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, list[float]]:
    stiffness = 1.0 / (1.0 / here["stiffness"][0] + 1.0 / more["stiffness"][0])
    result = {"stiffness": [stiffness], "rotor_inertia": [here["rotor_inertia"][0] + more["rotor_inertia"][0]]}
    if "loss" in here and "loss" in more:
        lost = here["loss"][0] / here["stiffness"][0] + more["loss"][0] / more["stiffness"][0]
        result["loss"] = [lost * stiffness]
    return result


RULES: dict[str, Callable[[dict[str, list[float]], dict[str, list[float]]], dict[str, list[float]] | None]] = {
    "viscous_friction": _sum,
    "coulomb_friction": _sum,
    "load_dependent_friction": _sum,
    "coupled_friction": _sum,
    "reflected_inertia": _sum,
    "inertial_parameters": _sum,
    "torque_bias": _sum,
    "encoder_offset": _sum,
    "time_delay": _sum,
    "gravity_tilt": _sum,
    "backlash": _sum,
    "torque_constant": _product,
    "torque_saturation": _least,
    "joint_spring": _springs,
    "payload": _loads,
    "stribeck_friction": _stribeck,
    "joint_elasticity": _in_series,
}
"""What two effects of one name at one place are together; what is not here, or answers None, stays beside the other."""

POSITIVE = frozenset(
    {
        "viscous_friction",
        "coulomb_friction",
        "load_dependent_friction",
        "coupled_friction",
        "reflected_inertia",
        "payload",
        "joint_spring",
        "stribeck_friction",
    }
)
"""Names whose coefficients are nothing at zero and cannot be below it."""

PER_JOINT = frozenset(
    {
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
        "load_dependent_friction",
        "reflected_inertia",
        "joint_spring",
        "joint_elasticity",
        "backlash",
        "torque_constant",
        "torque_bias",
        "torque_saturation",
        "encoder_offset",
    }
)
"""Names whose parameters hold a value per joint, and which add up joint by joint."""


def names(specs: Sequence[EffectSpec]) -> str:
    """For messages."""
    return ", ".join(spec.name for spec in specs)
