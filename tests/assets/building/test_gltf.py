"""glTF as the specification has it: linear factors, sRGB pictures, packed numbers, strips, fans, nodes."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.assets.building.made_meshes import box
from twin_diagram.assets.building.gltf import linear, srgb
from twin_diagram.assets.building.source_mesh import Source, read_source
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

ORANGE = np.array([0.8, 0.4, 0.2])
"""As a camera sees it: sRGB."""

KINDS = {"f4": 5126, "u2": 5123, "u1": 5121, "i2": 5122}


class Writer:
    """Writes one glTF file of one primitive, after the specification and by itself."""

    def __init__(self) -> None:
        self.data, self.told = b"", dict[str, Any](asset={"version": "2.0"}, bufferViews=[], accessors=[])

    def view(self, data: bytes) -> int:
        """Return the index of a new part of the buffer."""
        self.data += b"\0" * (-len(self.data) % 4)
        self.told["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.told["bufferViews"]) - 1

    def array(self, values: Array, kind: str = "f4", **more: Any) -> int:
        """Return the index of a new accessor; what is packed holds shares of its kind's largest number."""
        rows = np.asarray(values)
        if more.get("normalized"):
            rows = np.round(rows * np.iinfo(kind).max)
        width = "SCALAR" if rows.ndim == 1 else f"VEC{rows.shape[1]}"
        told = {"bufferView": self.view(rows.astype(f"<{kind}").tobytes()), "componentType": KINDS[kind]}
        self.told["accessors"].append({**told, "count": len(rows), "type": width, **more})
        return len(self.told["accessors"]) - 1

    def picture(self, rgb: Array) -> dict[str, Any]:
        """Return what a material says of a new picture."""
        png = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
        self.told |= {"images": [{"bufferView": self.view(png), "mimeType": "image/png"}], "textures": [{"source": 0}]}
        return {"index": 0}

    def read(self, folder: Path, primitive: dict[str, Any], material: dict[str, Any] | None = None) -> Source:
        """Write the file with one primitive, and read it."""
        if material is not None:
            self.told["materials"], primitive["material"] = [{"pbrMetallicRoughness": material}], 0
        self.told |= {"meshes": [{"primitives": [primitive]}]}
        self.told = {"nodes": [{"mesh": 0}], **self.told}
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        self.told["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
        (folder / "it.gltf").write_text(json.dumps(self.told))
        return read_source(folder / "it.gltf")


def corners() -> Array:
    """Return the corners (36, 3) of a box's triangles."""
    mesh = box(0.06, 0.08, 0.1)
    return np.asarray(mesh.vertices[mesh.faces].reshape(-1, 3), dtype=float)


def test_srgb_has_the_published_values() -> None:
    assert srgb(np.array([0.0, 0.0031308, 0.2140411, 1.0])) == pytest.approx([0.0, 0.0404500, 0.5, 1.0], abs=1e-6)
    assert srgb(linear(np.linspace(0, 1, 50))) == pytest.approx(np.linspace(0, 1, 50), abs=1e-6)


@pytest.mark.parametrize("material", [None, {}, {"baseColorFactor": [1, 1, 1, 1]}])
@pytest.mark.parametrize(("kind", "more"), [("f4", {}), ("u2", {"normalized": True}), ("u1", {"normalized": True})])
def test_colours_of_vertices_are_linear_light(
    tmp_path: Path, material: dict[str, Any] | None, kind: str, more: dict[str, Any]
) -> None:
    made = Writer()
    rgba = np.tile([*linear(ORANGE), 1.0], (36, 1))
    primitive = {"attributes": {"POSITION": made.array(corners()), "COLOR_0": made.array(rgba, kind, **more)}}
    (part,) = made.read(tmp_path, primitive, material).parts
    assert part.image is None and part.colours == pytest.approx(
        np.tile(ORANGE, (12, 1)), abs=0.007
    )  # half of a byte, where it is dark


def test_a_factor_is_linear_light_and_a_picture_is_not(tmp_path: Path) -> None:
    made = Writer()
    (part,) = made.read(
        tmp_path, {"attributes": {"POSITION": made.array(corners())}}, {"baseColorFactor": [*linear(ORANGE), 1]}
    ).parts
    assert part.colours == pytest.approx(np.tile(ORANGE, (12, 1)), abs=1e-6)
    plain = np.round(np.full((4, 4, 3), 255) * ORANGE).astype(np.uint8)
    white = np.full((4, 4, 3), 255, np.uint8)
    tint = np.tile(linear(ORANGE), (36, 1))
    for image, factor, tinted in (
        (plain, np.ones(3), False),
        (white, linear(ORANGE), False),
        (white, np.ones(3), True),
    ):
        made = Writer()
        attributes = {"POSITION": made.array(corners()), "TEXCOORD_0": made.array(np.full((36, 2), 0.5))}
        if tinted:
            attributes["COLOR_0"] = made.array(tint)
        material = {"baseColorFactor": [*factor, 1], "baseColorTexture": made.picture(image)}
        (part,) = made.read(tmp_path, {"attributes": attributes}, material).parts
        assert part.image is not None and part.image[0, 0] == pytest.approx(255 * ORANGE, abs=1)


def test_a_picture_is_where_its_material_says(tmp_path: Path) -> None:
    uv = np.random.default_rng(0).uniform(0, 1, (36, 2))
    told = {
        "plain": ({}, uv),
        "second": ({"texCoord": 1}, 0.5 * uv),
        "moved": ({"extensions": {"KHR_texture_transform": {"offset": [0.1, 0.2], "scale": [0.5, 0.25]}}}, None),
        # A quarter turn, counter-clockwise as v runs downwards.
        "turned": ({"extensions": {"KHR_texture_transform": {"rotation": np.pi / 2}}}, None),
    }
    right = {"moved": [0.1, 0.2] + [0.5, 0.25] * uv, "turned": np.stack([uv[:, 1], -uv[:, 0]], axis=1)}
    for name, (slot, expected) in told.items():
        made = Writer()
        attributes = {"POSITION": made.array(corners()), "TEXCOORD_0": made.array(uv, "u2", normalized=True)}
        attributes["TEXCOORD_1"] = made.array(0.5 * uv)
        picture = made.picture(np.zeros((4, 4, 3), np.uint8)) | slot
        (part,) = made.read(tmp_path, {"attributes": attributes}, {"baseColorTexture": picture}).parts
        u, v = (right[name] if expected is None else expected).T
        assert part.uv is not None and part.uv.reshape(-1, 2) == pytest.approx(np.stack([u, 1 - v], axis=1), abs=1e-4)


def test_triangles_are_read_however_they_are_packed(tmp_path: Path) -> None:
    made, places = Writer(), corners()
    packed = made.array(places / 0.05, "i2", normalized=True)
    made.told["nodes"] = [{"scale": 3 * [0.05], "mesh": 0}]
    (part,) = made.read(tmp_path, {"attributes": {"POSITION": packed}}).parts
    assert part.corners.reshape(-1, 3) == pytest.approx(places, abs=1e-6)

    made = Writer()
    lost = places.copy()
    lost[5:9] = 0.0
    index = made.array(lost)
    indices = {"bufferView": made.view(np.arange(5, 9, dtype="<u2").tobytes()), "componentType": KINDS["u2"]}
    values = {"bufferView": made.view(places[5:9].astype("<f4").tobytes())}
    made.told["accessors"][index]["sparse"] = {"count": 4, "indices": indices, "values": values}
    (part,) = made.read(tmp_path, {"attributes": {"POSITION": index}}).parts
    assert part.corners.reshape(-1, 3) == pytest.approx(places, abs=1e-6)


@pytest.mark.parametrize(("mode", "order"), [(4, [0, 1, 2, 0, 2, 3]), (5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans_face_as_triangles_do(tmp_path: Path, mode: int, order: list[int]) -> None:
    made = Writer()
    square = made.array(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]))
    indices = made.array(np.array(order), "u2")
    (part,) = made.read(tmp_path, {"attributes": {"POSITION": square}, "indices": indices, "mode": mode}).parts
    a, b, c = np.moveaxis(part.corners, 1, 0)
    assert np.cross(b - a, c - a) == pytest.approx(np.tile([0.0, 0, 1], (2, 1)))


def test_what_is_not_read_is_said(tmp_path: Path) -> None:
    made = Writer()
    made.told["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    with pytest.raises(AssetError, match=r"it\.gltf: needs EXT_mesh_gpu_instancing"):
        made.read(tmp_path, {"attributes": {"POSITION": made.array(corners())}})
    made = Writer()
    made.told["asset"]["version"] = "1.0"
    with pytest.raises(AssetError, match=r"it\.gltf: glTF of version 1\.0"):
        made.read(tmp_path, {"attributes": {"POSITION": made.array(corners())}})
    made = Writer()
    attributes = {"POSITION": made.array(corners()), "TEXCOORD_0": made.array(np.zeros((36, 2)))}
    attributes["COLOR_0"] = made.array(np.random.default_rng(1).uniform(0, 1, (36, 3)))
    source = made.read(tmp_path, {"attributes": attributes}, {"baseColorTexture": made.picture(np.ones((4, 4, 3)))})
    assert "COLOR_0" in source.notes[0]
    for spoilt in ({"byteOffset": 90}, {"count": 37}, {"bufferView": 7}, {"componentType": 1}):
        made = Writer()
        index = made.array(corners())
        made.told["accessors"][index] |= spoilt
        with pytest.raises(AssetError, match=r"it\.gltf: cannot be read as gltf"):
            made.read(tmp_path, {"attributes": {"POSITION": index}})
