"""The world can grip: what friction carries is held where it was taken, what it does not carry drops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Convex
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.station.sim.linkage_hand import FRAME, LONG, SHUT, X_FG, linkage_hand, opening
from twin_diagram.planning.tasks.step_ends import TUNING as STEP_ENDS
from twin_diagram.runs.true_clearance import TrueClearance
from twin_diagram.scenario import ArmModel, Pose, Scenario, WorldObject, load_scenario
from twin_diagram.station import ports
from twin_diagram.station.sim.driver import held_back
from twin_diagram.station.sim.grip_contact import COMPLIANCE, couple_fingers
from twin_diagram.station.sim.linkage import linkage_of
from twin_diagram.station.sim.station import SimStation
from twin_diagram.station.sim.world_plant import WorldPlant, build_world

MASS, FRICTION, PAD = 0.5, 0.6, 0.9
SIZE = (0.09, 0.06, 0.06)
WEIGHT = MASS * 9.81
ENOUGH = 0.5 * WEIGHT / (2.0 * FRICTION * PAD / (FRICTION + PAD))
"""Force limit whose friction just carries the box, on two sides [N]."""
GRIPPERS = {"arms/panda_hand.urdf": "panda_tcp", "arms/iiwa7_wsg.urdf": "wsg_tcp"}
HOMES = {
    "arms/panda_hand.urdf": [0.0, 0.3, 0.0, -1.9, 0.0, 2.2, 0.785],
    "arms/iiwa7_wsg.urdf": [0, 0.6, 0, -1.4, 0, 1.1, 0],
}

EMPTY = STEP_ENDS.empty

BOX = """<?xml version="1.0"?>
<sdf version="1.9" xmlns:drake="drake.mit.edu"><model name="box"><link name="object">
<inertial><mass>{m}</mass><inertia><ixx>{i[0]}</ixx><iyy>{i[1]}</iyy><izz>{i[2]}</izz>
<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>
<collision name="solid"><geometry><box><size>{s[0]} {s[1]} {s[2]}</size></box></geometry>
<drake:proximity_properties><drake:mu_static>{mu}</drake:mu_static><drake:mu_dynamic>{mu}</drake:mu_dynamic>
</drake:proximity_properties></collision></link></model></sdf>
"""


def plan(folder: Path, arm: str, time_step: float, width: float) -> Scenario:
    (folder / "box").mkdir(exist_ok=True)
    a, b, c = size = [SIZE[0], width, SIZE[2]]
    inertia = MASS / 12.0 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    (folder / "box" / "model.sdf").write_text(BOX.format(m=MASS, i=inertia, s=size, mu=FRICTION))
    scenario = load_scenario("tabletop", ["twin.camera=null", f"world.time_step={time_step}"])
    model = replace(scenario.twin.arm, model=arm, tool_frame=GRIPPERS[arm], effects=[])
    objects = {"box": WorldObject(asset=str(folder / "box"))}
    return replace(
        scenario,
        world=replace(scenario.world, arm=model, objects=objects, fixtures=[]),
        twin=replace(scenario.twin, arm=model, library={}, fixtures=[], home=HOMES[arm]),
    )


@dataclass(frozen=True)
class Held:
    moved: float  # greatest way of the box in the hand since it was taken [m]
    turned: float  # likewise [rad]
    dropped: bool
    contacts: int  # between arm and box, at the end
    squeeze: float  # normal force of each pad at the end [N]
    opening: float  # of the fingers at the end [m]


def hold(
    folder: Path,
    arm: str = "arms/panda_hand.urdf",
    force: float = 40.0,
    off: float = 0.0,
    time_step: float = 0.0025,
    duration: float = 2.0,
    width: float = SIZE[1],
) -> Held:
    """Take a box between the pads, `off` along their faces from its centre, and hold it; the hand points down."""
    station = SimStation(plan(folder, arm, time_step, width))
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    plant = station.world.plant
    inside = plant.GetMyMutableContextFromRoot(context)
    for finger in station.world.arm.fingers:
        side = np.sign(finger.position_lower_limits()[0] + finger.position_upper_limits()[0])
        finger.set_translation(inside, side * 0.5 * width)
    tool = plant.GetFrameByName(GRIPPERS[arm])
    box = plant.get_body(station.world.objects["box"])
    plant.SetFreeBodyPose(inside, box, tool.CalcPoseInWorld(inside) @ RigidTransform([off, 0.0, 0.0]))
    station.GetInputPort(ports.GRIPPER_COMMANDED).FixValue(context, np.zeros(2))
    limit = station.GetInputPort(ports.GRIPPER_FORCE_LIMIT)
    limit.FixValue(context, [40.0])

    def in_hand() -> RigidTransform:
        return tool.CalcPoseInWorld(inside).inverse() @ plant.EvalBodyPoseInWorld(inside, box)

    simulator.AdvanceTo(0.3)  # taken firmly, then held with what is asked for
    limit.FixValue(context, [force])
    simulator.AdvanceTo(0.5)
    taken = in_hand()
    moved = turned = 0.0
    for time in np.arange(0.6, duration + 0.55, 0.1):
        simulator.AdvanceTo(time)
        since = taken.inverse() @ in_hand()
        moved = max(moved, float(np.linalg.norm(since.translation())))
        turned = max(turned, abs(float(since.rotation().ToAngleAxis().angle())))
    _, contacts = TrueClearance(station).evaluate(context)
    results = station.GetOutputPort(ports.CONTACT_RESULTS).Eval(context)
    closing = tool.CalcPoseInWorld(inside).rotation().matrix()[:, 1]
    forces = [
        abs(float(closing @ results.hydroelastic_contact_info(i).F_Ac_W().translational()))
        for i in range(results.num_hydroelastic_contacts())
    ]
    opening = sum(abs(finger.get_translation(inside)) for finger in station.world.arm.fingers)
    return Held(moved, turned, in_hand().translation()[2] > 0.1, contacts, min(forces, default=0.0), opening)


@pytest.mark.long
def test_a_hand_that_a_linkage_carries_presses_with_the_force_it_is_told(tmp_path: Path) -> None:
    """As much as fingers that slide, of a narrow box and of a wide one: torque by the linkage's lever."""
    for width in (0.03, 0.06):
        scenario = plan(tmp_path, "arms/panda_hand.urdf", 0.0025, width)
        arm = replace(scenario.twin.arm, model=str(linkage_hand(tmp_path)), tool_frame=FRAME)
        arm.X_FG = Pose(translation=list(X_FG))
        world, twin = replace(scenario.world, arm=arm), replace(scenario.twin, arm=arm)
        station = SimStation(replace(scenario, world=world, twin=twin))
        simulator = Simulator(station)
        context = simulator.get_mutable_context()
        plant = station.world.plant
        inside = plant.GetMyMutableContextFromRoot(context)
        angles = np.linspace(0.0, SHUT, 1000)
        angle = float(np.interp(-width, -opening(angles), angles))
        for side in ("left", "right"):
            for joint, way in (("bar", 1.0), ("finger", -1.0)):
                plant.GetJointByName(f"{side}_{joint}_joint").set_angle(inside, way * angle)  # type: ignore[attr-defined]
        tool = plant.get_frame(station.world.arm.arm.tool_frame)
        box = plant.get_body(station.world.objects["box"])
        plant.SetFreeBodyPose(inside, box, tool.CalcPoseInWorld(inside) @ RigidTransform([0.0, 0.0, -0.01]))
        station.GetInputPort(ports.GRIPPER_COMMANDED).FixValue(context, [SHUT])
        station.GetInputPort(ports.GRIPPER_FORCE_LIMIT).FixValue(context, [30.0])
        box.Lock(inside)  # until the driver, which starts with the hand open, has come to it
        simulator.AdvanceTo(0.6)
        box.Unlock(inside)
        taken = tool.CalcPoseInWorld(inside).inverse() @ plant.EvalBodyPoseInWorld(inside, box)
        simulator.AdvanceTo(1.5)
        since = taken.inverse() @ (tool.CalcPoseInWorld(inside).inverse() @ plant.EvalBodyPoseInWorld(inside, box))
        assert np.linalg.norm(since.translation()) < 1e-3
        results = station.GetOutputPort(ports.CONTACT_RESULTS).Eval(context)
        closing = tool.CalcPoseInWorld(inside).rotation().matrix()[:, 1]
        pads = range(results.num_hydroelastic_contacts())
        forces = [abs(closing @ results.hydroelastic_contact_info(i).F_Ac_W().translational()) for i in pads]
        assert len(forces) == 2
        np.testing.assert_allclose(forces, 30.0, rtol=0.05)


def linkage_world(folder: Path, **shapes: str) -> WorldPlant:
    arm = ArmModel(model=str(linkage_hand(folder, **shapes)), tool_frame=FRAME)  # type: ignore[arg-type]
    scenario = plan(folder, "arms/panda_hand.urdf", 0.0025, 0.03)
    both = replace(scenario.world, arm=arm), replace(scenario.twin, arm=arm)
    return build_world(DiagramBuilder(), replace(scenario, world=both[0], twin=both[1]))


def test_what_a_linkage_hinges_passes_through_each_other(tmp_path: Path) -> None:
    """Bars whose shapes reach into the pads that they carry jammed the hand; pads of both sides still meet."""
    linkage = linkage_of(ArmModel(model=str(linkage_hand(tmp_path, bar=LONG)), tool_frame=FRAME), {})
    assert linkage is not None and linkage.travel is not None and len(linkage.hinged) >= 2
    world = linkage_world(tmp_path, bar=LONG)
    inspector, shape = world.scene_graph.model_inspector(), {}
    for name in ("left_bar", "right_bar", "left_pad", "right_pad"):
        shape[name] = world.plant.GetCollisionGeometriesForBody(world.plant.GetBodyByName(name))[0]
    for side in ("left", "right"):
        assert inspector.CollisionFiltered(shape[f"{side}_bar"], shape[f"{side}_pad"])
    assert not inspector.CollisionFiltered(shape["left_bar"], shape["right_pad"])


def test_a_finger_that_is_drawn_as_a_mesh_is_as_soft_as_a_box(tmp_path: Path) -> None:
    """Its hull is: by points alone a can swung by 17 mm between an xArm's fingers."""
    trimesh.creation.box((0.02, 0.0146, 0.05)).export(tmp_path / "pad.obj")
    world = linkage_world(tmp_path, pad='<mesh filename="pad.obj"/>')
    pads = [world.plant.GetBodyByName(f"{side}_pad") for side in ("left", "right")]
    shapes = [shape for pad in pads for shape in world.plant.GetCollisionGeometriesForBody(pad)]
    assert len(shapes) == 2
    inspector = world.scene_graph.model_inspector()
    for shape in shapes:
        assert isinstance(inspector.GetShape(shape), Convex)
        assert inspector.GetProximityProperties(shape).HasProperty(*COMPLIANCE)


def test_a_box_is_held_off_its_centre(tmp_path: Path) -> None:
    """A fifth of what ten seconds may do."""
    held = hold(tmp_path, off=0.02)
    assert held.moved < 0.2 * 0.5e-3
    assert held.turned < 0.2 * np.radians(1.0)
    assert held.squeeze == pytest.approx(40.0, rel=0.01), "whatever the width"
    assert held.contacts == 2, "surfaces count as contacts, too"


@pytest.mark.parametrize(("arm", "width"), [("arms/panda_hand.urdf", 0.0035), ("arms/iiwa7_wsg.urdf", 0.0085)])
def test_a_thin_wall_is_squeezed_as_a_box_is_and_told_from_nothing(tmp_path: Path, arm: str, width: float) -> None:
    """As thin as a mug's; the WSG's pads are 5 mm apart where its fingers meet. A plain spring would press by 3.5 N."""
    wall = hold(tmp_path, arm, width=width, duration=0.2)
    assert wall.squeeze == pytest.approx(40.0, rel=0.02)
    assert wall.opening > 1.5 * EMPTY
    nothing = hold(tmp_path, arm, width=width, off=0.5, duration=0.1)
    assert nothing.opening < 0.5 * EMPTY


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_friction_decides_what_is_carried(tmp_path: Path, share: float) -> None:
    held = hold(tmp_path, force=share * ENOUGH, duration=1.0)
    assert held.dropped == (share < 1.0)
    if share > 1.0:
        assert held.moved < 0.5e-3


@pytest.mark.slow
@pytest.mark.parametrize("time_step", [0.0025, 0.00125])
@pytest.mark.parametrize("off", [0.0, 0.02])
@pytest.mark.parametrize("arm", GRIPPERS)
def test_ten_seconds(tmp_path: Path, arm: str, off: float, time_step: float) -> None:
    held = hold(tmp_path, arm, off=off, time_step=time_step, duration=10.0)
    print(arm, off, time_step, held)
    assert held.moved < 0.5e-3
    assert held.turned < np.radians(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("time_step", [0.0025, 0.00125])
@pytest.mark.parametrize("arm", GRIPPERS)
@pytest.mark.parametrize("share", [0.8, 1.25])
def test_what_slips_and_what_does_not_is_no_matter_of_the_step(
    tmp_path: Path, arm: str, time_step: float, share: float
) -> None:
    held = hold(tmp_path, arm, force=share * ENOUGH, time_step=time_step)
    assert held.dropped == (share < 1.0)


# Fingers.


@pytest.mark.parametrize(
    ("limits", "coupled"),
    [
        ([(0.0, 0.04), (0.0, 0.04)], 1),
        ([(-0.055, 0.0), (0.0, 0.055)], 1),
        ([(0.0, 0.04), (0.0, 0.03)], 0),
        ([(0.0, np.inf), (0.0, np.inf)], 0),
        ([(0.0, 0.04)], 0),
    ],
)
def test_two_fingers_alike_move_together(limits: list[tuple[float, float]], coupled: int) -> None:
    plant = MultibodyPlant(0.01)
    fingers = []
    for k, (low, high) in enumerate(limits):
        body = plant.AddRigidBody(f"finger{k}", SpatialInertia.SolidCubeWithDensity(1e3, 0.01))
        joint = PrismaticJoint(f"slide{k}", plant.world_frame(), body.body_frame(), [1, 0, 0], low, high)
        fingers.append(plant.AddJoint(joint))
    couple_fingers(plant, fingers)
    assert plant.num_constraints() == coupled


def test_springs_are_wound_up_to_the_limit_alone() -> None:
    desired = np.array([0.03, -0.01, 0.2, -0.3])
    free = held_back(desired, np.array([0.029, -0.009]), np.array([0.002, 0.002]))
    np.testing.assert_array_equal(free, desired)
    held = held_back(desired, np.array([0.01, -0.009]), np.array([0.002, 0.004]))
    np.testing.assert_allclose(held, [0.012, -0.01, 0.0, -0.3])
    held = held_back(desired, np.array([0.04, -0.02]), np.array([0.002, 0.004]))
    np.testing.assert_allclose(held, [0.038, -0.016, 0.0, 0.0])


def test_what_things_stand_on_has_few_facets() -> None:
    """A bottle's feet are balls of 2 mm: with facets of a third of that one in a pad was four fifths of all contact."""
    scenario = load_scenario("bin_picking", ["world.objects.bottle={asset: objects/bottle}"])
    world = SimStation(scenario).world
    inspector, plant = world.scene_graph.model_inspector(), world.plant
    shapes = plant.GetCollisionGeometriesForBody(plant.get_body(world.objects["bottle"]))
    hints = {type(inspector.GetShape(shape)).__name__: [] for shape in shapes}
    for shape in shapes:
        told = inspector.GetProximityProperties(shape).GetProperty("hydroelastic", "resolution_hint")
        hints[type(inspector.GetShape(shape)).__name__].append(float(told))
    assert min(hints["Sphere"]) >= 0.0025
    assert max(hints["Cylinder"]) == pytest.approx(0.35 * 0.0355)
