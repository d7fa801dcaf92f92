"""The twin's camera as a sensor of the arm: known surfaces, a rendered arm, and the way to the filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Shape, Sphere
from pydrake.systems.analysis import Simulator
from scipy.spatial import ConvexHull

from tests.small_loop import small_scenario
from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.sensors import CloudError
from twin_diagram.scenario import ArmModel, Pose, SensorSpec
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.rotations import difference
from twin_diagram.station import ports
from twin_diagram.twin.arm_sensing.depth_pose import TUNING as DEPTH_POSE
from twin_diagram.twin.arm_sensing.depth_pose import ArmCloud
from twin_diagram.twin.arm_sensing.link_surface import inside, link_surface, shape_surface
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.twin import make_twin

CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (0.0, 0.2)])
SHAPES: dict[str, tuple[Shape, Array | None, float]] = {
    "box": (Box(0.2, 0.1, 0.3), None, 2.0 * (0.02 + 0.06 + 0.03)),
    "cylinder": (Cylinder(0.05, 0.2), None, 2.0 * np.pi * 0.05 * 0.25),
    "capsule": (Capsule(0.05, 0.2), None, 2.0 * np.pi * 0.05 * 0.3),
    "sphere": (Sphere(0.1), None, 4.0 * np.pi * 0.01),
    "ellipsoid": (Ellipsoid(0.1, 0.05, 0.07), None, np.nan),
    "hull": (Convex(points=CORNERS.T, label="block"), CORNERS, 2.0 * (0.02 + 0.04 + 0.02)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_points_lie_on_the_surface_and_normals_point_outwards(name: str) -> None:
    shape, corners, area = SHAPES[name]
    points, normals = shape_surface(shape, corners, 0.005, np.random.default_rng(1001))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert not inside(points, shape, corners).any()
    step = 2e-4
    assert inside(points - step * normals, shape, corners).mean() > 0.99  # but for rims
    assert not inside(points + step * normals, shape, corners).any()
    if np.isfinite(area):
        assert len(points) == pytest.approx(area / 0.005**2, rel=0.02)
        # Every side has its share: the middle of the points is that of the surface.
        middle = np.zeros(3) if corners is None else corners.mean(axis=0)
        np.testing.assert_allclose(points.mean(axis=0), middle, atol=0.005)


def test_a_links_surface_is_that_of_all_that_is_welded_to_it() -> None:
    arm = ArmModel()
    points, normals = link_surface(arm, "panda_link7")
    assert points.shape == normals.shape and len(points) > 1000
    hull = ConvexHull(points)
    assert hull.volume > 1e-4
    same, _ = link_surface(arm, "panda_hand")
    assert len(same) == len(points), "the hand is welded to the last link"
    assert np.array_equal(points, link_surface(arm, "panda_link7")[0]), "the same each time"
    with pytest.raises(ModelError, match="no link 'elbow'"):
        link_surface(arm, "elbow")


# Seen by the simulated camera.


@pytest.fixture(scope="module")
def seen(egl: None) -> tuple[ClosedLoop, Simulator]:
    scenario = small_scenario("seed=1004", "twin.filter.sensors=[{kind: depth}]")
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.9)
    return loop, simulator


def cloud_of(loop: ClosedLoop) -> ArmCloud:
    system: Any = loop.twin.diagram.GetSubsystemByName("depth_cloud")
    return system


def true_pose(loop: ClosedLoop, q: Array) -> Array:
    sensor = LinkFrame(ArmTerms.from_model(loop.model), loop.model.last_link)
    from pydrake.math import RotationMatrix

    R, p = sensor.pose(q)
    return np.concatenate([RotationMatrix(R).ToQuaternion().wxyz(), p])


def image_and_truth(loop: ClosedLoop, simulator: Simulator) -> tuple[Array, Array]:
    """A depth image, and the joint angles (n,) then; the arm moves slowly enough for one of each now."""
    context = loop.station.GetMyContextFromRoot(simulator.get_context())
    camera = loop.scenario.twin.camera
    assert camera is not None
    depth = loop.station.GetOutputPort(ports.depth_image(camera.name)).Eval(context).data[..., 0]
    state = np.array(loop.station.GetOutputPort(ports.ARM_STATE).Eval(context))
    late = simulator.get_context().get_time() - loop.station.GetOutputPort(ports.image_time(camera.name)).Eval(context)
    n = len(loop.model.joints)
    return depth, state[:n] - late * state[n:]


@pytest.mark.long
def test_the_hand_is_found_to_a_millimetre_or_two(seen: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = seen
    depth, q = image_and_truth(loop, simulator)
    truth = true_pose(loop, q)
    offset = 0.003 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    for start in (q, q + offset):
        z, R = cloud_of(loop).align(depth, start)
        assert np.linalg.norm(z[4:] - truth[4:]) < 0.0025
        assert np.linalg.norm(difference(z[:4], truth[:4])) < 0.02
        assert np.linalg.eigvalsh(R).min() >= 0.99 * min(DEPTH_POSE.floor) ** 2


@pytest.mark.long
def test_an_arm_out_of_sight_has_no_pose(seen: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = seen
    depth, q = image_and_truth(loop, simulator)
    with pytest.raises(CloudError):
        cloud_of(loop).align(np.zeros_like(depth), q)
    with pytest.raises(CloudError):
        cloud_of(loop).align(depth, q + np.array([np.pi, 0, 0, 0, 0, 0, 0]))


def test_the_filter_takes_each_image_once(seen: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = seen
    ekf = loop.twin.ekf
    track = ekf.belief(ekf.GetMyContextFromRoot(simulator.get_context())).tracks[0]
    # 15 images a second, some 35 ms late; the first comes before the filter has begun.
    assert 10 <= track[SensorTrack.ACCEPTED] <= 14 and track[SensorTrack.REFUSED] == 0
    assert track[SensorTrack.LATE] == track[SensorTrack.ACCEPTED] and track[SensorTrack.INVALID] <= 1
    assert 0.05 < track[SensorTrack.NIS_MEAN] < 2.5


def test_a_lens_that_is_covered_is_a_sensor_that_is_silent(egl: None) -> None:
    scenario = small_scenario("seed=1004", "twin.filter.sensors=[{kind: depth}]", objects=("can",))
    scenario.world.camera_defects.covered = [[0.0, 1.0]]
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.3)
    belief = loop.twin.ekf.belief(loop.twin.ekf.GetMyContextFromRoot(simulator.get_context()))
    assert belief.valid and belief.tracks[0][SensorTrack.ACCEPTED] == 0 and belief.tracks[0][SensorTrack.INVALID] >= 3


# Refused.


def test_without_a_camera_there_is_nothing_to_see_with() -> None:
    scenario = small_scenario("twin.camera=null", "twin.filter.sensors=[{kind: depth}]")
    with pytest.raises(ScenarioError, match="nothing to see the arm with"):
        make_twin(scenario.twin)


WRONG = {
    "is fused already": [SensorSpec("depth"), SensorSpec("depth", name="again")],
    "not two positive numbers": [SensorSpec("depth", std=[0.001])],
    "no link or frame 'elbow'": [SensorSpec("depth", body="elbow")],
}


@pytest.mark.parametrize("message", WRONG)
def test_what_cannot_be_is_refused_by_its_field(message: str) -> None:
    scenario = small_scenario()
    scenario.twin.filter.sensors = WRONG[message]
    with pytest.raises(ScenarioError, match=message) as caught:
        make_twin(scenario.twin)
    assert "twin.filter" in str(caught.value)


def test_two_links_may_be_watched() -> None:
    scenario = small_scenario()
    scenario.twin.filter.sensors = [
        SensorSpec("depth", name="hand", X_BS=Pose([0.0, 0.0, 0.1])),
        SensorSpec("depth", name="forearm", body="panda_link5"),
    ]
    twin = make_twin(scenario.twin)
    assert [sensor.spec.name for sensor in twin.fused] == ["hand", "forearm"]
    assert all(twin.diagram.HasSubsystemNamed(f"{name}_cloud") for name in ("hand", "forearm"))
