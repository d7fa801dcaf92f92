"""Compares a `gap.json` with a truth file: names, places, confidences, onsets and parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

SIZES = {
    "viscous_friction": ("damping",),
    "coulomb_friction": ("torque", "torque_positive", "torque_negative"),
    "stribeck_friction": ("coulomb", "static", "stribeck_velocity"),
    "load_dependent_friction": ("coefficient",),
    "coupled_friction": ("damping", "torque"),
    "payload": ("mass", "com"),
    "reflected_inertia": ("inertia",),
    "gravity_tilt": ("roll", "pitch"),
    "joint_spring": ("stiffness",),
    "joint_elasticity": ("stiffness", "rotor_inertia"),
    "backlash": ("gap", "rotor_inertia"),
    "torque_ripple": ("amplitude", "cycles"),
    "torque_constant": ("gain",),
    "torque_bias": ("torque",),
    "torque_saturation": ("limit",),
    "time_delay": ("delay",),
    "encoder_offset": ("offset",),
    "external_force": ("wrench",),
    "actuator_fault": ("gain",),
}
"""Parameters whose relative error means something: no angle of rest, no phase, no curve, and none of the ten of a link,
of which a motion shows combinations only."""

JOINED = {"gravity_tilt": ("roll", "pitch")}
"""Parameters that are one vector; the error of a component is taken relative to the whole."""

Place = tuple[str, frozenset[str], frozenset[str]]


def place(effect: dict[str, Any]) -> Place:
    """What an effect claims: name, joints, links."""
    return effect["name"], frozenset(effect.get("joints") or ()), frozenset(effect.get("links") or ())


def same(claim: Place, truth: Place) -> bool:
    """Whether a claim is right. Links need only agree where the claim names any: a payload's is always the last."""
    links_agree = claim[2] == truth[2] or (claim[0] == "payload" and not claim[2])
    return claim[:2] == truth[:2] and links_agree


def tolerated(claim: Place, truths: list[Place]) -> bool:
    """A rotor's inertia may be left inside an elasticity or a backlash, or be named beside it."""
    if claim[0] != "reflected_inertia":
        return False
    soft = [t[1] for t in truths if t[0] in ("joint_elasticity", "backlash")]
    return bool(claim[1]) and claim[1] <= frozenset().union(*soft)


def judge(found: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """Everything that can be said without the logs.

    Args:
        found: `gap.json`.
        truth: of `gap_truth.cases.describe`, with `parts`.
    """
    effects = found.get("effects", [])
    claims = [place(effect) for effect in effects]
    truths = [] if truth["outside"] else [place(effect) for effect in truth["effects"]]
    right = [any(same(claim, t) for t in truths) for claim in claims]
    extra = [k for k, claim in enumerate(claims) if not right[k] and not tolerated(claim, truths)]
    hit = [any(same(claim, t) for claim in claims) for t in truths]
    exact = found["verdict"] == "named" and all(hit) and not extra
    if not truths:
        exact = found["verdict"] == "none" if truth["kind"] == "clean" else _abstains(found)
    among = [any(_offers(effect, t) for effect in effects) for t in truths]
    return {
        "verdict": found["verdict"],
        "remainder": bool(found.get("remainder", False)),
        "exact": bool(exact),
        "hits": hit,
        "among": among,
        "abstains": _abstains(found),
        "claims": [
            {
                "name": effect["name"],
                "joints": list(effect.get("joints") or ()),
                "links": list(effect.get("links") or ()),
                "confidence": float(effect.get("confidence", 1.0)),
                "right": bool(right[k] or tolerated(claims[k], truths)),
            }
            for k, effect in enumerate(effects)
        ],
        "onset_errors": _onsets(effects, truth, truths),
        "oracle_onset_errors": [actual.get("oracle_onset_errors") for actual, _ in _with_onset(effects, truth, truths)],
        "parameters": _parameters(effects, truth, truths),
        "faults": faults(found),
    }


def _abstains(found: dict[str, Any]) -> bool:
    return bool(found["verdict"] == "unknown" or (found["verdict"] == "named" and found.get("remainder", False)))


def _offers(effect: dict[str, Any], truth: Place) -> bool:
    return any(same(place(x), truth) for x in (effect, *effect.get("alternatives", [])[:3]))


def _matching(effects: list[dict[str, Any]], truth: Place) -> dict[str, Any] | None:
    return next((effect for effect in effects if same(place(effect), truth)), None)


def _moment(value: Any) -> float | None:
    """Onsets are seconds of the fit log's own time, with several logs an object."""
    if isinstance(value, dict):
        return float(value["time"]) if value.get("log", 0) == 0 else None
    return None if value is None else float(value)


def _with_onset(
    effects: list[dict[str, Any]], truth: dict[str, Any], truths: list[Place]
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """True effects that have an onset, with what was found of them."""
    for actual, where in zip(truth["effects"], truths, strict=False):
        effect = _matching(effects, where)
        if actual.get("onset") is not None and effect is not None:
            yield actual, effect


def _onsets(effects: list[dict[str, Any]], truth: dict[str, Any], truths: list[Place]) -> list[float | None]:
    """Found less true [s] per true onset; None where it was not found, though the effect was."""
    result: list[float | None] = []
    for actual, effect in _with_onset(effects, truth, truths):
        moment = _moment(effect.get("onset"))
        result.append(None if moment is None else moment - actual["onset"])
    return result


def _parameters(effects: list[dict[str, Any]], truth: dict[str, Any], truths: list[Place]) -> list[dict[str, Any]]:
    """Relative error, and error over standard error, of every size of every effect that was found."""
    result = []
    parts = truth.get("parts", [])
    for actual, where in zip(truth["effects"], truths, strict=False):
        effect = _matching(effects, where)
        if effect is None:
            continue
        own = [p["separation"] for p in parts if p["name"] == actual["name"]]
        for key in SIZES.get(actual["name"], ()):
            for joint, value, std, true, whole in _pairs(effect, actual, key):
                result.append(
                    {
                        "name": actual["name"],
                        "key": key,
                        "joint": joint,
                        "error": abs(value - true) / whole,
                        "z": (value - true) / std if std > 0.0 else math.inf,
                        "separation": min(own, default=0.0),
                    }
                )
    return result


def _pairs(effect: dict[str, Any], actual: dict[str, Any], key: str) -> list[tuple[str, float, float, float, float]]:
    """(joint, value, standard error, true value, what the error is relative to)."""
    found, true = effect.get("parameters", {}), actual["parameters"]
    if key not in found:
        return []
    wanted = true.get(key)
    if wanted is None and key == "torque" and "torque_positive" in true:
        wanted = {j: 0.5 * (x + true["torque_negative"][j]) for j, x in true["torque_positive"].items()}
    if wanted is None and key in ("torque_positive", "torque_negative"):
        wanted = true.get("torque")
    if wanted is None:
        return []
    if isinstance(wanted, dict):
        return [
            (j, float(e["value"]), float(e["std"]), wanted[j], abs(wanted[j]))
            for j, e in found[key].items()
            if j in wanted
        ]
    entry = found[key]
    if "value" not in entry:  # a joint effect's form, for an effect that has one value for all its joints
        entry = next(iter(entry.values()))
    group = JOINED.get(actual["name"], (key,))
    whole = float(np.linalg.norm([np.linalg.norm(np.atleast_1d(true[k])) for k in group]))
    value, std, target = (np.atleast_1d(np.array(x, dtype=float)) for x in (entry["value"], entry["std"], wanted))
    if len(value) != len(target):
        return []
    std = np.broadcast_to(std, value.shape)
    return [("", float(a), float(s), float(t), max(whole, 1e-9)) for a, s, t in zip(value, std, target, strict=True)]


def faults(found: dict[str, Any]) -> list[str]:
    """Where a `gap.json` breaks its contract."""
    result = []
    if found.get("verdict") not in ("named", "none", "unknown"):
        result.append(f"verdict is {found.get('verdict')!r}")
    effects = found.get("effects", [])
    if found.get("verdict") != "named" and effects:
        result.append(f"verdict {found.get('verdict')!r} with {len(effects)} effects")
    if found.get("verdict") == "named" and not effects:
        result.append("named without effects")
    names = [effect.get("name") for effect in effects]
    if len(set(names)) != len(names):
        result.append(f"a name has more than one entry: {names}")
    for effect in effects:
        if not 0.0 <= effect.get("confidence", -1.0) <= 1.0:
            result.append(f"{effect.get('name')}: confidence is {effect.get('confidence')!r}")
        if len(effect.get("alternatives", [])) > 3:
            result.append(f"{effect.get('name')}: {len(effect['alternatives'])} alternatives")
        missing = {"name", "joints", "links", "parameters", "confidence", "alternatives", "onset", "end"} - set(effect)
        if missing:
            result.append(f"{effect.get('name')}: lacks {', '.join(sorted(missing))}")
    rms = found.get("gap", {}).get("torque_rms", {})
    missing = {"fit", "holdout", "noise_floor"} - set(rms)
    if missing:
        result.append(f"gap.torque_rms lacks {', '.join(sorted(missing))}")
    return result
