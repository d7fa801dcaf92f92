"""A serial arm with a rail: kinematics against the plant, slopes against differences, a payload against its energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.ball_cover import _link_poses, arm_plant
from twin_diagram.planning.collision.chain import Chain, depths, drawn_range, point_jacobian
from twin_diagram.planning.mpc.payload_gravity import gravity_regressor
from twin_diagram.scenario import ArmModel, Pose
from twin_diagram.signals.arrays import Array

ARM = """<robot name="arm"><link name="base"/>{links}
  <joint name="turn" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0.1 0.2" rpy="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
  <joint name="rail" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.1 0 0.3" rpy="0.4 0.2 -0.3"/>
    <axis xyz="0.6 0 0.8"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
  <joint name="bend" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0 0.1 0.2" rpy="0 -0.5 0.7"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
  <joint name="tip" type="fixed"><parent link="c"/><child link="tool"/>
    <origin xyz="0.1 -0.05 0.2" rpy="0.3 0 1"/></joint>
</robot>"""
LINK = '<link name="{}"><inertial><mass value="1"/>'
LINK += '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> tuple[MultibodyPlant, Chain, list[str]]:
    path = Path(tmp_path_factory.mktemp("arm")) / "arm.urdf"
    path.write_text(ARM.format(links="".join(LINK.format(name) for name in ("a", "b", "c", "tool"))))
    plant = MultibodyPlant(0.0)
    pose = Pose([0.1, -0.2, 0.3], [0.2, 0.1, 0.5])
    arm = add_arm(plant, ArmModel(model=str(path), tool_frame="tool", X_WB=pose, joints=["turn", "rail", "bend"]))
    plant.Finalize()
    return plant, Chain.from_plant(plant, arm.joint_indices, arm.tool_frame), ["a", "b", "c"]


Q = np.random.default_rng(0).uniform(-0.9, 0.9, (6, 3))


def test_places_are_the_plants(loaded: tuple[MultibodyPlant, Chain, list[str]]) -> None:
    plant, chain, links = loaded
    context = plant.CreateDefaultContext()
    placement = chain.place(Q)
    np.testing.assert_array_equal(chain.prismatic, [False, True, False])
    for row, q in enumerate(Q):
        plant.SetPositions(context, q)
        np.testing.assert_array_equal(placement.X_WL[row, 0], np.eye(4))
        for k, link in enumerate(links):
            X = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(link)).GetAsMatrix4()
            np.testing.assert_allclose(placement.X_WL[row, k + 1], X, atol=1e-12)
        X = plant.GetFrameByName("tool").CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(chain.tool(placement)[row], X, atol=1e-12)


def test_joints_outside_the_arm_stand_as_described(tmp_path: Path) -> None:
    """A tool behind a joint that is not the arm's, which starts at 0.7 rad, was 0.7 rad off; so were balls about it."""
    (tmp_path / "arm.urdf").write_text(ARM.format(links="".join(LINK.format(name) for name in ("a", "b", "c", "tool"))))
    (tmp_path / "arm.dmd.yaml").write_text(
        f"directives: [{{add_model: {{name: arm, file: 'file://{tmp_path}/arm.urdf', "
        "default_joint_positions: {bend: [0.7]}}}]"
    )
    spec = ArmModel(model=str(tmp_path / "arm.dmd.yaml"), tool_frame="tool", joints=["turn", "rail"])
    model = Model.load(spec)
    plant, _, arm, _ = arm_plant(spec)
    chain = Chain.from_plant(plant, arm.joint_indices, arm.tool_frame)
    for q in Q[:, :2]:
        expected = model.tool_pose(q).GetAsMatrix4()
        np.testing.assert_allclose(chain.tool(chain.place(q[None]))[0], expected, atol=1e-12)
    X_LB = _link_poses(plant, arm, depths(plant, arm.joint_indices))(plant.GetBodyByName("tool"))
    assert len(X_LB) == 1
    np.testing.assert_allclose(X_LB[0], chain.X_LT, atol=1e-12)


def test_points_move_with_the_joints_that_carry_them(loaded: tuple[MultibodyPlant, Chain, list[str]]) -> None:
    plant, chain, _ = loaded
    rng = np.random.default_rng(1)
    link, row = np.array([0, 1, 2, 3, 3, 2]), np.array([5, 4, 3, 2, 1, 1])
    p_L = rng.standard_normal((6, 3))

    def where(q: Array) -> Array:
        X = chain.place(q).X_WL[row, link]
        return np.asarray(np.einsum("mij,mj->mi", X[:, :3, :3], p_L) + X[:, :3, 3])

    found = point_jacobian(chain.place(Q), where(Q), link, row, chain.prismatic)
    h = 1e-6
    for joint in range(3):
        step = h * np.eye(3)[joint]
        np.testing.assert_allclose(found[:, joint], (where(Q + step) - where(Q - step)) / (2 * h), atol=1e-8)
    assert (found[0] == 0.0).all() and (found[1, 1:] == 0.0).all()
    tool, v = chain.tool_jacobian(chain.place(Q)), rng.standard_normal(3)
    after, before = (chain.tool(chain.place(Q + sign * h * v)) for sign in (1, -1))
    np.testing.assert_allclose(tool[:, 3:] @ v, (after - before)[:, :3, 3] / (2 * h), atol=1e-8)
    turn = (after - before)[:, :3, :3] / (2 * h) @ chain.tool(chain.place(Q))[:, :3, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(
        tool[:, :3] @ v, np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1), atol=1e-8
    )
    assert depths(plant, [plant.GetJointByName(name).index() for name in ("turn", "rail", "bend")]).tolist()[-4:] == [
        1,
        2,
        3,
        3,
    ]


def test_a_payloads_torque_is_the_slope_of_its_energy(loaded: tuple[MultibodyPlant, Chain, list[str]]) -> None:
    """Where a joint slides, too."""
    _, chain, _ = loaded
    mass, centre = 1.7, np.array([0.1, -0.2, 0.3])

    def energy(q: Array) -> float:
        X = chain.place(q[None]).X_WL[0, -1]
        return float(-mass * chain.gravity_W @ (X[:3, :3] @ centre + X[:3, 3]))

    for q in Q:
        expected = [(energy(q + 1e-6 * e) - energy(q - 1e-6 * e)) / 2e-6 for e in np.eye(3)]
        found = gravity_regressor(chain, q) @ np.append(mass, mass * centre)
        np.testing.assert_allclose(found, expected, atol=1e-7)
        assert np.abs(found[1]) > 1.0


def test_configurations_are_drawn_within_half_a_turn_or_about_the_least_that_the_limits_have() -> None:
    inf = np.inf
    lower = np.array([-1.0, -6.3, -inf, 3.5, -9.0, 5.0, -inf])
    upper = np.array([2.0, 6.3, inf, 6.0, -4.0, 20.0, -5.0])
    low, high = drawn_range(lower, upper)
    np.testing.assert_allclose(low, [-1.0, -np.pi, -np.pi, 3.5, -4.0 - np.pi, 5.0, -5.0 - np.pi])
    np.testing.assert_allclose(high, [2.0, np.pi, np.pi, 6.0, -4.0, 5.0 + np.pi, -5.0])
    np.random.default_rng(0).uniform(low, high)
