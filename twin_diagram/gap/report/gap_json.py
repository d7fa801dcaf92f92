"""The contents of gap.json: its layout is a contract, so it is made in this one place.

A value per joint is in that joint's own unit: `torque_rms` in N·m, or N where the joint is prismatic,
`rollout_position_rms` in rad or m; a parameter says its unit beside each joint's value.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from decimal import ROUND_FLOOR, Context
from typing import Any

import numpy as np

from twin_diagram.gap.experiments.advice import asked
from twin_diagram.gap.findings import Estimate, Finding, Moment, Place, Verdict
from twin_diagram.gap.report.comparison import Shown
from twin_diagram.signals.arrays import Array

DIGITS = 9
"""Significant ones that are kept."""


def contents(verdict: Verdict, shown: Shown) -> dict[str, Any]:
    """Return everything that the file holds, as plain dictionaries, lists, numbers and text."""
    files = of_files(shown)
    fit_before, fit_after = shown.fit_rms()
    before, after = shown.holdout_rms()
    joints = shown.joints
    rolled = shown.holdout
    return {
        "verdict": verdict.verdict,
        "remainder": bool(verdict.remainder),
        "effects": [
            {**_effect(finding, files), **_besides(finding, verdict.findings, files)}
            for finding in one_per_name(verdict.findings, joints)
        ],
        "where": [_place(place, files) for place in verdict.where],
        "gap": {
            "torque_rms": {
                "fit": {"before": _per_joint(joints, fit_before), "after": _per_joint(joints, fit_after)},
                "holdout": {"before": _per_joint(joints, before), "after": _per_joint(joints, after)},
                "noise_floor": _per_joint(joints, shown.noise_floor),
            },
            "rollout_position_rms": {
                "holdout": {
                    "before": _per_joint(joints, rolled.rollout_before),
                    "after": _per_joint(joints, rolled.rollout_after),
                }
            },
        },
        "separation": [
            {
                "a": near.a,
                "b": near.b,
                "distance": _number(near.distance),
                "experiment": asked(near, joints, shown.prismatic),
            }
            for near in verdict.separation
        ],
    }


def one_per_name(findings: Sequence[Finding], order: Sequence[str]) -> list[Finding]:
    """Return the findings of one name as one, with the times of the strongest: one entry per name is the layout.

    Args:
        findings: strongest first.
        order: of all joints.
    """
    result: dict[str, Finding] = {}
    for finding in findings:
        if finding.name not in result:
            result[finding.name] = finding
            continue
        first = result[finding.name]
        parameters = dict(first.parameters)
        for key, value in finding.parameters.items():
            old = parameters.get(key, {})
            parameters[key] = {**value, **old} if isinstance(old, dict) and isinstance(value, dict) else old or value
        joints = tuple(joint for joint in order if joint in {*first.joints, *finding.joints})
        links = tuple(dict.fromkeys(first.links + finding.links))
        result[finding.name] = replace(first, joints=joints, links=links, parameters=parameters)
    return list(result.values())


def text(answer: dict[str, Any]) -> str:
    """Return the contents as the file holds them: plain JSON without NaN or infinities."""
    return json.dumps(answer, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def of_files(shown: Shown) -> list[int]:
    """Return per fitted run which of the given files it is of: one that went silent was parted into several."""
    sources = [run.source for run in shown.fit]
    return [len(set(sources[:k])) - (source in sources[:k]) for k, source in enumerate(sources)]


def _besides(entry: Finding, findings: Sequence[Finding], files: Sequence[int]) -> dict[str, Any]:
    """Return what else is of an entry's name at other times: loads held one after the other, say; nothing where none.

    An entry has the times of the strongest alone.

    Args:
        entry: of `one_per_name`.
        findings: all.
        files: see `of_files`.
    """
    when = entry.onset, entry.end
    others = [one for one in findings if one.name == entry.name and (one.onset, one.end) != when]
    return {"others": [_at(one, files) for one in others]} if others else {}


def _at(finding: Finding, files: Sequence[int]) -> dict[str, Any]:
    """Return where, how much and when something is."""
    return {
        "joints": list(finding.joints),
        "links": list(finding.links),
        "parameters": {
            key: _estimate(value)
            if isinstance(value, Estimate)
            else {joint: _estimate(each) for joint, each in value.items()}
            for key, value in finding.parameters.items()
        },
        "onset": _moment(finding.onset, files),
        "end": _moment(finding.end, files),
    }


def _effect(finding: Finding, files: Sequence[int]) -> dict[str, Any]:
    what = _at(finding, files)
    return {
        "name": finding.name,
        **{key: what[key] for key in ("joints", "links", "parameters")},
        "confidence": _probability(finding.confidence),
        "alternatives": [
            {
                "name": other.name,
                "joints": list(other.joints),
                **({"links": list(other.links)} if other.links else {}),
                "probability": _probability(other.probability),
            }
            for other in finding.alternatives[:3]
        ],
        **{key: what[key] for key in ("onset", "end")},
    }


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {"value": _value(estimate.value), "std": _value(estimate.std), "unit": estimate.unit}


def _moment(moment: Moment | None, files: Sequence[int]) -> Any:
    if moment is None:
        return None
    time = _time(moment.time)
    return {"log": files[moment.log], "time": time} if max(files) else time


def _place(place: Place, files: Sequence[int]) -> dict[str, Any]:
    result = {
        "joint": place.joint,
        "share": _number(place.share),
        "condition": place.condition,
        "time": [_time(x) for x in place.time],
    }
    # With several logs a time without its log would say nothing.
    return {**result, "log": files[place.log]} if max(files) else result


def _per_joint(joints: Sequence[str], values: Array | None) -> dict[str, Any]:
    return {} if values is None else {joint: _number(x) for joint, x in zip(joints, values, strict=True)}


def _value(value: Any) -> Any:
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_value(x) for x in value]
    return _number(value)


def _time(value: float) -> float:
    """Return a time [s] rounded to the microsecond: a log's own clock may count from 1970, but no log is that exact."""
    return round(float(value), 6)


def _probability(value: float) -> float:
    """Return a probability rounded down, so that those of one effect never add up to more than 1."""
    exact = repr(float(min(1.0, max(0.0, value))))
    return float(Context(prec=DIGITS, rounding=ROUND_FLOOR).create_decimal(exact))


def _number(value: Any) -> float | None:
    number = float(value)
    return float(f"{number:.{DIGITS}g}") if math.isfinite(number) else None
