"""The lidar's ray casting beam by beam, the balls about its solids, and one scan of the system by itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, HalfSpace, SceneGraph, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Lidar, LidarDefects, Pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.sim.lidar import (
    LidarSystem,
    ScannedSolid,
    _parts,
    meet_ellipsoid,
    meet_planes,
    scan,
    world_solids,
)
from twin_diagram.station.sim.noise import Stream, generator

BOX = np.array([[1.0, 0, 0, -1], [-1, 0, 0, -1], [0, 1, 0, -0.5], [0, -1, 0, -0.5], [0, 0, 1, -0.2], [0, 0, -1, -0.2]])
"""Planes of a block of 2 m × 1 m × 0.4 m."""
INF = np.inf


def test_beams_along_the_faces_of_a_block_meet_it_or_pass_beside() -> None:
    ways = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for origin, wanted in (
        ([3.0, 0.0, 0.0], [2.0, INF, INF]),
        ([3.0, 0.49, 0.19], [2.0, INF, INF]),
        ([3.0, 0.51, 0.0], [INF, INF, INF]),
        ([3.0, 0.0, -0.21], [INF, INF, INF]),
        ([-3.0, 0.0, 0.0], [INF, 2.0, INF]),
        ([0.0, -2.0, 0.0], [INF, INF, 1.5]),
        ([0.2, 0.1, 0.0], [INF, INF, INF]),  # from within nothing is met
    ):
        np.testing.assert_allclose(meet_planes(np.array(origin), ways, BOX), wanted)
    # A beam that slides along a face is met, as one that comes from the side a little way off.
    assert meet_planes(np.array([3.0, 0.5, 0.0]), ways[:1], BOX)[0] == 2.0
    # One that starts on the surface meets it no more.
    assert meet_planes(np.array([1.0, 0.0, 0.0]), ways[:1], BOX)[0] == INF


def test_a_beam_meets_an_ellipsoid_where_it_first_enters() -> None:
    axes = np.array([1.0, 0.5, 0.25])
    for origin, way, wanted in (
        ([3.0, 0.0, 0.0], [-1.0, 0, 0], 2.0),
        ([3.0, 0.0, 0.0], [1.0, 0, 0], INF),
        ([0.0, 2.0, 0.0], [0, -1.0, 0], 1.5),
        ([0.0, 0.0, -2.0], [0, 0, 1.0], 1.75),
        ([3.0, 0.5, 0.0], [-1.0, 0, 0], 3.0),  # just touches it
        ([3.0, 0.51, 0.0], [-1.0, 0, 0], INF),
        ([0.1, 0.0, 0.0], [1.0, 0, 0], INF),
        ([3.0, 0.3, 0.0], [-1.0, 0, 0], 3.0 - 0.8),
    ):
        found = meet_ellipsoid(np.array(origin), np.array([way]), axes)[0]
        assert found == pytest.approx(wanted), (origin, way)


CORNERS = np.array([[0.1, 0.2, 0.3], [0.9, 0.1, 0.2], [0.3, 0.8, 0.4], [0.4, 0.3, 1.1], [0.7, 0.7, 0.9]])
SHAPES: dict[str, tuple[Shape, Array | None, int, float]] = {
    "box": (Box(0.4, 0.2, 0.6), None, 1, 0.5 * np.sqrt(0.56)),
    "sphere": (Sphere(0.3), None, 1, 0.3),
    "ellipsoid": (Ellipsoid(0.1, 0.2, 0.3), None, 1, 0.3),
    "cylinder": (Cylinder(0.3, 0.8), None, 1, 0.5),
    "flat cylinder": (Cylinder(0.6, 0.01), None, 1, 0.6),
    "capsule": (Capsule(0.3, 0.8), None, 3, 0.5),
    "hull": (Convex(points=CORNERS.T, label="hull"), CORNERS, 1, 0.0),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_ball_about_a_solid_holds_it_and_is_hardly_larger(name: str) -> None:
    """Nothing is lost by it, from near, from far and from within it; what is met is compared beam by beam."""
    shape, corners, count, largest = SHAPES[name]
    parts = _parts(shape, corners)
    assert len(parts) == count
    if largest:
        assert largest <= parts[0][3] <= 1.012 * largest
    rng = np.random.default_rng(2061)
    for shift, axes, planes, radius in parts:
        X = RigidTransform(RollPitchYaw(0.3, -0.5, 0.9), [0.4, -0.2, 0.1])
        seat = ScannedSolid(1, RollPitchYaw(-0.2, 0.1, 0.7).ToRotationMatrix().matrix(), shift, radius, axes, planes)
        hits = 0
        for away in (0.7, 1.5, 4.0):
            at = rng.normal(size=3)
            middle = X @ shift
            origin = middle + away * at / np.linalg.norm(at)
            ways = middle + rng.normal(0.0, 0.4, (400, 3)) - origin
            ways /= np.linalg.norm(ways, axis=1, keepdims=True)
            R = X.rotation().matrix() @ seat.R
            o, d = (origin - X @ seat.p) @ R, ways @ R
            every = meet_planes(o, d, planes) if axes is None else meet_ellipsoid(o, d, axes)
            found = scan(origin, ways, [seat], [RigidTransform(), X])
            np.testing.assert_allclose(found, every, rtol=1e-9)
            hits += np.count_nonzero(np.isfinite(every))
        assert hits > 20


def test_a_hull_is_what_lies_behind_all_faces_of_its_corners() -> None:
    ((middle, axes, planes, radius),) = _parts(SHAPES["hull"][0], CORNERS)
    assert axes is None
    np.testing.assert_allclose(middle, 0.5 * (CORNERS.min(axis=0) + CORNERS.max(axis=0)))
    assert radius == pytest.approx(max(np.linalg.norm(corner - middle) for corner in CORNERS))
    away = (CORNERS - middle) @ planes[:, :3].T + planes[:, 3]
    assert away.max() < 1e-8 and (np.abs(away) < 1e-8).any(axis=0).all()
    assert _parts(HalfSpace(), None) == []
    flat = CORNERS * [1.0, 1.0, 0.0]
    assert _parts(SHAPES["hull"][0], flat) == [], "a label has no inside to be met"


def test_a_tube_is_a_prism_of_64_sides_about_it() -> None:
    for shape in (Cylinder(0.3, 0.8), Capsule(0.3, 0.8)):
        _, axes, planes, _ = _parts(shape, None)[0]
        assert axes is None and planes.shape == (66, 4)
        np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
        turn = np.sort(np.arctan2(planes[:64, 1], planes[:64, 0]) % (2.0 * np.pi))
        np.testing.assert_allclose(np.diff(turn), 2.0 * np.pi / 64, atol=1e-9)
        np.testing.assert_allclose(planes[:64, 2:], np.tile([0.0, -0.3], (64, 1)), atol=1e-12)
        np.testing.assert_allclose(planes[64:], [[0, 0, 1, -0.4], [0, 0, -1, -0.4]])
    ends = _parts(Capsule(0.3, 0.8), None)[1:]
    np.testing.assert_allclose(sorted(end[0][2] for end in ends), [-0.4, 0.4])
    assert all(end[1].tolist() == [0.3] * 3 and end[3] == 0.3 for end in ends if end[1] is not None)


def test_all_that_is_shown_of_a_world_is_where_its_body_has_it() -> None:
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    body = plant.AddRigidBody("thing", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    X_BG = RigidTransform(RollPitchYaw(0.3, -0.2, 0.6), [0.1, 0.2, 0.3])
    plant.RegisterVisualGeometry(body, X_BG, Capsule(0.1, 0.6), "capsule", [1.0, 1.0, 1.0, 1.0])
    plant.RegisterVisualGeometry(body, X_BG, Convex(points=CORNERS.T, label="hull"), "hull", [1.0, 1.0, 1.0, 1.0])
    plant.RegisterVisualGeometry(plant.world_body(), RigidTransform([0, 0, -1]), Box(1, 1, 1), "box", [1.0] * 4)
    plant.Finalize()
    found = world_solids(SimpleNamespace(plant=plant, scene_graph=scene_graph))  # type: ignore[arg-type]
    assert [solid.body for solid in found] == [0, 1, 1, 1, 1]
    np.testing.assert_allclose(found[0].p, [0.0, 0.0, -1.0])
    middle = 0.5 * (CORNERS.min(axis=0) + CORNERS.max(axis=0))
    wanted = [X_BG @ np.array([0.0, 0.0, z]) for z in (0.0, -0.3, 0.3)] + [X_BG @ middle]
    places = sorted(tuple(np.round(solid.p, 9)) for solid in found[1:])
    np.testing.assert_allclose(places, sorted(tuple(np.round(place, 9)) for place in wanted), atol=1e-8)
    for solid in found[1:]:
        np.testing.assert_allclose(solid.R, X_BG.rotation().matrix(), atol=1e-12)


# The system.

STRAIGHT = Lidar(columns=1, rows=1, width=0.0, height=0.0, rate=8.0, latency=0.0625)
CLEAN = LidarDefects(noise=0.0, growth=0.0, dropout=0.0)


def wall(distance: float) -> list[ScannedSolid]:
    return [ScannedSolid(0, np.eye(3), np.zeros(3), 1e3, None, np.array([[-1.0, 0.0, 0.0, distance]]))]


def seen(distance: float, **lidar: Any) -> float:
    data = Lidar(columns=1, rows=1, width=0.0, height=0.0, **lidar)
    return float(LidarSystem(data, CLEAN, wall(distance), 1).ranges([RigidTransform()], 1)[0])


def test_echoes_from_nearest_to_farthest_are_measured() -> None:
    assert seen(2.0, range=[2.0, 2.0]) == 2.0
    assert seen(1.999, range=[2.0, 3.0]) == 0.0 and seen(3.001, range=[2.0, 3.0]) == 0.0
    assert seen(2.5, range=[2.0, 3.0]) == 2.5
    assert seen(-2.5, range=[0.0, 3.0]) == 0.0, "what lies behind gives no echo"


def test_beams_start_where_the_lidar_stands() -> None:
    assert seen(2.0, X_WS=Pose([0.5, 3.0, 1.0])) == pytest.approx(1.5)
    assert seen(2.0, X_WS=Pose([0.5, 0.0, 0.0], [0.0, 0.0, np.pi / 3])) == pytest.approx(3.0)


def test_noise_and_loss_are_those_of_seed_and_scan() -> None:
    data = Lidar(columns=30, rows=20, width=0.4, height=0.3)
    defects = LidarDefects(noise=0.02, growth=0.01, dropout=0.25)
    found = LidarSystem(data, defects, wall(2.0), 9).ranges([RigidTransform()], 4)
    rng = generator(9, Stream.LIDAR, 4)
    noise, chance = rng.standard_normal(600), rng.uniform(size=600)
    up, left = np.meshgrid(np.linspace(0.15, -0.15, 20), np.linspace(0.2, -0.2, 30), indexing="ij")
    true = (2.0 / (np.cos(up) * np.cos(left))).ravel()
    wanted = np.where(chance < 0.25, 0.0, true + noise * np.sqrt(0.02**2 + (0.01 * true**2) ** 2))
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def scans(defects: LidarDefects, times: list[float], lidar: Lidar = STRAIGHT) -> list[tuple[float, float]]:
    """Range and its time on the ports at these times; the wall comes nearer by its body's pose, which is fixed."""
    system = LidarSystem(lidar, defects, wall(2.0), 1)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("body_poses").FixValue(context, Value([RigidTransform([0.5, 0.0, 0.0])]))
    rows = []
    for time in times:
        simulator.AdvanceTo(time)
        ports = [system.GetOutputPort(name).Eval(context) for name in ("ranges", "scan_time")]
        rows.append((float(ports[0][0]), float(ports[1][0])))
    return rows


def test_scans_are_taken_at_k_over_the_rate_and_delivered_later() -> None:
    times = [0.01, 0.124, 0.126, 0.187, 0.188, 0.312, 0.313]
    wanted = [NEVER, NEVER, NEVER, NEVER, 0.125, 0.125, 0.25]
    found = scans(CLEAN, times)
    assert [time for _, time in found] == wanted
    assert [r for r, _ in found] == [0.0 if time < 0.0 else 2.5 for time in wanted]


def test_in_an_outage_the_newest_scan_stays() -> None:
    missing = LidarDefects(noise=0.0, growth=0.0, dropout=0.0, missing=[[0.25, 0.5], [0.75, 0.875]])
    times = [0.125 * k + 0.07 for k in range(1, 8)]
    assert [time for _, time in scans(missing, times)] == [0.125, 0.125, 0.125, 0.5, 0.625, 0.625, 0.875]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"noise": -1e-9}, "noise"),
        ({"growth": float("inf")}, "growth"),
        ({"dropout": float("nan")}, "dropout"),
        ({"missing": [[0.0, 1.0], [1.0, 0.9]]}, "missing"),
        ({"missing": [[0.0, 1.0], [1.0]]}, "missing"),
        ({"missing": [[0.0, 1.0, 2.0]]}, "missing"),
    ],
)
def test_defects_that_cannot_be_are_refused(change: dict[str, Any], field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.lidar_defects\.{field}"):
        LidarSystem(STRAIGHT, LidarDefects(**change), [], 1)
    LidarSystem(STRAIGHT, LidarDefects(noise=0.0, growth=0.0, dropout=0.0, missing=[[1.0, 1.0]]), [], 1)
