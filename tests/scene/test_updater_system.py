"""The updater between images: when it looks, what it takes for new, and what it tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from twin_diagram import scenario
from twin_diagram.scene import object_filter, object_life, object_update
from twin_diagram.scene.object_filter import FilterLayout
from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene, parked_poses
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import NEVER, TRACK_SIZE, ObjectStatus, PoseMeasurement, Track

COVARIANCE = np.diag([1e-4] * 3 + [1e-6] * 3)
AT = np.array([[1.0, 0, 0, 0, 0.5, -0.1, 0.1], [1.0, 0, 0, 0, 0.4, 0.2, 0.1]])
PARAMS = scenario.SceneUpdater(rate=50.0)
SETTINGS = object_filter.FilterSettings.of(PARAMS)


@pytest.fixture(scope="module")
def made() -> tuple[TwinScene, SceneGraphUpdater]:
    twin = scenario.Twin(library={"box": "objects/gelatin_box", "can": "objects/can"}, home=[0.1 * k for k in range(7)])
    scene = add_twin_scene(DiagramBuilder(), twin)
    return scene, SceneGraphUpdater(scene, PARAMS)


class Run:
    """The updater alone, its inputs set by hand."""

    def __init__(self, updater: SceneGraphUpdater) -> None:
        self.updater = updater
        self.context: Context = updater.CreateDefaultContext()
        self.simulator = Simulator(updater, self.context)
        updater.GetInputPort("arm_state").FixValue(self.context, np.zeros(14))

    def show(self, time: float, poses: Array, qualities: tuple[float, float] = (1.0, 1.0)) -> None:
        """Set an image's measurements, which stay until the next."""
        rows = [PoseMeasurement(q, time, pose, COVARIANCE).pack() for q, pose in zip(qualities, poses, strict=True)]
        self.updater.GetInputPort("object_poses").FixValue(self.context, np.concatenate(rows))
        self.updater.GetInputPort("image_time").FixValue(self.context, [time])

    def to(self, time: float) -> list[Track]:
        self.simulator.AdvanceTo(time)
        vector = self.updater.GetOutputPort("tracks").Eval(self.context)
        return [Track.unpack(row) for row in vector.reshape(-1, TRACK_SIZE)]

    @property
    def filters(self) -> Array:
        state = np.array(self.context.get_discrete_state(0).value())
        return state.reshape(-1, object_filter.FILTER_SIZE)[:2]


@pytest.fixture
def run(made: tuple[TwinScene, SceneGraphUpdater]) -> Run:
    return Run(made[1])


def shifted(pose: Array, *perturbation: float) -> Array:
    return object_update.moved(pose, np.array(perturbation))


def test_it_looks_at_the_scenarios_rate(made: tuple[TwinScene, SceneGraphUpdater]) -> None:
    timing = made[1].GetUniquePeriodicDiscreteUpdateAttribute()
    assert timing is not None and timing.period_sec() == pytest.approx(0.02) and timing.offset_sec() == 0.0


def test_it_takes_in_each_image_once_and_tells_what_the_filters_say(run: Run) -> None:
    expected = object_filter.initial_filters(2)
    for k in range(6):
        poses = np.array([shifted(pose, 0, 0, 0, 1e-4 * k, 0, 0) for pose in AT])
        run.show(0.1 * k, poses)
        tracks = run.to(0.1 * k + 0.07)
        for row in range(2):
            image = PoseMeasurement(1.0, 0.1 * k, poses[row], COVARIANCE)
            expected[row] = object_update.update(expected[row], image, 0.1 * k + 0.02, SETTINGS, row == 1)
        np.testing.assert_array_equal(run.filters, expected)
    now = run.context.get_time()
    belief = object_filter.propagate(expected, now, SETTINGS)
    covariances = object_filter.pose_covariances(belief, np.array([[0, 0, 0], [0, 0, 1.0]]), SETTINGS)
    for row, track in enumerate(tracks):
        assert track.status == ObjectStatus.TRACKED and track.last_seen == pytest.approx(0.5)
        np.testing.assert_array_equal(track.pose, belief.poses[row])
        np.testing.assert_array_equal(track.velocity, belief.velocities[row])
        np.testing.assert_array_equal(track.covariance, covariances[row])


@pytest.mark.filterwarnings("error")  # taken twice, it would move in no time at all
def test_an_outlier_that_stays_on_the_wire_counts_once(run: Run) -> None:
    run.show(0.0, AT)
    run.to(0.05)
    away = np.array([shifted(AT[0], 0, 0, 0, 0.05, 0, 0), AT[1]])
    run.show(0.06, away)
    for time in (0.09, 0.2, 0.4):
        tracks = run.to(time)
        assert run.filters[0, FilterLayout.REJECTED] == 1.0
        assert tracks[0].status == ObjectStatus.TRACKED
        np.testing.assert_allclose(tracks[0].pose, AT[0], atol=1e-9)
        assert (tracks[0].last_seen, tracks[1].last_seen) == (0.0, 0.06)


def test_what_an_image_does_not_show_is_not_used(run: Run) -> None:
    run.show(0.0, AT, (1.0, 0.0))
    first, second = run.to(0.05)
    assert (first.status, second.status) == (ObjectStatus.TRACKED, ObjectStatus.UNSEEN)
    assert second.last_seen == NEVER
    np.testing.assert_array_equal(second.pose, parked_poses(2)[1])
    np.testing.assert_allclose(first.pose, AT[0])
    run.show(0.1, AT, (0.0, 1e-6))
    first, second = run.to(0.15)
    assert (first.last_seen, second.last_seen) == (0.0, 0.1)


def test_a_can_may_turn_about_its_axis_and_a_box_may_not(run: Run) -> None:
    run.show(0.0, AT)
    run.to(0.05)
    run.show(0.1, np.array([shifted(pose, 0, 0, 1.0, 0, 0, 0) for pose in AT]))
    box, can = run.to(0.15)
    assert (box.last_seen, can.last_seen) == (0.0, 0.1)
    np.testing.assert_allclose(can.pose, AT[1], atol=1e-9)


def test_positions_hold_the_poses_and_the_home(made: tuple[TwinScene, SceneGraphUpdater], run: Run) -> None:
    scene = made[0]
    np.testing.assert_allclose(scene.default_positions[scene.arm_position_index], 0.1 * np.arange(7))
    np.testing.assert_array_equal(scene.default_positions[scene.object_position_index], parked_poses(2))
    np.testing.assert_array_equal([kind.axis for kind in scene.kinds], [[0, 0, 0], [0, 0, 1.0]])
    run.show(0.0, AT, (1.0, 0.0))
    run.updater.GetInputPort("arm_state").FixValue(run.context, np.arange(14.0))
    tracks = run.to(0.05)
    positions = run.updater.GetOutputPort("positions").Eval(run.context)
    np.testing.assert_array_equal(positions[scene.arm_position_index], np.arange(7.0))
    np.testing.assert_array_equal(positions[scene.object_position_index], [track.pose for track in tracks])


def test_a_state_is_used_whole_or_not_at_all(made: tuple[TwinScene, SceneGraphUpdater], run: Run) -> None:
    scene, fingers = made[0], np.array([0.01, 0.02, 5.0, 6.0])
    run.show(0.0, AT)
    for bad in range(-1, 4):
        arm, gripper = np.arange(14.0), fingers.copy()
        if bad >= 0:
            arm[3 * bad] = gripper[bad] = np.nan
        run.updater.GetInputPort("arm_state").FixValue(run.context, arm)
        run.updater.GetInputPort("gripper_state").FixValue(run.context, gripper)
        positions = run.updater.GetOutputPort("positions").Eval(run.context)
        joints, hand = scene.arm_position_index, scene.gripper_position_index
        expected = scene.default_positions if bad >= 0 else None
        np.testing.assert_array_equal(positions[joints], np.arange(7.0) if expected is None else expected[joints])
        np.testing.assert_array_equal(positions[hand], fingers[:2] if expected is None else expected[hand])


def test_what_the_calibration_leaves_open_is_in_all_tracks_and_no_image_removes_it(
    made: tuple[TwinScene, SceneGraphUpdater],
) -> None:
    camera = scenario.Camera(X_WC=scenario.Pose([1.4, 0.0, 0.85], [-2.27, 0.0, 1.57]), X_WC_std=[0.006, 0.0])
    doubtful = Run(SceneGraphUpdater(made[0], PARAMS, camera))
    sure = Run(SceneGraphUpdater(made[0], PARAMS, replace(camera, X_WC_std=[0.0, 0.0])))
    plain = Run(made[1])
    for run in (doubtful, sure, plain):
        for k in range(30):
            run.show(0.1 * k, AT)
            tracks = run.to(0.1 * k + 0.07)
        run.last = [track.covariance for track in tracks]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(sure.last, plain.last)  # type: ignore[attr-defined]
    added = np.array(doubtful.last) - np.array(plain.last)  # type: ignore[attr-defined]
    np.testing.assert_allclose(added, np.tile(np.diag([0.0] * 3 + [12e-6] * 3), (2, 1, 1)), atol=1e-12)
    camera.X_WC_std = [0.0, 0.01]
    turned = Run(SceneGraphUpdater(made[0], PARAMS, camera))
    turned.show(0.0, AT)
    plain = Run(made[1])
    plain.show(0.0, AT)
    for track, without, pose in zip(turned.to(0.07), plain.to(0.07), AT, strict=True):
        away = np.linalg.norm(pose[4:] - [1.4, 0.0, 0.85])
        added = track.covariance - without.covariance
        assert np.trace(added[3:, 3:]) == pytest.approx(2.0 * away**2 * 1e-4 / 3.0, rel=1e-6)
        np.testing.assert_allclose(added[:3, :3], np.eye(3) * 1e-4 / 3.0, atol=1e-9)


# The hand.


def with_hand(run: Run, hand: Hand) -> None:
    run.updater.GetInputPort("hand").FixValue(run.context, hand.pack())


def tool_pose(run: Run) -> Array:
    tool = run.updater._tool(run.context)
    assert tool is not None
    return tool.pose


X_TO = np.array([0.0, 1.0, 0.0, 0.0, 0.01, -0.02, 0.03])


def test_what_the_hand_holds_is_held_whatever_images_show(run: Run) -> None:
    """From the next tick on it goes along with the tool, though images show its place, or that empty."""
    with_hand(run, Hand())
    run.show(0.0, AT)
    assert run.to(0.05)[1].status == ObjectStatus.TRACKED
    with_hand(run, Hand(held=1, X_TO=X_TO))
    for k in range(1, 8):
        run.show(0.1 * k, AT, (1.0, -1.0))
        run.updater.GetInputPort("arm_state").FixValue(run.context, np.r_[0.1 * k * np.ones(7), np.zeros(7)])
        tracks = run.to(0.1 * k + 0.05)
        assert tracks[1].status == ObjectStatus.HELD and tracks[0].status == ObjectStatus.TRACKED
        np.testing.assert_allclose(tracks[1].pose, object_life.with_tool(X_TO, tool_pose(run)), atol=1e-12)


def test_what_is_let_go_rests_where_the_hand_left_it(run: Run) -> None:
    with_hand(run, Hand())
    run.show(0.0, AT)
    run.to(0.05)
    covariance = np.diag([1e-4, 2e-4, 3e-4, 1e-6, 4e-6, 9e-6])
    with_hand(run, Hand(held=1, X_TO=X_TO, covariance=covariance))
    run.to(0.2)
    with_hand(run, Hand(touched=1))
    track = run.to(0.3)[1]
    assert track.status == ObjectStatus.TRACKED
    np.testing.assert_allclose(track.pose, object_life.with_tool(X_TO, tool_pose(run)), atol=1e-9)
    R = object_update.rotations.matrix(tool_pose(run)[:4])
    told = run.filters[1][FilterLayout.COVARIANCE].reshape(12, 12)[3:6, 3:6]
    np.testing.assert_allclose(told, R @ np.diag([1e-6, 4e-6, 9e-6]) @ R.T, atol=1e-9)


def test_what_is_lost_is_where_images_show_it(run: Run) -> None:
    with_hand(run, Hand())
    run.show(0.0, AT)
    run.to(0.05)
    with_hand(run, Hand(held=1, X_TO=X_TO))
    run.to(0.2)
    with_hand(run, Hand())
    track = run.to(0.3)[1]
    assert track.status == ObjectStatus.TRACKED
    np.testing.assert_allclose(track.pose, AT[1], atol=1e-9)


def test_beside_a_hand_that_tells_nothing_is_guessed_to_be_held(run: Run) -> None:
    """An object that moves as the tool moves is taken for held only where nobody says what the hand holds."""
    for told, status in ((True, ObjectStatus.MOVING), (False, ObjectStatus.HELD)):
        alone = Run(run.updater)
        if told:
            with_hand(alone, Hand())
        bent = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 2.0, 0.7])
        for k in range(12):
            q = bent + np.r_[0.05 * k, np.zeros(6)]  # half a radian a second, ten images a second
            alone.updater.GetInputPort("arm_state").FixValue(alone.context, np.r_[q, 0.5, np.zeros(6)])
            there = np.array([1.0, 0, 0, 0, *(tool_pose(alone)[4:] + [0.0, 0.0, -0.03])])
            alone.show(0.1 * k, np.array([AT[0], there]))
            track = alone.to(0.1 * k + 0.05)[1]
        assert track.status == status
