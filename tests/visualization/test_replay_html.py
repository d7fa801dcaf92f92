"""A recorded run, opened in a real browser: both scenes are there, they move, and nothing is fetched."""

from __future__ import annotations

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram import scenario
from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.layouts import PoseMeasurement
from twin_diagram.station import ports
from twin_diagram.station.sim.station import SimStation
from twin_diagram.visualization.ghost import make_ghost
from twin_diagram.visualization.meshcat import add_meshcat, open_meshcat
from twin_diagram.visualization.scene_overlay import MeshcatOverlay

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
FLAGS = (
    "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --disable-dev-shm-usage --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--window-size=1000,700 --remote-debugging-pipe"
)
LIBRARY = {"cracker_box": "objects/cracker_box", "can": "objects/can", "mug": "objects/mug"}
START = {"cracker_box": [0.6, 0.3, 0.1055], "can": [0.45, -0.1, 0.058], "mug": [0.6, -0.3, 0.0505]}
SEEN_AT = np.array([0.62, 0.31, 0.1055])
"""Where the twin is told that the cracker box is: not quite where it stands, so that the scenes cannot be mixed up."""

SHAPES = """
(function () {
  const shapes = {real: [], twin: []};
  for (const scene of ["real", "twin"]) {
    const visit = function (node, path) {
      for (const [name, child] of Object.entries(node.children)) {
        if (name != "<object>") { visit(child, path.concat(name)); continue; }
        let vertices = 0;
        child.object.traverse(o => { vertices += o.isMesh ? o.geometry.attributes.position.count : 0; });
        if (vertices > 0) shapes[scene].push(path.join("::"));
      }
    };
    visit(viewer.scene_tree.find(["drake", scene]), []);
  }
  return shapes;
})()
"""
"""Names of the shapes that have arrived, by scene, as the page's scene tree holds them: ``body::geometry``."""


class Browser:
    """Headless Chromium, driven by the DevTools protocol over a pair of pipes."""

    def __init__(self, program: str, profile: Path) -> None:
        command_read, self._write = os.pipe()
        self._read, answer_write = os.pipe()
        theirs = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (command_read, answer_write)]
        self._process = subprocess.Popen(
            [program, *FLAGS.split(), f"--user-data-dir={profile}", "about:blank"],
            # The protocol wants file descriptors 3 and 4.
            preexec_fn=lambda: [os.dup2(end, wanted) for end, wanted in zip(theirs, (3, 4), strict=True)],
            pass_fds=(3, 4),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for end in (command_read, answer_write, *theirs):
            os.close(end)
        self._buffer, self._number, self._session = b"", 0, None
        self.requests: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Network.enable")

    def call(self, method: str, timeout: float = 60.0, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + timeout
        while True:
            while b"\0" not in self._buffer:
                if not select.select([self._read], [], [], max(0.0, deadline - time.monotonic()))[0]:
                    raise TimeoutError(method)
                part = os.read(self._read, 1 << 20)
                if not part:
                    raise RuntimeError("the browser went away")
                self._buffer += part
            raw, self._buffer = self._buffer.split(b"\0", 1)
            answer = json.loads(raw)
            if answer.get("method") == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"])
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def run(self, script: str) -> Any:
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description"))
        return answer["result"].get("value")

    def wait_for(self, script: str, timeout: float = 60.0) -> None:
        deadline = time.monotonic() + timeout
        while not self.run(script):
            if time.monotonic() > deadline:
                raise TimeoutError(script)
            time.sleep(0.2)

    def picture(self) -> np.ndarray:
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=float)

    def close(self) -> None:
        self._session = None
        try:
            self.call("Browser.close", timeout=5)
            self._process.wait(10)
        except (RuntimeError, TimeoutError, OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._write)
        os.close(self._read)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimStation, TwinScene, dict[str, Any]]:
    """A second of a simulated station, and the twin as it would be with a camera that errs by centimetres."""
    plan = scenario.Scenario()
    plan.twin = scenario.Twin(camera=None, fixtures=[scenario.Fixture()], library=LIBRARY)
    plan.twin.home = [0.3, 0.1, 0.0, -2.0, 0.0, 2.1, 0.8]
    plan.world.fixtures = [scenario.Fixture()]
    plan.world.objects = {
        name: scenario.WorldObject(asset=LIBRARY[name], X_WO=scenario.Pose(translation=p)) for name, p in START.items()
    }
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", SimStation(plan))
    scene = add_twin_scene(builder, plan.twin)
    updater = builder.AddSystem(SceneGraphUpdater(scene, plan.twin.scene))
    measured = [
        PoseMeasurement(
            1.0, 0.0, np.r_[1, 0, 0, 0, SEEN_AT if name == "cracker_box" else START[name]], 1e-6 * np.eye(6)
        )
        for name in LIBRARY
    ]
    measured[2] = PoseMeasurement(0.0, 0.0, measured[2].pose, measured[2].covariance)
    poses = builder.AddSystem(ConstantVectorSource(np.concatenate([m.pack() for m in measured])))
    image_time = builder.AddSystem(ConstantVectorSource([0.0]))
    builder.Connect(poses.get_output_port(), updater.GetInputPort("object_poses"))
    builder.Connect(image_time.get_output_port(), updater.GetInputPort("image_time"))
    builder.Connect(station.GetOutputPort(ports.ARM_STATE), updater.GetInputPort("arm_state"))
    builder.Connect(updater.GetOutputPort("positions"), scene.positions_input)
    make_ghost(scene)
    meshcat = open_meshcat()
    scenes = add_meshcat(builder, meshcat, scene.query_output, station.GetOutputPort(ports.QUERY_OBJECT))
    scenes.set_view((1.4, -0.65, 0.75), (0.4, 0.0, 0.2))
    overlay = builder.AddSystem(MeshcatOverlay(meshcat, scene, 4))
    plan_source = builder.AddSystem(ConstantVectorSource(np.tile(plan.twin.home, 4)))
    goal = builder.AddSystem(ConstantVectorSource([0, 1, 0, 0, 0.5, -0.25, 0.16]))
    builder.Connect(updater.GetOutputPort("tracks"), overlay.GetInputPort("tracks"))
    builder.Connect(plan_source.get_output_port(), overlay.GetInputPort("plan"))
    builder.Connect(goal.get_output_port(), overlay.GetInputPort("goal"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    scenes.start_recording()
    simulator.Initialize()
    simulator.AdvanceTo(1.0)
    path = scenes.write_replay(tmp_path_factory.mktemp("replay") / "out" / "replay.html")
    expected = {}
    for name, port in (("real", station.GetOutputPort(ports.QUERY_OBJECT)), ("twin", scene.query_output)):
        query = port.Eval(port.get_system().GetMyContextFromRoot(simulator.get_context()))
        inspector = query.inspector()
        expected[name] = {
            inspector.GetName(frame): (count, query.GetPoseInWorld(frame))
            for frame in inspector.GetAllFrameIds()
            if (count := inspector.NumGeometriesForFrameWithRole(frame, Role.kIllustration)) > 0
        }
    return path, station, scene, expected


@pytest.fixture(scope="module")
def page(recorded, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if BROWSER is None:
        pytest.skip("no Chromium or Chrome is installed")
    browser = Browser(BROWSER, tmp_path_factory.mktemp("profile"))
    try:
        browser.call("Page.navigate", url=recorded[0].as_uri())
        browser.wait_for("typeof viewer == 'object' && viewer.animator.duration > 0.9")
        # Meshes load late.
        shapes = sum(count for bodies in recorded[3].values() for count, _ in bodies.values())
        browser.wait_for(f"(s => s.real.length + s.twin.length >= {shapes})({SHAPES})")
        yield browser
    finally:
        browser.close()


def test_the_page_is_one_file_of_reasonable_size(recorded) -> None:
    path = recorded[0]
    assert [file.name for file in path.parent.iterdir()] == ["replay.html"]
    assert 0.5e6 < path.stat().st_size < 20e6


def test_the_page_holds_every_body_of_both_scenes(recorded, page: Browser) -> None:
    real, twin = recorded[3]["real"], recorded[3]["twin"]
    shapes = page.run(SHAPES)
    bodies = {}
    for scene, expected in recorded[3].items():
        owners = [[name for name in expected if shape.startswith(f"{name}::")] for shape in shapes[scene]]
        assert all(len(names) == 1 for names in owners), "a shape of no body"
        bodies[scene] = Counter(names[0] for names in owners)
        assert bodies[scene] == {name: count for name, (count, _) in expected.items()}
    # Arm and hand (11 links with a shape), three objects; the table is real only.
    assert len([name for name in real if name.endswith("::object")]) == 3
    assert len([name for name in twin if name.endswith("::object")]) == 3
    assert len(bodies["real"]) == len(bodies["twin"]) + 1 >= 14


def test_the_recording_ends_where_the_run_ended(recorded, page: Browser) -> None:
    page.run("viewer.animator.seek(viewer.animator.duration)")
    for scene in ("real", "twin"):
        for name, (_, X_WB) in recorded[3][scene].items():
            path = json.dumps(["drake", scene, *name.split("::")])
            matrix = page.run(
                f"(function () {{ const o = viewer.scene_tree.find({path}).object; o.updateWorldMatrix(true, false); "
                "return o.matrixWorld.elements; })()"
            )
            # three.js has y up in its world; meshcat turns Drake's z onto it.
            X_page = np.array(matrix).reshape(4, 4).T
            Y_up = RigidTransform(Quaternion([np.sqrt(0.5), -np.sqrt(0.5), 0, 0]), [0, 0, 0]).GetAsMatrix4()
            np.testing.assert_allclose(X_page, Y_up @ X_WB.GetAsMatrix4(), atol=3e-3, err_msg=f"{scene} {name}")
    twin_box = recorded[3]["twin"]["cracker_box::object"][1].translation()
    np.testing.assert_allclose(twin_box, SEEN_AT, atol=1e-6)
    assert recorded[3]["twin"]["mug::object"][1].translation()[2] < -1  # never seen, so out of sight


def test_the_ghosts_are_translucent_and_the_real_scene_is_not(page: Browser) -> None:
    opacities = json.loads(
        page.run(
            """JSON.stringify(["real", "twin"].map(function (scene) {
              const seen = new Set();
              const root = viewer.scene_tree.find(["drake", scene]).object;
              root.traverse(o => { if (o.isMesh) seen.add(o.material.opacity); });
              return Array.from(seen);
            }))"""
        )
    )
    assert opacities[0] == [1]
    assert max(opacities[1]) < 0.6


def test_goal_plan_and_uncertainty_are_drawn(page: Browser) -> None:
    page.run("viewer.animator.seek(viewer.animator.duration)")  # at its beginning there is neither goal nor plan
    visible = "viewer.scene_tree.find(['drake', 'overlay', {}]).object.visible"
    assert page.run(visible.format("'goal'")) and page.run(visible.format("'plan'"))
    shown = page.run(
        "['tracked', 'moving', 'stale', 'lost'].filter(s => "
        "viewer.scene_tree.find(['drake', 'overlay', 'uncertainty', 'can', s]).object.visible)"
    )
    # One image at time 0 and none since: stale after half a second.
    assert shown == ["stale"]


@pytest.mark.long
def test_something_is_on_the_screen(page: Browser) -> None:
    page.run("new Promise(resolve => setTimeout(resolve, 500))")
    image = page.picture()
    brown = (image[..., 0] > image[..., 2] + 40) & (image[..., 0] > 80)  # the table
    blue = (image[..., 2] > image[..., 0] + 30) & (image[..., 2] > 60)  # the ghosts
    assert brown.mean() > 0.05
    assert blue.mean() > 0.0005


def test_nothing_is_fetched(page: Browser) -> None:
    page.run("1")
    assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []
