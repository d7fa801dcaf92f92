"""Shapes of fixtures as convex solids, against Drake's own distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, HalfSpace, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.planning.collision.geometry_to_solids import fixture_solids
from twin_diagram.scenario.poses import pose

SHAPES = {
    "sphere": ("<sphere><radius>0.2</radius></sphere>", Sphere(0.2)),
    "box": ("<box><size>0.2 0.3 0.5</size></box>", Box(0.2, 0.3, 0.5)),
    "cylinder": ("<cylinder><radius>0.1</radius><length>0.5</length></cylinder>", Cylinder(0.1, 0.5)),
    "capsule": ("<capsule><radius>0.1</radius><length>0.4</length></capsule>", Capsule(0.1, 0.4)),
    "ellipsoid": ("<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>", Ellipsoid(0.1, 0.2, 0.3)),
    "plane": ("<plane><normal>0 0 1</normal><size>1 1</size></plane>", HalfSpace()),
}
LOOSE = {"sphere": 1e-9, "box": 1e-9, "plane": 1e-9, "cylinder": 0.0009, "capsule": 0.0009}
"""How much nearer than the shape its solids may be [m]: 0.9 % of a round shape's radius; a box about an ellipsoid."""


def test_solids_of_every_shape_are_the_shape_or_a_little_more(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    where = scenario.Pose(translation=[0.2, -0.1, 0.3])
    X_WB = pose(where)
    points = X_WB.translation() + 0.5 * rng.standard_normal((300, 3))
    for name, (text, shape) in SHAPES.items():
        file = tmp_path / f"{name}.sdf"
        file.write_text(
            '<sdf version="1.7"><model name="m"><link name="l"><collision name="c">'
            f"<pose>0.1 0 0.05 0.4 -0.3 0.2</pose><geometry>{text}</geometry></collision></link></model></sdf>"
        )
        ((found, solids),) = fixture_solids([scenario.Fixture(model=str(file), X_WB=where)])
        assert found == name
        distance = np.min([solid.distance(points)[0] for solid in solids], axis=0)
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        X_BG = RigidTransform(RollPitchYaw(0.4, -0.3, 0.2), [0.1, 0, 0.05])
        plant.RegisterCollisionGeometry(plant.world_body(), X_WB @ X_BG, shape, name, CoulombFriction(0.5, 0.5))
        plant.Finalize()
        diagram = builder.Build()
        context = diagram.CreateDefaultContext()
        query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
        exact = np.array([query.ComputeSignedDistanceToPoint(p)[0].distance for p in points])
        out = exact > 0.0
        assert out.sum() > 80
        assert (distance <= exact + 1e-9)[out].all(), name
        if name in LOOSE:
            assert (exact - distance)[out].max() <= LOOSE[name], name
        else:
            # A box about an ellipsoid stands out farthest at its corners.
            assert (exact - distance)[out].max() < np.linalg.norm([0.1, 0.2, 0.3])
