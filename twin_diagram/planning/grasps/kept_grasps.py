"""Grasps of known objects, kept with the asset: read again as long as object, gripper and question are the same."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.known_object import KnownObject
from twin_diagram.planning.grasps.proposal import Grasps, Wanted, propose_for
from twin_diagram.runtime import atomic_file
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array

VERSION = 2
"""Of how grasps are found and written: counted up when either changes, which makes all that was kept old."""

FOLDER = "grasps"
"""In an asset's folder: one file for each gripper."""


def grasps_of(
    known: KnownObject, gripper: Gripper, *, count: int = 10, seed: int = 0, table: bool = False, keep: bool = True
) -> Grasps:
    """Return the best grasps of a known object.

    Those of an asset are kept in its folder, whole or not at all, one list for each gripper, and found anew once the
    asset, the gripper or what is asked has changed. Where nothing can be written they are just not kept, nor are those
    of the objects that come along: nothing is written into an installation.

    Args:
        known: the object.
        gripper: that is to hold it.
        count: how many.
        seed: of all draws.
        table: whether it stands on a table, upright.
        keep: whether to read and write what is kept.

    Raises:
        GraspError: what is asked cannot be.
    """
    wanted = Wanted(count, seed, triangles=known.triangles)
    key = key_of(known, gripper, count, seed, table)
    folder = known.folder if keep else None
    if folder is not None and folder.resolve().is_relative_to(models_dir().resolve()):
        folder = None
    file = None if folder is None else place_of(folder, gripper)
    if file is not None and (kept := _read(file, key)) is not None:
        return kept
    grasps = propose_for(known.target(seed, table), gripper, wanted)
    if file is not None:
        try:
            atomic_file.write(file, json.dumps({"key": key, **as_json(grasps)}) + "\n")
        except OSError:  # somebody else's library, a disk that is full: it costs time next time, nothing else
            pass
    return grasps


def place_of(folder: Path, gripper: Gripper) -> Path:
    """Return the file in an asset's folder that keeps the grasps for a gripper."""
    return folder / FOLDER / (re.sub(r"[^A-Za-z0-9_-]+", "_", gripper.name)[:64] + ".json")


def key_of(known: KnownObject, gripper: Gripper, count: int, seed: int, table: bool) -> str:
    """Return what grasps depend on, as one word: another one wherever anything of it differs."""
    asked = [VERSION, known.digest, known.mass, asdict(gripper), count, seed, table]
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def as_json(grasps: Grasps) -> dict[str, Any]:
    """Return grasps as lists and numbers that `from_json` turns back to the bit; what is not seen is null."""

    def listed(array: Array) -> list[Any]:
        return [listed(row) if isinstance(row, np.ndarray) else _number(row) for row in array]

    return {
        "poses": listed(grasps.poses),
        "width": listed(grasps.width),
        "score": listed(grasps.score),
        "terms": {name: listed(term) for name, term in grasps.terms.items()},
        "contacts": listed(grasps.contacts),
        "reasons": grasps.reasons,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def from_json(said: dict[str, Any]) -> Grasps:
    """Return what `as_json` was given.

    Raises:
        ValueError, TypeError, KeyError: it is not such a thing.
    """
    count = len(said["score"])

    def array(value: Any, *shape: int) -> Array:
        return np.array(value, dtype=float).reshape(count, *shape)

    return Grasps(
        array(said["poses"], 7),
        array(said["width"]),
        array(said["score"]),
        {str(name): array(term) for name, term in said["terms"].items()},
        array(said["contacts"], 2, 3),
        {str(reason): int(number) for reason, number in said["reasons"].items()},
    )


def _read(file: Path, key: str) -> Grasps | None:
    """Return kept grasps; None where there are none, or for something else, or they are damaged."""
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        return from_json(said) if said["key"] == key else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
