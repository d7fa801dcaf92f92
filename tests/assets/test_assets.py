"""The asset library: files, shapes, masses, and that every side looks different."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import HalfSpace
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull, cKDTree

from twin_diagram.assets import Asset, shapes
from twin_diagram.assets.mesh import read_obj, read_png, sample, write_obj
from twin_diagram.assets.procedural import hollow_mug, write_bottle, write_box, write_can, write_mug
from twin_diagram.errors import AssetError
from twin_diagram.scenario.resources import models_dir

DEFAULTS = sorted(path.parent.name for path in (models_dir() / "objects").glob("*/asset.yaml"))


def folder(name: str) -> Path:
    return models_dir() / "objects" / name


def test_defaults_are_there() -> None:
    assert {"can", "mug", "bottle", "mover"} <= set(DEFAULTS)
    assert sum(name.endswith("_box") for name in DEFAULTS) >= 3


@pytest.mark.parametrize("name", DEFAULTS)
def test_cloud_fills_its_box_and_faces_outwards(name: str) -> None:
    asset = Asset.load(folder(name))
    half = asset.size / 2
    assert (np.abs(asset.points_O) <= half + 1e-6).all()
    assert np.allclose(np.linalg.norm(asset.normals_O, axis=1), 1.0)
    assert (asset.colours >= 0).all() and (asset.colours <= 1).all()
    assert np.abs(asset.points_O[:, 2]).max() > 0.98 * half[2]
    if name not in ("mug", "bottle", "angle", "ring", "flask"):
        # These are convex: a little way along the normal lies outside, a little way back inside.
        planes = ConvexHull(read_obj(folder(name) / "visual.obj").vertices).equations
        for step, outside in ((1e-3, True), (-1e-3, False)):
            moved = asset.points_O + step * asset.normals_O
            beyond = (moved @ planes[:, :3].T + planes[:, 3]).max(axis=1) > 0
            assert (beyond == outside).mean() > 0.95


@pytest.mark.parametrize("name", DEFAULTS)
def test_every_turn_by_180_degrees_changes_the_look(name: str) -> None:
    asset = Asset.load(folder(name))
    tree = cKDTree(asset.points_O)
    for axis in range(3):
        turned = asset.points_O * np.where(np.arange(3) == axis, 1.0, -1.0)
        distance, index = tree.query(turned)
        near = distance < 0.008
        if near.mean() < 0.5:
            continue
        difference = np.linalg.norm(asset.colours[near] - asset.colours[index[near]], axis=1)
        assert np.median(difference) > 0.3, (axis, np.median(difference))


@pytest.mark.parametrize("name", DEFAULTS)
def test_convex_pieces_hold_the_object(name: str) -> None:
    asset = Asset.load(folder(name))
    # A ring's and a flask's pieces have fewer sides than the surface: their chords lie that much inside [m].
    sagitta = 2e-4 if name in ("ring", "flask") else 1e-6
    inside = np.zeros(len(asset.points_O), dtype=bool)
    volume = 0.0
    for piece in asset.convex_pieces:
        hull = ConvexHull(piece)
        volume += hull.volume
        inside |= (asset.points_O @ hull.equations[:, :3].T + hull.equations[:, 3] < sagitta).all(axis=1)
    assert inside.mean() > 0.97
    assert volume < 1.05 * np.prod(asset.size)


@pytest.mark.parametrize("name", DEFAULTS)
def test_stands_still_in_drake(name: str) -> None:
    asset = Asset.load(folder(name))
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0025)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "ground", CoulombFriction(0.6, 0.6)
    )
    (model,) = Parser(plant).AddModels(str(asset.model_file))
    plant.Finalize()
    body = plant.GetBodyByName("object", model)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    X_WO = RigidTransform(RollPitchYaw(0.0, 0.0, 0.7), [0.4, 0.1, 0.001 - asset.points_O[:, 2].min()])
    plant.SetFreeBodyPose(plant_context, body, X_WO)
    Simulator(diagram, context).AdvanceTo(0.4)
    now = plant.EvalBodyPoseInWorld(plant_context, body)
    assert np.linalg.norm(now.translation() - X_WO.translation()) < 0.0015
    assert X_WO.rotation().InvertAndCompose(now.rotation()).ToAngleAxis().angle() < 2e-3
    assert body.get_mass(plant_context) == pytest.approx(asset.mass)


def test_writing_is_repeatable_and_seeds_differ(tmp_path: Path) -> None:
    def digest(path: Path) -> str:
        return hashlib.sha256(b"".join(p.read_bytes() for p in sorted(path.iterdir()))).hexdigest()

    first = write_mug(tmp_path / "a", "mug", 0.04, 0.1, texture_seed=4)
    again = write_mug(tmp_path / "b", "mug", 0.04, 0.1, texture_seed=4)
    other = write_mug(tmp_path / "c", "mug", 0.04, 0.1, texture_seed=5)
    assert digest(first) == digest(again) != digest(other)
    assert not [p for p in first.iterdir() if p.name.startswith(".")]
    assert sum(p.stat().st_size for p in first.iterdir()) < 300_000
    assert max(read_png(first / "visual.png").shape[:2]) <= 256


@pytest.mark.long
@settings(max_examples=12)
@given(
    size=st.tuples(*[st.floats(0.03, 0.3)] * 3),
    mass=st.floats(0.05, 3.0),
    seed=st.integers(0, 2**31 - 1),
)
def test_any_box_has_its_inertia_and_area(
    tmp_path: Path, size: tuple[float, float, float], mass: float, seed: int
) -> None:
    path = write_box(tmp_path / "box", "box", size, texture_seed=seed, mass=mass)
    asset = Asset.load(path)
    assert np.allclose(asset.size, size)
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(asset.model_file))
    plant.Finalize()
    inertia = plant.GetBodyByName("object").default_spatial_inertia()
    solid = trimesh.creation.box(extents=size)
    solid.density = mass / solid.volume
    assert np.allclose(inertia.CalcRotationalInertia().CopyToFullMatrix3(), solid.moment_inertia, rtol=1e-6)
    # Each pair of faces has its share of the points.
    share = np.array([(np.abs(np.abs(asset.normals_O[:, k]) - 1) < 1e-6).mean() for k in range(3)])
    area = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    assert np.allclose(share, area / area.sum(), atol=0.01)


def test_other_shapes_and_their_symmetry(tmp_path: Path) -> None:
    can = Asset.load(write_can(tmp_path / "can", "can", 0.03, 0.1))
    bottle = Asset.load(write_bottle(tmp_path / "bottle", "bottle", 0.04, 0.22))
    mug = Asset.load(write_mug(tmp_path / "mug", "mug", 0.04, 0.1))
    assert (can.symmetric_axis, bottle.symmetric_axis, mug.symmetric_axis) == ("z", None, None)
    # The handle is on the +x side, hollow between it and the wall.
    assert mug.points_O[:, 0].max() > 0.06 and mug.points_O[:, 0].min() > -0.041
    handle = mug.points_O[mug.points_O[:, 0] > 0.045]
    assert np.abs(handle[:, 1]).max() < 0.007
    # The arrays are shared by all systems: nobody writes to them.
    with pytest.raises(ValueError):
        can.points_O[0, 0] = 1.0


def test_obj_round_trip_and_foreign_files(tmp_path: Path) -> None:
    mesh = read_obj(folder("mug") / "visual.obj")
    texture = read_png(folder("mug") / "visual.png")
    write_obj(mesh, tmp_path / "copy.obj", texture)
    again = read_obj(tmp_path / "copy.obj")
    assert len(again.faces) == len(mesh.faces)
    one, two = sample(mesh, texture, 500), sample(again, read_png(tmp_path / "copy.png"), 500)
    assert np.allclose(np.sort(one.points, axis=0), np.sort(two.points, axis=0), atol=2e-3)
    # A polygon with negative indices, no texture, no normals.
    (tmp_path / "quad.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n")
    quad = read_obj(tmp_path / "quad.obj")
    assert len(quad.faces) == 2 and np.allclose(quad.normals, [0, 0, 1])


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("mass: 0.35", "mass: -1"), "mass"),
        (("mass: 0.35", "mass: .nan"), "mass"),
        (("mass: 0.35", "mas: 0.35"), "mas"),
        (("symmetric_axis: z", "symmetric_axis: x"), "symmetric_axis"),
        (("kind: cylinder", "kind: cone"), "cone"),
        (("visual: visual.obj", "visual: gone.obj"), "gone.obj"),
        (("size: [0.068, 0.068, 0.102]", "size: [0.068]"), "size"),
    ],
)
def test_bad_assets_are_named(tmp_path: Path, change: tuple[str, str], word: str) -> None:
    path = write_can(tmp_path / "can", "can", 0.034, 0.102, mass=0.35)
    text = (path / "asset.yaml").read_text()
    assert change[0] in text
    (path / "asset.yaml").write_text(text.replace(*change))
    with pytest.raises(AssetError, match=word):
        Asset.load(path)


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="nowhere"):
        Asset.load(tmp_path / "nowhere")
    path = write_can(tmp_path / "can", "can", 0.034, 0.102)
    (path / "visual.png").write_bytes(b"not an image")
    with pytest.raises(AssetError, match=r"visual\.png"):
        Asset.load(path)
    (path / "visual.obj").write_text("v 0 0 0\nf 1 2 3\n")
    with pytest.raises(AssetError, match=r"visual\.obj"):
        Asset.load(path)
    np.savez(path / "cloud.npz", points=np.zeros((200, 3)))
    whole = (path / "cloud.npz").read_bytes()
    damaged = whole[:500] + bytes([whole[500] ^ 1]) + whole[501:]
    for data in (b"PK", b"", whole[:1000], damaged):
        (path / "cloud.npz").write_bytes(data)
        with pytest.raises(AssetError, match=r"cloud\.npz"):
            Asset.load(path)


@pytest.mark.parametrize(
    "bad", [{"mass": 0.0}, {"mass": float("nan")}, {"radius": -0.1}, {"name": ""}, {"name": "a/b"}]
)
def test_impossible_objects_are_refused(tmp_path: Path, bad: dict[str, object]) -> None:
    wanted: dict[str, object] = {"name": "can", "radius": 0.03, "height": 0.1, "mass": 0.3, **bad}
    with pytest.raises(AssetError):
        write_can(tmp_path / "can", **wanted)  # type: ignore[arg-type]
    assert not (tmp_path / "can").exists()


def test_a_measured_cloud_is_used_where_there_is_one(tmp_path: Path) -> None:
    path = write_box(tmp_path / "box", "box", (0.1, 0.1, 0.1))
    np.savez(path / "cloud.npz", **_ball())
    assert len(Asset.load(path).points_O) == 200


def _ball() -> dict[str, Any]:
    """A measured cloud of a ball of 0.1 m."""
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return {"points": 0.05 * normals, "normals": normals, "colours": rng.random((200, 3))}


def test_a_cloud_by_others_is_taken_with_each_point_once_and_normals_of_length_1(tmp_path: Path) -> None:
    path, ball = write_box(tmp_path / "box", "box", (0.1, 0.1, 0.1)), _ball()
    np.savez(path / "cloud.npz", **ball)
    own = Asset.load(path)
    twice: dict[str, Any] = {name: np.concatenate([array, array[::-1]]) for name, array in ball.items()}
    np.savez(path / "cloud.npz", **{**twice, "normals": 3.0 * twice["normals"]})
    theirs = Asset.load(path)
    assert np.array_equal(theirs.points_O, own.points_O) and np.array_equal(theirs.colours, own.colours)
    np.testing.assert_allclose(theirs.normals_O, own.normals_O, atol=1e-12)
    assert own.unpainted is None
    below = twice["points"][:, 2] < 0.0
    np.savez(path / "cloud.npz", **twice, unpainted=below)
    marked = Asset.load(path)
    assert np.array_equal(marked.unpainted, marked.points_O[:, 2] < 0.0)  # type: ignore[arg-type]
    for bad in (below[1:], below.astype(float)):
        np.savez(path / "cloud.npz", **twice, unpainted=bad)
        with pytest.raises(AssetError, match=r"cloud\.npz: unpainted must be 400 truth values, one a point, not "):
            Asset.load(path)


def test_a_cloud_in_order_or_very_dense_is_mixed_and_thinned(tmp_path: Path) -> None:
    path, ball = write_box(tmp_path / "box", "box", (0.1, 0.1, 0.1)), _ball()
    dense = np.random.default_rng(1).standard_normal((50_000, 3))
    dense = 0.05 * dense / np.linalg.norm(dense, axis=1, keepdims=True)
    for points, count in ((ball["points"], 200), (dense, 20_000)):
        points = points[np.argsort(points[:, 0])]
        np.savez(path / "cloud.npz", points=points, normals=20.0 * points, colours=np.abs(points))
        asset = Asset.load(path)
        assert asset.points_O.shape == (count, 3)
        np.testing.assert_allclose(asset.normals_O, 20.0 * asset.points_O)
        # The first points are from all over the surface, not from one end of it.
        assert np.ptp(asset.points_O[:50, 0]) > 0.08


@pytest.mark.parametrize(
    ("name", "factor", "word"),
    [
        ("points", 1000.0, "metres"),
        ("points", 0.0, "1 different"),
        ("colours", 255.0, "0 to 1"),
        ("normals", 0.0, "no length"),
    ],
)
def test_clouds_in_other_units_are_refused(tmp_path: Path, name: str, factor: float, word: str) -> None:
    path, ball = write_box(tmp_path / "box", "box", (0.1, 0.1, 0.1)), _ball()
    np.savez(path / "cloud.npz", **{**ball, name: factor * ball[name]})
    with pytest.raises(AssetError, match=word):
        Asset.load(path)


def test_a_mugs_contact_shapes_are_hollow_and_keep_to_its_surface(tmp_path: Path) -> None:
    """Rays into the opening meet the bottom alone; from outside they meet the wall, at most 1 mm inside its surface."""
    radius, height = 0.042, 0.1
    parts = hollow_mug(radius, height)

    def depth(p: np.ndarray, d: np.ndarray) -> float:
        """Distance along a ray to the first part met, by the slabs of each box; of the bottom's cylinder its top."""
        nearest = np.inf
        for part in parts:
            if part.kind == "cylinder":
                top = part.translation[2] + part.size[1] / 2
                if d[2] < 0 and np.linalg.norm((p + d * (top - p[2]) / d[2])[:2]) < part.size[0]:
                    nearest = min(nearest, (top - p[2]) / d[2])
                continue
            R = RollPitchYaw(part.rpy).ToRotationMatrix().matrix()
            a, b = R.T @ (p - part.translation), R.T @ d
            half = np.array(part.size) / 2
            with np.errstate(divide="ignore"):
                times = np.sort(np.stack([(-half - a) / b, (half - a) / b]), axis=0)
            enters, leaves = times[0].max(), times[1].min()
            if enters < leaves and leaves > 0:
                nearest = min(nearest, enters)
        return float(nearest)

    down = np.array([0.0, 0.0, -1.0])
    wall = 0.004
    for angle in np.linspace(0, 2 * np.pi, 37):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        inside = out * (radius - wall - 0.001) + [0.0, 0.0, 0.08]
        assert depth(inside, down) == pytest.approx(0.08 + height / 2 - wall)
        met = 0.2 - depth(0.2 * out + [0.0, 0.0, 0.04], -out)
        assert radius - 0.001 < met < radius + 1e-9, np.degrees(angle)
    reach = max(shapes.handle_reach(radius, height)[0] + radius - wall / 2, 0.0)
    handle = 0.2 - depth(np.array([0.2, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]))
    assert handle == pytest.approx(reach + shapes.TUNING.handle_tube, abs=0.002)
    # A finger goes through the handle.
    gap = np.array([radius + 0.6 * shapes.handle_reach(radius, height)[0], 0.2, 0.0])
    assert depth(gap, np.array([0.0, -1.0, 0.0])) == np.inf
