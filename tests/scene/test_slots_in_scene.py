"""Slots of the twin's scene are filled, shaped and freed in a Context: tracks, events and geometry follow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from pydrake.geometry import Role
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from twin_diagram import scenario
from twin_diagram.scene import object_events
from twin_diagram.scene.slot_geometry import follow
from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement
from twin_diagram.signals.things import (
    FURTHER_MEASUREMENT_SIZE,
    FURTHER_TRACK_SIZE,
    OWNER_SIZE,
    THING_SIZE,
    Thing,
    things_of,
)

Array = npt.NDArray[np.float64]
SLOTS = scenario.Slots(instances=4, unknown=2, forget_after=0.3)
NOISE = np.diag([1e-6] * 6)
CUBE = np.array([[x, y, z] for x in (0.4, 0.5) for y in (-0.1, 0.0) for z in (0.0, 0.2)])


@dataclass
class Made:
    """A scene and its updater, whose inputs are told by hand."""

    diagram: Diagram
    scene: TwinScene
    updater: SceneGraphUpdater

    def start(self) -> Simulator:
        simulator = Simulator(self.diagram)
        own = self.own(simulator.get_context())
        self.updater.GetInputPort("arm_state").FixValue(own, np.zeros(14))
        self.tell(simulator.get_context(), NEVER)
        return simulator

    def own(self, context: Context) -> Context:
        return self.updater.GetMyContextFromRoot(context)

    def tell(
        self,
        context: Context,
        time: float,
        first: tuple[float, Array] = (0.0, np.zeros(3)),
        further: dict[int, tuple[int, int, float, Array]] | None = None,
        things: tuple[Thing, ...] = (),
    ) -> None:
        """Tell of an image: `first` quality and place of the can, `further` by slot identity, asset, quality, place."""
        own = self.own(context)
        rows = np.zeros((3, FURTHER_MEASUREMENT_SIZE))
        for slot, (identity, asset, quality, place) in (further or {}).items():
            rows[slot] = [identity, asset, *measured(quality, time, place)]
        gone = measured(0.0, NEVER, np.zeros(3))
        self.updater.GetInputPort("object_poses").FixValue(own, np.array(measured(first[0], time, first[1])))
        self.updater.GetInputPort("further_poses").FixValue(own, rows.ravel())
        packed = [thing.pack() for thing in things] + [Thing().pack()] * (2 - len(things))
        self.updater.GetInputPort("things").FixValue(own, np.concatenate(packed))
        self.updater.GetInputPort("image_time").FixValue(own, [time])
        assert len(gone) == len(measured(first[0], time, first[1]))

    def further(self, context: Context) -> Array:
        vector = np.array(self.updater.GetOutputPort("further_tracks").Eval(self.own(context)))
        return vector.reshape(-1, FURTHER_TRACK_SIZE)

    def status(self, context: Context) -> ObjectStatus:
        return ObjectStatus(int(self.updater.GetOutputPort("tracks").Eval(self.own(context))[0]))

    def events(self, context: Context) -> list[tuple[str, str]]:
        ring = np.array(self.updater.GetOutputPort("object_events").Eval(self.own(context)))
        return [(one["event"], one["object"]) for one in object_events.told(ring, object_events.Names(["can"]))]

    def keep(self, context: Context) -> bool:
        """Bring the scene graph up to date, as `twin.kept_scene` does."""
        things = np.array(self.updater.GetInputPort("things").Eval(self.own(context)))
        graph = self.scene.scene_graph
        own = graph.GetMyMutableContextFromRoot(context)
        return follow(
            graph, own, self.scene.slots, self.further(context).ravel(), things_of(things), self.scene.shapes_of
        )

    def above(self, context: Context, point: Array) -> float:
        """Distance of a point from the pieces of the first unknown thing's slot."""
        graph = self.scene.scene_graph
        query = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(context))
        own = query.inspector().GetGeometries(self.scene.slots.things[0], Role.kProximity)
        return min(float(one.distance) for one in query.ComputeSignedDistanceToPoint(point) if one.id_G in own)

    def hanging(self, context: Context, role: Role = Role.kProximity) -> list[int]:
        """How many shapes hang on each slot's frame."""
        query = self.scene.scene_graph.get_query_output_port().Eval(
            self.scene.scene_graph.GetMyContextFromRoot(context)
        )
        frames = [*self.scene.slots.further, *self.scene.slots.things]
        return [len(query.inspector().GetGeometries(frame, role)) for frame in frames]


def measured(quality: float, time: float, place: Array) -> list[float]:
    pose = np.r_[1.0, 0.0, 0.0, 0.0, place]
    return PoseMeasurement(quality, time, pose, NOISE).pack().tolist()


@pytest.fixture(scope="module")
def made() -> Made:
    builder = DiagramBuilder()
    twin = scenario.Twin(library={"can": "objects/can"}, slots=SLOTS)
    scene = add_twin_scene(builder, twin)
    params = scenario.SceneUpdater(rate=50.0, stale_after=0.2, lost_after=0.5)
    updater = builder.AddSystem(SceneGraphUpdater(scene, params, None, SLOTS.forget_after))
    builder.Connect(updater.GetOutputPort("positions"), scene.positions_input)
    builder.Connect(updater.GetOutputPort("further_tracks"), scene.further_input)
    return Made(builder.Build(), scene, updater)


HERE, THERE = np.array([0.5, 0.1, 0.05]), np.array([0.6, -0.2, 0.05])


def test_a_further_instance_has_a_track_shapes_and_a_name_while_it_holds_its_slot(made: Made) -> None:
    simulator = made.start()
    context = simulator.get_mutable_context()
    assert not made.keep(context) and made.hanging(context) == [0] * 5
    for k in range(4):
        made.tell(context, 0.1 * k, (1.0, HERE), {1: (7, 0, 1.0, THERE)})
        simulator.AdvanceTo(0.1 * k + 0.05)
    row = made.further(context)[1]
    assert row[0] == 7 and row[1] == 0 and row[OWNER_SIZE] == ObjectStatus.TRACKED
    np.testing.assert_allclose(row[OWNER_SIZE + 6 : OWNER_SIZE + 9], THERE, atol=1e-9)
    assert not made.further(context)[[0, 2], 0].any()
    assert made.keep(context) and not made.keep(context)
    own = made.scene.shapes_of(0)
    assert made.hanging(context)[1] == sum(role == Role.kProximity for _, _, role, _ in own) > 0
    assert made.hanging(context, Role.kIllustration)[1] == sum(role == Role.kIllustration for _, _, role, _ in own)
    query = made.scene.scene_graph.get_query_output_port().Eval(made.scene.scene_graph.GetMyContextFromRoot(context))
    np.testing.assert_allclose(query.GetPoseInWorld(made.scene.slots.further[1]).translation(), THERE, atol=1e-9)
    # Another takes the slot: its filter begins anew, at once where it is.
    made.tell(context, 0.45, (1.0, HERE), {1: (8, 0, 1.0, HERE + [0.0, 0.3, 0.0])})
    simulator.AdvanceTo(0.5)
    row = made.further(context)[1]
    assert row[0] == 8 and row[OWNER_SIZE + 7] == pytest.approx(0.4, abs=1e-6)
    made.tell(context, 0.5, (1.0, HERE))
    simulator.AdvanceTo(0.55)
    assert made.keep(context) and made.hanging(context) == [0] * 5
    assert made.events(context) == [
        ("new", "can"),
        ("new", "can#8"),
        *[("gone", "can#8"), ("removed", "can#8"), ("new", "can#9")],
        *[("gone", "can#9"), ("removed", "can#9")],
    ]


def test_an_unknown_things_pieces_hang_in_the_scene_and_change_with_it(made: Made) -> None:
    simulator = made.start()
    context = simulator.get_mutable_context()
    thing = Thing(3, ObjectStatus.UNSEEN, 0.0, 0.0, CUBE.mean(axis=0), (CUBE, CUBE + [0.0, 0.1, 0.0]))
    made.tell(context, 0.0, things=(thing,))
    simulator.AdvanceTo(0.05)
    assert not made.keep(context)  # seen once: no obstacle yet
    made.tell(context, 0.06, things=(replace(thing, status=ObjectStatus.TRACKED),))
    simulator.AdvanceTo(0.1)
    assert made.keep(context) and made.hanging(context) == [0, 0, 0, 2, 0]
    point = np.array([0.45, -0.05, 0.5])
    assert made.above(context, point) == pytest.approx(0.3, abs=1e-3)
    other = replace(thing, status=ObjectStatus.MOVING, pieces=(CUBE + [0.0, 0.0, 0.1],))
    made.tell(context, 0.12, things=(other,))
    simulator.AdvanceTo(0.15)
    assert made.keep(context) and made.hanging(context) == [0, 0, 0, 1, 0]
    assert made.above(context, point) == pytest.approx(0.2, abs=1e-3)
    for k, status in enumerate((ObjectStatus.STALE, ObjectStatus.LOST, ObjectStatus.GONE)):
        made.tell(context, 0.16 + 0.04 * k, things=(replace(other, status=status),))
        simulator.AdvanceTo(0.19 + 0.04 * k)
        made.keep(context)
        assert made.hanging(context)[3] == (0 if status == ObjectStatus.GONE else 1)
    made.tell(context, 0.3)
    simulator.AdvanceTo(0.35)
    names = ["new", "moved", "stale", "lost", "gone", "removed"]
    assert made.events(context) == [(name, "unknown#3") for name in names]


def test_two_contexts_of_one_scene_never_meet(made: Made) -> None:
    first, second = made.start(), made.start()
    thing = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, CUBE.mean(axis=0), (CUBE,))
    made.tell(first.get_mutable_context(), 0.0, (1.0, HERE), {0: (1, 0, 1.0, THERE)}, (thing,))
    made.tell(second.get_mutable_context(), 0.0, (1.0, THERE))
    for simulator in (first, second):
        simulator.AdvanceTo(0.1)
        made.keep(simulator.get_mutable_context())
    assert made.hanging(first.get_context())[3] == 1 and made.further(first.get_context())[0, 0] == 1
    assert not any(made.hanging(second.get_context())) and not made.further(second.get_context()).any()
    assert made.events(second.get_context()) == [("new", "can")]


def test_a_place_seen_empty_makes_an_object_gone_and_after_a_while_removed_until_it_is_back(made: Made) -> None:
    simulator = made.start()
    context = simulator.get_mutable_context()
    seen: list[ObjectStatus] = []
    for k in range(12):
        found = (1.0, HERE) if k < 3 else (-0.9, HERE)
        made.tell(context, 0.05 * k, found)
        simulator.AdvanceTo(0.05 * k + 0.03)
        seen.append(made.status(context))
    # Two images may be late ones; the third counts.
    assert seen[4] != ObjectStatus.GONE and seen[5:] == [ObjectStatus.GONE] * 7
    positions = made.updater.GetOutputPort("positions").Eval(made.own(context))
    assert positions[made.scene.object_position_index[0, 6]] < -1.0
    made.tell(context, 0.6, (1.0, THERE))
    simulator.AdvanceTo(0.65)
    assert made.status(context) == ObjectStatus.TRACKED
    track = made.updater.GetOutputPort("tracks").Eval(made.own(context))
    np.testing.assert_allclose(track[6:9], THERE, atol=1e-9)
    assert made.events(context) == [("new", "can"), ("gone", "can"), ("removed", "can"), ("new", "can")]


def test_hidden_is_neither_gone_nor_removed(made: Made) -> None:
    simulator = made.start()
    context = simulator.get_mutable_context()
    for k in range(20):
        made.tell(context, 0.05 * k, (1.0 if k < 3 else 0.0, HERE))
        simulator.AdvanceTo(0.05 * k + 0.03)
    assert made.status(context) == ObjectStatus.LOST
    assert made.events(context) == [("new", "can"), ("stale", "can"), ("lost", "can")]


def test_unknown_things_are_told_where_they_have_got_to(made: Made) -> None:
    simulator = made.start()
    context = simulator.get_mutable_context()
    v = np.array([0.2, 0.0, 0.0])
    thing = Thing(3, ObjectStatus.MOVING, 0.0, 0.0, CUBE.mean(axis=0), (CUBE,), v, 0.02**2)
    made.tell(context, 0.0, (1.0, HERE), None, [thing])
    simulator.AdvanceTo(0.1)
    (now, nobody) = things_of(np.array(made.updater.GetOutputPort("things").Eval(made.own(context))))
    np.testing.assert_allclose(now.shift, 0.1 * v, atol=1e-12)
    np.testing.assert_allclose(now.velocity, v)
    assert now.velocity_variance == 0.02**2 and not nobody.stands


def test_rows_of_the_wires_hold_what_they_are_given() -> None:
    moves = np.array([0.1, -0.2, 0.3]), 0.01, np.array([0.01, 0.0, -0.02])
    thing = Thing(5, ObjectStatus.STALE, 0.25, 1.5, np.array([0.1, 0.2, 0.3]), (CUBE, CUBE[:5] + 1.0), *moves)
    again = Thing.unpack(thing.pack())
    assert len(thing.pack()) == THING_SIZE
    assert (again.identity, again.status, again.first_seen, again.last_seen) == (5, ObjectStatus.STALE, 0.25, 1.5)
    np.testing.assert_array_equal(again.middle, thing.middle)
    np.testing.assert_array_equal(again.velocity, moves[0])
    np.testing.assert_array_equal(again.shift, moves[2])
    assert again.velocity_variance == moves[1]
    assert len(again.pieces) == 2
    np.testing.assert_array_equal(again.pieces[1], CUBE[:5] + 1.0)
    assert things_of(np.zeros(2 * THING_SIZE)) and not things_of(np.zeros(THING_SIZE))[0].stands


def test_a_correction_of_the_camera_moves_all_that_it_shows_and_narrows_what_is_claimed() -> None:
    camera = scenario.Camera(X_WC=scenario.Pose([1.4, 0.0, 0.85], [-2.27, 0.0, 1.571]), X_WC_std=[0.005, 0.01])
    builder = DiagramBuilder()
    scene = add_twin_scene(builder, scenario.Twin(library={"can": "objects/can"}, slots=SLOTS))
    updater = builder.AddSystem(SceneGraphUpdater(scene, scenario.SceneUpdater(rate=50.0), camera))
    builder.Connect(updater.GetOutputPort("positions"), scene.positions_input)
    made = Made(builder.Build(), scene, updater)
    simulator = made.start()
    context = simulator.get_mutable_context()
    own, port = made.own(context), updater.GetInputPort("calibration")
    told = np.diag([0.01**2 / 3] * 3 + [0.005**2 / 3] * 3 + [0.0] * 4)
    port.FixValue(own, np.r_[np.zeros(10), told.ravel()])
    for k in range(4):
        made.tell(context, 0.1 * k, (1.0, HERE))
        simulator.AdvanceTo(0.1 * k + 0.05)
    first = np.array(updater.GetOutputPort("tracks").Eval(own))
    # The camera turns out to stand 2 mm farther along x, and to be turned by 3 mrad about the vertical.
    errors = np.r_[0.0, 0.0, 0.003, 0.002, np.zeros(6)]
    port.FixValue(own, np.r_[errors, 0.01 * told.ravel()])
    simulator.AdvanceTo(0.4)
    second = np.array(updater.GetOutputPort("tracks").Eval(own))
    expected = HERE + [0.002, 0.0, 0.0] + np.cross([0.0, 0.0, 0.003], HERE - camera.X_WC.translation)
    np.testing.assert_allclose(second[6:9], expected, atol=1e-6)
    assert second[5] - first[5] == pytest.approx(0.0015, abs=1e-6)  # half the turn about z
    assert second[0] == ObjectStatus.TRACKED and np.linalg.norm(second[9:15]) == 0.0
    before, after = (np.trace(one[15:].reshape(6, 6)[3:, 3:]) for one in (first, second))
    assert before > 0.005**2 and after < 0.1 * before
