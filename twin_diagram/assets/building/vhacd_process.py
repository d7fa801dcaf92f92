"""V-HACD in a process of its own: `python -m twin_diagram.assets.building.vhacd_process MESH.npz PIECES.npz`."""

from __future__ import annotations

import ctypes
import signal
import sys

import numpy as np

from twin_diagram.assets.building.pieces import TUNING


def main(given: str, made: str) -> None:
    """Take the mesh in one file (`vertices`, `faces`) apart and write the pieces' vertices to another."""
    # Linux ends this process with its starter, also where that is killed.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    import vhacdx

    with np.load(given, allow_pickle=False) as data:
        vertices, faces = data["vertices"], data["faces"]
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    counted = np.column_stack([np.full(len(faces), 3), faces]).astype(np.uint32)
    pieces = vhacdx.compute_vhacd(
        (vertices - low) / size,
        counted.reshape(-1),
        maxConvexHulls=TUNING.most,
        resolution=TUNING.cells,
        maxNumVerticesPerCH=TUNING.corners,
        shrinkWrap=True,  # it pulls some into the surface, which `holding` undoes; without it all are a voxel too large
        asyncACD=False,
    )
    np.savez(made, **{f"piece{k}": low + size * np.asarray(piece) for k, (piece, _) in enumerate(pieces)})


if __name__ == "__main__":
    main(*sys.argv[1:])
