"""A carry that a camera watches: the tool goes across the table, and what it holds may slip on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.tasks.in_hand import Eye, HeldImage, InHand, after_image, closed_on
from twin_diagram.planning.tasks.slips import slipped
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CalibrationError, pose_shifts
from twin_diagram.signals.pose_vectors import compose

PERIOD = 1.0 / 15.0
DOWN = np.array([0.0, 1.0, 0.0, 0.0])
R_WC = np.array([[0.0, -0.6, -0.8], [1.0, 0.0, 0.0], [0.0, -0.8, 0.6]])
SHEET = CalibrationError(shift=0.005, turn=0.0087, focal=0.003, centre=1.0, depth_scale=0.01)
"""What is told of a D435."""
FOUND = CalibrationError(shift=0.0033, turn=0.0026, focal=0.0023, centre=0.95, depth_scale=0.0019)
"""What is left of that once it was calibrated by the arm, as in the demo."""
EXACT = CalibrationError()


@dataclass(frozen=True)
class Carry:
    """What is true of a carry of 3 s over 0.6 m, at 0.5 m/s at most.

    Attributes:
        seed: of the noise and the camera's errors.
        noise: of an image's pose [rad], [m].
        waves: the same of what lasts for half a second.
        late: by how much depth is late [s].
        camera: by how much the camera may be off.
        slip: (6) by which the object moves in the hand, (φ, δp) in T …
        at: … between these times [s].
    """

    seed: int = 0
    noise: tuple[float, float] = (0.02, 0.0015)
    waves: tuple[float, float] = (0.01, 0.001)
    late: float = 0.033
    camera: CalibrationError = FOUND
    slip: tuple[float, ...] = (0.0,) * 6
    at: tuple[float, float] = (1.5, 1.7)

    def tool(self, time: float) -> Array:
        """Return X_WT (7) at a time: at rest, carried across with a turn of the hand, at rest again."""
        s = np.clip((time - 0.3) / 2.4, 0.0, 1.0)
        smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        q = rotations.multiply(rotations.exp(np.array([0.0, 0.0, 0.8 * smooth])), DOWN)
        return np.array([*q, 0.5 + 0.1 * smooth, -0.3 + 0.6 * smooth, 0.2])

    def lies(self, time: float) -> Array:
        """Return X_TO (7) at a time, in truth."""
        share = np.clip((time - self.at[0]) / (self.at[1] - self.at[0]), 0.0, 1.0)
        by = share * np.array(self.slip)
        return np.array([*rotations.multiply(rotations.exp(by[:3]), DOWN), *([0.004, 0.0, 0.02] + by[3:])])

    def eye(self) -> Eye:
        """Return the camera as it is told."""
        where = np.array([1.4, 0.0, 0.85]), R_WC, (300.0, 300.0)
        return Eye(*where, np.zeros(10), np.diag(self.camera.variances))

    def watched(self, told_of_camera: bool = True) -> tuple[InHand, list[tuple[float, float]]]:
        """Return what is known at the end, and the slips that were told."""
        rng, eye = np.random.default_rng([77, self.seed]), self.eye()
        errors = np.sqrt(np.diagonal(eye.covariance)) * rng.standard_normal(10)
        noise, waves = np.repeat(self.noise, 3), np.repeat(self.waves, 3)
        wave, keep = waves * rng.standard_normal(6), float(np.exp(-PERIOD / 0.5))

        def shown(time: float) -> Array:
            past = compose(self.tool(time - self.late), self.lies(time - self.late))
            p_CO = (past[4:] - eye.p_WC) @ R_WC
            off = pose_shifts(p_CO[None], R_WC, *eye.focal)[0] @ errors + wave + noise * rng.standard_normal(6)
            return np.array([*rotations.multiply(rotations.exp(off[:3]), past[:4]), *(past[4:] + off[3:])])

        covariance = np.diag(noise**2 + waves**2)
        # Seen for a while before: what lasts stays, and what the camera is off by.
        R_WT = rotations.matrix(self.tool(0.0)[:4])
        turn = np.kron(np.eye(2), R_WT.T)
        first = compose(self.tool(0.0), self.lies(0.0))
        J = pose_shifts(((first[4:] - eye.p_WC) @ R_WC)[None], R_WC, *eye.focal)[0]
        by = turn @ (J @ errors + wave)
        X_TO = self.lies(0.0)
        closed = np.array([*rotations.multiply(rotations.exp(by[:3]), X_TO[:4]), *(X_TO[4:] + by[3:])])
        closed[5] = X_TO[5]  # the fingers put it in their middle
        shared = J @ eye.covariance @ J.T + np.diag(waves**2)
        given = eye if told_of_camera else None
        known = closed_on(closed, turn @ shared @ turn.T, self.tool(0.0), given, 0.0)
        told = []
        for k in range(1, 46):
            time = k * PERIOD
            wave = keep * wave + np.sqrt(1.0 - keep**2) * waves * rng.standard_normal(6)
            X_WT, step = self.tool(time), 0.5 * PERIOD
            before, after = self.tool(time - step), self.tool(time + step)
            V = np.concatenate([rotations.difference(after[:4], before[:4]), after[4:] - before[4:]]) / (2 * step)
            known = after_image(known, HeldImage(time, shown(time), covariance, X_WT, V), given)
            known, one = slipped(known)
            told += [one] if one is not None else []
        return known, told
