"""Trains the camera's noise model: deviations of a hand pose from how covered and how bright the hand's image is.

    python sims/train_camera_noise.py

Simulated frames of the arms of seeds 3000 to 3019, their poses held against the truth; a frame is its pose and its
look, as a detector reports them, and is not rendered. Prints the coefficients that
`twin_diagram.estimation.sensors.camera_noise` holds, and how well calibrated they are on ten arms held back.
"""

from __future__ import annotations

import argparse

import numpy as np
from hrt_truth import world
from hrt_truth.hidden import Hidden
from hrt_truth.motion import pick_and_place
from hrt_truth.sensors import Case, sense
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from twin_diagram.estimation.sensors.camera_noise import camera_noise, features
from twin_diagram.signals import Array

DURATION = 20.0
FAR = 5.0
"""A pose this many times farther off than its look explains is of something else."""


def frames(seeds: range) -> tuple[Array, Array]:
    """Looks (K, 2) and errors (K, 2, 3), rotation [rad] and position [m]."""
    looks, errors = [], []
    for seed in seeds:
        case = Case(Hidden.draw(seed, mass=1.0), DURATION)
        streams, truth = sense(case, world.run(case.hidden, *pick_and_place(seed, DURATION)))
        rows = np.searchsorted(truth.time, streams.camera_time - 1e-6)
        hand = truth.hand[rows]
        found = Rotation.from_quat(streams.camera[:, [1, 2, 3, 0]])
        turn = (found * Rotation.from_quat(hand[:, [1, 2, 3, 0]]).inv()).as_rotvec()
        looks.append(streams.camera_look)
        errors.append(np.stack([turn, streams.camera[:, 4:] - hand[:, 4:]], axis=1))
    return np.concatenate(looks), np.concatenate(errors)


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
    good = np.sum(white[:, 1] ** 2, axis=1) < 3.0 * FAR**2
    return np.sqrt(np.mean(white[good] ** 2, axis=(0, 2)))


def main() -> None:
    """Trains and prints."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    coefficients = fit(*frames(range(3000, 3020)))
    print(np.array2string(coefficients, precision=3, separator=", ", suppress_small=True))
    rotation, position = calibration(*frames(range(3020, 3030)), coefficients)
    print(f"RMS error over claimed deviation on arms held back: rotation {rotation:.3f}, position {position:.3f}")


if __name__ == "__main__":
    main()
