"""Reads the triangles of a COLLADA file (.dae).

As robot descriptions mean them: lengths in the file's unit become metres, and its up axis is left as it is.
"""

from __future__ import annotations

import io

import numpy as np

from twin_diagram.signals.arrays import Array


def corners(content: bytes) -> Array:
    """Return the corners (T, 3, 3) of all triangles of the scene [m]; of a file without a scene, of all its shapes.

    Args:
        content: of the file.

    Raises:
        ValueError: it is not one, or broken.
    """
    import collada

    passed_over = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]  # materials, pictures
    try:
        file = collada.Collada(io.BytesIO(content), ignore=passed_over)
        scenes = list(file.scenes) if file.scene is None else [file.scene]
        placed = [shape for scene in scenes for shape in scene.objects("geometry")]
        shapes = [part for shape in placed for part in shape.primitives()]
        if not placed:
            shapes = [part for shape in file.geometries for part in shape.primitives]
        parts = [np.zeros((0, 3, 3)), *(_triangles(part) for part in shapes)]
    except (collada.common.DaeError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(str(error) or "no COLLADA") from error
    return float(file.assetInfo.unitmeter or 1.0) * np.concatenate(parts)


def _triangles(part: object) -> Array:
    """Return the corners (T, 3, 3) of one list of triangles or polygons; lines and points have none."""
    part = part.triangleset() if hasattr(part, "triangleset") else part
    index, vertex = getattr(part, "vertex_index", None), getattr(part, "vertex", None)
    if index is None or vertex is None or np.ndim(index) != 2 or np.shape(index)[1] != 3:
        return np.zeros((0, 3, 3))
    return np.asarray(vertex, dtype=float)[np.asarray(index)]
