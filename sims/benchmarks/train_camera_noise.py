"""Trains the camera's noise model: deviations of a pose from how covered and how bright the object's image is.

    python sims/benchmarks/train_camera_noise.py  # some minutes
    # keeps the frames, and reads them again where they are there
    python sims/benchmarks/train_camera_noise.py --frames f.npz

Frames of the simulated RGB-D camera are rendered and registered (`camera_frames`), poses held against the truth.
Prints the coefficients that `twin_diagram.estimation.sensors.camera_noise_regressor` holds, how well calibrated they
are on
frames held back, and what those frames themselves say by look: the table `hrt_truth.sensors.MEASURED`, which the
simulated streams of `hrt_tables` follow. Needs EGL.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from twin_diagram.estimation.sensors.camera_noise_regressor import (
    TUNING as CAMERA_NOISE_REGRESSOR,
)
from twin_diagram.estimation.sensors.camera_noise_regressor import (
    camera_noise,
    features,
)
from twin_diagram.signals.arrays import Array

TRAINING, HELD_BACK = 3000, 3001
"""Seeds."""
ARRANGEMENTS = {TRAINING: 200, HELD_BACK: 130}
FAR = 5.0
"""A pose this many times farther off than its look explains is of something else."""
COVERED = (0.0, 0.12, 0.3, 0.5, 0.7, 1.0)
BRIGHTNESS = (0.0, 0.1, 0.25, 0.6, 1.0)
"""Edges of the table's bins."""
FEWEST = 8
"""Frames that say something of a bin."""


def frames(seed: int) -> tuple[Array, Array]:
    """Looks (K, 2) and errors (K, 2, 3), rotation [rad] and position [m], of rendered frames."""
    from camera_frames import Studio

    looks, errors = [], []
    for seen in Studio().frames(seed, ARRANGEMENTS[seed]):
        looks.append([seen.covered, seen.brightness])
        errors.append([seen.turn, seen.shift])
        if len(looks) % 100 == 0:
            print(f"seed {seed}: {len(looks)} frames", flush=True)
    return np.array(looks), np.array(errors)


def kept(seed: int, path: Path | None) -> tuple[Array, Array]:
    """Frames from a file where there is one; it is written otherwise."""
    if path is None:
        return frames(seed)
    file = path.with_name(f"{path.stem}_{seed}.npz")
    if not file.exists():
        looks, errors = frames(seed)
        part = file.with_suffix(f".{os.getpid()}.part.npz")
        np.savez(part, looks=looks, errors=errors)
        part.replace(file)
    with np.load(file, allow_pickle=False) as data:
        return data["looks"], data["errors"]


def fit(looks: Array, errors: Array) -> Array:
    """Coefficients (2, F) of greatest likelihood; what is of something else is left out, found from the fit itself."""
    X = np.array([features(*look) for look in looks])
    result = []
    for part in (0, 1):
        square = np.sum(errors[:, part] ** 2, axis=1)
        good = np.ones(len(square), dtype=bool)
        weights = np.zeros(X.shape[1])
        weights[0] = 0.5 * np.log(np.median(square) / 3.0)
        for _ in range(4):

            def cost(w: Array, Z: Array = X[good], s: Array = square[good]) -> tuple[float, Array]:
                white = s * np.exp(-2.0 * (Z @ w))
                return float(np.mean(3.0 * (Z @ w) + 0.5 * white)), Z.T @ (3.0 - white) / len(Z)

            weights = minimize(cost, weights, jac=True, method="L-BFGS-B").x
            good = square * np.exp(-2.0 * (X @ weights)) < 3.0 * FAR**2
        result.append(weights)
    return np.array(result)


def calibration(looks: Array, errors: Array, coefficients: Array) -> Array:
    """(2,) RMS of errors over the deviations claimed, of those frames that are no outliers: 1 is honest."""
    std = np.array([camera_noise(*look, coefficients=coefficients) for look in looks]).reshape(-1, 2, 3)
    white = errors / std
    good = np.sum(white**2, axis=2) < 3.0 * FAR**2
    return np.array([np.sqrt(np.mean(white[good[:, part], part] ** 2)) for part in (0, 1)])


def likelihood(looks: Array, errors: Array, coefficients: Array) -> float:
    """Mean log density of the errors; poses of something else count as `FAR` deviations off."""
    std = np.exp(np.array([coefficients @ features(*look) for look in looks]))[:, :, None]
    white = np.minimum((errors / std) ** 2, FAR**2)
    return float(np.mean(np.sum(-0.5 * white - np.log(std), axis=(1, 2))))


def by_look(looks: Array, errors: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """What frames say of each look, by bins of covered share and brightness.

    Args:
        looks: (K, 2).
        errors: (K, 2, 3).
        coefficients: (2, 5) of the law; what is `FAR` times farther off than it claims is of something else.

    Returns:
        (C,) and (B,) mean covered share and brightness of the frames in each row and column; (C, B, 2) RMS of errors
        over what the law claims, 1 where it is honest, NaN for few frames; (C, B, 2) deviations over those of a good
        look: the claim at the bin's mean look, times that.
    """
    white = np.mean(errors**2, axis=2) / np.exp(2.0 * np.array([coefficients @ features(*look) for look in looks]))
    rows = np.clip(np.searchsorted(COVERED, looks[:, 0], side="right") - 1, 0, len(COVERED) - 2)
    columns = np.clip(np.searchsorted(BRIGHTNESS, looks[:, 1], side="right") - 1, 0, len(BRIGHTNESS) - 2)
    covered = np.array([_mean(looks[rows == i, 0]) for i in range(len(COVERED) - 1)])
    brightness = np.array([_mean(looks[columns == j, 1]) for j in range(len(BRIGHTNESS) - 1)])
    honest = np.full((len(covered), len(brightness), 2), np.nan)
    claims = np.empty_like(honest)
    for i, c in enumerate(covered):
        for j, b in enumerate(brightness):
            claims[i, j] = np.exp(coefficients @ features(c, b))
            inside = white[(rows == i) & (columns == j)]
            if len(inside) >= FEWEST:
                honest[i, j] = np.sqrt(np.nanmean(np.where(inside < FAR**2, inside, np.nan), axis=0))
    table = claims * honest
    good = table[0, int(np.searchsorted(BRIGHTNESS, CAMERA_NOISE_REGRESSOR.good[1], side="right") - 1)]
    return covered, brightness, honest, table / good


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else np.nan


def main() -> None:
    """Trains and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, help="keep rendered frames' looks and errors beside this file's name")
    given = parser.parse_args()
    coefficients = fit(*kept(TRAINING, given.frames))
    print(np.array2string(coefficients, precision=3, separator=", ", suppress_small=True))
    looks, errors = kept(HELD_BACK, given.frames)
    rotation, position = calibration(looks, errors, coefficients)
    print(f"RMS error over claimed deviation on frames held back: rotation {rotation:.3f}, position {position:.3f}")
    constant = np.zeros_like(coefficients)
    constant[:, 0] = np.log(np.sqrt(np.mean(errors**2, axis=(0, 2))))
    gain = likelihood(looks, errors, coefficients) - likelihood(looks, errors, constant)
    print(f"log likelihood per frame above that of one deviation for all looks: {gain:.2f}")
    covered, brightness, honest, table = by_look(looks, errors, coefficients)
    print(f"mean covered share of the rows {covered.round(3)}, brightness of the columns {brightness.round(3)}")
    print("errors over claims by look, rotation then position:")
    print(np.array2string(honest.transpose(2, 0, 1), precision=2, separator=", "))
    print("deviation over that of a good look:")
    print(np.array2string(table.transpose(2, 0, 1), precision=2, separator=", "))


if __name__ == "__main__":
    main()
