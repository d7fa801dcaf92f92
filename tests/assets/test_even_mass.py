"""What the shipped models are told to weigh, and where: as bodies of even density within what is seen and met of them.

Who learns an object takes it for even where torques say nothing else; a model that is none spoils what is told of it.
A load that is hidden belongs into a scenario (`load_at`), not into a model.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Box, Convex, Cylinder, Mesh, Role, SceneGraphInspector, Sphere
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull

from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.surface import weld
from twin_diagram.assets.mesh import read_obj
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array

MODELS = sorted(path.parent for path in (models_dir() / "objects").glob("*/model.sdf"))
SEEN = (1e-4, 0.005)
"""Off the body within the visible surface: centre [m], moments and products as a share of the largest moment."""
MET = (0.0035, 0.06)
"""The same off what collides: it holds a bottle's round shoulder within a step, and stays 0.5 mm behind feet."""
CELL = 0.0015
"""Edge of the cells in each of which one point stands for what collides [m]."""


def parsed(folder: Path) -> tuple[float, Array, Array, Array]:
    """Mass, centre (3,) and moments (3, 3) about it that a model is told; points (N, 3) within its convex shapes."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.001)
    (model,) = Parser(plant).AddModels(str(folder / "model.sdf"))
    plant.Finalize()
    body = plant.GetBodyByName("object", model)
    told = body.default_spatial_inertia()
    about = told.Shift(told.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    inspector = scene_graph.model_inspector()
    ids = inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity)
    seen = read_obj(folder / "visual.obj").vertices
    lines = (np.arange(*ends, CELL) for ends in zip(seen.min(axis=0), seen.max(axis=0), strict=True))
    cells = np.array(np.meshgrid(*lines, indexing="ij")).reshape(3, -1).T
    # Anywhere in its cell: of a thin wall whole layers of middles would lie within, or without.
    cells = cells + np.random.default_rng(0).uniform(0.0, CELL, cells.shape)
    inside = np.zeros(len(cells), dtype=bool)
    for one in ids:
        X_FG = inspector.GetPoseInFrame(one)
        inside |= within(inspector, one, (cells - X_FG.translation()) @ X_FG.rotation().matrix())
    return told.get_mass(), told.get_com(), about, cells[inside]


def within(inspector: SceneGraphInspector, one: object, p_G: Array) -> Array:
    """Which points (N, 3) lie within a shape."""
    shape = inspector.GetShape(one)  # type: ignore[arg-type]
    if isinstance(shape, Box):
        return np.asarray((np.abs(p_G) < 0.5 * shape.size()).all(axis=1))
    if isinstance(shape, Cylinder):
        return (np.hypot(p_G[:, 0], p_G[:, 1]) < shape.radius()) & (np.abs(p_G[:, 2]) < 0.5 * shape.length())
    if isinstance(shape, Sphere):
        return np.asarray(np.linalg.norm(p_G, axis=1) < shape.radius())
    assert isinstance(shape, Mesh | Convex)
    hull = inspector.GetConvexHull(one)  # type: ignore[arg-type]
    planes = ConvexHull([hull.vertex(k) for k in range(hull.num_vertices())]).equations
    return np.asarray((p_G @ planes[:, :3].T + planes[:, 3]).max(axis=1) < 0.0)


def off(told: tuple[Array, Array], even: tuple[Array, Array]) -> tuple[float, float]:
    """By how much the centre [m] and the worst of the moments differ, these as a share of the largest."""
    worst = np.abs(told[1] - even[1]).max() / np.linalg.eigvalsh(even[1])[-1]
    return float(np.linalg.norm(told[0] - even[0])), float(worst)


@pytest.mark.parametrize("folder", MODELS, ids=lambda folder: folder.name)
def test_a_model_is_told_the_mass_of_an_even_body(folder: Path) -> None:
    mass, centre, about, points = parsed(folder)
    mesh = read_obj(folder / "visual.obj")
    body = solid_of(weld(mesh.vertices[mesh.faces]))
    seen = off((centre, about), (body.centre, body.inertia(mass)))
    assert seen[0] < SEEN[0] and seen[1] < SEEN[1], seen
    spread = np.cov(points.T, bias=True)
    met = off((centre, about), (points.mean(axis=0), mass * (np.trace(spread) * np.eye(3) - spread)))
    assert met[0] < MET[0] and met[1] < MET[1], met
