"""Merged shapes without a renderer: the triangles, normals and colours written, and which shapes are merged."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryFrame,
    GeometryId,
    GeometryInstance,
    InMemoryMesh,
    PerceptionProperties,
    Rgba,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw

from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.merged_shapes import merge_shapes, tessellate, wavefront


@pytest.mark.parametrize(
    ("shape", "half", "volume"),
    [
        (Box(0.4, 0.2, 0.6), [0.2, 0.1, 0.3], 0.048),
        (Cylinder(0.3, 0.8), [0.3, 0.3, 0.4], np.pi * 0.09 * 0.8),
        (Sphere(0.3), [0.3, 0.3, 0.3], 4.0 / 3.0 * np.pi * 0.027),
        (Capsule(0.3, 0.8), [0.3, 0.3, 0.7], np.pi * 0.09 * 0.8 + 4.0 / 3.0 * np.pi * 0.027),
    ],
)
def test_triangles_are_those_of_the_shape_about_its_own_middle(shape: Shape, half: list[float], volume: float) -> None:
    mesh = tessellate(shape)
    assert mesh is not None and mesh.is_watertight
    np.testing.assert_allclose(mesh.bounds, [[-x for x in half], half], rtol=0.006)  # round ones have 32 sides
    assert 0.97 * volume < mesh.volume <= volume * (1.0 + 1e-9)
    assert tessellate(Ellipsoid(0.1, 0.2, 0.3)) is None


def read(mesh: InMemoryMesh) -> tuple[Array, Array, Array, Array, Array]:
    """Places (V, 3), normals (V, 3), texels (T,), corners (F, 3), texel of each face (F,)."""
    rows = [line.split() for line in mesh.mesh_file.contents().decode().splitlines()]
    numbers = {key: np.array([row[1:] for row in rows if row[0] == key], dtype=float) for key in ("v", "vn", "vt")}
    faces = np.array([[[int(i) for i in corner.split("/")] for corner in row[1:]] for row in rows if row[0] == "f"])
    np.testing.assert_array_equal(faces[..., 0], faces[..., 2])
    assert (faces[:, :1, 1] == faces[..., 1]).all()
    return numbers["v"], numbers["vn"], numbers["vt"][:, 0], faces[..., 0] - 1, faces[:, 0, 1] - 1


def palette(mesh: InMemoryMesh) -> Array:
    """(K, 3) r, g, b."""
    png = np.frombuffer(mesh.supporting_files["palette.png"].contents(), np.uint8)
    return np.asarray(cv2.imdecode(png, cv2.IMREAD_COLOR)[0, :, ::-1])


def triangles(places: Array, faces: Array) -> set[frozenset[tuple[float, ...]]]:
    return {frozenset(tuple(np.round(places[i], 5) + 0.0) for i in face) for face in faces}


def test_several_parts_are_written_one_after_the_other_each_with_its_texel() -> None:
    parts = [trimesh.creation.box(extents=[0.2, 0.3, 0.4]) for _ in range(3)]
    for k, part in enumerate(parts):
        part.apply_translation([k, 0.5 * k, 0.0])
    colours = [(1.0, 0.0, 0.2), (0.0, 0.5, 1.0), (0.3, 0.3, 0.3)]
    found = wavefront(parts, colours)
    places, normals, texels, faces, of = read(found)
    assert len(places) == len(normals)
    np.testing.assert_allclose(texels, [1 / 6, 3 / 6, 5 / 6], rtol=1e-6)
    np.testing.assert_array_equal(palette(found), [[255, 0, 51], [0, 128, 255], [76, 76, 76]])
    for k, part in enumerate(parts):
        assert triangles(places, faces[of == k]) == triangles(part.vertices, part.faces)
        # Faces keep their side: normals point away from the part's middle.
        corners = places[faces[of == k]]
        turn = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outwards = corners.mean(axis=1) - part.vertices.mean(axis=0)
        assert (np.einsum("ij,ij->i", turn, outwards) > 0.0).all()
        assert (np.einsum("ij,ij->i", normals[faces[of == k][:, 0]], outwards) > 0.0).all()


@pytest.mark.parametrize(("sections", "smooth"), [(32, True), (14, True), (12, True), (10, False), (7, False)])
def test_edges_of_more_than_six_tenths_of_a_radian_are_sharp(sections: int, smooth: bool) -> None:
    """A prism's sides meet at 2π / sections: 0.52 rad for 12, 0.63 rad for 10; its caps at a right angle."""
    prism = trimesh.creation.cylinder(0.5, 1.0, sections=sections)
    places, normals, _, faces, _ = read(wavefront([prism], [(1.0, 1.0, 1.0)]))
    side = np.abs(normals[:, 2]) < 0.5
    away = np.einsum("ij,ij->i", normals[side][:, :2], places[side][:, :2]) / 0.5
    if smooth:
        np.testing.assert_allclose(away, 1.0, atol=0.03)  # along the radius
    else:
        np.testing.assert_allclose(away, np.cos(np.pi / sections), atol=1e-4)  # across the side
    np.testing.assert_allclose(np.abs(normals[~side][:, 2]), 1.0, atol=1e-4)
    assert faces.max() == len(places) - 1


# Which shapes are merged.


def shown(
    scene_graph: SceneGraph, source: object, frame: object, shape: Shape, X: RigidTransform, **properties: object
) -> GeometryId:
    instance = GeometryInstance(X, shape, f"shape{len(scene_graph.model_inspector().GetAllGeometryIds())}")
    geometry = scene_graph.RegisterGeometry(source, frame, instance)
    perception = PerceptionProperties()
    for name, value in properties.items():
        perception.AddProperty("phong", name, value)
    scene_graph.AssignRole(source, geometry, perception)
    return geometry


def test_plain_and_opaque_shapes_of_a_body_become_one_mesh(tmp_path: Path) -> None:
    scene_graph = SceneGraph()
    source, other = scene_graph.RegisterSource("mine"), scene_graph.RegisterSource("other")
    frame, alone, theirs = (
        scene_graph.RegisterFrame(owner, GeometryFrame(name))
        for owner, name in ((source, "a"), (source, "b"), (other, "c"))
    )
    X = RigidTransform(RollPitchYaw(0.2, 0.3, 0.4), [0.5, -0.5, 1.0])
    red, grey = Rgba(1.0, 0.0, 0.0), {}
    merged = [
        shown(scene_graph, source, frame, Box(0.2, 0.4, 0.6), X, diffuse=red),
        shown(scene_graph, source, frame, Box(0.1, 0.1, 0.1), RigidTransform(), **grey),
    ]
    texture = tmp_path / "texture.png"
    cv2.imwrite(str(texture), np.zeros((2, 2, 3), np.uint8))
    kept = [
        shown(scene_graph, source, frame, Sphere(0.1), X, diffuse=Rgba(1.0, 1.0, 1.0, 0.9)),
        shown(scene_graph, source, frame, Sphere(0.2), X, diffuse=red, diffuse_map=str(texture)),
        shown(scene_graph, source, frame, Ellipsoid(0.1, 0.2, 0.3), X, diffuse=red),
        shown(scene_graph, source, alone, Box(1.0, 1.0, 1.0), X, diffuse=red),
        shown(scene_graph, other, theirs, Box(1.0, 1.0, 1.0), X, diffuse=red),
        shown(scene_graph, other, theirs, Box(2.0, 1.0, 1.0), X, diffuse=red),
    ]
    merge_shapes(scene_graph, source)
    inspector = scene_graph.model_inspector()
    seen = [g for f in (frame, alone, theirs) for g in inspector.GetGeometries(f, Role.kPerception)]
    (new,) = set(seen) - set(kept)
    assert set(kept) <= set(seen) and not set(merged) & set(seen)
    assert inspector.GetFrameId(new) == frame and inspector.GetPoseInFrame(new).IsExactlyIdentity()
    memory = inspector.GetShape(new).source().in_memory()
    places, _, _, faces, of = read(memory)
    first = trimesh.creation.box(extents=[0.2, 0.4, 0.6])
    first.apply_transform(X.GetAsMatrix4())
    second = trimesh.creation.box(extents=[0.1, 0.1, 0.1])
    order = {bytes(colour): k for k, colour in enumerate(palette(memory))}
    # One that has no colour is of a grey of seven tenths.
    for part, colour in ((first, [255, 0, 0]), (second, [178, 178, 178])):
        k = order[bytes(np.array(colour, np.uint8))]
        assert triangles(places, faces[of == k]) == triangles(part.vertices, part.faces)


def test_shapes_of_the_world_are_merged_too_and_those_of_another_source_are_not() -> None:
    scene_graph = SceneGraph()
    source, other = scene_graph.RegisterSource("mine"), scene_graph.RegisterSource("other")
    world = scene_graph.world_frame_id()
    mine = [shown(scene_graph, source, world, Box(0.1, 0.1, k), RigidTransform()) for k in (1.0, 2.0, 3.0)]
    kept = [shown(scene_graph, other, world, Box(0.1, 0.1, k), RigidTransform()) for k in (4.0, 5.0)]
    merge_shapes(scene_graph, source)
    seen = set(scene_graph.model_inspector().GetGeometries(world, Role.kPerception))
    assert set(kept) < seen and not set(mine) & seen and len(seen) == 3
