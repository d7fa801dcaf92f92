"""Improves a finished asset's convex pieces by CoACD, which takes minutes where V-HACD takes seconds."""

from __future__ import annotations

import hashlib
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from scipy.spatial import ConvexHull

from twin_diagram.assets.building.decimation import decimated
from twin_diagram.assets.building.flat_faces import flat_faces
from twin_diagram.assets.building.inertia import spread
from twin_diagram.assets.building.pieces import TUNING as PIECES
from twin_diagram.assets.building.pieces import farthest_out, holding, taken_apart
from twin_diagram.assets.building.surface import Faces
from twin_diagram.assets.building.write_asset import kept_files, own_files, write_models
from twin_diagram.assets.description import AssetSpec, read_spec
from twin_diagram.assets.library import check, entry
from twin_diagram.assets.mesh import read_obj
from twin_diagram.errors import AssetError
from twin_diagram.runtime import atomic_file, written_files
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    triangles: int = 3000
    """Of the surface that CoACD is given: its time grows with them, and a mug's wall needs no more."""

    samples: int = 200_000
    """Points in the box about an object by which its pieces' volume is told: to half a percent of a mug's."""

    gain: float = 0.02
    """Share of their volume that new pieces must save: four times the samples' error."""

    patience: float = 600.0
    """Time after which CoACD is ended, where none is told [s]: clean mugs take up to 80 s of an idle core."""


TUNING = Tuning()


@dataclass(frozen=True)
class Improvement:
    """What became of an asset's pieces.

    Attributes:
        folder: of the asset.
        before, after: volume of the pieces together, as they were, and as they would be [m³]; NaN: not known.
        pieces: how many there are now.
        taken: whether the new ones are there.
        why: why not, else empty.
    """

    folder: Path
    before: float
    after: float
    pieces: int
    taken: bool
    why: str = ""


def improve_pieces(name: str, library: str | Path, patience: float | None = None) -> Improvement:
    """Take an asset's surface apart with CoACD, and put its pieces into the asset where they hold it more closely.

    It runs at low priority, in a process of its own. The asset is replaced as a whole at the end, or stays as it is;
    grasps that were kept are worked out anew when they are asked for.

    Args:
        name: of the asset.
        library: the folder of assets.
        patience: time after which it is given up [s]; None: `TUNING.patience`.

    Raises:
        AssetError: no such asset, one that is corrupt, or one that was not built here.
    """
    limit = TUNING.patience if patience is None else patience
    if not (np.isfinite(limit) and limit > 0.0):
        raise AssetError(f"--limit {limit:g}: a time in seconds, above 0")
    found = entry(library, name)
    folder = Path(library) / name
    if found.asset is None:
        raise AssetError(f"{folder} is corrupt: {found.wrong}")
    spec = read_spec(folder)
    if spec.files is None or not spec.pieces:
        raise AssetError(f"{folder}: was not made by `assets build`, so its pieces are its maker's")
    old = [np.asarray(piece) for piece in found.asset.convex_pieces]
    if len(old) == 1:
        return Improvement(folder, np.nan, np.nan, 1, False, "it is held by its hull, which it nearly fills")
    mesh = read_obj(folder / spec.visual)
    vertices, faces = joined(mesh.vertices, mesh.faces)
    made = taken_apart(*decimated(vertices, faces, TUNING.triangles), "coacd", limit)
    before = volume_of(old)
    if not made:
        why = f"CoACD did not take it apart within {limit:g} s"
        return Improvement(folder, before, np.nan, len(old), False, why)
    points = spread(vertices[faces], PIECES.step * float(np.ptp(vertices, axis=0).max()))
    new = holding(made, np.unique(np.concatenate([vertices, points]), axis=0))
    after = volume_of(new)
    if not after < (1.0 - TUNING.gain) * before:
        return Improvement(folder, before, after, len(old), False, "CoACD's pieces hold it no more closely")
    _replace(folder, spec, new, vertices, faces)
    return Improvement(folder, before, after, len(new), True)


def joined(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Return a surface whose vertices of one place, parted where its texture has a seam, are one; (V, 3), (F, 3)."""
    places, number = np.unique(np.round(vertices, 7), axis=0, return_inverse=True)
    own = number.reshape(-1)[faces]
    whole = (own[:, 0] != own[:, 1]) & (own[:, 1] != own[:, 2]) & (own[:, 2] != own[:, 0])
    return places, own[whole]


def volume_of(pieces: list[Array]) -> float:
    """Return the volume that convex pieces, vertices (m, 3) each, hold together [m³], where they overlap once.

    By points in their box, the same ones each time.
    """
    every = np.concatenate(pieces)
    low, high = every.min(axis=0), every.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (TUNING.samples, 3))
    held = np.zeros(len(points), bool)
    for piece in pieces:
        held[~held] = farthest_out(points[~held], ConvexHull(piece)) <= 0.0
    return float(held.mean() * np.prod(high - low))


def _replace(folder: Path, spec: AssetSpec, pieces: list[Array], vertices: Array, faces: Faces) -> None:
    """Write an asset anew, with other pieces and the models that are made of them; all else stays as it was."""
    made = re.compile(r"pieces/piece\d+\.obj|asset\.yaml|model\.sdf|model\.xml|grasps/[^/]+\.json")
    with atomic_file.folder(folder) as aside:
        for path in written_files.files_of(folder):
            if path in kept_files(folder) or not made.fullmatch(path):
                (aside / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(folder / path, aside / path, follow_symlinks=False)
        write_models(aside, spec, pieces, vertices, flat_faces(vertices[faces]))
        listed = own_files(aside) - {"asset.yaml"}
        spec.files = {path: hashlib.sha256((aside / path).read_bytes()).hexdigest() for path in sorted(listed)}
        (aside / "asset.yaml").write_text(yaml_dump_typed(spec))
        check(aside)
