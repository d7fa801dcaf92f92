"""Table I of SyncTwin: how much of a displacement the twin follows, by the paper's formulas."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from synctwin_truth.motions import FAR, TURN, Rest
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]
Pose = tuple[Array, Array]


def tracked(objects: Path, asset: str) -> dict[int, Pose]:
    """Return an asset's poses (R, p) in W by picture, as `objects.jsonl` has them; the last one where it has none."""
    poses: dict[int, Pose] = {}
    last: Pose | None = None
    for line in objects.read_text().splitlines():
        row = json.loads(line)
        for one in row["objects"]:
            if one["asset"] == asset:
                last = rotations.matrix(np.array(one["q_WO"])), np.array(one["p_WO"])
        if last is not None:
            poses[int(row["frame"])] = last
    return poses


def angle_between(A: Array, B: Array) -> float:
    """Return the angle [rad] of Aᵀ B, as the paper's 2 arccos |q_w|."""
    return float(np.linalg.norm(rotations.log(rotations.from_matrix(A.T @ B))))


def motion_errors(stops: list[Rest], poses: dict[int, Pose]) -> list[float]:
    """Return e_trans [m] of the three translations, then e_rot [rad] of the three rotations.

    Of a thing that was never found, the whole of it.
    """
    errors = []
    for k, (before, after) in enumerate(pairwise(stops)):
        if before.picture not in poses or after.picture not in poses:
            errors.append(FAR if k < 3 else TURN)
            continue
        (R0, p0), (R1, p1) = poses[before.picture], poses[after.picture]
        if k < 3:
            errors.append(float(np.linalg.norm((after.p - before.p) - (p1 - p0))))
        else:
            errors.append(angle_between(after.R @ before.R.T, R1 @ R0.T))
    return errors


def accuracy(errors: Array) -> tuple[float, float]:
    """Return Acc_trans and Acc_rot (1 − mean error / displacement) of errors (N, 6)."""
    return 1 - float(errors[:, :3].mean()) / FAR, 1 - float(errors[:, 3:].mean()) / TURN


def off_true(stops: list[Rest], poses: dict[int, Pose]) -> list[float]:
    """Return how far orientation is off at each rest [rad], π where it was not found; asset and mesh share axes."""
    return [angle_between(s.R, poses[s.picture][0]) if s.picture in poses else float(np.pi) for s in stops]
