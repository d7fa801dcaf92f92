"""Shapes as points around them and as solids: they hold the shape and stand out as little as told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.planning.collision import convex_solids
from twin_diagram.planning.collision.geometry_to_solids import _prism, fixture_solids, moved, points_of
from twin_diagram.signals.arrays import Array


def points(shape: Shape) -> Array:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    geometry = plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(), shape, "g", CoulombFriction())
    return points_of(scene_graph.model_inspector(), geometry)


@pytest.mark.parametrize(
    ("shape", "half"),
    [
        (Sphere(0.2), (0.2, 0.2, 0.2)),
        (Box(0.2, 0.3, 0.5), (0.1, 0.15, 0.25)),
        (Ellipsoid(0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
        (Cylinder(0.1, 0.5), (0.1, 0.1, 0.25)),
        (Capsule(0.1, 0.4), (0.1, 0.1, 0.3)),
    ],
)
def test_points_around_a_shape_reach_as_far_as_it_does(shape: Shape, half: tuple[float, float, float]) -> None:
    found = points(shape)
    reach = np.abs(found).max(axis=0)
    assert (reach >= np.array(half) - 1e-12).all() and (reach <= 1.009 * np.array(half)).all()
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-12)


def test_a_prism_stands_out_by_nine_thousandths_at_its_corners() -> None:
    corners = _prism(0.1, 0.5)
    radius = np.linalg.norm(corners[:, :2], axis=1)
    np.testing.assert_allclose(radius, radius[0])
    assert 0.008 < radius[0] / 0.1 - 1 < 0.009
    solid = convex_solids.Polytope(corners)
    angle = np.linspace(0, 2 * np.pi, 500)
    around = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.full(500, 0.1)], axis=1)
    depth = solid.distance(around)[0]
    assert depth.max() <= 1e-9 and depth.max() > -1e-6 and depth.min() > -0.0009  # it touches the faces
    np.testing.assert_allclose(np.sort(np.unique(corners[:, 2])), [-0.25, 0.25])


def test_a_half_space_is_ten_metres_of_it(tmp_path: Path) -> None:
    file = tmp_path / "floor.sdf"
    file.write_text(
        '<sdf version="1.7"><model name="m"><link name="l"><collision name="c"><geometry><plane><normal>0 0 1</normal>'
        "<size>1 1</size></plane></geometry></collision></link></model></sdf>"
    )
    ((_, (solid,)),) = fixture_solids([scenario.Fixture(model=str(file))])
    p = np.array([[9.9, -9.9, 0.3], [0, 0, -4.0], [10.5, 0, -1.0], [0, -10.5, -1.0], [0, 0, -20.5]])
    np.testing.assert_allclose(solid.distance(p)[0], [0.3, -4.0, 0.5, 0.5, 0.5], atol=1e-9)


def test_points_are_turned_and_then_moved() -> None:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3]
    np.testing.assert_allclose(moved(X, np.array([[1.0, 0, 0], [0, 1, 0]])), [[1, 3, 3], [0, 2, 3]])
