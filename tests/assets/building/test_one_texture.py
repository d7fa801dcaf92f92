"""One picture for all parts: each corner has the colour that it has in its own picture, repeated as it may be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.assets.building.made_meshes import box
from twin_diagram.assets.building import one_texture as module
from twin_diagram.assets.building.obj_materials import materials_of
from twin_diagram.assets.building.one_texture import laid_out, one_texture, plain
from twin_diagram.assets.building.source_mesh import Part, read_source
from twin_diagram.assets.mesh import bilinear
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


def part(uv: Array | None, image: Array | None, colours: Array) -> Part:
    count = len(colours)
    picture = None if image is None else image.astype(np.uint8)
    return Part(np.zeros((count, 3, 3)), uv, picture, colours)


def test_several_pictures_and_plain_colours_become_one() -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (20, 30, 3)), rng.integers(0, 256, (12, 50, 3))]
    uvs = [rng.uniform(0.1, 0.9, (7, 3, 2)) for _ in pictures]
    colours = rng.uniform(0, 1, (5, 3))
    parts = [part(uv, image, np.zeros((7, 3))) for uv, image in zip(uvs, pictures, strict=True)]
    uv, atlas = one_texture([parts[0], part(None, None, colours), parts[1]])
    assert uv.shape == (19, 3, 2) and uv.min() >= 0 and uv.max() <= 1
    for rows, image, own in ((slice(0, 7), pictures[0], uvs[0]), (slice(12, 19), pictures[1], uvs[1])):
        expected = bilinear(image.astype(np.uint8), own.reshape(-1, 2))
        np.testing.assert_allclose(bilinear(atlas, uv[rows].reshape(-1, 2)), expected, atol=1e-6)
    seen = bilinear(atlas, uv[7:12].reshape(-1, 2)).reshape(5, 3, 3)
    np.testing.assert_allclose(seen, np.repeat(colours[:, None], 3, axis=1), atol=0.003)


def test_a_picture_that_runs_on_is_laid_out_as_often() -> None:
    image = np.random.default_rng(1).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    uv = np.array([[[-0.3, 4.2], [1.6, 4.4], [0.2, 6.1]], [[0.1, 0.2], [0.3, 0.4], [0.9, 1.0]]])
    mapped, picture = laid_out(uv, image)
    assert picture.shape == (24, 24, 3)  # three times along both edges
    inner = np.mod(uv, 1.0)
    away = (np.abs(inner - 0.5) < 0.4).all(axis=-1)  # at the picture's edge, its neighbour blends in
    assert away.sum() >= 3
    np.testing.assert_allclose(bilinear(picture, mapped[away]), bilinear(image, inner[away]), atol=1e-6)
    # A triangle that ends at the upper edge stays at the upper edge.
    same, whole = laid_out(np.array([[[0.0, 1.0], [1.0, 1.0], [0.5, 0.0]]]), image)
    np.testing.assert_array_equal(whole, image)
    np.testing.assert_allclose(same[0], [[0.0, 1.0], [1.0, 1.0], [0.5, 0.0]])
    with pytest.raises(AssetError, match="9 times"):
        laid_out(np.array([[[0.0, 0.0], [8.5, 0.0], [0.0, 1.0]]]), image)


def test_many_colours_are_rounded_to_what_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TUNING", replace(module.TUNING, most_colours=64))
    colours = np.random.default_rng(2).uniform(0, 1, (3000, 3))
    uv, picture = plain(colours)
    assert picture.shape[0] <= 8 * module.TUNING.patch
    assert np.abs(bilinear(picture, uv[:, 0]) - colours).max() < 0.18
    few, exact = plain(colours[:40])
    np.testing.assert_allclose(bilinear(exact, few[:, 1]), colours[:40], atol=0.003)


def test_large_pictures_are_reduced() -> None:
    image = np.zeros((100, 4000, 3))
    image[:, 2000:] = 255
    uv, picture = one_texture([part(np.full((1, 3, 2), [0.75, 0.5]), image, np.zeros((1, 3)))])
    assert picture.shape == (26, 1024, 3)
    np.testing.assert_allclose(bilinear(picture, uv[0]), 1.0)


# Colours as files have them.


def test_gltf_materials(tmp_path: Path) -> None:
    grey = Image.fromarray(np.full((4, 4, 3), 200, np.uint8))
    looks = {
        "factor": trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 0, 0, 255]),
        "both": trimesh.visual.material.PBRMaterial(baseColorTexture=grey, baseColorFactor=[255, 128, 0, 255]),
    }
    for name, material in looks.items():
        mesh = box(0.1, 0.1, 0.1)
        mesh.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), material=material)
        (tmp_path / f"{name}.glb").write_bytes(mesh.export(file_type="glb"))
    (red,) = read_source(tmp_path / "factor.glb").parts
    assert red.image is None
    np.testing.assert_allclose(red.colours, np.tile([1, 0, 0], (12, 1)), atol=0.01)
    (both,) = read_source(tmp_path / "both.glb").parts
    assert both.image is not None and both.uv is not None
    np.testing.assert_allclose(both.image[0, 0], [200, 147, 0], atol=1.5)  # half of the light, not of the number
    # Who wants the shape alone gets the same triangles without either.
    (plain,) = read_source(tmp_path / "both.glb", looks=False).parts
    assert plain.image is None and plain.uv is None
    np.testing.assert_array_equal(plain.corners, both.corners)


def test_colours_of_vertices(tmp_path: Path) -> None:
    text = "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 0 0 1\nv 0 0 1 0 0 1\nf 1 3 2\nf 1 2 4\n"
    (tmp_path / "a.obj").write_text(text)
    (made,) = read_source(tmp_path / "a.obj").parts
    np.testing.assert_allclose(made.colours, np.tile([2 / 3, 0, 1 / 3], (2, 1)))
    np.testing.assert_array_equal(read_source(tmp_path / "a.obj", looks=False).parts[0].corners, made.corners)
    mesh = box(0.1, 0.1, 0.1)
    mesh.visual.vertex_colors = np.tile([0, 255, 0, 255], (8, 1))
    (tmp_path / "a.glb").write_bytes(mesh.export(file_type="glb"))
    (made,) = read_source(tmp_path / "a.glb").parts
    np.testing.assert_allclose(made.colours, np.tile([0, 1, 0], (12, 1)))


def test_what_has_no_colour_is_grey(tmp_path: Path) -> None:
    for kind in ("stl", "glb"):
        data = box(0.1, 0.1, 0.1).export(file_type=kind)
        (tmp_path / f"a.{kind}").write_bytes(data)
        (made,) = read_source(tmp_path / f"a.{kind}").parts
        assert 0.3 < made.colours.min() == made.colours.max() < 0.9, kind


PLY = """ply
format ascii 1.0
{head}element vertex 4
property float x
property float y
property float z
{vertex}element face 2
property list uchar int vertex_indices
{face}end_header
"""
CORNERS = ("0 0 0", "0.1 0 0", "0 0.1 0", "0 0 0.1")
UV = ("0 0", "1 0", "0 1", "1 1")
RED = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))


def ply(folder: Path, of_faces: bool, picture: bool, coloured: bool = False) -> Part:
    """Two triangles with texture coordinates at vertices, as BOP's models have them, or at faces, as MeshLab's have."""
    names = "" if of_faces else "property float texture_u\nproperty float texture_v\n"
    more = "property list uchar float texcoord\n" if of_faces else ""
    head = "comment TextureFile my look.png\n" if picture else ""
    rows = [
        " ".join([at, *([] if of_faces else [uv]), *(["200 10 20"] if coloured else [])])
        for at, uv in zip(CORNERS, UV, strict=True)
    ]
    for face in ((0, 2, 1), (0, 1, 3)):
        own = " ".join(UV[k] for k in face)
        rows.append(f"3 {face[0]} {face[1]} {face[2]}" + (f" 6 {own}" if of_faces else ""))
    text = PLY.format(head=head, vertex=names + (RED if coloured else ""), face=more)
    (folder / "a.ply").write_text(text + "\n".join(rows) + "\n")
    (made,) = read_source(folder / "a.ply").parts
    return made


@pytest.mark.parametrize("of_faces", [False, True])
def test_the_picture_of_a_ply_file_is_read(of_faces: bool, tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    Image.fromarray(picture).save(tmp_path / "my look.png")
    made = ply(tmp_path, of_faces, True)
    np.testing.assert_array_equal(made.image, picture)
    np.testing.assert_allclose(made.uv, [[[0, 0], [0, 1], [1, 0]], [[0, 0], [1, 0], [1, 1]]])
    (tmp_path / "my look.png").write_bytes(b"none")
    with pytest.raises(AssetError, match=r"my look\.png: not an image"):
        ply(tmp_path, of_faces, True)
    (tmp_path / "my look.png").unlink()
    assert ply(tmp_path, of_faces, True).image is None
    assert "my look.png" in read_source(tmp_path / "a.ply").notes[0]


def test_without_a_picture_a_ply_files_vertices_have_its_colours(tmp_path: Path) -> None:
    made = ply(tmp_path, False, False, coloured=True)
    assert made.image is None and made.uv is None
    np.testing.assert_allclose(made.colours, np.tile([200, 10, 20], (2, 1)) / 255)
    older = (tmp_path / "a.ply").read_text().replace("uchar red", "uchar diffuse_red")
    (tmp_path / "a.ply").write_text(
        older.replace("uchar green", "uchar diffuse_green").replace("uchar b", "uchar diffuse_b")
    )
    np.testing.assert_array_equal(read_source(tmp_path / "a.ply").parts[0].colours, made.colours)


def test_an_obj_files_vertices_may_have_bytes(tmp_path: Path) -> None:
    for name, rgb in (("shares", "0.8 0.4 0.2"), ("bytes", "204 102 51"), ("beyond", "0.8 0.4 1.0001")):
        rows = [f"v {at} {rgb}" for at in CORNERS]
        (tmp_path / f"{name}.obj").write_text("\n".join([*rows, "f 1 3 2", "f 1 2 4"]))
        (made,) = read_source(tmp_path / f"{name}.obj").parts
        np.testing.assert_allclose(made.colours, np.tile([0.8, 0.4, 1.0 if name == "beyond" else 0.2], (2, 1)))


def test_a_broken_picture_in_a_gltf_is_said_to_be_so(tmp_path: Path) -> None:
    mesh = box(0.1, 0.1, 0.1)
    noise = np.random.default_rng(0).integers(0, 256, (99, 99, 3), dtype=np.uint8)
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), image=Image.fromarray(noise))
    data = bytearray(mesh.export(file_type="glb"))
    at = data.find(b"IDAT") + 1000
    data[at : at + 20_000] = bytes(20_000)
    (tmp_path / "a.glb").write_bytes(data)
    with pytest.raises(AssetError, match=r"a\.glb: a picture in it cannot be read"):
        read_source(tmp_path / "a.glb")


@pytest.mark.parametrize(
    ("line", "colour"), [("Kd 0.5", [0.5] * 3), ("Kd 0.1 0.2 0.3 1", [0.1, 0.2, 0.3]), ("Ka 1 1 1", [0.7] * 3)]
)
def test_colours_of_materials(line: str, colour: list[float], tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text(f"newmtl m\n{line}\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    np.testing.assert_allclose(read_source(tmp_path / "a.obj").parts[0].colours[0], colour)


@pytest.mark.parametrize("line", ["Kd nan 0 0", "Kd spectral file.rfl", "Kd", "Kd 1 2"])
def test_colours_that_are_none_are_refused(line: str, tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="a colour is three numbers"):
        materials_of(f"newmtl m\n{line}\n", "a.mtl")


def test_a_texture_may_be_named_as_windows_does(tmp_path: Path) -> None:
    mesh = tmp_path / "mesh" / "a.obj"
    (mesh.parent / "looks").mkdir(parents=True)
    for folder, colour in ((mesh.parent / "looks", (9, 8, 7)), (tmp_path, (1, 2, 3))):
        Image.new("RGB", (4, 4), colour).save(folder / "a.png")
    mesh.write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    mesh.with_suffix(".mtl").write_text("newmtl m\nmap_Kd looks\\a.png\n")
    (made,) = read_source(mesh).parts
    assert made.image is not None and made.image[0, 0].tolist() == [9, 8, 7]
    mesh.with_suffix(".mtl").write_text("newmtl m\nmap_Kd ..\\a.png\n")
    with pytest.raises(AssetError, match="outside"):
        read_source(mesh)
