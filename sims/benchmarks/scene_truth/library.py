"""The library of a script's things: own assets as they come along, YCB meshes by `assets build`."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh
from pose_truth.things import OWN

from twin_diagram.assets.building.from_mesh import build_from_mesh
from twin_diagram.assets.building.source_mesh import z_up
from twin_diagram.assets.description import read_spec
from twin_diagram.scenario import models_dir

Array = npt.NDArray[np.float64]


def built(library: Path, kept: Path, names: Iterable[str], data: Path) -> dict[str, Array]:
    """Fill a library with assets and return, by name, where each asset's O is in the thing's frame [m].

    Args:
        library: folder that gets them.
        kept: where assets that were built before are.
        names: of things.
        data: folder that holds `ycb/`.
    """
    origins = {}
    for name in sorted(set(names)):
        source = kept / name
        if name in OWN:
            source, origins[name] = models_dir() / "objects" / name, np.zeros(3)
        else:
            mesh = data / "ycb" / f"{name}_textured.gltf"
            if not source.exists():
                build_from_mesh(mesh, name, kept, mass=0.5)
            corners = z_up(np.asarray(trimesh.load(mesh, force="mesh", process=False).vertices))
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
            origins[name] = np.asarray(read_spec(source).origin) - middle
        shutil.copytree(source, library / name)
    return origins
