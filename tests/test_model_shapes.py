"""The shapes of the models that come along: tool frames, what covers what, self-collision, table and bins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Role, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from tests.loaded_models import HOMES, PANDA_FINGERS, PANDA_JOINTS, Array, Loaded, every_arm, load, load_arm
from twin_diagram.scenario.resources import models_dir


@pytest.mark.parametrize(
    ("arm", "frame", "base", "p_BF"),
    [
        ("panda_hand.urdf", "panda_tcp", "panda_hand", [0, 0, 0.1034]),
        ("panda_hand.urdf", "panda_hand", "panda_link8", [0, 0, 0]),
        ("ur5e.urdf", "tool0", "wrist_3_link", [0, 0, 0]),
        ("iiwa7.urdf", "iiwa_link_ee", "iiwa_link_7", [0, 0, 0.045]),
        ("iiwa7_wsg.urdf", "wsg_tcp", "iiwa_link_7", [0, 0, 0.09 + 0.108133]),
    ],
)
def test_tool_frames(arm: str, frame: str, base: str, p_BF: list[float]) -> None:
    X_BF = load_arm(arm).pose(frame, base)
    np.testing.assert_allclose(X_BF[:3, 3], p_BF, atol=1e-12)
    np.testing.assert_allclose(X_BF[:3, 2], [0, 0, 1], atol=1e-12)  # z is the approach


@pytest.mark.parametrize(
    ("arm", "tool", "fingers"),
    [
        ("panda_hand.urdf", "panda_tcp", ("panda_leftfinger", "panda_rightfinger")),
        ("iiwa7_wsg.urdf", "wsg_tcp", ("wsg_left_finger", "wsg_right_finger")),
    ],
)
def test_the_tool_frame_lies_between_the_finger_tips(arm: str, tool: str, fingers: tuple[str, str]) -> None:
    """Opening moves each tip to its side of the tool frame, along y; closed they (nearly) meet there."""
    robot = load_arm(arm)
    opened = np.zeros(robot.plant.num_positions())
    opened[-2:] = np.where(robot.plant.GetPositionUpperLimits()[-2:] > 0, 0.02, -0.02)
    gaps = []
    for q in (np.zeros_like(opened), opened):
        robot.plant.SetPositions(robot.context, q)
        X_TF = [robot.pose(finger, tool) for finger in fingers]
        assert abs(X_TF[0][0, 3]) < 1e-9 and abs(X_TF[1][0, 3]) < 1e-9
        np.testing.assert_allclose(X_TF[0][1, 3], -X_TF[1][1, 3], atol=1e-9)
        query = robot.scene_graph.get_query_output_port().Eval(robot.scene_graph.GetMyContextFromRoot(robot.root))
        to_tips = query.ComputeSignedDistanceToPoint(robot.pose(tool)[:3, 3], threshold=0.05)
        gaps.append(min(hit.distance for hit in to_tips))
    assert 0 <= gaps[0] < 0.003
    np.testing.assert_allclose(gaps[1] - gaps[0], 0.02, atol=1e-6)


def signed_distance(shape: Any, p_GQ: Array) -> Array:
    """Of points (N, 3) in the shape's frame from its surface, negative inside."""
    if isinstance(shape, Sphere):
        return np.linalg.norm(p_GQ, axis=1) - shape.radius()
    if isinstance(shape, Capsule):
        half = shape.length() / 2
        along = np.clip(p_GQ[:, 2], -half, half)
        return np.hypot(np.hypot(p_GQ[:, 0], p_GQ[:, 1]), p_GQ[:, 2] - along) - shape.radius()
    if isinstance(shape, Cylinder):
        radial = np.hypot(p_GQ[:, 0], p_GQ[:, 1]) - shape.radius()
        outside = np.stack([radial, np.abs(p_GQ[:, 2]) - shape.length() / 2], axis=1)
    else:
        outside = np.abs(p_GQ) - np.asarray(shape.size()) / 2
    return np.minimum(outside.max(axis=1), 0) + np.linalg.norm(np.maximum(outside, 0), axis=1)


def surface_points(shape: Any, count: int, rng: np.random.Generator) -> Array:
    """Points (N, 3) all over a primitive's surface, its edges included: a cloud around it, brought to the surface."""
    u = rng.normal(size=(count, 3))
    u /= np.abs(u).max(axis=1, keepdims=True)  # on a cube of half width 1
    if isinstance(shape, Box):
        return u * np.asarray(shape.size()) / 2
    around = u[:, :2] / np.linalg.norm(u[:, :2], axis=1, keepdims=True)
    if isinstance(shape, Cylinder):
        radius = np.minimum(1.0, np.abs(u[:, :2]).max(axis=1)) * shape.radius()
        return np.column_stack([around * radius[:, None], u[:, 2] * shape.length() / 2])
    ball = u / np.linalg.norm(u, axis=1, keepdims=True) * shape.radius()
    if isinstance(shape, Capsule):
        ball[:, 2] += np.sign(u[:, 2]) * shape.length() / 2
    return ball


@every_arm
def test_few_primitives_cover_what_is_drawn(arm: str) -> None:
    """Perception takes the robot's points out by its collision shapes, so these must cover the visual ones."""
    robot = load_arm(arm)
    inspector = robot.scene_graph.model_inspector()
    rng = np.random.default_rng(3)
    for index in robot.plant.GetBodyIndices(robot.plant.GetModelInstanceByName(Path(arm).stem)):
        body = robot.plant.get_body(index)
        frame = robot.plant.GetBodyFrameIdOrThrow(index)
        drawn, hard = (
            [(inspector.GetShape(g), inspector.GetPoseInFrame(g)) for g in inspector.GetGeometries(frame, role)]
            for role in (Role.kPerception, Role.kProximity)
        )
        assert len(hard) <= 3, body.name()
        assert bool(drawn) == bool(hard), body.name()
        for shape, X_LG in drawn:
            assert isinstance(shape, Box | Capsule | Cylinder | Sphere)
            p_LQ = (X_LG @ surface_points(shape, 1500, rng).T).T
            outside = [signed_distance(each, (X_LH.inverse() @ p_LQ.T).T) for each, X_LH in hard]
            assert np.min(outside, axis=0).max() < 0.010, body.name()


@every_arm
def test_no_self_collision_at_home(arm: str) -> None:
    robot = load_arm(arm)
    for name, q in HOMES[arm].items():
        robot.plant.SetPositions(robot.context, q)
        query = robot.scene_graph.get_query_output_port().Eval(robot.scene_graph.GetMyContextFromRoot(robot.root))
        touching = [
            {robot.plant.GetBodyFromFrameId(query.inspector().GetFrameId(g)).name() for g in (pair.id_A, pair.id_B)}
            for pair in query.ComputePointPairPenetration()
        ]
        assert not touching, (name, touching)


FOLDED: dict[str, list[float]] = {
    "panda.urdf": [0, 1.0, 0, -2.9, 0, 0.7, 0],
    "iiwa7.urdf": [0, 1.9, 0, -2.09, 0, -1.9, 0],
    "ur5e.urdf": [0, -1.57, 3.0, 0, 0, 0],
}
FOLDED["panda_hand.urdf"] = [*FOLDED["panda.urdf"], 0, 0]
FOLDED["iiwa7_wsg.urdf"] = [*FOLDED["iiwa7.urdf"], 0, 0]


@every_arm
def test_filters_leave_real_collisions_in(arm: str) -> None:
    """Most configurations are free of collision, and an arm that is folded into itself is not."""
    robot = load_arm(arm)
    rng = np.random.default_rng(11)
    free = []
    for q in [np.array(FOLDED[arm], float)] + [robot.draw(rng) for _ in range(150)]:
        robot.plant.SetPositions(robot.context, q)
        query = robot.scene_graph.get_query_output_port().Eval(robot.scene_graph.GetMyContextFromRoot(robot.root))
        free.append(not query.HasCollisions())
    assert not free[0]
    assert np.mean(free) > 0.7


# --- table and bins -------------------------------------------------------------------------------


def _boxes(robot: Loaded) -> list[tuple[Array, Array]]:
    """Lowest and highest corner of each collision box in the world."""
    inspector = robot.scene_graph.model_inspector()
    corners = []
    for geometry in inspector.GetAllGeometryIds(Role.kProximity):
        shape = inspector.GetShape(geometry)
        assert isinstance(shape, Box)
        centre = inspector.GetPoseInFrame(geometry).translation()
        corners.append((centre - np.asarray(shape.size()) / 2, centre + np.asarray(shape.size()) / 2))
    return corners


def test_table() -> None:
    ((low, high),) = _boxes(load(models_dir() / "scenes" / "table.sdf"))
    np.testing.assert_allclose(high - low, [1.4, 1.8, 0.04], atol=1e-12)
    np.testing.assert_allclose([low[0], high[0], high[2]], [-0.4, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("name", ["bin_a", "bin_b"])
def test_bin_is_open_above_and_closed_all_round(name: str) -> None:
    robot = load(models_dir() / "scenes" / f"{name}.sdf")
    boxes = _boxes(robot)
    assert len(boxes) == 5
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    assert abs(low[2]) < 1e-9 and abs(low[0] + high[0]) < 1e-9 and abs(low[1] + high[1]) < 1e-9
    rng = np.random.default_rng(2)
    p = rng.uniform(low, high, (4000, 3))
    filled = np.any([np.all((p >= box[0]) & (p <= box[1]), axis=1) for box in boxes], axis=0)
    depth = np.minimum(p[:, :2] - low[:2], high[:2] - p[:, :2]).min(axis=1)
    wall, foot = 0.006 if name == "bin_a" else 0.005, 0.001  # the bottom lies one foot above the walls' lower edge
    bottom = (p[:, 2] >= foot) & (p[:, 2] <= foot + wall)
    np.testing.assert_array_equal(filled, bottom | (depth <= wall))
    inertia = robot.plant.GetBodyByName("bin").default_spatial_inertia()
    volume = sum(np.prod(box[1] - box[0]) for box in boxes)
    np.testing.assert_allclose(inertia.get_mass(), 950 * volume, rtol=1e-3)
    assert inertia.IsPhysicallyValid()


def test_an_arm_stands_on_the_table_untouched_and_a_bin_comes_to_rest_on_it() -> None:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.002)
    parser = Parser(plant)
    for name, root in (("arms/panda_hand.urdf", "panda_link0"), ("scenes/table.sdf", "table")):
        parser.AddModels(str(models_dir() / name))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root))
    parser.AddModels(str(models_dir() / "scenes" / "bin_a.sdf"))
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    for name, value in zip((*PANDA_JOINTS, *PANDA_FINGERS), HOMES["panda_hand.urdf"]["ready, open"], strict=True):
        joint = plant.GetJointByName(name)
        plant.SetPositions(context, joint.model_instance(), _with(plant, context, joint, value))
        joint.Lock(context)
    plant.get_actuation_input_port().FixValue(context, np.zeros(plant.num_actuators()))
    body = plant.GetBodyByName("bin")
    plant.SetFreeBodyPose(context, body, RigidTransform([0.55, 0.25, 0.003]))
    assert plant.get_contact_results_output_port().Eval(context).num_point_pair_contacts() == 0
    simulator.AdvanceTo(0.4)
    p_WB = plant.EvalBodyPoseInWorld(context, body).translation()
    np.testing.assert_allclose(p_WB, [0.55, 0.25, 0.0], atol=5e-4)


def _with(plant: MultibodyPlant, context: Context, joint: Any, value: float) -> Array:
    positions = plant.GetPositions(context)
    positions[joint.position_start()] = value
    return np.asarray(plant.GetPositionsFromArray(joint.model_instance(), positions))
