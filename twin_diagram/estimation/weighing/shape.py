"""What an object's outer surface says of its mass: where it would lie if it were even."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.surface import weld
from twin_diagram.errors import AssetError
from twin_diagram.estimation.weighing.held import WeighingError
from twin_diagram.model.rigid_body.mass_properties import parameters_of
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Shape:
    """Moments of a mass of 1 kg, spread evenly, in the object's frame O.

    Attributes:
        centre: (3,) of the solid [m].
        second: (3, 3) Σ = ∫ r rᵀ dm of the solid about its centre [m²].
        shell_centre: (3,) of the surface as a thin wall [m].
        shell_second: (3, 3) of it, about its own centre [m²].
        half: (3,) half the edges of the box about the surface, along O's axes [m].
        middle: (3,) of that box [m].
    """

    centre: Array
    second: Array
    shell_centre: Array
    shell_second: Array
    half: Array
    middle: Array

    @staticmethod
    def of_mesh(vertices: Array, faces: npt.NDArray[np.int64]) -> Shape:
        """Return that of a surface in O: vertices (V, 3) [m], triangles (F, 3), counter-clockwise from outside.

        Raises:
            WeighingError: a sheet, arrays of another form, or vertices that are not finite.
        """
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise WeighingError(
                f"the object's mesh: vertices must be (V, 3) and faces (F, 3), not {vertices.shape}, {faces.shape}"
            )
        if not np.all(np.isfinite(vertices)):
            raise WeighingError("the object's mesh has vertices that are not finite")
        try:
            solid = solid_of(weld(vertices[faces]))
        except AssetError as error:
            raise WeighingError(f"the object's mesh: {error}") from error
        low, high = vertices[faces].min(axis=(0, 1)), vertices[faces].max(axis=(0, 1))
        wall = _wall(vertices, faces)
        return Shape(solid.centre, solid.second / solid.volume, *wall, 0.5 * (high - low), 0.5 * (high + low))

    @staticmethod
    def box(edges: Array) -> Shape:
        """Return that of a box about O's origin, edges (3,) along O's axes [m]."""
        edges = np.asarray(edges, dtype=float)
        if edges.shape != (3,) or not np.all(np.isfinite(edges)) or np.any(edges <= 0.0):
            raise WeighingError(f"a box needs three positive edges [m], not {edges}")
        x, y, z = edges
        areas = np.array([y * z, x * z, x * y])
        wall = np.array([edges[k] ** 2 * (areas.sum() / 12.0 + areas[k] / 6.0) / areas.sum() for k in range(3)])
        return Shape(np.zeros(3), np.diag(edges**2 / 12.0), np.zeros(3), np.diag(wall), 0.5 * edges, np.zeros(3))

    def even(self, mass: float) -> Array:
        """Return the ten inertial parameters (10,) in O of that mass [kg], spread evenly within the surface."""
        return parameters_of(np.array(mass), self.centre, mass * self.second)


def _wall(vertices: Array, faces: npt.NDArray[np.int64]) -> tuple[Array, Array]:
    """Return centre (3,) and second moments (3, 3) per mass of triangles of even thickness."""
    corners = np.asarray(vertices, dtype=float)[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weight = area / area.sum()
    middle = corners.mean(axis=1)
    centre = weight @ middle
    from_centre = corners - centre
    # ∫ r rᵀ over a triangle: (Σ cᵢ cᵢᵀ + 9 m mᵀ) / 12 per area, with m its middle.
    each = np.einsum("fka,fkb->fab", from_centre, from_centre) / 12.0
    each += 0.75 * np.einsum("fa,fb->fab", middle - centre, middle - centre)
    return centre, np.einsum("f,fab->ab", weight, each)
