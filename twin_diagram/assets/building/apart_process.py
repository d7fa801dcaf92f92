"""V-HACD or CoACD in a process of its own: `python -m …building.apart_process METHOD MESH.npz PIECES.npz`."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

import numpy as np

from twin_diagram.assets.building.pieces import TUNING
from twin_diagram.assets.building.surface import Faces
from twin_diagram.signals.arrays import Array

POLITE = 10
"""By so much CoACD is nicer than what else runs: it takes a minute or more, beside the user's work."""

CONCAVITY = 0.05
"""How much of an object's size a piece may bridge, CoACD's own default: what `TUNING.most` pieces of a mug reach."""


def main(method: str, given: str, made: str) -> None:
    """Take the mesh in one file (`vertices`, `faces`) apart and write the pieces' vertices to another."""
    # Linux ends this process with its starter, also where that is killed.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    with np.load(given, allow_pickle=False) as data:
        vertices, faces = data["vertices"], data["faces"]
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    pieces = METHODS[method]((vertices - low) / size, faces)
    np.savez(made, **{f"piece{k}": low + size * piece for k, piece in enumerate(pieces)})


def vhacd(vertices: Array, faces: Faces) -> list[Array]:
    """Return V-HACD's pieces, vertices (m, 3) each, of a surface whose longest edge is 1."""
    import vhacdx

    counted = np.column_stack([np.full(len(faces), 3), faces]).astype(np.uint32)
    pieces = vhacdx.compute_vhacd(
        vertices,
        counted.reshape(-1),
        maxConvexHulls=TUNING.most,
        resolution=TUNING.cells,
        maxNumVerticesPerCH=TUNING.corners,
        shrinkWrap=True,  # it pulls some into the surface, which `holding` undoes; without it all are a voxel too large
        asyncACD=False,
    )
    return [np.asarray(piece) for piece, _ in pieces]


def coacd(vertices: Array, faces: Faces) -> list[Array]:
    """Return CoACD's pieces (Wei et al., 2022), vertices (m, 3) each, of a surface whose longest edge is 1."""
    import coacd as library

    os.nice(POLITE)
    library.set_log_level("error")
    pieces = library.run_coacd(library.Mesh(vertices, faces), threshold=CONCAVITY, max_convex_hull=TUNING.most, seed=0)
    return [np.asarray(piece) for piece, _ in pieces]


METHODS = {"vhacd": vhacd, "coacd": coacd}
"""By their names."""


if __name__ == "__main__":
    main(*sys.argv[1:])
