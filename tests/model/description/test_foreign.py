"""Descriptions as other programs write them: their meshes, packages and names."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.errors import ModelError
from twin_diagram.model import Model
from twin_diagram.model.description import mesh_files
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.planning.collision.collision_scene import load_scene
from twin_diagram.scenario import ArmModel, Fixture

CORNERS = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.2) for z in (0.0, 0.3)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
TRIANGLES = CORNERS[[[q[0], *pair] for q in QUADS for pair in (q[1:3], q[2:4])]]

INERTIAL = """<inertial><origin xyz="0 0 0.1"/><mass value="2"/>
 <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def binary_stl(triangles: np.ndarray) -> bytes:
    rows = [struct.pack("<12fH", *np.zeros(3), *triangle.ravel(), 0) for triangle in triangles]
    return b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows)


def letters_stl(triangles: np.ndarray) -> bytes:
    lines = ["solid box"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex {:e} {:e} {:e}".format(*corner) for corner in triangle] + ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid box"]).encode()


def dae() -> bytes:
    """The same box in cm, as polygons, set 1 m up by a node that turns it about z by 90°."""
    numbers = " ".join(f"{100 * x:g}" for x in CORNERS.ravel())
    corners = " ".join(f"{k} 0" for quad in QUADS for k in quad)
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
    <asset><unit name="cm" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
    <library_geometries><geometry id="box"><mesh>
      <source id="p"><float_array id="pa" count="24">{numbers}</float_array>
        <technique_common><accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
        <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
      <source id="n"><float_array id="na" count="3">0 0 1</float_array>
        <technique_common><accessor source="#na" count="1" stride="3"><param name="X" type="float"/>
        <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
      <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
      <polylist count="6"><input semantic="VERTEX" source="#v" offset="0"/>
        <input semantic="NORMAL" source="#n" offset="1"/><vcount>4 4 4 4 4 4</vcount><p>{corners}</p></polylist>
    </mesh></geometry></library_geometries>
    <library_visual_scenes><visual_scene id="s"><node id="a"><translate>0 0 100</translate>
      <node id="b"><rotate>0 0 1 90</rotate><instance_geometry url="#box"/></node></node></visual_scene>
    </library_visual_scenes></COLLADA>""".encode()


def urdf(mesh: str, more: str = "") -> str:
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    return f"""<robot name="arm"><link name="base"/>
    <link name="link">{INERTIAL}<visual>{shape}</visual><collision>{shape}</collision></link>
    <joint name="lift" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
      <limit lower="-1" upper="1" velocity="1" effort="50"/></joint>{more}</robot>"""


SDF = """<sdf version="1.6"><model name="arm"><link name="base"/><link name="finger">%s
<inertial><mass>0.2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
<collision name="tip"><geometry><box><size>0.1 0.2 0.3</size></box></geometry>%s</collision></link>
<joint name="pin" type="revolute"><parent>base</parent><child>finger</child>
<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper><velocity>1</velocity><effort>5</effort></limit></axis>
</joint></model></sdf>"""
"""A finger, with room for what pybullet adds to a link and to a shape that is touched."""


def shape_of(description: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """Lowest and highest corner of the link's only collision shape, and how many shapes are seen of it."""
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    arm = add_arm(plant, description)
    link = plant.get_body(arm.last_link)
    (geometry,) = plant.GetCollisionGeometriesForBody(link)
    inspector = scene_graph.model_inspector()
    hull = inspector.GetConvexHull(geometry)
    corners = np.array([hull.vertex(k) for k in range(hull.num_vertices())])
    X = inspector.GetPoseInFrame(geometry)
    corners = corners @ X.rotation().matrix().T + X.translation()
    seen = inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(link.index()), Role.kPerception)
    return corners.min(axis=0), corners.max(axis=0), len(seen)


OBJ = "\n".join(
    [f"v {x:g} {y:g} {z:g}" for x, y, z in CORNERS] + ["f " + " ".join(str(k + 1) for k in quad) for quad in QUADS]
).encode()
"""Without normals, as many programs write it."""
OFF = "\n".join(
    ["OFF", "8 6 0", *(f"{x:g} {y:g} {z:g}" for x, y, z in CORNERS), *("4 {} {} {} {}".format(*quad) for quad in QUADS)]
).encode()


def ply() -> bytes:
    """The same box of quads, binary, as Blender and MeshLab write it."""
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "element face 6\nproperty list uchar int vertex_indices\nend_header\n"
    return head.encode() + CORNERS.astype("<f4").tobytes() + b"".join(struct.pack("<B4i", 4, *quad) for quad in QUADS)


def glb() -> bytes:
    """The same box, y up, with its numbers in the file's second part."""
    numbers = CORNERS[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    index = np.array([[q[0], *pair] for q in QUADS for pair in (q[1:3], q[2:4])], np.uint16)
    binary = numbers.astype("<f4").tobytes() + index.astype("<u2").tobytes()
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": index.nbytes},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3",
             "min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5123, "count": index.size, "type": "SCALAR"},
        ],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    size = 28 + len(text) + len(binary)
    return (
        struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )


@pytest.mark.parametrize(
    ("name", "content", "low", "high"),
    [
        ("box.glb", glb(), (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
        ("box.obj", OBJ, (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
        ("box.stl", binary_stl(TRIANGLES), (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
        ("Box.STL", letters_stl(TRIANGLES), (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
        ("box.dae", dae(), (-0.2, 0.0, 1.0), (0.0, 0.1, 1.3)),
        ("box.ply", ply(), (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
        ("box.off", OFF, (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
    ],
)
def test_meshes_that_drake_does_not_read(
    tmp_path: Path, name: str, content: bytes, low: tuple[float, ...], high: tuple[float, ...]
) -> None:
    """Beside the description, and in a package that nobody named: found above it, also from a corrected model."""
    package = tmp_path / "my_arm"
    for folder in ("meshes", "urdf"):
        (package / folder).mkdir(parents=True)
    (package / "meshes" / name).write_bytes(content)
    for mesh in (f"../meshes/{name}", f"package://my_arm/meshes/{name}"):
        (package / "urdf" / "arm.urdf").write_text(urdf(mesh))
        Model.load(package / "urdf" / "arm.urdf").save(tmp_path / "corrected")
        for description in (package / "urdf" / "arm.urdf", tmp_path / "corrected"):
            found_low, found_high, seen = shape_of(description)
            np.testing.assert_allclose(found_low, low, atol=1e-6)
            np.testing.assert_allclose(found_high, high, atol=1e-6)
            assert seen == 1


@pytest.mark.parametrize("asks", ["", "<!-- drake:compliant_hydroelastic -->"])
def test_of_a_large_mesh_that_may_be_touched_the_hull_is_read(tmp_path: Path, asks: str) -> None:
    """A parse took 2 s with five of 50,000 triangles; what is drawn stays whole."""
    triangles = TRIANGLES
    for _ in range(5):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    (tmp_path / "box.stl").write_bytes(binary_stl(triangles))
    (tmp_path / "arm.urdf").write_text(urdf("box.stl", asks))
    np.testing.assert_allclose(shape_of(tmp_path / "arm.urdf")[:2], [(0.0, 0.0, 0.0), (0.1, 0.2, 0.3)], atol=1e-6)
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    link, inspector = plant.get_body(add_arm(plant, tmp_path / "arm.urdf").last_link), scene_graph.model_inspector()
    found = [plant.GetCollisionGeometriesForBody(link)[0], plant.GetVisualGeometriesForBody(link)[0]]
    touched, drawn = (Path(inspector.GetShape(each).source().path()).stat().st_size for each in found)
    assert drawn > 200_000 and (touched < 1_000) == (asks == "")


def test_an_obj_without_normals_keeps_its_materials(tmp_path: Path) -> None:
    """Drake's renderer refuses it, in a traceback; its plane normals are those of the faces."""
    (tmp_path / "box.obj").write_bytes(b"mtllib box.mtl\nusemtl red\n" + OBJ.replace(b"f 1 2", b"f -8/ -7/"))
    (tmp_path / "box.mtl").write_text("newmtl red\nmap_Kd red.png\n")
    turned = mesh_files.readable(tmp_path / "box.obj")
    lines = turned.read_text().splitlines()
    assert sum(line.startswith("vn ") for line in lines) == 6 and "mtllib box.mtl" in lines
    assert lines[0] == "vn -1 0 0" and "f -8//1 -7//1 4//1 3//1" in lines
    picture = (turned.parent / "box.mtl").read_text().split("map_Kd ")[1].strip()
    assert (turned.parent / picture).resolve() == tmp_path / "red.png"
    assert mesh_files.readable(turned) == turned


def test_a_picture_that_is_no_png_is_turned_or_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Drake's renderer told of each in some twenty lines of errors, and of one more for each image."""
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 2] = 255
    (tmp_path / "red.jpg").write_bytes(cv2.imencode(".jpg", red)[1].tobytes())
    (tmp_path / "blue.tga").write_bytes(b"no picture")
    (tmp_path / "fine.png").write_bytes(cv2.imencode(".png", red)[1].tobytes())
    (tmp_path / "box.obj").write_bytes(b"mtllib box.mtl\nvn 0 0 1\nusemtl red\n" + OBJ)
    (tmp_path / "box.mtl").write_text(
        "newmtl red\nmap_Kd red.jpg\nnewmtl blue\nKd 0 0 1\nmap_Kd blue.tga\nnewmtl fine\nmap_Kd fine.png\n"
    )
    turned = mesh_files.readable(tmp_path / "box.obj")
    assert turned.read_bytes() == (tmp_path / "box.obj").read_bytes()
    materials = (turned.parent / "box.mtl").read_text()
    first, second = (turned.parent / name for name in re.findall("map_Kd (.*)", materials))
    np.testing.assert_array_equal(cv2.imread(str(first)), cv2.imread(str(tmp_path / "red.jpg")))
    assert first.suffix == ".png" and second.resolve() == tmp_path / "fine.png" and "Kd 0 0 1" in materials
    mesh_files.readable(tmp_path / "box.obj")
    (said,) = [record.getMessage() for record in caplog.records]
    assert said.startswith(str(tmp_path / "blue.tga")) and "drawn without" in said
    (tmp_path / "box.mtl").write_text("newmtl red\nmap_Kd fine.png\nmap_Bump red.jpg\n")
    assert mesh_files.readable(tmp_path / "box.obj") == tmp_path / "box.obj"


def test_what_cannot_be_kept_is_turned_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    (tmp_path / "box.stl").write_bytes(binary_stl(TRIANGLES))
    (tmp_path / "arm.urdf").write_text(urdf("box.stl"))
    np.testing.assert_allclose(shape_of(tmp_path / "arm.urdf")[1], (0.1, 0.2, 0.3), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cut.stl", binary_stl(TRIANGLES)[:300]),
        ("not.dae", b"<COLLADA"),
        ("none.stl", b"\0" * 84),
        ("cut.glb", glb()[:300]),
        ("less.obj", b"v 0 0 0\nf 1 2 3\n"),
    ],
)
def test_a_mesh_that_is_spoilt_is_named(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    (tmp_path / "arm.urdf").write_text(urdf(name))
    with pytest.raises(ModelError, match=name):
        shape_of(tmp_path / "arm.urdf")


MJCF = """<mujoco model="arm"><compiler angle="radian" meshdir="assets"/><include file="meshes.xml"/><worldbody>
  <body name="base"><inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>
    <body name="link"><joint name="lift" axis="0 1 0" range="-1 1"/>
      <inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.1 0.1"/><geom type="mesh" mesh="box"/></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("folder", ['meshdir="assets"', ""])
def test_a_mesh_of_an_mjcf_that_is_not_there_is_named_where_it_was_looked_for(tmp_path: Path, folder: str) -> None:
    """It was told to be in the folder that the user is in."""
    (tmp_path / "meshes.xml").write_text('<mujoco><asset><mesh file="box.stl"/></asset></mujoco>')
    (tmp_path / "arm.xml").write_text(MJCF.replace('meshdir="assets"', folder))
    place = tmp_path / "assets" if folder else tmp_path
    with pytest.raises(ModelError, match=re.escape(f'"{place / "box.stl"}" could not be found')):
        shape_of(tmp_path / "arm.xml")


def test_what_pybullet_says_in_an_sdf_is_left_out_and_lines_keep_their_numbers(tmp_path: Path) -> None:
    """Its iiwa with a hand was refused: `XML Element[contact], child of element[link], not defined in SDF`."""
    own = "<contact>\n<lateral_friction>1.0</lateral_friction><spinning_friction>1.5</spinning_friction>\n</contact>"
    paint = "<material><ambient>1 0 0 1</ambient></material>"
    (tmp_path / "arm.sdf").write_text(SDF % (own, paint))
    model = Model.load(tmp_path / "arm.sdf")
    assert (model.joints, model.last_link) == (("pin",), "finger")
    (tmp_path / "bad.sdf").write_text((SDF % (own, paint)).replace("</collision>", "</collision>\n<nonsense/>"))
    with pytest.raises(ModelError, match=r"bad\.sdf:6: error: .*nonsense"):
        Model.load(tmp_path / "bad.sdf")


@pytest.mark.parametrize("shape", ['<box size="0.1 0 0.2"/>', '<cylinder length="0.0" radius="0.1"/>'])
@pytest.mark.parametrize("use", ["visual", "collision"])
def test_a_placeholder_without_volume_is_no_shape(tmp_path: Path, shape: str, use: str) -> None:
    """Drake ends the program where it meets one."""
    (tmp_path / "box.stl").write_bytes(binary_stl(TRIANGLES))
    nothing = f"<{use}><origin xyz='0 0 9'/><geometry>{shape}</geometry></{use}>"
    text = urdf("box.stl")
    (tmp_path / "arm.urdf").write_text(text)
    expected = shape_of(tmp_path / "arm.urdf")
    (tmp_path / "arm.urdf").write_text(text.replace("<inertial>", f"{nothing}<inertial>"))
    assert nothing in (tmp_path / "arm.urdf").read_text()
    found = shape_of(tmp_path / "arm.urdf")
    np.testing.assert_array_equal(found[1], expected[1])
    assert found[2] == expected[2]


@pytest.mark.parametrize("kind", ["mesh", "sphere", "box"])
def test_an_mjcf_with_stl_meshes_and_a_body_without_mass(tmp_path: Path, kind: str) -> None:
    """A sphere as large as its mesh is taken for the mesh."""
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "box.stl").write_bytes(binary_stl(TRIANGLES))
    (tmp_path / "meshes.xml").write_text('<mujoco><asset><mesh file="box.stl" scale="2 2 2"/></asset></mujoco>')
    (tmp_path / "arm.xml").write_text(MJCF.replace('type="mesh"', f'type="{kind}"'))
    model = Model.load(tmp_path / "arm.xml")
    flat = np.zeros(1)
    assert model.joints == ("lift",)
    assert model.inverse_dynamics(flat, flat, flat + 1.0)[0] == pytest.approx(0.1 + 2 * 0.1**2)
    low, high, _ = shape_of(tmp_path / "arm.xml")
    np.testing.assert_allclose(high - low, (0.2, 0.4, 0.6), atol=1e-6)


@pytest.mark.parametrize("quoted", ["", '"'])
def test_what_directives_name_is_put_right_too(tmp_path: Path, quoted: str) -> None:
    (tmp_path / "assets").mkdir()
    for folder in (tmp_path, tmp_path / "assets"):
        (folder / "box.stl").write_bytes(binary_stl(TRIANGLES))
    (tmp_path / "meshes.xml").write_text('<mujoco><asset><mesh file="box.stl"/></asset></mujoco>')
    (tmp_path / "arm.xml").write_text(MJCF)
    (tmp_path / "arm.urdf").write_text(urdf("box.stl"))
    for kind in ("urdf", "xml"):
        inner, outer = (tmp_path / f"{name}_{kind}.dmd.yaml" for name in ("inner", "outer"))
        place = f"{quoted}file://{tmp_path}/arm.{kind}{quoted}"
        start = "default_joint_positions: {lift: [0.3]}"
        inner.write_text(f"directives:\n- add_model: {{name: arm, file: {place}, {start}}}\n")
        weld = "{parent: world, child: arm::base, X_PC: {rotation: !Rpy {deg: [0, 0, 90]}}}"
        welded = f"- add_weld: {weld}\n" if kind == "urdf" else ""  # an MJCF stands still by itself
        outer.write_text(f"directives:\n- add_directives: {{file: 'file://{inner}'}}\n{welded}")
        for path in (inner, outer):
            given = path.read_text()
            low, high, _ = shape_of(path)
            np.testing.assert_allclose(high - low, (0.1, 0.2, 0.3), atol=1e-6)
            assert path.read_text() == given


def test_what_lacks_is_named_as_directives_name_it(tmp_path: Path) -> None:
    # Its motors are put right, so that a copy is read; the mesh is not there.
    (tmp_path / "arm.urdf").write_text(urdf("tip.obj", transmission("lift") + transmission("nobody")))
    path = tmp_path / "arm.dmd.yaml"
    path.write_text(f"directives:\n- add_model: {{name: arm, file: file://{tmp_path}/arm.urdf}}\n")
    with pytest.raises(ModelError, match=rf"{tmp_path}/(arm\.urdf|tip\.obj)") as error:
        shape_of(path)
    assert "0_" not in str(error.value) and "1_" not in str(error.value)


CHAIN = """<robot>
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"/>
  <link name="tip"><visual><geometry><sphere radius="0.1"/></geometry>
    <material name="grey"><color rgba="0.6 0.6 0.6 1"/></material></visual>{0}</link>
  <link name="arm">{0}</link><link name="plate">{0}</link>
  <joint name="wrist" type="revolute"><parent link="arm"/><child link="tip"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="7"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="50"/></joint>
  <joint name="bolt" type="fixed"><parent link="tip"/><child link="plate"/><mimic joint="wrist"/></joint>
  {1}
</robot>"""


def transmission(joint: str) -> str:
    return f"""<transmission name="t_{joint}"><type>transmission_interface/SimpleTransmission</type>
    <joint name="{joint}"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
    <actuator name="motor"/></transmission>"""


def test_names_that_mean_two_things_or_none(tmp_path: Path) -> None:
    """Two greys, two motors called `motor`, one of a joint that is not there, a fixed joint that follows, no name.

    The wrist stands before the shoulder in the file: joints are told from the base on, and a payload hangs on the tip.
    """
    motors = "".join(map(transmission, ("wrist", "shoulder", "finger")))
    (tmp_path / "arm.urdf").write_text(CHAIN.format(INERTIAL, motors))
    model = Model.load(tmp_path / "arm.urdf")
    assert model.joints == ("shoulder", "wrist") and model.last_link == "tip"
    np.testing.assert_array_equal(model.effort_limit, (50.0, 7.0))
    assert shape_free(tmp_path / "arm.urdf") == ("shoulder", "wrist")


def test_joints_of_a_differential_have_motors(tmp_path: Path) -> None:
    """Drake reads no such transmission: the wrists of Tiago and Talos were left out, and hung loose."""
    geared = transmission("wrist").replace("Simple", "Differential")
    (tmp_path / "arm.urdf").write_text(CHAIN.format(INERTIAL, transmission("shoulder") + geared))
    model = Model.load(tmp_path / "arm.urdf")
    assert model.joints == ("shoulder", "wrist")
    np.testing.assert_array_equal(model.effort_limit, (50.0, 7.0))


@pytest.mark.parametrize("bare", ['<material name="{0}"/>', '<material name="{0}">\n</material>'])
@pytest.mark.parametrize("named", ["grey", "nowhere"])
def test_materials_that_are_said_elsewhere_or_nowhere(tmp_path: Path, bare: str, named: str) -> None:
    grey = '<material name="grey"><color rgba="0.6 0.6 0.6 1"/></material>'
    assert grey in CHAIN
    (tmp_path / "arm.urdf").write_text(CHAIN.replace(grey, bare.format(named)).format(INERTIAL, ""))
    assert shape_free(tmp_path / "arm.urdf") == ("shoulder", "wrist")


def test_a_mesh_that_is_not_there_is_named(tmp_path: Path) -> None:
    sphere = '<sphere radius="0.1"/>'
    (tmp_path / "arm.urdf").write_text(CHAIN.replace(sphere, '<mesh filename="shapes/tip.obj"/>').format(INERTIAL, ""))
    with pytest.raises(ModelError, match=r"shapes/tip\.obj' (resolved to .* which )?does not exist"):
        shape_free(tmp_path / "arm.urdf")


def shape_free(description: Path) -> tuple[str, ...]:
    """The joints of an arm that is read with its shapes."""
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    return add_arm(plant, description).joints


def test_a_last_link_without_a_shape_can_be_planned_with(tmp_path: Path) -> None:
    """Of three links above a table; the last, drawn nowhere, turns about the one before."""
    ends = [("base", "one"), ("one", "two"), ("two", "three")]
    joints = [
        f"""<joint name="{child}_joint" type="revolute"><parent link="{parent}"/><child link="{child}"/>
        <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="50"/></joint>"""
        for parent, child in ends
    ]
    shape = '<collision><geometry><box size="0.05 0.05 0.2"/></geometry></collision>'
    links = [f'<link name="{child}">{INERTIAL}{shape if child != "three" else ""}</link>' for _, child in ends]
    (tmp_path / "arm.urdf").write_text("".join(['<robot name="a"><link name="base"/>', *links, *joints, "</robot>"]))
    arm = ArmModel(model=str(tmp_path / "arm.urdf"), tool_frame="")
    assert load_scene(arm, [Fixture(model="scenes/table.sdf")], {}).chain.size == 3


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("box.ply", ply()[:-30], "not a mesh that can be read"),
        ("box.off", OFF[:40], "not a mesh that can be read"),
        ("cloud.ply", ply().split(b"element face")[0] + b"end_header\n" + bytes(96), "no triangles"),
    ],
)
def test_meshes_that_are_none(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ModelError, match=words) as refused:
        mesh_files.readable(tmp_path / name)
    assert name in str(refused.value) and "\n" not in str(refused.value)


def test_two_like_arms_in_one_description_are_refused(tmp_path: Path) -> None:
    """Names tell an arm's joints: the first model's were taken, and a run ended in a traceback."""
    (tmp_path / "arm.urdf").write_text(urdf("box.obj").replace("<visual>", "<!--").replace("</collision>", "-->"))
    (tmp_path / "package.xml").write_text("<package><name>cell</name></package>")
    both = "".join(f"- add_model: {{name: {name}, file: package://cell/arm.urdf}}\n" for name in ("left", "right"))
    (tmp_path / "both.dmd.yaml").write_text(f"directives:\n{both}")
    for joints in ([], ["lift"]):
        with pytest.raises(ModelError, match="joint 'lift' is in left and in right"):
            Model.load(
                ArmModel(model=str(tmp_path / "both.dmd.yaml"), tool_frame="", joints=joints), {"cell": tmp_path}
            )
