"""How far surfaces move with an uncertain pose, against sampled poses and against a Kalman filter that has settled."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision import forecast_growth
from twin_diagram.planning.collision.collision_scene import Scene, body_of_pieces, load_scene, packed
from twin_diagram.planning.collision.convex_solids import Ball, Box, Drum, Polytope, Solid, solid_of
from twin_diagram.planning.collision.forecast_growth import TUNING
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.planning.collision.unsure_pose import Unsure
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus, Track

R = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()
SOLIDS: list[Solid] = [
    Box(np.array([0.1, 0.04, 0.02]), R, np.array([0.02, 0.0, -0.03])),
    Drum(np.array([0.0, 0.03, 0.0]), R[:, 2], 0.04, 0.09),
    Ball(np.array([0.05, 0.0, 0.02]), 0.06),
    Polytope(0.07 * np.random.default_rng(4).standard_normal((14, 3))),
]


def drawn_covariance(seed: int, turn: float = 0.03, shift: float = 0.004) -> Array:
    root = np.random.default_rng(seed).standard_normal((6, 6)) * np.array([turn] * 3 + [shift] * 3)[:, None]
    return root @ root.T / 6


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_outermost_points_lie_on_the_surface_where_their_normals_say(solid: Solid) -> None:
    points, normals = solid.surface
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(solid.distance(points)[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(solid.distance(points + 0.01 * normals)[0], 0.01, atol=2e-3)
    # Together they reach as far as the solid does, along any direction.
    along = Rotation.random(40, random_state=0).as_matrix()[:, 0]
    p = 0.2 * np.random.default_rng(0).standard_normal((4000, 3))
    inside = p[solid.distance(p)[0] < 0.0]
    assert ((inside @ along.T).max(axis=0) <= (points @ along.T).max(axis=0) * 1.02 + 0.025).all()


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_an_object_grows_by_what_its_surface_moves_in_sampled_poses(solid: Solid) -> None:
    covariance, R_WO = drawn_covariance(1), Rotation.from_rotvec([0.2, 0.5, -0.7]).as_matrix()
    spread = forecast_growth.spread(forecast_growth.surface_rows([solid]), covariance, R_WO)
    points, normals = solid.surface
    draws = np.random.default_rng(2).multivariate_normal(np.zeros(6), covariance, 20000)
    p_W, n_W = points @ R_WO.T, normals @ R_WO.T
    moved = np.cross(draws[:, None, :3], p_W[None, :40]) + draws[:, None, 3:]
    std = np.einsum("dsi,si->ds", moved, n_W[:40]).std(axis=0)
    np.testing.assert_allclose(np.sqrt(spread[:40, 0]), std, rtol=0.03)
    np.testing.assert_allclose(spread[:, 1], (np.cross(points, normals) ** 2).sum(axis=1), atol=1e-12)
    # The grown solid holds what the true one has, in nearly all poses: exactly turned, not as linearised.
    grown = float(forecast_growth.growth(spread, np.zeros(1), np.zeros(1))[0])
    assert grown == pytest.approx(3.0 * np.sqrt(spread[:, 0].max())) and 0.01 < grown < TUNING.cap
    sticks_out = 0
    for draw in draws[:400]:
        turned = p_W @ Rotation.from_rotvec(draw[:3]).as_matrix().T + draw[3:]
        sticks_out += bool((solid.distance(turned @ R_WO)[0] > grown).any())
    assert sticks_out <= 8
    half = float(forecast_growth.growth(spread / 9, np.zeros(1), np.zeros(1))[0])
    out = [
        (solid.distance((p_W @ Rotation.from_rotvec(d[:3]).as_matrix().T + d[3:]) @ R_WO)[0] > half).any()
        for d in draws[:400]
    ]
    assert np.mean(out) > 0.15  # a third of it would be too little


def test_what_can_never_be_the_worst_is_left_out() -> None:
    spread = np.random.default_rng(0).uniform(0.0, 1.0, (300, 2)) * [1e-4, 0.04]
    turn, shift = np.linspace(0.0, 0.02, 30), np.linspace(0.0, 1e-5, 30)
    few = forecast_growth.outermost(spread)
    assert len(few) < 20
    np.testing.assert_array_equal(forecast_growth.growth(few, shift, turn), forecast_growth.growth(spread, shift, turn))
    np.testing.assert_array_equal(forecast_growth.outermost(np.zeros((4, 2))), np.zeros((1, 2)))


def test_turning_about_an_axis_of_symmetry_moves_no_surface() -> None:
    drum = Drum(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.04, 0.06)
    about = np.diag([0.0, 0.0, 4.0, 0.0, 0.0, 0.0])
    rows = forecast_growth.surface_rows([drum])
    np.testing.assert_allclose(forecast_growth.spread(rows, about, np.eye(3))[:, 0], 0.0, atol=1e-20)
    across = np.diag([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    assert forecast_growth.spread(rows, across, np.eye(3))[:, 0].max() == pytest.approx(0.01 * 0.06**2, rel=0.02)


@pytest.mark.parametrize(("variance", "density"), [(4e-6, 0.054), (1e-4, 0.6)])
def test_variance_grows_as_that_of_a_settled_filter_without_images(variance: float, density: float) -> None:
    A, Q = np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, density])

    def settled(r: float) -> Array:
        return np.asarray(solve_continuous_are(A.T, np.array([[1.0], [0.0]]), Q, [[r]]))

    low, high = 1e-14, 1.0
    for _ in range(200):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if settled(middle)[0, 0] < variance else (low, middle)
    P = settled(low)
    assert P[0, 0] == pytest.approx(variance, rel=1e-6)

    def flow(t: float, flat: Array) -> Array:
        S = flat.reshape(2, 2)
        return np.asarray((A @ S + S @ A.T + Q).ravel())

    times = np.array([0.0, 0.05, 0.15, 0.2])
    ahead = solve_ivp(flow, (0.0, 0.2), P.ravel(), t_eval=times, rtol=1e-10, atol=1e-16).y[0] - variance
    np.testing.assert_allclose(forecast_growth.added_variance(variance, density, times), ahead, rtol=1e-4, atol=1e-12)
    late = forecast_growth.added_variance(variance, density, np.array([0.2, 3.0]))
    assert late[0] == late[1]


@pytest.fixture(scope="module")
def scene() -> Scene:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in ("can", "cracker_box")}
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], library)


def tracks(speed: float, turn: float) -> Array:
    covariance = np.diag([0.0, 0.0, turn**2, 1e-6, 1e-6, 1e-6])
    moves = np.array([0, 0, 0, speed, 0, 0])
    status = ObjectStatus.MOVING if speed else ObjectStatus.TRACKED
    rows = [Track(status, 0.0, np.array([1.0, 0, 0, 0, x, 0, 0.1]), moves, covariance).pack() for x in (0.4, 0.7)]
    return np.concatenate(rows)


def test_margins_grow_ahead_for_what_moves_and_with_turns_for_what_is_not_round(scene: Scene) -> None:
    times = np.linspace(0.0, 1.0, 11)
    still = scene.around(scene.forecast(tracks(0.0, 0.02)), times).grown[scene.fixture_count :]
    assert (np.ptp(still, axis=1) == 0.0).all()
    can, box = still[:, 0]
    assert can == pytest.approx(0.003, rel=0.05)  # free about its axis: its place alone counts
    assert box > 0.004
    moving = scene.around(scene.forecast(tracks(0.3, 0.02)), times).grown[scene.fixture_count :]
    np.testing.assert_allclose(moving[:, 0], still[:, 0])
    assert (np.diff(moving, axis=1)[:, :2] > 0.003).all() and (np.diff(moving, axis=1)[:, 2:] == 0.0).all()
    assert (moving <= TUNING.cap).all()
    lost = scene.around(scene.forecast(tracks(0.0, 2.0)), times).grown[scene.fixture_count :]
    assert lost[1, 0] == TUNING.cap and lost[0, 0] == pytest.approx(can)


@pytest.mark.parametrize("moving", [False, True])
def test_turns_about_an_axis_of_symmetry_make_nothing_larger(moving: bool) -> None:
    """A ring of sixteen pieces, as `assets build` makes them, lying on its side: of its turn nothing is known."""
    ring = Asset.load(models_dir() / "objects" / "ring")
    solids, R_WO = [solid_of(piece) for piece in ring.convex_pieces], Rotation.from_euler("yz", [1.2, 0.4]).as_matrix()
    known = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])
    free = known.copy()
    free[:3, :3] += np.pi**2 / 3 * np.outer(R_WO[:, 2], R_WO[:, 2])
    times, round_ = np.array([0.0, 0.1, 0.2]), Body.of("ring", solids, round_about_z=True)
    plain = Unsure.of(known, R_WO, round_, moving=moving).growth(times)
    np.testing.assert_allclose(Unsure.of(free, R_WO, round_, moving=moving).growth(times), plain, rtol=1e-6)
    assert plain[0] < 0.004
    assert Unsure.of(free, R_WO, Body.of("ring", solids), moving=moving).growth(times)[0] == TUNING.cap


def test_what_the_library_calls_symmetric_is_round() -> None:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in ("can", "mug")}
    bodies = load_scene(scenario.ArmModel(), [], library).clearance.bodies
    assert [body.round_about_z for body in bodies] == [True, False]
    assert [body_of_pieces(*packed(asset)).round_about_z for asset in library.values()] == [True, False]
