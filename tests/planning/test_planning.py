"""Planning's mathematics: kinematics, distances, trajectories, programs, goals, guides, forecasts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Box as DrakeBox
from pydrake.geometry import Convex, Cylinder
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from tests.planning.mpc.prox_qp import ProxQp
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import AssetError, ModelError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.ball_cover import TUNING as BALL_COVER
from twin_diagram.planning.collision.ball_cover import arm_balls, arm_plant, box_cover
from twin_diagram.planning.collision.chain import Chain, depths
from twin_diagram.planning.collision.clearance import TUNING as CLEARANCE
from twin_diagram.planning.collision.clearance import Clearance, Surroundings
from twin_diagram.planning.collision.collision_scene import (
    Forecast,
    Scene,
    load_scene,
    travel,
)
from twin_diagram.planning.collision.convex_solids import Ball, Box, Drum, Polytope, solid_of
from twin_diagram.planning.collision.forecast_growth import TUNING as FORECAST_GROWTH
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.planning.mpc.payload_gravity import gravity_regressor
from twin_diagram.planning.mpc.quadratic_program import QuadraticProgram
from twin_diagram.planning.mpc.trajectory import Trajectory, response
from twin_diagram.planning.paths import inverse_kinematics, rrt_connect
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
ARMS = [
    scenario.ArmModel(),
    scenario.ArmModel(model="arms/ur5e.urdf", tool_frame=""),
    scenario.ArmModel(model="arms/iiwa7_wsg.urdf", tool_frame=""),
]
seeds = st.integers(0, 2**31 - 1)


@pytest.fixture(scope="module")
def scene() -> Scene:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in ("mover", "can", "mug")}
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], library)


def packed(pose_xyz: tuple[float, float, float], **changes: object) -> np.ndarray:
    values: dict[str, object] = {
        "status": ObjectStatus.TRACKED,
        "last_seen": 0.0,
        "pose": np.array([1.0, 0, 0, 0, *pose_xyz]),
        "velocity": np.zeros(6),
        "covariance": np.zeros((6, 6)),
    }
    return Track(**{**values, **changes}).pack()  # type: ignore[arg-type]


# Kinematics.


@pytest.mark.parametrize("spec", ARMS, ids=lambda spec: spec.model)
def test_forward_kinematics_agrees_with_the_plant(spec: scenario.ArmModel) -> None:
    model = Model.load(spec)
    chain = Chain.from_plant(model.plant, model.arm.joint_indices, model.arm.tool_frame)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, chain.size))
    placement = chain.place(q)
    tool, jacobian = chain.tool(placement), chain.tool_jacobian(placement)
    for row in range(len(q)):
        np.testing.assert_allclose(tool[row], model.tool_pose(q[row]).GetAsMatrix4(), atol=1e-12)
        np.testing.assert_allclose(jacobian[row], model.tool_jacobian(q[row]), atol=1e-12)


def test_a_frame_that_does_not_move_with_all_joints_is_refused() -> None:
    model = Model.load(scenario.ArmModel())
    frame = model.plant.GetFrameByName("panda_link3").index()
    with pytest.raises(ModelError, match="panda_link3"):
        Chain.from_plant(model.plant, model.arm.joint_indices, frame)
    with pytest.raises(ModelError, match="serial chain"):
        Chain.from_plant(model.plant, model.arm.joint_indices[::-1], model.arm.tool_frame)


@pytest.mark.parametrize("spec", ARMS, ids=lambda spec: spec.model)
def test_payload_torque_agrees_with_the_model(spec: scenario.ArmModel) -> None:
    mass, com = 1.3, [0.02, -0.03, 0.11]
    model = Model.load(spec)
    loaded = Model.load(
        scenario.ArmModel(
            model=spec.model,
            tool_frame=spec.tool_frame,
            effects=[scenario.EffectSpec(name="payload", parameters={"mass": [mass], "com": com})],
        )
    )
    chain = Chain.from_plant(model.plant, model.arm.joint_indices, model.arm.tool_frame)
    for q in np.random.default_rng(1).uniform(-1.5, 1.5, (5, chain.size)):
        expected = loaded.bias(q, np.zeros_like(q)) - model.bias(q, np.zeros_like(q))
        found = gravity_regressor(chain, q) @ np.array([mass, *(mass * np.array(com))])
        np.testing.assert_allclose(found, expected, atol=1e-9)


# Convex solids.


def turned(seed: int) -> np.ndarray:
    return Rotation.random(random_state=seed).as_matrix()


@given(seeds)
def test_a_box_is_the_hull_of_its_corners(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = Box(rng.uniform(0.01, 0.2, 3), turned(seed), rng.normal(size=3))
    points = box.p_GB + 0.3 * rng.normal(size=(60, 3))
    distance, normal = box.distance(points)
    expected, expected_normal = Polytope(box.vertices).distance(points)
    np.testing.assert_allclose(distance, expected, atol=1e-9)
    clear = np.abs(distance) > 1e-6
    away = clear & (distance > 0)
    np.testing.assert_allclose(normal[away], expected_normal[away], atol=1e-5)
    found = solid_of(rng.permutation(box.vertices))
    assert isinstance(found, Box)
    np.testing.assert_allclose(np.sort(found.half), np.sort(box.half), rtol=1e-6)


def test_a_polytope_agrees_with_quadratic_programming() -> None:
    rng = np.random.default_rng(3)
    vertices = 0.1 * rng.normal(size=(20, 3))
    points = 0.3 * rng.normal(size=(12, 3))
    distance, normal = Polytope(vertices).distance(points)
    count = len(vertices)
    for point, d, n in zip(points, distance, normal, strict=True):
        if d < 1e-3:
            continue
        best = minimize(
            lambda w, point=point: 1e2 * np.sum((w @ vertices - point) ** 2),
            np.full(count, 1 / count),
            jac=lambda w, point=point: 2e2 * vertices @ (w @ vertices - point),
            bounds=[(0, 1)] * count,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1, "jac": lambda w: np.ones(count)},
            method="SLSQP",
            options={"ftol": 1e-15, "maxiter": 400},
        )
        nearest = best.x @ vertices
        assert abs(np.linalg.norm(point - nearest) - d) < 1e-5
        np.testing.assert_allclose(point - d * n, nearest, atol=1e-3)


@given(seeds)
def test_distances_are_lipschitz_with_their_normals_as_slopes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solids = [
        Polytope(0.1 * rng.normal(size=(12, 3))),
        Box(rng.uniform(0.02, 0.1, 3), turned(seed), np.zeros(3)),
        Drum(np.zeros(3), turned(seed)[:, 0], 0.05, 0.1),
        Ball(np.zeros(3), 0.07),
    ]
    p = 0.2 * rng.normal(size=(40, 3))
    step = 1e-6 * rng.normal(size=p.shape)
    for solid in solids:
        d, n = solid.distance(p)
        moved, _ = solid.distance(p + step)
        assert (np.abs(moved - d) <= np.linalg.norm(step, axis=1) + 1e-12).all()
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-9)
        # Away from ridges the slope is the derivative; few points are on one.
        wrong = np.abs(moved - d - np.einsum("mi,mi->m", n, step)) > 1e-9
        assert wrong.mean() < 0.15
        outside = d > 0
        assert (solid.box.distance(p)[0] <= d + 1e-12).all()
        surface, _ = solid.distance(p - d[:, None] * n)
        assert np.abs(surface[outside]).max(initial=0.0) < 1e-9
        centre, radius = solid.ball
        assert (d >= np.linalg.norm(p - centre, axis=1) - radius - 1e-12).all()


def test_a_prism_of_many_sides_is_a_drum_that_holds_it() -> None:
    can = Asset.load(models_dir() / "objects" / "can").convex_pieces[0]
    drum = solid_of(can)
    assert isinstance(drum, Drum)
    p = 0.1 * np.random.default_rng(0).normal(size=(500, 3))
    d, _ = drum.distance(p)
    expected, _ = Polytope(can).distance(p)
    assert (d <= expected + 1e-9).all()
    assert (expected - d).max() < 0.001
    # Not everything with 24 corners is one.
    assert isinstance(solid_of(np.random.default_rng(0).normal(size=(32, 3))), Polytope)


def test_flat_pieces_are_refused() -> None:
    with pytest.raises(AssetError, match="no volume"):
        solid_of(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.2, 0]]))


# Covers.


@given(st.tuples(*[st.floats(0.01, 0.4)] * 3))
def test_balls_hold_their_box(size: tuple[float, float, float]) -> None:
    cover = box_cover(np.array(size), BALL_COVER.overhang)
    centres, radii = np.array([c for c, _, _ in cover]), np.array([r for _, r, _ in cover])
    p = np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3))
    p[:100] = np.sign(p[:100]) / 2  # corners and, below, faces
    p[100:200, 0] = np.sign(p[100:200, 0]) / 2
    inside = (np.linalg.norm(p[:, None] * size - centres, axis=2) <= radii + 1e-9).any(axis=1)
    assert inside.all()


def test_the_cover_of_the_hand_is_tight() -> None:
    for size in ((0.064, 0.206, 0.068), (0.021, 0.024, 0.033)):
        beyond = max(
            (np.abs(c) + r - np.array(size) / 2).max() for c, r, _ in box_cover(np.array(size), BALL_COVER.overhang)
        )
        assert beyond <= BALL_COVER.overhang + 1e-9


def test_an_arm_without_shapes_is_covered_along_its_joints(tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    text = (models_dir() / "arms" / "panda.urdf").read_text()
    bare = tmp_path / "bare.urdf"
    while "<collision>" in text:
        head, _, rest = text.partition("<collision>")
        text = head + rest.partition("</collision>")[2]
    bare.write_text(text)
    plant, scene_graph, arm, _ = arm_plant(scenario.ArmModel(model=str(bare), tool_frame=""))
    balls = arm_balls(plant, scene_graph, arm, depths(plant, arm.joint_indices))
    assert "no collision geometry" in caplog.text
    context = plant.CreateDefaultContext()
    poses = [plant.get_joint(index).child_body().EvalPoseInWorld(context) for index in arm.joint_indices]
    origins = np.array([X_WL.translation() for X_WL in poses])
    lengths = np.linalg.norm(np.diff(origins, axis=0), axis=1)
    np.testing.assert_allclose(balls.radii, 0.05 * lengths.sum())
    assert len(balls.pairs) == 0
    for k, X_WL in enumerate(poses):
        centres = np.array([X_WL.multiply(c) for c in balls.centres_L[balls.links == k + 1]])
        np.testing.assert_allclose(centres[0], origins[k], atol=1e-12)
        if k < 6:  # the balls overlap all along the line to the next joint
            np.testing.assert_allclose(centres[-1], origins[k + 1], atol=1e-12)
            gaps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
            assert np.all(gaps <= balls.radii[0]) and gaps.sum() == pytest.approx(lengths[k])


# Clearance.


def drake_distances(assets: list[tuple[np.ndarray, object]], configurations: np.ndarray) -> np.ndarray:
    """Smallest distance of the arm from each shape, by Drake, with the fingers open."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    arm = description.add_arm(plant, scenario.ArmModel())
    friction = CoulombFriction(0.5, 0.5)
    ids = []
    for number, (X_WO, shape) in enumerate(assets):
        ids.append(
            plant.RegisterCollisionGeometry(
                plant.world_body(), RigidTransform(X_WO), shape, f"object{number}", friction
            )
        )
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyContextFromRoot(context)
    inspector = scene_graph.model_inspector()
    moving = {
        geometry
        for instance in arm.instances
        for body in plant.GetBodyIndices(instance)
        if plant.get_body(body).name() != "panda_link0"
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(body))
    }
    result = np.zeros((len(configurations), len(assets)))
    for row, q in enumerate(configurations):
        all_q = plant.GetPositions(plant_context)
        for k, index in enumerate(arm.joint_indices):
            all_q[plant.get_joint(index).position_start()] = q[k]
        for index in arm.gripper_joint_indices:
            all_q[plant.get_joint(index).position_start()] = 0.04
        plant.SetPositions(plant_context, all_q)
        query = plant.get_geometry_query_input_port().Eval(plant_context)
        for column, other in enumerate(ids):
            result[row, column] = min(
                query.ComputeSignedDistancePairClosestPoints(geometry, other).distance for geometry in moving
            )
    del inspector
    return result


def test_clearance_is_drakes_or_a_little_less() -> None:
    rng = np.random.default_rng(5)
    shapes = [
        (DrakeBox(0.1, 0.06, 0.24), [Box(np.array([0.05, 0.03, 0.12]), np.eye(3), np.zeros(3))]),
        (Cylinder(0.034, 0.1), [Drum(np.zeros(3), np.array([0.0, 0, 1]), 0.034, 0.05)]),
    ]
    hull = 0.06 * rng.normal(size=(10, 3))
    shapes.append((Convex(points=hull.T, label="stone"), [solid_of(hull)]))  # type: ignore[arg-type]
    poses = []
    for _ in shapes:
        X = np.eye(4)
        X[:3, :3] = Rotation.random(random_state=rng.integers(1000)).as_matrix()
        X[:3, 3] = [rng.uniform(0.3, 0.6), rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.5)]
        poses.append(X)
    q = HOME + 0.6 * rng.standard_normal((25, 7))
    q[:, 3] = np.minimum(q[:, 3], -0.5)
    plant, scene_graph, arm, _ = arm_plant(scenario.ArmModel())
    depth = depths(plant, arm.joint_indices)
    chain = Chain.from_plant(plant, arm.joint_indices, arm.tool_frame)
    clearance = Clearance(
        chain, arm_balls(plant, scene_graph, arm, depth), [Body.of(str(k), s) for k, (_, s) in enumerate(shapes)]
    )
    X_WO = np.repeat(np.array(poses)[:, None], len(q), axis=1)
    around = Surroundings(X_WO, np.zeros((3, len(q))), np.ones(3, dtype=bool), np.ones(3, dtype=bool))
    found = clearance.distances(q, around, 2.0)[:, :3]
    expected = drake_distances([(X, shape) for X, (shape, _) in zip(poses, shapes, strict=True)], q)
    apart = expected > 0
    assert apart.mean() > 0.5
    assert (found <= expected + 1e-6)[apart].all()
    # Covers reach beyond the shapes, at a box's corners by somewhat more than beyond its faces.
    assert (expected - found)[apart].max() < 0.03
    assert np.median((expected - found)[apart]) < 0.012
    # One body that moves gives the same as one that stands still wherever it is.
    again = clearance.distances(q, Surroundings(X_WO, around.grown, around.present, ~around.still), 2.0)
    np.testing.assert_allclose(again[:, :3], found, atol=1e-12)
    larger = clearance.distances(q, Surroundings(X_WO, around.grown + 0.01, around.present, around.still), 2.0)
    np.testing.assert_allclose(larger[:, :3], found - 0.01, atol=1e-9)


def test_gradients_are_derivatives(scene: Scene) -> None:
    rng = np.random.default_rng(2)
    tracks = np.concatenate([packed((0.5, 0.1, 0.12)), packed((0.45, -0.1, 0.05)), packed((0.6, 0.3, 0.05))])
    q = HOME + 0.3 * rng.standard_normal((12, 7))
    around = scene.around(Forecast.of_tracks(tracks), np.zeros(len(q)))
    contacts = scene.clearance.contacts(q, around, 0.3, 0.1)
    assert set(contacts.body) >= {0, 1, 2, 3, 4}
    nearest = np.full((len(q), 5), CLEARANCE.far)
    np.minimum.at(nearest, (contacts.row, contacts.body), contacts.distance)
    np.testing.assert_allclose(np.minimum(nearest, 0.1), np.minimum(scene.clearance.distances(q, around, 0.3), 0.1))
    step = 1e-6
    checked = 0
    for row, body in sorted({(int(r), int(b)) for r, b in zip(contacts.row, contacts.body, strict=True)}):
        here = (contacts.row == row) & (contacts.body == body)
        distance, gradient = contacts.distance[here], contacts.gradient[here]
        order = np.argsort(distance)
        if len(order) > 1 and distance[order[1]] - distance[order[0]] < 1e-4:
            continue  # two parts are equally near: the smallest distance has a kink
        for joint in range(7):
            moved = q[row].copy()
            moved[joint] += step
            after = scene.clearance.distances(moved[None], around.take(np.array([row])), 0.3)[0, body]
            assert abs((after - distance[order[0]]) / step - gradient[order[0], joint]) < 2e-3
        checked += 1
    assert checked > 20


def test_links_that_cannot_leave_the_table_do_not_count(scene: Scene) -> None:
    lifted = scene.clearance.link_distances(
        HOME[None], scene.around(Forecast.of_tracks(np.zeros(3 * TRACK_SIZE)), np.zeros(1))
    )
    assert lifted[0, 0, 0] == CLEARANCE.far  # the shoulder turns above the table
    assert lifted[0, 6, 0] < 0.5
    # At home the arm is clear of itself.
    around = scene.around(Forecast.of_tracks(np.zeros(3 * TRACK_SIZE)), np.zeros(1))
    assert scene.clearance.distances(HOME[None], around, 0.3)[0, -1] > 0.01
    folded = HOME.copy()
    folded[3], folded[5] = -3.07, -0.01
    assert scene.clearance.distances(folded[None], around, 0.3)[0, -1] < 0.01


# Trajectories.


def test_a_trajectory_works_its_knots_out_once() -> None:
    """And who asks for them may write to what it gets."""
    motion = Trajectory(2.0, 0.1, np.ones(3), np.zeros(3), np.random.default_rng(0).normal(size=(5, 3)))
    first = motion.knots
    first[:] = 7.0
    assert motion._knots is motion._knots and not (motion.knots == 7.0).any()
    np.testing.assert_allclose(motion.knots[:, 0], [motion.position(2.0 + 0.1 * k)[0] for k in range(5)], rtol=1e-12)


@given(seeds, st.integers(4, 20), st.floats(0.02, 0.3))
def test_trajectories_are_linear_in_their_accelerations(seed: int, knots: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    motion = Trajectory(2.0, step, rng.normal(size=3), rng.normal(size=3), rng.normal(size=(knots, 3)))
    times = 2.0 + rng.uniform(0, step * (knots - 1), 20)
    q, v, _ = motion.at(times)
    position, velocity = response(times - 2.0, step, knots)
    np.testing.assert_allclose(
        motion.q0 + motion.v0 * (times - 2.0)[:, None] + position @ motion.accelerations, q, atol=1e-9
    )
    np.testing.assert_allclose(motion.v0 + velocity @ motion.accelerations, v, atol=1e-9)
    np.testing.assert_allclose([motion.position(t) for t in times], q, atol=1e-9)
    np.testing.assert_allclose(motion.at(motion.start + step * np.arange(knots))[0], motion.knots, atol=1e-9)


def test_trajectories_are_smooth_and_then_rest() -> None:
    rng = np.random.default_rng(0)
    motion = Trajectory(0.0, 0.1, rng.normal(size=2), rng.normal(size=2), rng.normal(size=(8, 2)))
    h = 1e-5
    times = np.linspace(0.01, 0.69, 400)
    before, here, after = (motion.at(times + d) for d in (-h, 0.0, h))
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), here[1], atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), here[2], atol=1e-3)
    late = motion.at(np.array([motion.end, 5.0]))
    np.testing.assert_allclose(late[0], motion.knots[[-1, -1]])
    assert (late[1] == 0).all()
    np.testing.assert_allclose(motion.position(9.0), motion.knots[-1])


# Quadratic programs.


@given(seeds, st.floats(1e-4, 1e2))
def test_programs_are_solved_to_their_conditions(seed: int, strength: float) -> None:
    """However weak the objective: a solver that stops by absolute residuals answers anything when it is weak enough."""
    rng = np.random.default_rng(seed)
    n, rows = 12, 20
    root = rng.normal(size=(n, n))
    program = QuadraticProgram(
        H=strength * (root @ root.T + 0.1 * np.eye(n)),
        g=strength * rng.normal(size=n),
        A=rng.normal(size=(2, n)),
        b=np.zeros(2),
        C=rng.normal(size=(rows, n)),
        low=np.full(rows, -0.3),
        high=np.full(rows, 0.3),
        lower=np.full(n, -0.5),
        upper=np.full(n, 0.5),
    )
    answer = ProxQp().solve(program)
    assert answer.solved
    x = answer.x
    np.testing.assert_array_equal(ProxQp().solve(program).x, x)
    assert np.abs(program.A @ x).max() < 1e-5
    assert (np.abs(program.C @ x) < 0.3 + 1e-5).all()
    assert (np.abs(x) < 0.5 + 1e-5).all()

    def cost(z: np.ndarray) -> float:
        return float(z @ program.H @ z / 2 + program.g @ z)

    best = minimize(
        lambda z: cost(z) / strength,
        np.zeros(n),
        jac=lambda z: (program.H @ z + program.g) / strength,
        bounds=[(-0.5, 0.5)] * n,
        constraints=[
            {"type": "eq", "fun": lambda z: program.A @ z, "jac": lambda z: program.A},
            {"type": "ineq", "fun": lambda z: 0.3 - program.C @ z, "jac": lambda z: -program.C},
            {"type": "ineq", "fun": lambda z: 0.3 + program.C @ z, "jac": lambda z: program.C},
        ],
        method="SLSQP",
        options={"ftol": 1e-13, "maxiter": 300},
    )
    np.testing.assert_allclose(x, best.x, atol=2e-4)


def test_a_program_without_solution_is_reported() -> None:
    eye = np.eye(2)
    program = QuadraticProgram(
        eye, np.zeros(2), np.zeros((0, 2)), np.zeros(0), eye, np.full(2, 3.0), np.full(2, 4.0), -np.ones(2), np.ones(2)
    )
    assert not ProxQp().solve(program).solved


# Inverse kinematics.


@pytest.mark.parametrize("spec", ARMS, ids=lambda spec: spec.model)
def test_joint_goals_reach_the_pose(spec: scenario.ArmModel) -> None:
    loaded = load_scene(spec, [], {})
    n = loaded.chain.size
    rng = np.random.default_rng(0)
    near = np.clip(np.array([0.3, -0.8, 0.4, -1.5, 0.5, 1.2, 0.3])[:n], loaded.lower + 0.2, loaded.upper - 0.2)
    X_WG = loaded.chain.tool(loaded.chain.place(near[None]))[0]
    start = np.clip(near + 0.5, loaded.lower, loaded.upper)
    goals = inverse_kinematics.solve(loaded.chain, X_WG, start, loaded.lower, loaded.upper, rng)
    assert len(goals) >= 2
    error = inverse_kinematics.pose_error(loaded.chain.tool(loaded.chain.place(goals)), X_WG)
    assert np.abs(error).max() < 2e-4
    assert (goals >= loaded.lower).all() and (goals <= loaded.upper).all()


def test_a_pose_out_of_reach_has_no_joint_goal(scene: Scene) -> None:
    X_WG = np.eye(4)
    X_WG[:3, 3] = [2.0, 0.0, 0.3]
    assert inverse_kinematics.solve(
        scene.chain, X_WG, HOME, scene.lower, scene.upper, np.random.default_rng(0)
    ).shape == (0, 7)


# The guide.


def wall_with_gap(q: np.ndarray) -> np.ndarray:
    return (np.abs(q[:, 0]) > 0.3) | (q[:, 1] > 1.5)


def test_the_guide_finds_the_gap() -> None:
    start, goals = np.array([-1.0, 0.0]), np.array([[1.0, 0.0], [1.5, 0.5]])
    bound = np.full(2, 2.5)
    paths = [
        rrt_connect.plan(start, goals, wall_with_gap, -bound, bound, np.random.default_rng(4), checks=4000)
        for _ in range(2)
    ]
    path = paths[0]
    assert path is not None
    np.testing.assert_array_equal(path, paths[1])
    np.testing.assert_array_equal(path[0], start)
    assert (np.abs(path[-1] - goals).max(axis=1) == 0).any()
    for a, b in pairwise(path):
        assert wall_with_gap(rrt_connect.interpolate(a, b, 0.05)).all()
    assert rrt_connect.length(path, np.ones(2)) < 6.0


def test_the_guide_gives_up_when_told() -> None:
    asked = []

    def is_free(q: np.ndarray) -> np.ndarray:
        asked.append(len(q))
        return np.abs(q).max(axis=1) < 0.5

    bound = np.full(2, 2.0)
    found = rrt_connect.plan(
        np.zeros(2), np.array([[1.0, 1.0]]), is_free, -bound, bound, np.random.default_rng(0), checks=500
    )
    assert found is None
    assert 500 <= sum(asked) < 700


# Forecasts.


def test_what_is_not_there_is_absent() -> None:
    statuses = list(ObjectStatus)
    tracks = np.concatenate([packed((0.5, 0, 0.1), status=status) for status in statuses])
    present = Forecast.of_tracks(tracks).present
    absent = {ObjectStatus.UNSEEN, ObjectStatus.HELD, ObjectStatus.GONE}
    assert [bool(p) for p in present] == [status not in absent for status in statuses]
    broken = packed((0.5, np.nan, 0.1))
    assert not Forecast.of_tracks(broken).present[0]
    assert Forecast.of_tracks(np.zeros(0)).at(np.zeros(3))[0].shape == (0, 3, 4, 4)


def test_objects_grow_by_their_uncertainty_up_to_a_cap() -> None:
    for std, expected in ((0.0, 0.0), (0.002, 0.006), (0.5, FORECAST_GROWTH.cap)):
        covariance = np.diag([0.1, 0.1, 0.1, std**2, (std / 2) ** 2, 0.0])
        grown = Forecast.of_tracks(packed((0.5, 0, 0.1), covariance=covariance)).grown
        np.testing.assert_allclose(grown, [expected], atol=1e-12)


def test_a_moving_object_keeps_going_and_then_slows() -> None:
    velocity = np.array([0.0, 0, 0.5, 0.1, -0.05, 0.0])
    forecast = Forecast.of_tracks(packed((0.5, 0, 0.1), status=ObjectStatus.MOVING, velocity=velocity))
    times = np.array([0.0, 0.5, 1.0, 10.0])
    X_WO, _ = forecast.at(times)
    np.testing.assert_allclose(X_WO[0, :3, :3, 3] - [0.5, 0, 0.1], times[:3, None] * velocity[3:])
    np.testing.assert_allclose(Rotation.from_matrix(X_WO[0, 1, :3, :3]).as_rotvec(), 0.5 * velocity[:3], atol=1e-12)
    assert travel(np.array([10.0]))[0] == pytest.approx(1.5, abs=1e-6)
    slow = Forecast.of_tracks(packed((0.5, 0, 0.1), velocity=0.05 * velocity))
    assert not slow.moving[0]
    np.testing.assert_allclose(slow.at(times)[0][0, :, :3, 3], np.tile([0.5, 0, 0.1], (4, 1)))


def test_what_turns_in_place_goes_on_turning() -> None:
    spin = np.array([0.0, 0, 0.8, 0.001, 0, 0])
    forecast = Forecast.of_tracks(packed((0.5, 0, 0.1), status=ObjectStatus.MOVING, velocity=spin))
    assert forecast.moving[0]
    X_WO, _ = forecast.at(np.array([0.5]))
    np.testing.assert_allclose(Rotation.from_matrix(X_WO[0, 0, :3, :3]).as_rotvec(), 0.5 * spin[:3], atol=1e-12)
    np.testing.assert_allclose(X_WO[0, 0, :3, 3], [0.5, 0, 0.1])
    assert not Forecast.of_tracks(packed((0.5, 0, 0.1), velocity=spin)).moving[0], "the noise of tracking turns, too"


# What stands still.


def test_a_fixture_that_moves_or_is_missing_is_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ModelError, match="no such file"):
        load_scene(scenario.ArmModel(), [scenario.Fixture(model="scenes/nowhere.sdf")], {})
    with pytest.raises(ModelError, match="stands still"):
        load_scene(scenario.ArmModel(), [scenario.Fixture(model="arms/ur5e.urdf")], {})


def test_a_fixture_stands_where_it_is_put() -> None:
    pose = scenario.Pose(translation=[0.0, 0.0, -0.25])
    loaded = load_scene(scenario.ArmModel(), [scenario.Fixture(X_WB=pose)], {})
    around = loaded.around(Forecast.of_tracks(np.zeros(0)), np.zeros(1))
    on_table = load_scene(scenario.ArmModel(), [scenario.Fixture()], {})
    lower = loaded.clearance.distances(HOME[None], around, 2.0)[0, 0]
    higher = on_table.clearance.distances(HOME[None], around, 2.0)[0, 0]
    assert lower - higher == pytest.approx(0.25, abs=1e-9)
