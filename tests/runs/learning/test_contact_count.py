"""Contacts that no step asks for are counted once each, and what a step asks for is not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.runs.learning import contact_count
from twin_diagram.runs.learning.cell import FREE, GRASP, RELEASE, Doing
from twin_diagram.runs.learning.contact_count import NOTHING, CellParts, ContactCount, Watchers, asked_for
from twin_diagram.runs.learning.record import LearningRecord
from twin_diagram.scenario import Scenario

TABLE, LINK, PALM, FINGER, MUG, CAN = range(6)
PLACE = np.array([0.4, 0.0, 0.1])
PARTS = CellParts(frozenset({LINK, PALM, FINGER}), frozenset({PALM, FINGER}), frozenset({MUG, CAN}))


@pytest.mark.parametrize(
    ("a", "b", "phase", "wanted", "asked"),
    [
        (FINGER, MUG, GRASP, MUG, True),
        (MUG, PALM, FREE.phase, MUG, True),
        (FINGER, PALM, FREE.phase, NOTHING, True),
        (FINGER, CAN, GRASP, MUG, False),
        (FINGER, MUG, FREE.phase, NOTHING, False),
        (FINGER, TABLE, GRASP, MUG, False),
        (LINK, MUG, GRASP, MUG, False),
        (LINK, PALM, FREE.phase, NOTHING, False),
        (MUG, TABLE, GRASP, MUG, True),
        (MUG, CAN, GRASP, MUG, True),
        (MUG, TABLE, RELEASE, MUG, True),
        (MUG, TABLE, FREE.phase, MUG, False),
        (MUG, CAN, FREE.phase, MUG, False),
        (MUG, CAN, FREE.phase, NOTHING, True),
        (CAN, TABLE, FREE.phase, MUG, True),
    ],
)
def test_what_a_step_asks_for(a: int, b: int, phase: str, wanted: int, asked: bool) -> None:
    assert asked_for(a, b, PARTS, phase, wanted) is asked_for(b, a, PARTS, phase, wanted) is asked


class Scene:
    """A world in which whatever is said touches, at the time that is said."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.told: list[dict[str, Any]] = []
        self.count = ContactCount(lambda **what: self.told.append(what))
        self.count._parts, self.count._names = PARTS, {FINGER: "finger", MUG: "mug", CAN: "can", LINK: "link"}
        self.now = 0.0
        monkeypatch.setattr(self.count, "_nearest", lambda station, context, place: MUG)
        monkeypatch.setattr(self.count, "_pairs", lambda *pairs: ((a, b, lambda: PLACE) for a, b in pairs))

    def tick(self, *pairs: tuple[int, int], doing: Doing = FREE, after: float = 0.01) -> None:
        self.now += after
        query = SimpleNamespace(ComputeContactSurfacesWithFallback=lambda representation: pairs)
        plant = SimpleNamespace(
            get_geometry_query_input_port=lambda: SimpleNamespace(Eval=lambda context: query),
            GetMyContextFromRoot=lambda context: context,
            get_contact_surface_representation=lambda: None,
        )
        station: Any = SimpleNamespace(world=SimpleNamespace(plant=plant))
        context: Any = SimpleNamespace(get_time=lambda: self.now)
        self.count.ticked(station, context, doing)


def test_a_whole_pick_and_place_counts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, grasp, release = Scene(monkeypatch), Doing(GRASP, ((0.0, 0.0, 0.0),)), Doing(RELEASE, ((0.0, 0.0, 0.0),))
    scene.tick((MUG, TABLE))
    scene.tick((MUG, TABLE), doing=grasp)
    scene.tick((MUG, TABLE), (FINGER, MUG), doing=grasp)
    scene.tick((FINGER, MUG))
    scene.tick((MUG, TABLE), (FINGER, MUG), doing=release)
    scene.tick((MUG, TABLE), doing=release)
    scene.tick((MUG, TABLE), (MUG, CAN))
    assert scene.told == [] and scene.count.count == 0


def test_a_contact_is_told_once_until_it_has_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    for _ in range(4):
        scene.tick((FINGER, CAN))
    scene.tick()
    scene.tick((FINGER, CAN))
    assert len(scene.told) == 1, "it bounced"
    scene.tick(after=2.0 * contact_count.TUNING.anew)
    scene.tick((FINGER, CAN))
    assert [what["between"] for what in scene.told] == [["finger", "can"]] * 2
    assert scene.told[0]["place"] == [0.4, 0.0, 0.1] and scene.told[0]["doing"] == "move"


def test_what_is_lost_from_the_hand_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.tick((FINGER, MUG), doing=Doing(GRASP, ((0.0, 0.0, 0.0),)))
    scene.tick((FINGER, MUG))
    scene.tick()
    scene.tick((MUG, TABLE))
    assert [what["between"] for what in scene.told] == [["mug", "nothing"]]


def test_what_touches_is_what_the_plant_resolves() -> None:
    """Over a surface and in a point, and not what is near alone."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.01)
    plant.SetUseSampledOutputPorts(False)
    soft, told = ProximityProperties(), list[dict[str, Any]]()
    AddCompliantHydroelasticProperties(0.02, 1e7, soft)
    AddContactMaterial(properties=soft, friction=CoulombFriction(0.5, 0.5))
    rigid = ProximityProperties()
    AddRigidHydroelasticProperties(0.02, rigid)
    AddContactMaterial(properties=rigid, friction=CoulombFriction(0.5, 0.5))
    point = ProximityProperties()
    AddContactMaterial(properties=point, friction=CoulombFriction(0.5, 0.5))
    for name, x, properties in (("pad", 0.0, soft), ("held", 0.099, rigid), ("by", 0.198, point), ("far", 0.31, point)):
        body = plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.RegisterCollisionGeometry(body, RigidTransform(), Box(0.1, 0.1, 0.1), name, properties)
        plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform([x, 0.0, 0.0]))
    plant.Finalize()
    context = builder.Build().CreateDefaultContext()
    results: Any = plant.get_contact_results_output_port().Eval(plant.GetMyContextFromRoot(context))
    assert (results.num_hydroelastic_contacts(), results.num_point_pair_contacts()) == (1, 1)
    numbers = {name: int(plant.GetBodyByName(name).index()) for name in ("pad", "held", "by", "far")}
    count = ContactCount(lambda **what: told.append(what))
    hand = frozenset({numbers["pad"]})
    count._parts = CellParts(hand, hand, frozenset(numbers.values()) - hand)
    count._wanted, count._names = numbers["held"], {number: name for name, number in numbers.items()}
    bodies = [plant.GetBodyByName(name) for name in numbers]
    count._body_of = {g: int(body.index()) for body in bodies for g in plant.GetCollisionGeometriesForBody(body)}
    station: Any = SimpleNamespace(world=SimpleNamespace(plant=plant))
    count.ticked(station, context, FREE)
    assert count._gripped, "the pad holds it"
    (only,) = told
    assert only["between"] == ["held", "by"] and only["place"] == pytest.approx([0.1485, 0.0, 0.0], abs=0.06)


def test_what_is_wanted_is_what_is_grasped_not_what_has_its_origin_nearest() -> None:
    """A bottle beside a ring was taken by its end: its own pads' contacts counted as unasked."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.01)
    objects = {}
    for name, shape, offset in (("bottle", Box(0.2, 0.06, 0.06), 0.1), ("ring", Sphere(0.03), 0.0)):
        body = plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.RegisterCollisionGeometry(
            body, RigidTransform([offset, 0.0, 0.0]), shape, name, CoulombFriction(0.5, 0.5)
        )
        objects[name] = body.index()
    plant.Finalize()
    root = builder.Build().CreateDefaultContext()
    plant.SetFreeBodyPose(plant.GetMyContextFromRoot(root), plant.GetBodyByName("ring"), RigidTransform([0.18, 0.1, 0]))
    count = ContactCount(lambda **what: None)
    count._parts = CellParts(frozenset(), frozenset(), frozenset(int(index) for index in objects.values()))
    bodies = [plant.get_body(index) for index in objects.values()]
    count._body_of = {g: int(body.index()) for body in bodies for g in plant.GetCollisionGeometriesForBody(body)}
    station: Any = SimpleNamespace(world=SimpleNamespace(plant=plant, objects=objects))
    for place, name in (([0.18, 0.0, 0.0], "bottle"), ([0.19, 0.1, 0.0], "ring"), ([0.19, 0.045, 0.0], "bottle")):
        assert count._nearest(station, root, np.array(place)) == int(objects[name])
    assert count._nearest(station, root, np.array([3.0, 0.0, 0.0])) == NOTHING


def test_what_is_pushed_is_what_most_of_the_places_lie_on() -> None:
    """Where fingers press on a box that leans on a can the can may be nearer: its pushed box counted as unasked for."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.01)
    objects = {}
    for name, size in (("box", (0.2, 0.1, 0.06)), ("can", (0.06, 0.06, 0.1))):
        body = plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.RegisterCollisionGeometry(body, RigidTransform(), Box(*size), name, CoulombFriction(0.5, 0.5))
        objects[name] = int(body.index())
    plant.Finalize()
    root = builder.Build().CreateDefaultContext()
    plant.SetFreeBodyPose(plant.GetMyContextFromRoot(root), plant.GetBodyByName("can"), RigidTransform([0.15, 0, 0]))
    count = ContactCount(lambda **what: None)
    count._parts = CellParts(frozenset(), frozenset(), frozenset(objects.values()))
    bodies = [plant.GetBodyByName(name) for name in objects]
    count._body_of = {g: int(body.index()) for body in bodies for g in plant.GetCollisionGeometriesForBody(body)}
    station: Any = SimpleNamespace(world=SimpleNamespace(plant=plant, objects=objects))
    pressed, seen = [0.115, 0.0, 0.02], [[x, 0.0, 0.03] for x in np.linspace(-0.1, 0.1, 9)]
    assert count._meant(station, root, np.array([pressed])) == objects["can"]
    assert count._meant(station, root, np.array([pressed, *seen])) == objects["box"]


def test_they_stand_among_the_events_of_a_run(tmp_path: Any) -> None:
    record = LearningRecord(tmp_path / "run", Scenario())
    record.begin()
    assert record.unasked() == 0
    record.event(stage="contact", between=["finger", "can"], doing="move", at=1.0)
    record.event(object="object_01", stage="pick", outcome="taken")
    assert record.unasked() == 1


def test_several_watch_as_one() -> None:
    seen: list[str] = []
    one: Any = SimpleNamespace(moment=lambda name, positions: seen.append(name), ticked=lambda *_: seen.append("tick"))
    both = Watchers(one, None, one)
    both.moment("object_01", np.zeros(3))
    both.ticked(*[None] * 3)  # type: ignore[arg-type]
    assert seen == ["object_01"] * 2 + ["tick"] * 2
