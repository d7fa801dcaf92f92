"""What is kept of a swinging arm: its messages, what was in the hand, and when that slipped."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram.logs.measured_log import Log
from twin_diagram.runtime import atomic_file
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    told: float = 5e-5
    """By which fingers have moved in the end where they tell when what they hold slipped [m]: they breathe by 2 µm
    while nothing slips, and a bottle that turned by 2° let them together by 0.17 mm."""

    ends: float = 0.03
    """Share of the time at either end over which their opening is taken."""

    far: tuple[float, float] = (0.010, 0.17)
    """From such a slide on a thing is swung once more [m], [rad]: creeping is less, and what slid once by as much is
    about to fall."""

    too_far: tuple[float, float] = (0.030, 0.5)
    """From such a slide on torques tell the mass alone [m], [rad]: with slips of 4 to 26 mm 95 % of told intervals
    held; of a bottle that slid by 36 mm and 38° a moment was told as 79 ± 23 % more than it is."""


TUNING = Tuning()


@dataclass(frozen=True)
class Swung:
    """A log of the swinging arm, and what was in the hand.

    Attributes:
        log: the arm's messages.
        fingers: where they stood, by the names of their joints [m].
        X_TS: (4, 4) of the object's frame S in the tool, in the middle of the way that it slipped meanwhile; the
            identity where the hand was empty.
        slip: by how much it slipped from the begin to the end [m], [rad].
        way: (N,) where on that way it was at each message, from -1 to 1; None: nobody knows, steadily.
    """

    log: Log
    fingers: dict[str, float]
    X_TS: Array
    slip: tuple[float, float] = (0.0, 0.0)
    way: Array | None = None


def slid_by(swung: Swung, far: tuple[float, float] = TUNING.far) -> float:
    """Return how far what was swung slid or turned in the fingers, as a share of what is called far."""
    return max(swung.slip[0] / far[0], swung.slip[1] / far[1])


def way_slipped(time: Array, noted: Array) -> Array | None:
    """Return where on its way what slipped in the hand was, from -1 to 1, by the fingers; None: they do not tell.

    What is round lets the fingers together as it turns between them, and what tapers as it slides: mostly all at once.

    Args:
        time: (N,) at which it is asked for [s].
        noted: (K, 2) times, and the fingers' opening then [s], [m].
    """
    few = max(1, int(TUNING.ends * len(noted)))
    begin, end = np.median(noted[:few, 1]), np.median(noted[-few:, 1])
    if abs(end - begin) < TUNING.told:
        return None
    share = np.clip((noted[:, 1] - begin) / (end - begin), 0.0, 1.0)
    return np.asarray(np.interp(time, noted[:, 0], 2.0 * share - 1.0))


def write_swung(path: Path, swung: Swung) -> None:
    """Write a log, whole."""
    data = io.BytesIO()
    log = swung.log
    assert log.velocity is not None and log.torque is not None
    np.savez(
        data,
        time=log.time,
        position=log.position,
        velocity=log.velocity,
        torque=log.torque,
        joints=np.array(log.joints),
        finger_names=np.array(list(swung.fingers)),
        fingers=np.array(list(swung.fingers.values())),
        X_TS=swung.X_TS,
        slip=np.array(swung.slip),
        way=np.zeros(0) if swung.way is None else swung.way,
    )
    atomic_file.write(path, data.getvalue())


def read_swung(path: Path) -> Swung:
    """Return the inverse of `write_swung`."""
    with np.load(path, allow_pickle=False) as data:
        joints = tuple(str(name) for name in data["joints"])
        fingers = dict(zip((str(name) for name in data["finger_names"]), data["fingers"].tolist(), strict=True))
        log = Log(
            data["time"],
            joints,
            data["position"],
            velocity=data["velocity"],
            torque=data["torque"],
            source=f"{path.parent.name}/{path.name}",
        )
        slip = data["slip"] if "slip" in data.files else np.zeros(2)
        way = data["way"] if "way" in data.files and len(data["way"]) else None
        return Swung(log, fingers, data["X_TS"], (float(slip[0]), float(slip[1])), way)


def slipped(swung: Swung, X_TS: Array) -> Swung:
    """Return what was swung with where the object was found in the tool (4, 4) afterwards."""
    turn = Rotation.from_matrix(swung.X_TS[:3, :3].T @ X_TS[:3, :3]).as_rotvec()
    middle = np.eye(4)
    middle[:3, :3] = swung.X_TS[:3, :3] @ Rotation.from_rotvec(0.5 * turn).as_matrix()
    middle[:3, 3] = 0.5 * (swung.X_TS[:3, 3] + X_TS[:3, 3])
    way = float(np.linalg.norm(X_TS[:3, 3] - swung.X_TS[:3, 3]))
    return replace(swung, X_TS=middle, slip=(way, float(np.linalg.norm(turn))))
