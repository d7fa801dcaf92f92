"""A growth as a file, for a process of its own; and a partial thing as one, for people."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np

from twin_diagram.assets.building.growth import Growth, PartialThing, Support
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.runtime import atomic_file


def free_name(library: Path, identity: int, taken: Container[str]) -> str:
    """Return a name for the asset that a thing becomes, which neither `taken` nor the library has: `thing_N`.

    Args:
        library: folder of assets, which may be missing.
        identity: of the thing; N is the first free number from it on.
        taken: names of the assets that are in use.
    """
    number = identity
    while (name := f"thing_{number}") in taken or (library / name).exists():
        number += 1
    return name


def write_growth(path: Path, growth: Growth) -> None:
    """Write pictures, cameras and masks as one .npz; cameras of colour and depth are one."""
    told: dict[str, Any] = {"count": np.array(len(growth))}
    for k, (frame, direction, support) in enumerate(
        zip(growth.frames, growth.directions, growth.supports, strict=True)
    ):
        c = frame.camera
        told[f"depth{k}"], told[f"mask{k}"], told[f"direction{k}"] = frame.depth, frame.mask, direction
        if frame.rgb is not None:
            told[f"rgb{k}"] = frame.rgb
        told[f"camera{k}"] = np.array([c.width, c.height, c.fx, c.fy, c.cx, c.cy, *c.R_WC.ravel(), *c.p_WC])
        if support is not None:
            told[f"plane{k}"], told[f"shown{k}"] = support.plane, support.shown
    _write(path, told)


def read_growth(path: Path) -> Growth:
    """Return the inverse of `write_growth`.

    Raises:
        FramesError: it cannot be read.
    """
    growth = Growth()
    try:
        with np.load(path, allow_pickle=False) as data:
            for k in range(int(data["count"])):
                row = data[f"camera{k}"]
                fx, fy, cx, cy = (float(x) for x in row[2:6])
                camera = ViewCamera(int(row[0]), int(row[1]), fx, fy, cx, cy, row[6:15].reshape(3, 3), row[15:18])
                rgb = data[f"rgb{k}"] if f"rgb{k}" in data else None
                frame = RgbdFrame(k, float(k), rgb, data[f"depth{k}"], data[f"mask{k}"], camera, camera)
                support = Support(data[f"plane{k}"], data[f"shown{k}"]) if f"plane{k}" in data else None
                growth = Growth(
                    (*growth.frames, frame), (*growth.directions, data[f"direction{k}"]), (*growth.supports, support)
                )
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise FramesError(f"{path}: no pictures of a thing: {error}") from None
    return growth


def write_partial(path: Path, part: PartialThing) -> None:
    """Write what was seen of a thing as .npz: `points` [m], `normals`, `colours`, `seen`, `partial` (True)."""
    seen = {"seen": np.array(part.seen), "partial": np.array(True)}
    _write(path, {"points": part.points, "normals": part.normals, "colours": part.colours} | seen)


def _write(path: Path, told: dict[str, Any]) -> None:
    data = io.BytesIO()
    np.savez(data, **told)
    atomic_file.write(path, data.getvalue())
