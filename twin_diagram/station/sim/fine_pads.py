"""Gives a gripper's pads more facets, so that what they hold stays where it was taken at longer steps, too.

Drake's solver smooths friction: what is held creeps, at each point of contact in proportion to the impulse there, which
is the force at that point times the step. Drake makes a soft box of as few tetrahedra as can be, whatever is asked for,
so that a pad touches at a few points alone; of more points each bears less.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    Role,
    SceneGraph,
    Shape,
)
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    usual_step: float = 0.0025
    """At steps up to this pads stay as Drake makes them [s]: a box of 0.5 kg that is held 2 cm off its centre with 40 N
    turns by 0.65° in 10 s. At 5 ms it would by 1.11°."""

    cells: int = 4
    """Along each side of a pad's face: at 5 ms that box turns by 0.6°. Three leave 1.5°, as Drake's own 1.1°."""

    layers: int = 2
    """Across its thickness: pressure is greatest in its middle, as in Drake's own boxes."""


TUNING = Tuning()


def refine(plant: MultibodyPlant, scene_graph: SceneGraph, pad: GeometryId) -> None:
    """Make a soft box of finer tetrahedra; what it never touches it never touches still.

    Args:
        plant: of the world, finalized.
        scene_graph: its geometry.
        pad: whose proximity properties are those of a compliant shape; another shape than a box stays as it is.
    """
    inspector = scene_graph.model_inspector()
    box = inspector.GetShape(pad)
    if plant.time_step() <= TUNING.usual_step or not isinstance(box, Box):
        return
    size = np.array(box.size())
    cells = np.where(size == size.min(), TUNING.layers, TUNING.cells)
    mesh = Mesh(InMemoryMesh(mesh_file=MemoryFile(as_vtk(*tetrahedra(size, cells)), ".vtk", "pad")))
    reshape(plant, scene_graph, pad, mesh)


def reshape(plant: MultibodyPlant, scene_graph: SceneGraph, geometry: GeometryId, shape: Shape) -> None:
    """Give a geometry another shape where it is; what it never touches it never touches still."""
    inspector = scene_graph.model_inspector()
    others = inspector.GetAllGeometryIds(Role.kProximity)
    unmet = [other for other in others if other != geometry and inspector.CollisionFiltered(geometry, other)]
    scene_graph.ChangeShape(plant.get_source_id(), geometry, shape, inspector.GetPoseInFrame(geometry))
    apart = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(geometry), GeometrySet(unmet))
    scene_graph.collision_filter_manager().Apply(apart)


def tetrahedra(size: Array, cells: Ints) -> tuple[Array, Ints]:
    """Return corners (P, 3) and tetrahedra (T, 4) of a box about the origin, six of them in each cell.

    Args:
        size: (3,) edges [m].
        cells: (3,) along them.
    """
    axes = [np.linspace(-0.5 * edge, 0.5 * edge, count + 1) for edge, count in zip(size, cells, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(corners)).reshape([len(axis) for axis in axes])
    found = []
    for order in permutations(range(3)):  # from one corner of a cell to the opposite one, an edge after the other
        steps = np.vstack([np.zeros(3, dtype=int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)])
        rows = [number[tuple(slice(a, a + n) for a, n in zip(at, cells, strict=True))].ravel() for at in steps]
        turned = np.linalg.det(np.eye(3)[list(order)]) < 0.0
        found.append(np.column_stack([rows[k] for k in ((0, 2, 1, 3) if turned else (0, 1, 2, 3))]))
    return corners, np.concatenate(found)


def as_vtk(corners: Array, tetrahedra: Ints) -> str:
    """Return the text of a VTK file of tetrahedra, as Drake reads it."""
    lines = ["# vtk DataFile Version 3.0", "pad", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines += [f"POINTS {len(corners)} double", *(" ".join(f"{x:.12g}" for x in corner) for corner in corners)]
    lines += [f"CELLS {len(tetrahedra)} {5 * len(tetrahedra)}"]
    lines += [" ".join(str(k) for k in (4, *row)) for row in tetrahedra.tolist()]
    lines += [f"CELL_TYPES {len(tetrahedra)}", *["10"] * len(tetrahedra)]
    return "\n".join(lines) + "\n"
