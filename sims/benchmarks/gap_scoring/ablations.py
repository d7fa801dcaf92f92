"""Three simpler ways to the same end, on the same cases: what the workflow's care is worth.

- `greedy_bic`: forward selection by the Bayesian information criterion alone, every sample counted as independent.
- `stlsq`: sparse regression by sequentially thresholded least squares (Brunton and others 2016), of pysindy.
- `mujoco_sysid`: MuJoCo's own toolbox fits all parameters that its model has; those that move are its names.

The first two choose from `gap_truth.explanations`, which is the catalogue as the benchmark itself writes it. None of
them can abstain: each names what it keeps.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfiltfilt

from gap_scoring.regressions import KEPT, Answer, greedy_bic, read, stlsq
from gap_scoring.sysid import mujoco_sysid

Array = npt.NDArray[np.float64]

METHODS: dict[str, Callable[[Path], Answer]] = {
    "greedy_bic": greedy_bic,
    "stlsq": stlsq,
    "mujoco_sysid": mujoco_sysid,
}


def floors(folder: Path, signature: Array) -> tuple[Array, Array]:
    """RMS below 10 Hz per joint of the given model's held-out residual, without and with the truth in it."""
    held = read(folder, "holdout.csv")
    n = held.setting.chain.n
    return _rms(held.residual, n), _rms(held.residual - held.reduce(signature), n)


def _rms(residual: Array, n: int) -> Array:
    low = sosfiltfilt(butter(4, 10.0, fs=KEPT, output="sos"), residual.reshape(-1, n), axis=0)
    return np.asarray(np.sqrt(np.mean(low**2, axis=0)))


def missing_method(name: str) -> str:
    """Why a method cannot run here; empty: it can."""
    try:
        if name == "stlsq":
            importlib.import_module("pysindy.optimizers")
        if name == "mujoco_sysid" and not hasattr(importlib.import_module("mujoco.sysid"), "optimize"):
            return "mujoco.sysid lacks its requirements: pip install 'mujoco[sysid]'"
    except ImportError as error:
        return str(error)
    return ""


def run_method(name: str, folder: Path, joints: int) -> tuple[dict[str, Any], Array, float]:
    """An answer as a `gap.json`, its held-out RMS per joint below 10 Hz, and its processor seconds."""
    begin = time.process_time()
    answer = METHODS[name](folder)
    used = time.process_time() - begin
    verdict = "named" if answer.effects else "none"
    return {"verdict": verdict, "effects": answer.effects}, _rms(answer.residual, joints), used
