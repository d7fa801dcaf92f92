"""One object weighed in every way that the tables compare."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from twin_diagram.estimation.weighing import (
    ArmDoubt,
    EmptyRun,
    ExcitationPlan,
    LoadedRun,
    ShapePrior,
    Weighing,
    WeighingError,
    crlb,
    weigh,
)
from twin_diagram.model.rigid_body.mass_properties import about_centre
from weighing_truth import world
from weighing_truth.objects import Thing, draw, principal

Array = np.ndarray
NOISES = (0.05, 0.2)
"""Of the torques, at 200 a second [N·m]."""
ABLATIONS = (
    *("no gain calibration", "no shape prior", "published excitation"),
    *("arm calibrated before", "gains told exactly"),
)
ALIKE = 0.3
"""Axes are compared where moments differ by this share."""


def run(seed: int, torque_side: str, quick: bool) -> list[dict[str, Any]]:
    """Results of one seed: for each noise, as it is done and with each ablation."""
    random = np.random.default_rng(seed)
    thing = draw(random)
    X_TO = world.grasp(thing.size, random)
    motor, model = world.arm("motor"), world.arm(torque_side)
    X_true = world.moved(X_TO, random)
    about = thing.told.even(float(thing.parameters[0]))
    steps = {"starts": 1, "steps": 35} if quick else {"starts": 1, "steps": 70}
    start = time.process_time()
    try:
        motion = world.excite(motor, X_TO, about, 60.0, ExcitationPlan(seed=seed, **steps))
        planned = time.process_time() - start
        plain = world.excite(motor, X_TO, about, 60.0, ExcitationPlan(harmonics=5, seed=seed, **steps))
    except WeighingError as error:
        return [{"seed": seed, "failed": str(error)}]
    told = _described(thing, seed) | {"plan_cpu": planned, "scale": motion.scale}
    told |= _bound(motor, motion, X_true, thing)
    rows = []
    for noise in NOISES:
        sensors = world.Sensors.draw(random, noise, len(model.joints))
        logs = {
            which: (
                world.record(model, one, sensors, random, (X_true, thing.parameters)),
                world.record(model, one, sensors, random),
            )
            for which, one in (("ours", motion), ("plain", plain))
        }
        prior, doubt = ShapePrior(thing.told), ArmDoubt.of_side(torque_side)
        alone, scale = world.calibration(model, sensors, np.random.default_rng([seed, 1])), 1.0 + sensors.gain
        logs["exact"] = tuple(replace(log, torque=log.torque / scale) for log in logs["ours"])
        ways = {
            "ours": ("ours", prior, doubt),
            "arm calibrated before": ("ours", prior, doubt),
            "gains told exactly": ("exact", prior, replace(doubt, gain=1e-6)),
            "no gain calibration": ("ours", prior, replace(doubt, gain=1e-6)),
            "no shape prior": ("ours", ShapePrior.none(thing.told), doubt),
            "published excitation": ("plain", prior, doubt),
        }
        for name, (which, shape, arm) in ways.items():
            loaded, *empty = logs[which]
            runs = [EmptyRun(log) for log in (empty + [alone] if name == "arm calibrated before" else empty)]
            start = time.process_time()
            found = weigh(model, [LoadedRun(loaded, X_TO)], runs, shape, torque_side, arm)
            spent = {"cpu": time.process_time() - start, "noise": noise, "way": name}
            gains = {"gain_z": ((found.gain - sensors.gain) / found.gain_std).tolist()}
            rows.append(told | spent | gains | score(found, thing))
    return rows


def score(found: Weighing, thing: Thing) -> dict[str, Any]:
    """Errors of an estimate, and of even density in the told shape with the measured mass."""
    mass, centre, _ = about_centre(thing.parameters)
    moments, axes = principal(thing.parameters)
    own_moments, own_axes = principal(found.parameters)
    even, _ = principal(thing.told.even(found.mass))
    low, high = found.interval()
    angles = np.degrees(np.arccos(np.clip(np.abs(np.sum(axes * own_axes, axis=0)), 0.0, 1.0)))
    gap = np.diff(moments) / moments[:-1]
    apart = [gap[0] >= ALIKE, min(gap) >= ALIKE, gap[1] >= ALIKE]
    return {
        "mass": float(abs(found.mass / mass - 1.0)),
        "centre": float(np.linalg.norm(found.centre - centre)),
        "moment": float(np.max(np.abs(own_moments / moments - 1.0))),
        "even": float(np.max(np.abs(even / moments - 1.0))),
        "axis": float(max((a for a, b in zip(angles, apart, strict=True) if b), default=np.nan)),
        "held": ((low <= thing.parameters) & (thing.parameters <= high)).tolist(),
        "moments_held": (np.abs(found.moments - moments) <= 1.96 * found.errors["moments"]).tolist(),
        "verdicts": list(found.verdicts.values()),
    }


def _described(thing: Thing, seed: int) -> dict[str, Any]:
    return {
        "seed": seed,
        "kind": thing.kind,
        "load": thing.load,
        "kg": float(thing.parameters[0]),
        "off_centre": thing.off_centre,
    }


def _bound(motor: Any, motion: Any, X_TO: Any, thing: Thing) -> dict[str, Any]:
    bound = crlb(motor, X_TO, thing.parameters, motion.sampled(100.0)[1], 0.05)
    return {"bound": [bound.mass, float(bound.centre.max()), float(bound.moments.max())]}
