"""Lets a drawn arm run, and writes what the workflow under test may see: description and two logs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from gap_truth import cases
from gap_truth.chain import write_urdf
from gap_truth.world import CONTROL_PERIOD, Controller, DivergedError, Nominal, simulate
from gap_truth.world import Truth as Run

from whole_robots import arms

Array = npt.NDArray[np.float64]


@dataclass
class Robot:
    """One arm and its two runs, without noise.

    Attributes:
        truth: what is true of it.
        fit, holdout: what happened.
        period: of the logs [s].
        noise: of the torque.
        control: that moved it, with the encoders' resolution.
    """

    truth: arms.Truth
    fit: Run
    holdout: Run
    period: float
    noise: cases.Noise
    control: Controller


def make(seed: int, quick: bool, folder: Path) -> Robot:
    """Draws and runs an arm; where it does not get through, another is drawn.

    Raises:
        DivergedError: none got through.
    """
    for attempt in range(12):
        try:
            return _make(seed, quick, folder, np.random.default_rng([seed, 77, attempt]))
        except DivergedError:
            if attempt == 11:
                raise
    raise AssertionError


def _make(seed: int, quick: bool, folder: Path, rng: np.random.Generator) -> Robot:
    chain = arms.arm(rng)
    nominal = Nominal(chain)
    duration = float(np.exp(rng.uniform(np.log(5.0), np.log(12.0 if quick else 60.0))))
    period = float(rng.choice([0.001, 0.002, 0.004, 0.01]))
    speed = rng.uniform(0.3, 0.8)
    kinds = ("multisine", "multisine" if rng.random() < 0.5 else "point_to_point")
    kinds = kinds if rng.random() < 0.6 else kinds[::-1]
    motions = [cases._feasible(nominal, kind, max(duration, 5.0), speed, rng) for kind in kinds]
    scale = cases._scale(nominal, *motions[0])
    truth = arms.draw(chain, scale, duration, seed, rng)
    control, feed = cases._controller(nominal, scale, motions[0][0], truth.unusual, rng)
    truth.setting |= {"duration": duration, "period": period, "motions": "+".join(kinds), "arm": chain.kind}
    every = round(period / CONTROL_PERIOD)
    runs = []
    for afterwards, (motion, torque) in enumerate(motions):
        world = arms.world(truth, duration, bool(afterwards))
        runs.append(simulate(world, control, motion, feed * torque, every, "implicitfast"))
    noise = cases._noise(chain, period, rng)
    if any(thing.name == "payload" for thing in truth.unusual):  # a day before it was put on
        bare = arms.world(replace(truth, unusual=[]), duration, False)
        run = simulate(bare, control, motions[1][0], feed * motions[1][1], every, "implicitfast")
        _write(truth, run, noise, period, folder / "unloaded.csv", rng)
    write_urdf(truth.described, folder / "model.urdf")
    for name, run in (("fit", runs[0]), ("holdout", runs[1])):
        _write(truth, run, noise, period, folder / f"{name}.csv", rng)
    return Robot(truth, runs[0], runs[1], period, noise, control)


def _write(
    truth: arms.Truth, run: Run, noise: cases.Noise, period: float, path: Path, rng: np.random.Generator
) -> None:
    joints, effort = truth.described.joints, truth.described.column("effort")
    time = run.time + rng.normal(size=len(run.time)) * noise.jitter
    step = effort / 2.0**12
    torque = np.round((run.torque + noise.draw(len(time), period, rng)) / step) * step
    header = ",".join(["time", *(f"{s}.{j}" for s in ("position_measured", "torque_measured") for j in joints)])
    np.savetxt(path, np.column_stack([time, run.encoder, torque]), "%.8g", ",", header=header, comments="")
