"""The gap on the held-out run, worked out anew from `predict`, and the floor that the truth sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfiltfilt

Array = npt.NDArray[np.float64]

CUTOFF = 10.0
CUT = 0.3
HORIZON = 0.01
"""Of the rollouts that `predict` writes too [s]: torques alone are scored, so that nothing long need be rolled out."""

VISIBLE = 2.0
"""A gap is spoken of where it is at least this many noise floors, over all joints."""


def read_columns(path: Path) -> dict[str, Array]:
    """A log's columns by name."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2).T, strict=True))


def stack(columns: dict[str, Array], signal: str, joints: list[str]) -> Array:
    """(N, n) of one signal."""
    return np.stack([columns[f"{signal}.{joint}"] for joint in joints], axis=1)


def low_passed(signal: Array, rate: float) -> Array:
    """As the contract has it: fourth order, 10 Hz, without phase."""
    return np.asarray(sosfiltfilt(butter(4, CUTOFF, fs=rate, output="sos"), signal, axis=0))


def measure(
    given: Path, corrected: Path, log: Path, joints: list[str], signature: Array, scratch: Path
) -> dict[str, Any]:
    """Residual torque of the given and of the corrected model on a run, against what is true of it.

    Args:
        given: model.
        corrected: model that the workflow wrote.
        log: the held-out run.
        joints: in order.
        signature: (N, n) torque that the given model truly lacks, at the log's samples [N·m].
        scratch: folder for predictions.
    """
    from twin_diagram.model.prediction import predict

    columns = read_columns(log)
    time = columns["time"]
    rate = (len(time) - 1) / (time[-1] - time[0])
    inner = (time >= time[0] + CUT) & (time <= time[-1] - CUT)
    torque = stack(columns, "torque_measured", joints)
    rms = {}
    for name, model in (("before", given), ("after", corrected)):
        out = scratch / f"{name}.csv"
        predict(model, log, out, horizon=HORIZON)
        residual = torque - stack(read_columns(out), "torque_predicted", joints)
        rms[name] = np.sqrt(np.mean(low_passed(residual, rate)[inner] ** 2, axis=0))
        if name == "before":
            floor = np.sqrt(np.mean(low_passed(residual - signature, rate)[inner] ** 2, axis=0))
    return {
        "joints": joints,
        "before": rms["before"].tolist(),
        "after": rms["after"].tolist(),
        "floor": floor.tolist(),
        **left_over(rms["before"], rms["after"], floor),
    }


def left_over(before: Array, after: Array, floor: Array) -> dict[str, Any]:
    """What is left of the gap above the noise floor, over all joints in units of their floors."""

    def above(rms: Array) -> float:
        return float(np.sqrt(max(0.0, np.sum((rms**2 - floor**2) / floor**2))))

    whole = above(before)
    return {"gap": whole, "left": above(after) / whole if whole > 0.0 else None, "visible": whole >= VISIBLE}
