"""The arm as foreseen with what it holds, and the ellipsoids, in a recording that a real browser opens."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from tests.visualization.test_replay_html import BROWSER, Browser
from twin_diagram import scenario
from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.pose_vectors import as_matrix
from twin_diagram.visualization.arm_overlay import MAGNIFIED, ArmOverlay
from twin_diagram.visualization.meshcat import add_meshcat, open_meshcat

HOME = np.array([0.0, 0.1, 0.0, -2.0, 0.0, 2.1, 0.8])
SPEED = 1.2
AHEAD = 0.25
STD_Q, STD_V, STD_THEN = 1e-4, 1e-3, 5e-3
HELD = Hand(0, X_TO=np.array([np.cos(0.3), np.sin(0.3), 0, 0, 0.01, 0.02, 0.05]), covariance=4e-6 * np.eye(6))


def motion(t: float) -> tuple[Array, Array]:
    """At rest for half a second, then the first joint turns; q, v."""
    q, v = HOME.copy(), np.zeros(7)
    if t > 0.5:
        q[0], v[0] = SPEED * (t - 0.5), SPEED
    return q, v


class Moving(LeafSystem):
    """x̂ by `motion`, and what is foreseen of it."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("state", 14, self._calc, {self.time_ticket()})
        self.DeclareVectorOutputPort("then", 7, self._then, {self.time_ticket()})

    @staticmethod
    def _then(context: Context, output: BasicVector) -> None:
        q, v = motion(context.get_time())
        output.SetFromVector(q + AHEAD * v)

    @staticmethod
    def _calc(context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate(motion(context.get_time())))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TwinScene]:
    """One second."""
    builder = DiagramBuilder()
    twin = scenario.Twin(camera=None, home=HOME.tolist(), library={"can": "objects/can"})
    scene = add_twin_scene(builder, twin)
    still = builder.AddSystem(ConstantVectorSource(scene.default_positions))
    builder.Connect(still.get_output_port(), scene.positions_input)
    meshcat = open_meshcat()
    scenes = add_meshcat(builder, meshcat, scene.query_output)
    scenes.set_view((1.4, -0.65, 0.75), (0.4, 0.0, 0.2))
    P = np.zeros((16, 16))  # of two parameters as well
    P[np.arange(14), np.arange(14)] = np.repeat([STD_Q, STD_V], 7) ** 2
    overlay = builder.AddSystem(
        ArmOverlay(meshcat, scene, P.size, rate=10.0)
    )  # drawings fall on frames of the recording
    state = builder.AddSystem(Moving())
    covariance = builder.AddSystem(ConstantVectorSource(P.ravel()))
    builder.Connect(state.GetOutputPort("state"), overlay.GetInputPort("arm_state"))
    builder.Connect(state.GetOutputPort("then"), overlay.GetInputPort("position_previewed"))
    for name, values in (("preview_covariance", STD_THEN**2 * np.eye(7)), ("hand", HELD.pack())):
        source = builder.AddSystem(ConstantVectorSource(values.ravel()))
        builder.Connect(source.get_output_port(), overlay.GetInputPort(name))
    builder.Connect(covariance.get_output_port(), overlay.GetInputPort("covariance"))
    simulator = Simulator(builder.Build())
    scenes.start_recording()
    simulator.Initialize()
    simulator.AdvanceTo(1.0)
    return scenes.write_replay(tmp_path_factory.mktemp("overlay") / "replay.html"), scene


@pytest.fixture(scope="module")
def page(recorded: tuple[Path, TwinScene], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if BROWSER is None:
        pytest.skip("no Chromium or Chrome is installed")
    browser = Browser(BROWSER, tmp_path_factory.mktemp("profile"))
    try:
        browser.call("Page.navigate", url=recorded[0].as_uri())
        browser.wait_for("typeof viewer == 'object' && viewer.animator.duration > 0.9")
        browser.run("viewer.animator.pause()")  # it plays from the start, and would leave the moment that is looked at
        yield browser
    finally:
        browser.close()


def find(*path: str) -> str:
    return f"viewer.scene_tree.find({json.dumps(['drake', 'arm_overlay', *path])}).object"


def pose(page: Browser, *path: str) -> Array:
    """X_W of a node, with its scale; Drake's axes."""
    script = f"(o => {{ o.updateWorldMatrix(true, false); return o.matrixWorld.elements; }})({find(*path)})"
    turned = np.array(page.run(script)).reshape(4, 4).T
    y_up = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    return np.asarray(y_up @ turned)


def kinematics(scene: TwinScene, q: Array, p_T: Array | None = None) -> tuple[Array, Array, Array]:
    """X_WT, the hand's link in W, (4, 4) each, and the Jacobian (3, n) of what is held, by differences."""

    def tool(q: Array) -> tuple[Array, Array]:
        context = scene.plant.CreateDefaultContext()
        positions = scene.default_positions.copy()
        positions[scene.arm_position_index] = q
        scene.plant.SetPositions(context, positions)
        hand = scene.plant.GetBodyByName("panda_hand").EvalPoseInWorld(context).GetAsMatrix4()
        return scene.plant.get_frame(scene.arm.tool_frame).CalcPoseInWorld(context).GetAsMatrix4(), hand

    p_T = np.zeros(3) if p_T is None else p_T

    def point(q: Array) -> Array:
        X_WT = tool(q)[0]
        return np.asarray(X_WT[:3, 3] + X_WT[:3, :3] @ p_T)

    step = 1e-6
    J = [(point(q + step * e) - point(q - step * e)) / (2 * step) for e in np.eye(7)]
    return *tool(q), np.stack(J, axis=1)


@pytest.mark.long
def test_the_ghost_is_where_the_arm_will_be(recorded: tuple[Path, TwinScene], page: Browser) -> None:
    for at in (0.7, 0.9):
        page.run(f"viewer.animator.seek({at})")
        assert page.run(find("ghost") + ".visible") and page.run(find("then") + ".visible")
        q, v = motion(at)
        _, X_WH, _ = kinematics(recorded[1], q + AHEAD * v)
        # At a drawing; between two, the page interpolates.
        np.testing.assert_allclose(pose(page, "ghost", "panda_hand"), X_WH, atol=4e-3)


@pytest.mark.long
def test_what_is_held_goes_with_the_ghost(recorded: tuple[Path, TwinScene], page: Browser) -> None:
    for at in (0.7, 0.9):
        page.run(f"viewer.animator.seek({at})")
        assert page.run(find("held", "can") + ".visible")
        q, v = motion(at)
        X_WT, _, _ = kinematics(recorded[1], q + AHEAD * v)
        np.testing.assert_allclose(pose(page, "held", "can"), X_WT @ as_matrix(HELD.X_TO), atol=4e-3)
    page.run("viewer.animator.seek(0.3)")
    assert not page.run(find("held", "can") + ".visible")


@pytest.mark.long
def test_an_arm_at_rest_has_no_ghost(page: Browser) -> None:
    page.run("viewer.animator.seek(0.3)")
    assert not page.run(find("ghost") + ".visible") and not page.run(find("then") + ".visible")
    assert page.run(find("now") + ".visible")


@pytest.mark.long
def test_the_ellipsoids_are_the_covariance_at_every_time_of_the_recording(
    recorded: tuple[Path, TwinScene], page: Browser
) -> None:
    for at in (0.3, 0.6, 0.9):
        page.run(f"viewer.animator.seek({at})")
        q, v = motion(at)
        for name, ahead, std, own, p_T, scale in (
            ("now", 0.0, STD_Q, 0.0, np.zeros(3), 3.0 * MAGNIFIED),
            ("then", AHEAD, STD_THEN, 2e-3, HELD.X_TO[4:], 1.0),
        ):
            if ahead and at < 0.5:
                continue
            X_WT, _, J = kinematics(recorded[1], q + ahead * v, p_T)
            X = pose(page, name, "sphere", "<object>")
            np.testing.assert_allclose(X[:3, 3], X_WT[:3, 3] + X_WT[:3, :3] @ p_T, atol=4e-3)
            shape = X[:3, :3] @ X[:3, :3].T / scale**2
            expected = std**2 * J @ J.T + own**2 * np.eye(3)
            np.testing.assert_allclose(shape, expected, atol=0.06 * expected.max())


@pytest.mark.long
def test_they_can_be_seen(page: Browser) -> None:
    """Violet that is not there while the arm rests."""

    def violet(at: float) -> float:
        page.run(f"viewer.animator.seek({at})")
        page.run("new Promise(resolve => setTimeout(resolve, 500))")
        image = page.picture()
        return float(((image[..., 2] > image[..., 1] + 25) & (image[..., 0] > image[..., 1] + 8)).mean())

    assert violet(0.9) > violet(0.2) + 0.003
