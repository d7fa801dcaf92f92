"""Holds what `twin-diagram gap` says of an arm against what is true of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gap_truth.world import Nominal
from real_references import least_squares
from real_references.regression import equations

from twin_diagram.model.model import Model
from whole_robots.runs import Robot
from whole_robots.separation import separation, with_payload

Array = npt.NDArray[np.float64]

USUAL = {
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "reflected_inertia",
    "torque_bias",
    "torque_constant",
    "inertial_parameters",
}
"""What any arm may lack."""

PERCENTILES = (10, 50, 90)
"""Of a log's speeds, at which friction is compared."""

SLIDING = 0.02
"""Slower, a joint may stick, and what holds it is no friction's curve [rad/s]."""

NEAR = 1e-3
"""As far from one another, points are the same [m]."""

LEVELS = {"torque": 1.0, "torque_positive": 0.5, "torque_negative": 0.5, "coulomb": 1.0}
"""Parameters of dry friction, and their share of the mean of both directions."""


def score(robot: Robot, folder: Path, out: Path) -> dict[str, Any]:
    """All figures of one arm."""
    said = json.loads((out / "gap.json").read_text(encoding="utf-8"))
    corrected = Model.load(out / "model", torque_side="motor")
    true = [thing.name for thing in robot.truth.unusual]
    result: dict[str, Any] = {
        "verdict": said["verdict"],
        "remainder": said["remainder"],
        "names": [effect["name"] for effect in said["effects"]],
        "unusual": true,
        "as_described": robot.truth.as_described,
        "setting": robot.truth.setting,
        "confidences": [[e["name"], e["confidence"], right(e, robot)] for e in said["effects"]],
        "false": [e["name"] for e in said["effects"] if e["name"] not in USUAL and e["name"] not in true],
        "found": all(any(e["name"] == name and right(e, robot) for e in said["effects"]) for name in true),
        "separation": separation(robot, folder) if true else None,
        "separation_white": separation(robot, folder, plain=True) if true else None,
        "held_out": held_out(folder, said),
    }
    if not robot.truth.as_described:
        result["friction"] = friction(robot, corrected, said)
        result["rotors"] = rotors(robot, corrected)
        result["payload"] = payload(robot, said)
    return result


def right(effect: dict[str, Any], robot: Robot) -> bool:
    """Whether a name is true of all the places that it is said of."""
    truth, name = robot.truth, effect["name"]
    at = [truth.described.joints.index(joint) for joint in effect["joints"]]
    if truth.as_described:
        return False
    if name == "load_dependent_friction":
        return all(truth.friction.shape[j] == "load" for j in at)
    if name == "reflected_inertia":
        return all(truth.real.links[j].rotor != truth.described.links[j].rotor for j in at)
    if name == "torque_bias":
        return all(truth.offset[j] != 0.0 or truth.friction.shape[j] == "asymmetric" for j in at)
    if name == "torque_constant":
        return all(truth.gain[j] != 1.0 for j in at)
    if name in USUAL:
        return True
    for thing in truth.unusual:
        links = [] if thing.link is None else [truth.described.link_names[thing.link]]
        if thing.name == name:
            same = not links or effect["links"] == links or (name == "external_force" and carried(effect, robot))
            return sorted(at) == sorted(thing.joints) and same
    return False


def carried(effect: dict[str, Any], robot: Robot) -> bool:
    """Whether a force is told at a point that an inner link carries and that is the origin of the link pushed.

    What lies on the axis of the joint between moves with either link, and the force turns that joint by nothing: no
    log tells one from the other, and the contract takes the innermost. A Panda's links 5 and 6 have one origin.
    """
    (thing,) = [thing for thing in robot.truth.unusual if thing.name == "external_force"]
    chain, told = robot.truth.described, effect["parameters"]
    if np.any(thing.values["wrench"][3:]) or np.any(told["wrench"]["value"][3:]):
        return False
    point = np.zeros(3)
    for k in range(thing.link or 0, 0, -1):
        if np.linalg.norm(np.cross(chain.links[k].axis, point)) > NEAR:
            return False
        point = chain.links[k].position + chain.links[k].rotation @ point
        if effect["links"] == [chain.link_names[k - 1]]:
            off = np.abs(point - told["point"]["value"])
            return bool(np.all(off <= NEAR + 3.0 * np.array(told["point"]["std"])))
    return False


def friction(robot: Robot, corrected: Model, said: dict[str, Any]) -> list[dict[str, float]]:
    """Per joint and percentile of its speed while it slides: friction there, what is said of it, its standard error.

    Friction that grows with the load is compared at the log's load.
    """
    run, laws = robot.fit, robot.truth.friction
    home = np.median(run.q, axis=0)
    load = np.sqrt(np.mean(run.torque**2, axis=0))[None]
    result = []
    for j, joint in enumerate(robot.truth.described.joints):
        speeds = np.abs(run.v[:, j])
        speeds = speeds[speeds > SLIDING]
        for percent in PERCENTILES if len(speeds) else ():
            v = np.zeros((3, len(home)))
            v[:, j] = np.percentile(speeds, percent) * np.array([1.0, -1.0, 0.0])
            both = corrected.inverse_dynamics(np.stack([home] * 3), v, np.zeros_like(v))[:, j]
            true = np.concatenate([laws.sliding(v[k : k + 1], load) for k in range(2)])[:, j]
            std, more = 0.0, 0.0
            for effect in said["effects"]:
                told = {key: value[joint] for key, value in effect["parameters"].items() if joint in value}
                if effect["name"] == "load_dependent_friction" and told:
                    coefficient = told["coefficient"]
                    more = coefficient["value"] * (load[0, j] - abs(both[2]))
                    std = float(np.hypot(std, load[0, j] * coefficient["std"]))
                elif "friction" in effect["name"]:
                    parts = [LEVELS[key] * one["std"] for key, one in told.items() if key in LEVELS]
                    parts += [v[0, j] * one["std"] for key, one in told.items() if key == "damping"]
                    std = float(np.linalg.norm([std, *parts]))
            true, curve = 0.5 * (true[0] - true[1]), 0.5 * (both[0] - both[1]) + more
            result.append({"joint": j, "percent": percent, "true": float(true), "said": float(curve), "std": std})
    return result


def rotors(robot: Robot, corrected: Model) -> list[list[float]]:
    """Per joint: inertia about its own axis at the middle of the motion, true and as corrected [kg·m²]."""
    home = np.median(robot.fit.q, axis=0)
    true = np.diag(Nominal(with_payload(robot)).inertia(home))
    said = np.diag(corrected.mass_matrix(home))
    return [[float(x) for x in pair] for pair in zip(true, said, strict=True)]


def payload(robot: Robot, said: dict[str, Any]) -> list[float]:
    """Mass that is true, said, and its standard error [kg]: 0 where none is said; empty where there is none."""
    true = [thing.values["mass"][0] for thing in robot.truth.unusual if thing.name == "payload"]
    told = [e["parameters"]["mass"] for e in said["effects"] if e["name"] == "payload"]
    return [true[0], *((told[0]["value"], told[0]["std"]) if told else (0.0, 0.0))] if true else []


def held_out(folder: Path, said: dict[str, Any]) -> dict[str, float]:
    """The held-out residual over that of an estimator that is told the structure, mean over joints."""
    model = folder / "model.urdf"
    seen, unseen = (equations(model, folder / f"{name}.csv", "motor") for name in ("fit", "holdout"))
    told = unseen.left(least_squares.physical(seen))
    rms = said["gap"]["torque_rms"]["holdout"]
    before, after = (np.array(list(rms[when].values())) for when in ("before", "after"))
    return {"over_told": float(np.mean(after / told)), "over_description": float(np.mean(after / before))}
