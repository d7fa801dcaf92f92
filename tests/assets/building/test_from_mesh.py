"""From a file to an asset: units, axes, looks, masses; what is bad is refused in one line, and nothing is written."""

from __future__ import annotations

import json
import os
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import cKDTree

from tests.assets.building.made_meshes import box, box_inertia, corner, write_coloured
from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import cli, scenario
from twin_diagram.assets import Asset
from twin_diagram.assets.building import build_from_mesh, from_mesh, source_mesh, write_asset
from twin_diagram.assets.building.source_mesh import read_source
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.mesh import read_obj, read_png
from twin_diagram.assets.procedural import write_box
from twin_diagram.errors import AssetError
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import register
from twin_diagram.perception.registration.resting import resting
from twin_diagram.perception.registration.rotation import exp, log
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scene.twin_scene import add_twin_scene
from twin_diagram.signals.arrays import Array


def colour_at(asset: Asset, point: tuple[float, float, float]) -> Array:
    return np.asarray(asset.colours[cKDTree(asset.points_O).query(point)[1]])


def write_stl(path: Path, mesh: trimesh.Trimesh) -> Path:
    path.write_bytes(mesh.export(file_type="stl"))
    return path


# What comes out.


def test_an_obj_keeps_its_picture_and_its_plain_colours(tmp_path: Path) -> None:
    built = build_from_mesh(write_coloured(tmp_path / "src"), "box", tmp_path / "lib", mass=0.5)
    asset = Asset.load(tmp_path / "lib" / "box")
    assert built.folder == tmp_path / "lib" / "box" and built.mass == asset.mass == 0.5
    assert built.volume == pytest.approx(0.1 * 0.06 * 0.04) and not [n for n in built.notes if "watertight" in n]
    np.testing.assert_allclose(asset.size, [0.1, 0.06, 0.04], atol=1e-6)
    np.testing.assert_allclose(colour_at(asset, (-0.03, 0.01, 0.02)), [1, 0, 0], atol=0.02)
    np.testing.assert_allclose(colour_at(asset, (0.03, 0.01, 0.02)), [0, 1, 0], atol=0.02)
    for side in ((0.05, 0.0, 0.0), (0.0, -0.03, 0.0), (0.02, 0.01, -0.02)):
        np.testing.assert_allclose(colour_at(asset, side), [0, 0, 1], atol=0.02)
    # What is shown has the same colours as the cloud.
    mesh, texture = read_obj(built.folder / "visual.obj"), read_png(built.folder / "visual.png")
    top = (mesh.normals[:, 2] > 0.9) & (mesh.vertices[:, 0] < -0.04)
    row, column = (1 - mesh.uv[top, 1]) * (texture.shape[0] - 1), mesh.uv[top, 0] * (texture.shape[1] - 1)
    seen = texture[np.round(row).astype(int), np.round(column).astype(int)]
    assert top.any() and (seen == [255, 0, 0]).all()


def test_what_asset_yaml_says(tmp_path: Path) -> None:
    mesh = write_stl(tmp_path / "brick.stl", box(100, 60, 40, at=(10, 20, 30)))
    build_from_mesh(mesh, "brick", tmp_path / "lib", density=500.0, unit="mm")
    spec = read_spec(tmp_path / "lib" / "brick")
    assert (spec.version, spec.unit, spec.source, spec.symmetries) == (1, "mm", "brick.stl", ["x 2", "y 2", "z 2"])
    assert spec.mass == pytest.approx(0.12, rel=1e-6) and spec.volume == pytest.approx(2.4e-4, rel=1e-6)
    np.testing.assert_allclose(spec.origin, [0.01, 0.02, 0.03], atol=1e-8)
    expected = np.diag(box_inertia(0.12, 0.1, 0.06, 0.04))
    np.testing.assert_allclose(spec.inertia, [*expected, 0, 0, 0], rtol=1e-5, atol=1e-10)
    assert str(tmp_path) not in "".join(
        path.read_text(errors="ignore") for path in (tmp_path / "lib" / "brick").rglob("*") if path.is_file()
    )


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0), ("in", 1 / 0.0254)])
def test_units(tmp_path: Path, unit: str, scale: float) -> None:
    mesh = write_stl(tmp_path / "a.stl", box(0.1 * scale, 0.06 * scale, 0.2 * scale))
    assert build_from_mesh(mesh, "a", tmp_path, mass=1.0, unit=unit).size == pytest.approx([0.1, 0.06, 0.2])


@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_gltf_is_turned_upright_and_its_nodes_are_placed(tmp_path: Path, kind: str) -> None:
    """A tall box (y) with a small one on its +z side, which becomes −y."""
    scene = trimesh.Scene(box(0.05, 0.2, 0.05))
    X = np.eye(4)
    X[:3, 3] = [0.0, 0.05, 0.035]
    scene.add_geometry(box(0.02, 0.02, 0.02), transform=X)
    if kind == "glb":
        (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    else:
        for name, data in scene.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(data)
        (tmp_path / "model.gltf").rename(tmp_path / "a.gltf")
    build_from_mesh(tmp_path / f"a.{kind}", "a", tmp_path / "lib", mass=0.2)
    vertices = read_obj(tmp_path / "lib" / "a" / "visual.obj").vertices
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.05, 0.07, 0.2], atol=1e-6)
    knob = vertices[vertices[:, 1] < vertices[:, 1].min() + 1e-6]
    assert knob[:, 2].mean() - (vertices[:, 2].max() + vertices[:, 2].min()) / 2 == pytest.approx(0.05, abs=1e-6)
    centre = np.average([[0, 0, 0], [0, -0.035, 0.05]], axis=0, weights=[0.05 * 0.2 * 0.05, 0.02**3])
    np.testing.assert_allclose(read_spec(tmp_path / "lib" / "a").origin, centre, atol=1e-7)


@pytest.mark.parametrize(
    ("up", "size"), [("Z_UP", [0.1, 0.2, 0.3]), ("Y_UP", [0.1, 0.3, 0.2]), ("X_UP", [0.2, 0.3, 0.1])]
)
def test_collada_tells_its_unit_and_what_is_up(tmp_path: Path, up: str, size: list[float]) -> None:
    text = trimesh.exchange.dae.export_collada(box(10.0, 20.0, 30.0)).decode()
    text = re.sub(r"<up_axis>\w+</up_axis>", f"<up_axis>{up}</up_axis>", text)
    assert up in text
    text = re.sub(r"<unit [^>]*/>", "", text).replace(f"<up_axis>{up}", f'<unit name="cm" meter="0.01"/><up_axis>{up}')
    (tmp_path / "a.dae").write_text(text)
    built = build_from_mesh(tmp_path / "a.dae", "a", tmp_path / "lib", mass=1.0)
    np.testing.assert_allclose(built.size, size, atol=1e-6)
    assert built.volume == pytest.approx(0.006, rel=1e-5)


@pytest.mark.parametrize("turn", [source_mesh.z_up, source_mesh.x_becomes_up])
def test_what_is_set_upright_is_turned_and_not_mirrored(turn: Callable[[Array], Array]) -> None:
    R = turn(np.eye(3)).T
    np.testing.assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == 1.0
    # COLLADA 1.4.1, `up_axis`: with Y_UP x leads to the right and z comes towards the viewer, with X_UP −y and z.
    right = [0.0, -1.0, 0.0] if turn is source_mesh.x_becomes_up else [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(turn(np.array(right)), [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(turn(np.array([0.0, 0.0, 1.0])), [0.0, -1.0, 0.0])


def test_the_plant_knows_mass_centre_and_moments(tmp_path: Path) -> None:
    mesh = corner()
    build_from_mesh(write_stl(tmp_path / "l.stl", mesh), "l", tmp_path / "lib", density=2000.0)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(tmp_path / "lib" / "l" / "model.sdf"))
    plant.Finalize()
    M = plant.GetBodyByName("object").CalcSpatialInertiaInBodyFrame(plant.CreateDefaultContext())
    assert M.get_mass() == pytest.approx(2000.0 * 3.2e-4, rel=1e-6)
    np.testing.assert_allclose(M.get_com(), 0, atol=1e-12)
    mesh.density = 2000.0
    np.testing.assert_allclose(M.CalcRotationalInertia().CopyToFullMatrix3(), mesh.moment_inertia, rtol=1e-5, atol=1e-9)


def test_what_is_not_watertight_says_so(tmp_path: Path) -> None:
    mesh = write_stl(tmp_path / "a.stl", trimesh.Trimesh(*_without_lid(), process=False))
    built = build_from_mesh(mesh, "a", tmp_path / "lib")
    assert any("not watertight" in note and "hull" in note for note in built.notes)
    assert any("mass not told" in note for note in built.notes) and built.mass == pytest.approx(1000 * 2.4e-4)
    assert read_spec(tmp_path / "lib" / "a").volume_by == "hull"


def test_a_ball_that_is_hollow_and_closed_is_one_piece(tmp_path: Path) -> None:
    outer, inner = (trimesh.creation.icosphere(subdivisions=3, radius=radius) for radius in (0.05, 0.04))
    inner.invert()
    trimesh.util.concatenate([outer, inner]).export(tmp_path / "ball.stl")
    built = build_from_mesh(tmp_path / "ball.stl", "ball", tmp_path / "library", density=1000.0)
    assert read_spec(built.folder).pieces == ["pieces/piece0.obj"]  # twelve of V-HACD's before
    assert built.mass == pytest.approx(1000 * (outer.volume + inner.volume), rel=1e-4)


def test_what_a_label_covers_is_not_in_the_cloud(tmp_path: Path) -> None:
    side, label = trimesh.creation.box([0.1, 0.06, 0.04]), trimesh.creation.box([0.06, 0.001, 0.02])
    label.apply_translation([0.0, -0.03, 0.0])
    for mesh, colour in ((side, [200, 130, 40, 255]), (label, [225, 225, 225, 255])):
        mesh.visual.vertex_colors = np.tile(np.array(colour, dtype=np.uint8), (len(mesh.vertices), 1))
    trimesh.util.concatenate([side, label]).export(tmp_path / "box.ply")
    build_from_mesh(tmp_path / "box.ply", "box", tmp_path / "lib")
    asset = Asset.load(tmp_path / "lib" / "box")
    x, y, z = asset.points_O.T
    front = (np.abs(x) < 0.028) & (np.abs(z) < 0.009) & (y < y.min() + 0.002)
    assert np.count_nonzero(front) > 100
    np.testing.assert_allclose(asset.colours[front], 225 / 255, atol=0.02)  # half of them were the side's below
    whole = Asset.load(build_from_mesh(write_coloured(tmp_path / "src"), "plain", tmp_path / "lib").folder)
    assert len(asset.points_O) == len(whole.points_O)


def test_bodies_that_overlap_are_weighed_as_one_and_said_to(tmp_path: Path) -> None:
    cubes = trimesh.util.concatenate([box(0.06, 0.06, 0.06), box(0.04, 0.04, 0.04, at=(0.03, 0.0, 0.0))])
    built = build_from_mesh(write_stl(tmp_path / "a.stl", cubes), "a", tmp_path / "lib", density=1000.0)
    assert built.mass == pytest.approx(0.248, rel=0.01)
    assert any("bodies in it overlap" in note for note in built.notes)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_is_read_with_its_colours(tmp_path: Path, encoding: str) -> None:
    mesh = trimesh.creation.box([0.06, 0.05, 0.1])
    mesh.visual.vertex_colors = np.tile([200, 30, 40, 255], (8, 1)).astype(np.uint8)
    mesh.export(tmp_path / "a.ply", encoding=encoding)
    built = build_from_mesh(tmp_path / "a.ply", "a", tmp_path / "lib", mass=0.3)
    assert built.volume == pytest.approx(3e-4) and built.size == pytest.approx([0.06, 0.05, 0.1])
    colours = Asset.load(built.folder).colours
    assert np.abs(colours - np.array([200, 30, 40]) / 255).max() < 0.02
    if encoding == "ascii":
        return
    (tmp_path / "cut.ply").write_bytes((tmp_path / "a.ply").read_bytes()[:-40])
    with pytest.raises(AssetError, match=r"cut\.ply: "):
        build_from_mesh(tmp_path / "cut.ply", "b", tmp_path / "lib", mass=0.3)
    assert not (tmp_path / "lib" / "b").exists()


def _without_lid() -> tuple[Array, Array]:
    mesh = box(0.1, 0.06, 0.04)
    lid = np.asarray(mesh.face_normals)[:, 2] > 0.5
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)[~lid]


def test_a_mass_in_grams_is_asked_about(tmp_path: Path) -> None:
    built = build_from_mesh(write_stl(tmp_path / "a.stl", box(0.1, 0.06, 0.04)), "a", tmp_path / "lib", mass=300.0)
    assert any("in grams" in note for note in built.notes)


# In use.


def test_a_built_object_is_found_in_a_picture(tmp_path: Path) -> None:
    """A textured box, brought as GLB with its y axis up, is registered where the original stands."""
    size = (0.09, 0.05, 0.16)
    original = Asset.load(write_box(tmp_path / "made", "made", size, texture_seed=7))
    mesh = read_obj(tmp_path / "made" / "visual.obj")
    y_up = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1) + [0.3, 0.0, -0.1]
    look = trimesh.visual.TextureVisuals(uv=mesh.uv, image=Image.open(tmp_path / "made" / "visual.png"))
    brought = trimesh.Trimesh(y_up, mesh.faces, visual=look, process=False)
    (tmp_path / "brought.glb").write_bytes(brought.export(file_type="glb"))
    built = Asset.load(build_from_mesh(tmp_path / "brought.glb", "it", tmp_path / "lib", mass=0.4).folder)
    orientations = resting(built)
    assert np.allclose(orientations[0][0], np.eye(3)) and orientations[0][1] == pytest.approx(0.08, abs=1e-5)
    view, params = camera(), scenario.Registration()
    thing = Thing(original, 7, yawed(0.7), np.array([0.5, 0.05, 0.08]))
    rgb, depth, _ = picture(view, [thing], np.random.default_rng(1))
    frame = Frame.of(segment(rgb, depth, 0.0, Grid.of(view, 2), scenario.Perception()))
    model = ModelCloud.of(built, params.model_points)
    found = register(model, frame, thing.R @ exp(np.array([0.03, -0.03, 0.05])), thing.p + [0.004, 0.003, 0], params)
    assert found.quality > 0.9
    assert np.linalg.norm(found.p - thing.p) < 1e-3 and np.degrees(np.linalg.norm(log(found.R @ thing.R.T))) < 0.7
    # The look counts: the other way round it is not the box.
    other_way = register(model, frame, thing.R @ exp(np.array([0, 0, np.pi])), thing.p, params)
    assert other_way.likeness < 0.5 < 0.8 < found.likeness


def test_a_scenario_takes_it_at_once(tmp_path: Path) -> None:
    built = build_from_mesh(write_coloured(tmp_path / "src"), "box", tmp_path / "lib", mass=0.5)
    told = scenario.load_scenario("tabletop").twin
    told.library = {"mine": str(built.folder)}
    scene = add_twin_scene(DiagramBuilder(), told)
    assert list(scene.object_names) == ["mine"]
    assert scene.plant.GetBodyByName("object", scene.plant.GetModelInstanceByName("mine")).default_mass() == 0.5


def test_it_stands_where_it_is_put(tmp_path: Path) -> None:
    """On feet that touch the hull from inside, spread over it."""
    corners = np.array(box(0.1, 0.06, 0.04).vertices)
    feet = write_asset.feet(corners)
    np.testing.assert_allclose(np.sort(np.abs(feet), axis=0), np.tile([0.048, 0.028, 0.018], (8, 1)), atol=1e-6)
    can = np.array(trimesh.creation.cylinder(radius=0.04, height=0.1, sections=64).vertices)
    feet = write_asset.feet(can)
    assert len(feet) == write_asset.TUNING.feet
    for z in (-0.048, 0.048):
        angle = np.sort(np.arctan2(*feet[np.abs(feet[:, 2] - z) < 1e-6, :2].T))
        assert len(angle) >= 8 and np.diff(angle, append=angle[0] + 2 * np.pi).max() < 1.2
    assert len(write_asset.feet(np.array(box(0.1, 0.06, 0.003).vertices))) == 0


def test_each_step_is_told(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = write_stl(tmp_path / "box.stl", box(0.1, 0.06, 0.04))
    for slow, first in ((12, []), (11, ["box.stl: 12 triangles read"])):
        monkeypatch.setattr(from_mesh, "TUNING", replace(from_mesh.TUNING, slow=slow))
        given = ["assets", "build", str(mesh), "--name", "box", "--library", str(tmp_path / "lib"), "--replace"]
        assert cli.main(given) == 0
        told = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("note: ")]
        vertices = "8 vertices, 240 cm³; looking for convex pieces that hold it"
        assert told == [*first, vertices, "writing it and reading it back"]


def test_one_build_is_like_another(tmp_path: Path) -> None:
    mesh = write_coloured(tmp_path / "src")
    one, two = (build_from_mesh(mesh, "box", tmp_path / lib, mass=0.5).folder for lib in ("a", "b"))
    names = sorted(path.relative_to(one).as_posix() for path in one.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(two).as_posix() for path in two.rglob("*") if path.is_file())
    for name in names:
        assert name == "cloud.npz" or (one / name).read_bytes() == (two / name).read_bytes() or name == "asset.yaml"


def test_replace_keeps_what_others_put_there(tmp_path: Path) -> None:
    mesh = write_stl(tmp_path / "a.stl", box(0.1, 0.06, 0.04))
    folder = build_from_mesh(write_stl(tmp_path / "l.stl", corner()), "a", tmp_path / "lib", mass=1.0).folder
    assert (folder / "pieces" / "piece1.obj").is_file()
    (folder / "grasps").mkdir()
    (folder / "grasps" / "mine.yaml").write_text("precious\n")
    build_from_mesh(mesh, "a", tmp_path / "lib", mass=2.0, replace_it=True)
    assert Asset.load(folder).mass == 2.0 and not (folder / "pieces" / "piece1.obj").exists()
    assert (folder / "grasps" / "mine.yaml").read_text() == "precious\n"
    assert sorted(path.name for path in (tmp_path / "lib").iterdir()) == ["a"]


def test_what_fails_on_the_way_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = write_stl(tmp_path / "a.stl", box(0.1, 0.06, 0.04))
    folder = build_from_mesh(mesh, "a", tmp_path / "lib", mass=1.0).folder
    before = (folder / "asset.yaml").read_bytes()

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(write_asset, "_read_back", fails)
    with pytest.raises(OSError, match="No space"):
        build_from_mesh(mesh, "a", tmp_path / "lib", mass=2.0, replace_it=True)
    with pytest.raises(OSError, match="No space"):
        build_from_mesh(mesh, "b", tmp_path / "lib", mass=2.0)
    assert sorted(path.name for path in (tmp_path / "lib").iterdir()) == ["a"]
    assert (folder / "asset.yaml").read_bytes() == before


# What is refused.


def written(folder: Path, name: str, text: str | bytes) -> Path:
    (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
    return folder / name


TRIANGLES = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


STRIPS = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 2\n"
)


def bad_meshes(folder: Path) -> dict[str, tuple[Path, list[str]]]:
    """Files that must be refused, with words that the line holds."""
    secret = folder.parent / "secret.png"
    secret.write_bytes((write_coloured(folder / "colours").parent / "top.png").read_bytes())
    linked = folder / "linked"
    mesh = write_coloured(linked)
    (linked / "top.png").unlink()
    (linked / "top.png").symlink_to(secret)
    climbing = write_coloured(folder / "climbing")
    (folder / "climbing" / "box.mtl").write_text("newmtl top\nmap_Kd ../../secret.png\n")
    absolute = write_coloured(folder / "absolute")
    absolute.write_text(absolute.read_text().replace("mtllib box.mtl", f"mtllib {secret}"))
    broken = write_coloured(folder / "broken")
    (folder / "broken" / "top.png").write_bytes(b"no picture")
    good = box(0.1, 0.1, 0.1)
    glb = good.export(file_type="glb")
    stl = bytearray(good.export(file_type="stl"))
    stl[96:100] = struct.pack("<f", float("nan"))
    far = json.dumps(
        {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 4, "uri": "../../secret.png"}],
            "bufferViews": [{"buffer": 0, "byteLength": 4}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 1, "type": "SCALAR"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
    )
    return {
        "link": (mesh, ["box.obj", "top.png", "outside"]),
        "climb": (climbing, ["../../secret.png", "outside"]),
        "absolute": (absolute, ["secret.png", "outside"]),
        "broken picture": (broken, ["top.png", "not an image"]),
        "far buffer": (written(folder, "far.gltf", far), ["far.gltf", "../../secret.png", "outside"]),
        "nan": (written(folder, "nan.obj", TRIANGLES.replace("0.1 0 0", "nan 0 0")), ["nan.obj", "not finite"]),
        "nan stl": (written(folder, "nan.stl", bytes(stl)), ["nan.stl", "not finite"]),
        "no faces": (written(folder, "points.obj", "v 0 0 0\nv 1 0 0\n"), ["points.obj", "no triangles"]),
        "empty": (written(folder, "empty.obj", ""), ["empty.obj", "no triangles"]),
        "empty stl": (written(folder, "empty.stl", ""), ["empty.stl"]),
        "cut stl": (written(folder, "cut.stl", bytes(stl[:-30])), ["cut.stl", "12 triangles", "684 bytes", "654"]),
        "strips": (written(folder, "strips.ply", STRIPS), ["strips.ply", "strips, which are not read"]),
        "index": (written(folder, "index.obj", TRIANGLES + "f 1 2 9\n"), ["index.obj", "not there"]),
        "words": (written(folder, "words.obj", "v a b c\n"), ["words.obj", "'a'"]),
        "short": (written(folder, "short.obj", "v 0 1\nf 1 1 1\n"), ["short.obj", "'v'"]),
        "binary": (written(folder, "binary.obj", b"\xff\xfe\x00v 0"), ["binary.obj"]),
        "flat": (written(folder, "flat.obj", TRIANGLES.replace("0 0 0.1", "0.1 0.1 0")), ["flat.obj", "plane"]),
        "slivers": (written(folder, "slivers.obj", "v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n"), ["slivers.obj"]),
        "cut glb": (written(folder, "cut.glb", glb[: len(glb) // 2]), ["cut.glb", "glb"]),
        "text glb": (written(folder, "text.glb", "hello"), ["text.glb", "glb"]),
        "text gltf": (written(folder, "text.gltf", "hello"), ["text.gltf", "no JSON"]),
        "list gltf": (written(folder, "list.gltf", "[1]"), ["list.gltf", "no JSON object"]),
        "ending": (written(folder, "mesh.blend", "hello"), ["mesh.blend", ".obj", ".stl", ".glb"]),
        "folder": (folder / "colours", ["colours"]),
        "missing": (folder / "gone.obj", ["gone.obj", "no such"]),
        "large": (write_stl(folder / "large.stl", box(120, 80, 40)), ["120 m", "over 2 m", "--unit mm", "120 mm"]),
        "small": (write_stl(folder / "small.stl", box(1e-4, 8e-5, 4e-5)), ["0.0001 m", "under 5 mm", "no unit"]),
        "huge": (write_stl(folder / "huge.stl", box(1e6, 8, 4)), ["over 2 m", "no unit"]),
    }


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, list[str]]]:
    folder = tmp_path_factory.mktemp("outer") / "bad"
    folder.mkdir()
    return bad_meshes(folder)


NAMES = (
    "link,climb,absolute,broken picture,far buffer,nan,nan stl,no faces,empty,empty stl,cut stl,strips,index,words,"
    "short,binary,flat,slivers,cut glb,text glb,text gltf,list gltf,ending,folder,missing,large,small,huge"
).split(",")


def test_a_byte_order_mark_hides_no_vertex(tmp_path: Path) -> None:
    """Some editors on Windows put one before all."""
    (part,) = read_source(written(tmp_path, "marked.obj", b"\xef\xbb\xbf" + TRIANGLES.encode())).parts
    assert part.corners.shape == (4, 3, 3)


def refused(capfd: pytest.CaptureFixture[str], *argv: str | Path) -> str:
    try:
        status = cli.main([str(word) for word in argv])
    except SystemExit as end:
        status = int(end.code or 0)
    out, err = capfd.readouterr()
    assert status == 2 and out == "", (status, out, err)
    assert err.startswith("error: ") and err.count("\n") == 1, err
    return err


@pytest.mark.parametrize("case", NAMES)
def test_bad_meshes_are_refused(
    case: str, bad: dict[str, tuple[Path, list[str]]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, words = bad[case]
    line = refused(capfd, "assets", "build", path, "--name", "it", "--library", tmp_path / "lib", "--mass", "1")
    assert all(word in line for word in words), line
    assert not (tmp_path / "lib").exists() and not list(tmp_path.iterdir())


def test_no_bad_mesh_is_forgotten(bad: dict[str, tuple[Path, list[str]]]) -> None:
    assert list(bad) == NAMES


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--name", "../it"], ["'../it'", "no path"]),
        (["--name", "a/b"], ["'a/b'"]),
        (["--name", "/it"], ["'/it'"]),
        (["--name", ".."], ["'..'"]),
        (["--name", ".hidden"], ["'.hidden'"]),
        (["--name", ""], ["''"]),
        (["--name", "it\n"], ["no path"]),
        (["--name", "x" * 65], ["64"]),
        (["--name", "taken"], ["'taken'", "--replace"]),
        (["--name", "notes"], ["'notes'", "something else"]),
        (["--name", "notes", "--replace"], ["'notes'", "something else"]),
        (["--name", "linked", "--replace"], ["'linked'", "something else"]),
        (["--name", "it", "--mass", "0"], ["--mass 0", "positive"]),
        (["--name", "it", "--mass=-1"], ["--mass -1"]),
        (["--name", "it", "--mass", "nan"], ["--mass nan"]),
        (["--name", "it", "--mass", "inf"], ["--mass inf"]),
        (["--name", "it", "--mass", "heavy"], ["'heavy'"]),
        (["--name", "it", "--density", "0"], ["--density 0"]),
        (["--name", "it", "--density=-3"], ["--density -3"]),
        (["--name", "it", "--mass", "1", "--density", "1000"], ["--mass 1", "--density 1000"]),
        (["--name", "it", "--unit", "ft"], ["'ft'", "mm"]),
    ],
)
def test_bad_options_are_refused(
    options: list[str], words: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    mesh = write_stl(tmp_path / "a.stl", box(0.1, 0.06, 0.04))
    lib = tmp_path / "lib"
    build_from_mesh(mesh, "taken", lib, mass=1.0)
    (lib / "notes").mkdir()
    (lib / "linked").symlink_to(lib / "taken")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    line = refused(capfd, "assets", "build", mesh, "--library", lib, *options)
    assert all(word in line for word in words), line
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert sorted(os.listdir(lib)) == ["linked", "notes", "taken"]


def test_a_library_that_is_a_file_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    mesh = write_stl(tmp_path / "a.stl", box(0.1, 0.06, 0.04))
    line = refused(capfd, "assets", "build", mesh, "--library", mesh, "--name", "it")
    assert "--library" in line and "a.stl" in line


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_mesh, "TUNING", replace(source_mesh.TUNING, most_faces=11))
    mesh = write_stl(tmp_path / "a.stl", box(0.1, 0.06, 0.04))
    with pytest.raises(AssetError, match="12 triangles"):
        build_from_mesh(mesh, "a", tmp_path / "lib")
    monkeypatch.setattr(source_mesh, "TUNING", replace(source_mesh.TUNING, most_faces=12))
    build_from_mesh(mesh, "a", tmp_path / "lib")


def test_a_missing_material_is_told_and_gone_without(tmp_path: Path) -> None:
    mesh = write_coloured(tmp_path / "src")
    (tmp_path / "src" / "top.png").unlink()
    assert any("top.png" in note for note in build_from_mesh(mesh, "a", tmp_path / "lib").notes)
    (tmp_path / "src" / "box.mtl").unlink()
    assert any("box.mtl" in note for note in build_from_mesh(mesh, "b", tmp_path / "lib").notes)


def test_pictures_beside_the_meshes_folder_are_read_where_one_says_so(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As `meshes/` and `textures/` lie in one folder."""
    mesh = write_coloured(tmp_path / "thing" / "meshes")
    (tmp_path / "thing" / "textures").mkdir()
    (mesh.parent / "top.png").rename(tmp_path / "thing" / "textures" / "top.png")
    materials = mesh.with_suffix(".mtl")
    materials.write_text(materials.read_text().replace("top.png", "../textures/top.png"))
    build = ["assets", "build", mesh, "--name", "a", "--library", tmp_path / "lib"]
    assert "--root" in refused(capfd, *build)
    assert "gone" in refused(capfd, *build, "--root", tmp_path / "gone")
    assert "textures" in refused(capfd, *build, "--root", mesh.parent)
    assert cli.main([str(word) for word in (*build, "--root", tmp_path / "thing")]) == 0
    asset = Asset.load(tmp_path / "lib" / "a")
    np.testing.assert_allclose(colour_at(asset, (-0.03, 0.01, 0.02)), [1, 0, 0], atol=0.02)


def test_gazebos_pictures_are_found_by_their_names(tmp_path: Path) -> None:
    """Scanned objects come as `meshes/model.obj` and `materials/textures/texture.png`, named without a folder."""
    mesh = write_coloured(tmp_path / "meshes")
    (tmp_path / "materials" / "textures").mkdir(parents=True)
    (mesh.parent / "top.png").rename(tmp_path / "materials" / "textures" / "top.png")
    assert not any(part.image is not None for part in source_mesh.read_source(mesh).parts)
    found = source_mesh.read_source(mesh, root=tmp_path)
    assert sum(part.image is not None for part in found.parts) == 1 and not found.notes


def test_what_a_gltf_lacks_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Its triangles' file; and a compression that would be read as zeros."""
    for name, data in box(0.1, 0.1, 0.1).export(file_type="gltf").items():
        written(tmp_path, name, data)
    tree = json.loads((tmp_path / "model.gltf").read_text())
    build = ["assets", "build", tmp_path / "model.gltf", "--name", "a", "--library", tmp_path / "lib"]
    packed = {**tree, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    written(tmp_path, "model.gltf", json.dumps(packed))
    assert "KHR_draco_mesh_compression" in refused(capfd, *build)
    written(tmp_path, "model.gltf", json.dumps(tree))
    buffer = tree["buffers"][0]["uri"]
    (tmp_path / buffer).unlink()
    line = refused(capfd, *build)
    assert buffer in line and "not there" in line


def test_remarks_and_names_may_have_any_encoding(tmp_path: Path) -> None:
    mesh = write_coloured(tmp_path / "src")
    mesh.write_bytes("# für Möbel\n".encode("latin-1") + mesh.read_bytes())
    assert build_from_mesh(mesh, "a", tmp_path / "lib").volume == pytest.approx(0.1 * 0.06 * 0.04)


def test_mujoco_reads_the_same_object_as_drake(tmp_path: Path) -> None:
    built = build_from_mesh(write_stl(tmp_path / "l.stl", corner()), "l", tmp_path / "lib", mass=0.4)
    spec = read_spec(built.folder)
    model = mujoco.MjModel.from_xml_path(str(built.folder / "model.xml"))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    inertia = turn.reshape(3, 3) @ np.diag(model.body_inertia[1]) @ turn.reshape(3, 3).T
    xx, yy, zz, xy, xz, yz = spec.inertia
    np.testing.assert_allclose(inertia, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-9)
    assert model.body_mass[1] == pytest.approx(0.4) and np.abs(model.body_ipos[1]).max() < 1e-9
    assert model.ngeom == 1 + len(spec.pieces)
