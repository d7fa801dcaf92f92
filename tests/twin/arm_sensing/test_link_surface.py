"""Surfaces of links, held against closed forms: who is within, how points spread, what shapes that overlap hide."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, HalfSpace, Shape, Sphere

from twin_diagram.errors import ModelError
from twin_diagram.scenario import ArmModel
from twin_diagram.signals.arrays import Array
from twin_diagram.twin.arm_sensing.known_surfaces import ArmParts
from twin_diagram.twin.arm_sensing.link_surface import inside, link_surface, other_surfaces, shape_surface

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-0.5, 0.5) for z in (-0.25, 0.25)])
X, Y, Z = np.eye(3)

# Within a shape.

EDGES: dict[str, tuple[Shape, Array | None, Array, float]] = {
    "box x": (Box(2.0, 1.0, 0.5), None, X, 1.0),
    "box y": (Box(2.0, 1.0, 0.5), None, -Y, 0.5),
    "box z": (Box(2.0, 1.0, 0.5), None, Z, 0.25),
    "cylinder side": (Cylinder(1.0, 0.5), None, Y, 1.0),
    "cylinder cap": (Cylinder(1.0, 0.5), None, -Z, 0.25),
    "capsule side": (Capsule(1.0, 0.5), None, X, 1.0),
    "capsule end": (Capsule(1.0, 0.5), None, Z, 1.25),
    "sphere": (Sphere(1.0), None, -X, 1.0),
    "hull": (Convex(points=CORNERS.T, label="block"), CORNERS, Z, 0.25),
}


@pytest.mark.parametrize("name", EDGES)
def test_a_point_is_within_from_a_micrometre_below_the_surface_on(name: str) -> None:
    shape, corners, way, edge = EDGES[name]
    for below, wanted in ((1.4e-6, True), (0.7e-6, False), (0.0, False), (-0.5e-6, False), (-1e-3, False)):
        assert inside((edge - below) * way[None], shape, corners).item() is wanted
    if name.split()[0] in {"box", "cylinder", "sphere"}:  # the others compare rounded figures
        assert not inside((edge - 1e-6) * way[None], shape, corners).item()


def test_of_an_ellipsoid_a_ten_thousandth_of_its_axes_counts_as_surface() -> None:
    shape = Ellipsoid(1.0, 0.5, 0.25)
    for way, edge in ((X, 1.0), (-Y, 0.5), (Z, 0.25)):
        for share, wanted in ((1.4e-4, True), (1e-4, False), (0.7e-4, False), (-0.5e-4, False), (-1.0, False)):
            assert inside(edge * (1.0 - share) * way[None], shape, None).item() is wanted


DEPTHS: dict[str, tuple[Shape, Array | None, Callable[[Array], Array]]] = {
    "box": (Box(2.0, 1.0, 0.5), None, lambda p: np.max(np.abs(p) - [1.0, 0.5, 0.25], axis=1)),
    "cylinder": (
        Cylinder(0.6, 0.8),
        None,
        lambda p: np.maximum(np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2) - 0.6, np.abs(p[:, 2]) - 0.4),
    ),
    "capsule": (
        Capsule(0.6, 0.8),
        None,
        lambda p: (
            np.min([np.linalg.norm(p - [0.0, 0.0, z], axis=1) for z in np.linspace(-0.4, 0.4, 161)], axis=0) - 0.6
        ),
    ),
    "sphere": (Sphere(0.7), None, lambda p: np.linalg.norm(p, axis=1) - 0.7),
    "ellipsoid": (
        Ellipsoid(0.9, 0.6, 0.3),
        None,
        lambda p: (p[:, 0] / 0.9) ** 2 + (p[:, 1] / 0.6) ** 2 + (p[:, 2] / 0.3) ** 2 - 1.0,
    ),
    "hull": (
        Convex(points=CORNERS.T, label="block"),
        CORNERS,
        lambda p: np.max(np.abs(p) - [1.0, 0.5, 0.25], axis=1),
    ),
}


@pytest.mark.parametrize("name", DEPTHS)
def test_within_is_what_the_distance_function_says(name: str) -> None:
    shape, corners, outside = DEPTHS[name]
    points = np.random.default_rng(2001).uniform(-1.3, 1.3, (4000, 3))
    depth = outside(points)
    sure = np.abs(depth) > 2e-3
    np.testing.assert_array_equal(inside(points, shape, corners)[sure], depth[sure] < 0.0)
    assert 100 < np.count_nonzero(depth < 0.0) < 3900


def test_what_is_no_solid_holds_nothing() -> None:
    points = np.zeros((3, 3))
    assert inside(points, HalfSpace(), None).tolist() == [False] * 3
    assert inside(points, HalfSpace(), CORNERS).tolist() == [False] * 3, "corners are those of a mesh alone"
    assert [part.shape for part in shape_surface(HalfSpace(), None, 0.01, np.random.default_rng(1))] == [(0, 3)] * 2


# Spread evenly: as many as the area asks for, with the moments of an even sheet.


def box_moments(size: Array) -> tuple[float, Array]:
    """Area, and the mean of the squares of x, y and z over a box's surface, side by side."""
    area, squares = 0.0, np.zeros(3)
    for axis in range(3):
        side = 2.0 * size[(axis + 1) % 3] * size[(axis + 2) % 3]
        own = size**2 / 12.0
        own[axis] = size[axis] ** 2 / 4.0
        area, squares = area + side, squares + side * own
    return area, squares / area


def round_moments(r: float, length: float, ends: float, across: float, along: float) -> tuple[float, Array]:
    """The same of a tube and its ends, by their area and means of squares."""
    side = 2.0 * np.pi * r * length
    xx = (side * r**2 / 2.0 + ends * across) / (side + ends)
    zz = (side * length**2 / 12.0 + ends * along) / (side + ends)
    return side + ends, np.array([xx, xx, zz])


SHEETS: dict[str, tuple[Shape, Array | None, tuple[float, Array]]] = {
    "box": (Box(0.4, 0.3, 0.1), None, box_moments(np.array([0.4, 0.3, 0.1]))),
    "cylinder": (Cylinder(0.1, 0.3), None, round_moments(0.1, 0.3, 2.0 * np.pi * 0.01, 0.01 / 4.0, 0.15**2)),
    "capsule": (
        Capsule(0.1, 0.3),
        None,
        round_moments(0.1, 0.3, 4.0 * np.pi * 0.01, 0.01 / 3.0, 0.01 / 3.0 + 0.1 * 0.15 + 0.15**2),
    ),
    "sphere": (Sphere(0.2), None, (4.0 * np.pi * 0.04, np.full(3, 0.04 / 3.0))),
    "hull": (Convex(points=0.2 * CORNERS.T, label="b"), 0.2 * CORNERS, box_moments(np.array([0.4, 0.2, 0.1]))),
}


@pytest.mark.parametrize("name", SHEETS)
def test_points_are_spread_evenly_one_to_every_square_of_the_spacing(name: str) -> None:
    shape, corners, (area, squares) = SHEETS[name]
    points, normals = shape_surface(shape, corners, 0.003, np.random.default_rng(2002))
    assert len(points) == pytest.approx(area / 0.003**2, rel=0.005)
    np.testing.assert_allclose(np.mean(points**2, axis=0), squares, rtol=0.05)
    np.testing.assert_allclose(np.mean(points, axis=0), 0.0, atol=0.004)
    np.testing.assert_allclose(np.mean(points * normals, axis=0) > 0.0, True)  # outwards, along each axis
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    # Nothing lies off the surface, nor within.
    assert not inside(points, shape, corners).any()
    assert inside(points * (1.0 - 1e-4) - 1e-5 * normals, shape, corners).all()


def test_a_hull_with_slanted_faces_has_points_on_each_of_its_triangles() -> None:
    """A tetrahedron: of an even sheet, each face's middle is the mean of its points, and their spread is known."""
    corners = np.array([[0.0, 0.0, 0.0], [0.3, 0.05, 0.0], [0.02, 0.2, 0.03], [0.1, 0.05, 0.25]])
    shape = Convex(points=corners.T, label="t")
    points, normals = shape_surface(shape, corners, 0.002, np.random.default_rng(2003))
    faces = [np.delete(corners, k, axis=0) for k in range(4)]
    areas = [0.5 * np.linalg.norm(np.cross(b - a, c - a)) for a, b, c in faces]
    assert len(points) == pytest.approx(sum(areas) / 0.002**2, rel=0.001)
    for (a, b, c), area, k in zip(faces, areas, range(4), strict=True):
        n = np.cross(b - a, c - a) / (2.0 * area)
        n *= -np.sign(n @ (corners[k] - a))
        on = np.abs(normals @ n - 1.0) < 1e-9
        assert np.mean(on) == pytest.approx(area / sum(areas), abs=0.02)
        np.testing.assert_allclose((points[on] - a) @ n, 0.0, atol=1e-12)
        share = np.linalg.lstsq(np.array([b - a, c - a]).T, (points[on] - a).T, rcond=None)[0]
        assert (share > -1e-9).all() and (share.sum(axis=0) < 1.0 + 1e-9).all()
        np.testing.assert_allclose(share.mean(axis=1), 1.0 / 3.0, atol=0.02)
        np.testing.assert_allclose(share.var(axis=1), 1.0 / 18.0, atol=0.005)


def test_an_ellipsoid_has_at_least_what_its_area_asks_for_and_normals_along_its_gradient() -> None:
    axes = np.array([0.2, 0.1, 0.05])
    points, normals = shape_surface(Ellipsoid(*axes), None, 0.004, np.random.default_rng(2004))
    assert len(points) == pytest.approx(4.0 * np.pi * 0.2**2 / 0.004**2, rel=1e-3), "those of the ball about it"
    np.testing.assert_allclose(np.sum((points / axes) ** 2, axis=1), 1.0)
    gradient = points / axes**2
    np.testing.assert_allclose(normals, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), atol=1e-12)


# Of a description: a base, a link of two blocks that overlap, a ball welded to it, and another link.

ARM = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.1 0.1"/></geometry></visual>
    <visual><origin xyz="0.2 0 0.05" rpy="0 0 0.5"/><geometry><box size="0.1 0.06 0.2"/></geometry></visual>
    <collision><geometry><sphere radius="2.0"/></geometry></collision>
  </link>
  <link name="knob"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><sphere radius="0.05"/></geometry></visual>
  </link>
  <link name="lower"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.2 0.1 0.1"/></geometry></visual>
  </link>
  <joint name="one" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0.3 0.2 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="10" velocity="1"/></joint>
  <joint name="fix" type="fixed"><parent link="upper"/><child link="knob"/>
    <origin xyz="0 0.05 0" rpy="0 0.4 0"/></joint>
  <joint name="two" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="1"/></joint>
  <transmission name="t1"><type>transmission_interface/SimpleTransmission</type><joint name="one"/>
    <actuator name="m1"/></transmission>
  <transmission name="t2"><type>transmission_interface/SimpleTransmission</type><joint name="two"/>
    <actuator name="m2"/></transmission>
</robot>
"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> ArmModel:
    file = tmp_path_factory.mktemp("surface") / "two.urdf"
    file.write_text(ARM)
    return ArmModel(model=str(file), tool_frame="")


def distances(p: Array) -> Array:
    """(3, K): how far points in the frame of `upper` lie outside of each of its three shapes."""
    turn = np.array([[np.cos(0.5), -np.sin(0.5), 0.0], [np.sin(0.5), np.cos(0.5), 0.0], [0.0, 0.0, 1.0]])
    one = np.max(np.abs(p - [0.1, 0.0, 0.0]) - [0.1, 0.05, 0.05], axis=1)
    two = np.max(np.abs((p - [0.2, 0.0, 0.05]) @ turn) - [0.05, 0.03, 0.1], axis=1)
    return np.array([one, two, np.linalg.norm(p - [0.0, 0.05, 0.0], axis=1) - 0.05])


def test_a_links_surface_is_the_outside_of_all_its_shapes(arm: ArmModel) -> None:
    points, normals = link_surface(arm, "upper", spacing=0.005)
    away = distances(points)
    np.testing.assert_allclose(away.min(axis=0), 0.0, atol=2e-6)
    outwards = distances(points + 1e-3 * normals).min(axis=0) > 0.99e-3
    assert np.mean(outwards) > 0.97, "but where two shapes meet in a corner"
    # As many as a dense cloud of the union's skin says, counted by volume between two levels.
    rng = np.random.default_rng(2005)
    low, high = np.array([-0.07, -0.07, -0.08]), np.array([0.28, 0.13, 0.18])
    cloud = rng.uniform(low, high, (400_000, 3))
    skin = np.mean(np.abs(distances(cloud).min(axis=0)) < 0.002) * np.prod(high - low) / 0.004
    assert len(points) == pytest.approx(skin / 0.005**2, rel=0.06)
    assert len(link_surface(arm, "upper")[0]) == pytest.approx(skin / 0.004**2, rel=0.06), "4 mm unless told"
    knob, _ = link_surface(arm, "knob", spacing=0.005)
    assert len(knob) == len(points), "one rigid part"


def test_others_are_all_rigid_parts_but_the_one(arm: ArmModel) -> None:
    others = other_surfaces(arm, "knob")
    assert list(others) == ["lower"], "the base has no shape, and the upper link is welded to the knob"
    points, normals = others["lower"]
    area = 2.0 * (0.2 * 0.1 + 0.2 * 0.1 + 0.1 * 0.1)
    assert len(points) == pytest.approx(area / 0.01**2, rel=0.02), "a centimetre unless told"
    np.testing.assert_allclose(np.max(np.abs(points) - [0.1, 0.05, 0.05], axis=1), 0.0, atol=1e-12)
    assert np.all(np.einsum("ij,ij->i", points, normals) > 0.0)
    assert list(other_surfaces(arm, "lower", spacing=0.02)) == ["upper"], "once for all that is welded together"


def test_a_link_that_is_not_there_or_cannot_be_seen_is_named(arm: ArmModel) -> None:
    with pytest.raises(ModelError, match=r"no link 'elbow'"):
        link_surface(arm, "elbow")
    with pytest.raises(ModelError, match=r"no link 'elbow'"):
        other_surfaces(arm, "elbow")
    with pytest.raises(ModelError, match=r"'base' in .* has no shape to be seen by"):
        link_surface(arm, "base")


FLAT = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n"


def test_a_flat_mesh_has_no_surface_and_hides_nothing(tmp_path: Path, arm: ArmModel) -> None:
    (tmp_path / "label.obj").write_text(FLAT)
    label = '<visual><geometry><mesh filename="label.obj"/></geometry></visual>'
    (tmp_path / "two.urdf").write_text(ARM.replace('<link name="upper">', f'<link name="upper">{label}'))
    labelled = ArmModel(model=str(tmp_path / "two.urdf"), tool_frame="")
    for points, wanted in zip(link_surface(labelled, "upper"), link_surface(arm, "upper"), strict=True):
        np.testing.assert_array_equal(points, wanted)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert not inside(np.array([[0.3, 0.3, 0.0]]), Convex(points=CORNERS.T, label="l"), corners).any()


HAND = """<robot name="hand">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><sphere radius="0.03"/></geometry></visual></link>
  <link name="lower"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.01 0.01 0.05"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="lower"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="50" velocity="0.2"/></joint>
</robot>
"""


def test_links_of_arm_and_hand_may_have_the_same_name(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(ARM)
    (tmp_path / "hand.urdf").write_text(HAND)
    (tmp_path / "both.dmd.yaml").write_text(
        f"""directives:
- add_model: {{name: arm, file: "file://{tmp_path}/two.urdf"}}
- add_model: {{name: hand, file: "file://{tmp_path}/hand.urdf"}}
- add_weld: {{parent: "arm::lower", child: "hand::base"}}
"""
    )
    both = ArmModel(model=str(tmp_path / "both.dmd.yaml"), tool_frame="")
    parts = ArmParts(both)
    places = [p for _, p in parts.poses(np.array([0.0, 0.3]))]
    assert len(places) == 3, "two links called `lower` and the one before them; the arm's base has no shape"
    one, two = (link_surface(both, name) for name in ("upper", "knob"))
    np.testing.assert_array_equal(one[0].shape, two[0].shape)
    with pytest.raises(ModelError, match=r"2 links are called 'lower' in .*both"):
        link_surface(both, "lower")
    with pytest.raises(ModelError, match=r"2 links are called 'base' in .*both"):
        other_surfaces(both, "base")
