"""What a run of learning took, where it left things, and what its motions could tell at best."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.signal import savgol_filter

from twin_diagram.estimation.weighing import Shape, WeighingError, crlb
from twin_diagram.model import Model
from twin_diagram.runs.learning.record import EVENTS, OBJECTS, STATE, SWUNG
from twin_diagram.runs.learning.swung_log import read_swung
from twin_diagram.scenario import Scenario

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    size: tuple[float, float, float] = (0.06, 0.09, 0.175)
    """Of the reference object, its thinnest axis between the fingers [m]: the issue's."""

    mass: float = 0.5
    """Of it [kg]."""

    noise: float = 0.05
    """Of its torques [N·m], a hundred a second."""

    smooth: int = 21
    """Messages over which positions are smoothed to become accelerations: 0.1 s, beside a period of 0.67 s."""

    tall: float = 0.3
    """Above a bin's bottom what lies in it has its origin lower than this [m]."""


TUNING = Tuning()


def bound_of(model: Model, swung: Path) -> list[float] | None:
    """Return what the motion of a kept log could tell at best of the reference object; None: nothing of some figure.

    Args:
        model: the arm.
        swung: file of the log.

    Returns:
        Standard errors of the mass as a share, of the worst of the centre's [m], of the worst moment as a share.
    """
    log = read_swung(swung).log
    step = float(np.median(np.diff(log.time)))
    even = np.arange(log.time[0], log.time[-1], step)
    q = np.stack([np.interp(even, log.time, column) for column in log.position.T], axis=1)
    motion = tuple(
        savgol_filter(q, TUNING.smooth, 4, deriv=order, delta=step, axis=0)[:: max(1, round(0.01 / step))]
        for order in range(3)
    )
    X_TO = RigidTransform(RollPitchYaw(0.0, 0.0, np.pi / 2), np.zeros(3))
    even_box = Shape.box(np.array(TUNING.size)).even(TUNING.mass)
    try:
        bound = crlb(model, X_TO, even_box, (motion[0], motion[1], motion[2]), TUNING.noise)
    except WeighingError:
        return None
    return [bound.mass, float(bound.centre.max()), float(bound.moments.max())]


def events_of(out: Path) -> list[dict[str, Any]]:
    """Return the events of a run."""
    return [json.loads(line) for line in (out / EVENTS).read_text(encoding="utf-8").splitlines()]


def times_of(events: list[dict[str, Any]], name: str) -> dict[str, float]:
    """Return what an object took in all its stages, of the cell's time and by the clock [s]."""
    own = [event for event in events if event.get("object") == name and "took" in event]
    return {"sim_s": sum(event["sim"] for event in own), "wall_s": sum(event["took"] for event in own)}


def extras_of(model: Model, out: Path, name: str) -> dict[str, Any]:
    """Return what an object took, and the bound of its motion where it was swung."""
    swung = out / OBJECTS / name / SWUNG
    return times_of(events_of(out), name) | {"bound": bound_of(model, swung) if swung.is_file() else None}


def run_row(scenario: Scenario, out: Path, places: dict[str, Array]) -> dict[str, Any]:
    """Return where a run left its objects, and how many contacts there were that no step asked for.

    Args:
        scenario: of it.
        out: its folder.
        places: (3,) of the true objects at its end in W, by name.
    """
    learning = scenario.twin.learning
    assert learning is not None
    events = events_of(out)

    def inside(place: Array, box: list[list[float]]) -> bool:
        low, high = (np.array(corner) for corner in box)
        return bool((place[:2] > low[:2]).all() and (place[:2] < high[:2]).all() and place[2] < low[2] + TUNING.tall)

    away = [name for name, place in places.items() if inside(place, learning.into_bin)]
    left = [name for name, place in places.items() if inside(place, learning.from_bin)]
    return {
        "objects": len(places),
        "put_away": len(away),
        "left": len(left),
        "elsewhere": len(places) - len(away) - len(left),
        "contacts": sum(event["stage"] == "contact" for event in events),
        "reported": sum(event["stage"] in ("report", "give up") for event in events),
        "sim_s": max((event["at"] for event in events if "at" in event), default=0.0),
    }


def final_positions(out: Path) -> Array:
    """Return the positions (nq,) of the world's plant at a run's end."""
    with np.load(out / STATE, allow_pickle=False) as data:
        return np.asarray(data["world_positions"])
