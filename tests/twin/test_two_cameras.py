"""Two cameras of one twin: what one cannot see the other does, each may fail, and a run repeats to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.small_loop import same, small_scenario, watch
from twin_diagram import load_scenario
from twin_diagram.errors import ScenarioError, TwinError
from twin_diagram.perception.segmentation.segmentation_system import PerceptionSystem
from twin_diagram.scenario import Camera, Pose, Scenario, WorldCamera
from twin_diagram.scenario.defects import CameraDefects
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.things import things_of
from twin_diagram.station.make_station import make_station
from twin_diagram.station.sim.station import SimStation
from twin_diagram.station.sim.world_renderer import WorldRenderer
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.twin import make_twin

OBJECTS = ("can", "cracker_box")
HIDDEN = [0.45, 0.0, 0.051]
"""Where the can stands: behind the box, as the first camera looks."""
STILL = ("twin.task.X_WG=null", "world.arm.effects=[]")


def aside(role: str = "perception", **more: Any) -> Camera:
    """A camera a quarter turn from the first, as large."""
    where = Pose([0.5, -0.95, 0.85], [-2.270689, 0.0, 0.0])
    return Camera(role=role, X_WC=where, width=320, height=240, focal=300.0, **more)


def plan(*overrides: str, second: Camera | None = None, objects: tuple[str, ...] = OBJECTS) -> Scenario:
    """A can behind a box, seen by one camera or by two."""
    made = small_scenario(*STILL, *overrides, objects=objects)
    made.world.objects["can"].X_WO = Pose(HIDDEN, [0.0, 0.0, 0.0])
    made.world.objects["cracker_box"].X_WO = Pose([0.58, 0.0, 0.105], [0.0, 0.0, 1.4])
    if second is not None:
        made.twin.cameras = {"aside": second}
    return made


def tracks(look: dict[str, Any]) -> dict[str, Track]:
    rows = look["tracks"].reshape(-1, TRACK_SIZE)
    return {name: Track.unpack(row) for name, row in zip(OBJECTS, rows, strict=True)}


@pytest.mark.slow
def test_what_stands_behind_a_box_is_seen_by_the_other_camera(egl: None) -> None:
    (one,) = watch(make_closed_loop(plan()), [0.8])
    (both,) = watch(make_closed_loop(plan(second=aside())), [0.8])
    assert tracks(one)["can"].status == ObjectStatus.UNSEEN
    can = tracks(both)["can"]
    assert can.status == ObjectStatus.TRACKED
    assert np.linalg.norm(can.pose[4:] - HIDDEN) < 0.003
    box = [tracks(look)["cracker_box"] for look in (one, both)]
    errors = [float(np.linalg.norm(each.pose[4:] - [0.58, 0.0, 0.105])) for each in box]
    assert errors[1] < max(0.002, errors[0])
    assert np.trace(box[1].covariance) <= 1.5 * np.trace(box[0].covariance)


@pytest.mark.slow
def test_a_camera_that_stops_is_told_of_and_the_other_goes_on(egl: None) -> None:
    made = plan(second=aside())
    made.world.cameras = {"aside": WorldCamera(defects=CameraDefects(stops=0.5))}
    loop = make_closed_loop(made)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(1.8)
    twin = loop.twin.diagram.GetMyContextFromRoot(simulator.get_context())
    found = {(lack["reason"], lack["what"]) for lack in loop.twin.lacking(twin)}
    assert found == {("no_image", "they have ceased from aside")}
    now = np.array(loop.twin.diagram.GetOutputPort("tracks").Eval(twin)).reshape(-1, TRACK_SIZE)
    can, box = (Track.unpack(row) for row in now)
    assert box.status == ObjectStatus.TRACKED and box.last_seen > 1.6
    # Nobody sees the can's place any more: it is where it was, and nothing says that it has gone.
    assert can.status in (ObjectStatus.TRACKED, ObjectStatus.STALE, ObjectStatus.LOST) and can.last_seen < 0.5
    assert np.linalg.norm(can.pose[4:] - HIDDEN) < 0.003


@pytest.mark.slow
def test_the_same_bits_again_and_in_two_contexts_at_once(egl: None) -> None:
    made = plan("world.camera_defects.profile=d415", second=aside(latency=0.02, rate=10.0))
    times = [0.3, 0.5]
    loop = make_closed_loop(made)
    first = watch(loop, times)
    assert same(first, watch(make_closed_loop(made), times)) == []
    simulators = [Simulator(loop.diagram, loop.diagram.CreateDefaultContext()) for _ in range(2)]
    for time in (0.2, 0.3):
        for each in simulators:
            each.AdvanceTo(time)
    twins = [loop.twin.diagram.GetMyContextFromRoot(each.get_context()) for each in simulators]
    port = loop.twin.diagram.GetOutputPort("object_poses")
    for twin in twins:
        assert np.array(port.Eval(twin)).tobytes() == first[0]["object_poses"].tobytes()


@pytest.mark.slow
def test_an_unknown_thing_that_both_see_is_one(egl: None) -> None:
    made = plan(second=aside(), objects=(*OBJECTS, "sugar_box"))
    made.world.objects["sugar_box"].X_WO = Pose([0.5, 0.35, 0.0875], [0.0, 0.0, 0.4])
    del made.twin.library["sugar_box"]
    loop = make_closed_loop(made)
    simulator = Simulator(loop.diagram)
    twin = loop.twin.diagram.GetMyContextFromRoot(simulator.get_context())
    seen = []
    for time in np.arange(0.4, 1.21, 0.1):
        simulator.AdvanceTo(time)
        things = things_of(np.array(loop.twin.diagram.GetOutputPort("things").Eval(twin)))
        seen.append([(thing.identity, thing.status) for thing in things if thing.identity])
    assert all(each == [(1, ObjectStatus.TRACKED)] for each in seen)


@pytest.mark.slow
def test_what_nobody_looks_through_is_not_rendered(egl: None, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[str] = []
    for name in ("colour", "depth"):
        real = getattr(WorldRenderer, name)

        def counted(self: Any, positions: Any, view: Any, X: Any, real: Any = real) -> Any:
            rendered.append("aside" if X.translation()[1] < -0.5 else "camera")
            return real(self, positions, view, X)

        monkeypatch.setattr(WorldRenderer, name, counted)
    made = plan("world.camera_defects.profile=d415", second=aside())
    made.twin.cameras["third"] = aside("pictures")
    station = make_station(made)
    assert isinstance(station, SimStation) and not station.HasOutputPort("third.rgb_image")
    simulator = Simulator(station)
    simulator.AdvanceTo(0.5)
    assert rendered == []
    port = station.GetOutputPort("aside.depth_image")
    for _ in range(3):
        port.Eval(simulator.get_context())
    assert rendered == ["aside"]
    loop = make_closed_loop(plan("world.camera_defects.profile=d415", second=aside("pictures")))
    rendered.clear()
    Simulator(loop.diagram).AdvanceTo(0.2)
    assert rendered and set(rendered) == {"camera"}


def test_one_camera_under_a_name_is_wired_as_the_short_form_is(egl: None) -> None:
    made = plan()
    named = plan()
    assert named.twin.camera is not None
    named.twin.cameras = {"camera": named.twin.camera}
    named.twin.cameras["camera"].role, named.twin.camera = "perception", None

    def systems(scenario: Scenario) -> list[str]:
        return [system.get_name() for system in make_twin(scenario.twin).diagram.GetSystems()]

    assert systems(made) == systems(named)


def test_what_cannot_be_is_refused_by_name() -> None:
    bad = plan(second=aside("seeing"))
    with pytest.raises(ScenarioError, match=r"twin.cameras.aside.role: 'seeing' is none of perception, pictures"):
        make_twin(bad.twin)
    clash = plan()
    clash.twin.cameras = {"camera": aside()}
    with pytest.raises(ScenarioError, match=r"twin.cameras.camera: twin.camera is called 'camera', too"):
        make_twin(clash.twin)
    both = plan(second=aside())
    both.station = "lcm"
    with pytest.raises(ScenarioError, match=r"twin.cameras: the lcm station reads the pictures of one camera, not of"):
        make_station(both)
    nobody = plan()
    nobody.world.cameras = {"other": WorldCamera()}
    with pytest.raises(ScenarioError, match=r"world.cameras.other: none of twin.cameras is called so"):
        make_station(nobody)


def test_a_perception_of_ones_own_sees_through_one_camera() -> None:
    from pydrake.systems.primitives import ConstantVectorSource

    with pytest.raises(TwinError, match="it sees through one camera, not through camera, aside"):
        make_twin(plan(second=aside()).twin, perception=ConstantVectorSource([0.0]))


def test_a_loop_of_two_cameras_connects_each_port(egl: None) -> None:
    loop: ClosedLoop = make_closed_loop(plan(second=aside()))
    for name in ("camera", "aside"):
        for image in ("rgb_image", "depth_image", "image_time"):
            assert loop.twin.diagram.HasInputPort(f"{name}.{image}")
            assert loop.station.HasOutputPort(f"{name}.{image}")


@pytest.mark.parametrize("scenario", [pytest.param("two_cameras", marks=pytest.mark.long), "pick_and_place"])
def test_each_camera_is_told_of_the_hand(egl: None, scenario: str) -> None:
    task = "twin.task={steps: [{kind: pick, object: can}]}"
    loop = make_closed_loop(load_scenario(scenario, [task]))
    context = loop.diagram.CreateDefaultContext()
    eyes = [system for system in loop.twin.diagram.GetSystems() if isinstance(system, PerceptionSystem)]
    assert len(eyes) == (2 if scenario == "two_cameras" else 1)
    for eye in eyes:
        assert eye.GetInputPort("hand").HasValue(eye.GetMyContextFromRoot(context))


def test_things_grow_before_one_camera() -> None:
    with pytest.raises(ScenarioError, match=r"twin\.growth: things grow before one camera, not camera, opposite"):
        make_closed_loop(load_scenario("two_cameras", ["twin.growth={}"]))
