"""What an object does when it swings, is pushed, tilted and let fall: the same for an asset and for the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydrake.geometry import Box, ProximityProperties, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.spatial import ConvexHull

from twin_diagram.station.add_models import add_model
from twin_diagram.station.sim.grip_contact import rub

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    step: float = 0.001
    """Of the trials [s]."""

    friction: float = 0.5
    """Told to both, for push and fall."""

    rough: float = 20.0
    """Told to both while they are tilted: they topple before they slide."""

    swing: float = 2.0
    """How long it swings in a pinch [s]."""

    begun: float = 0.35
    """Angle from its rest at which it begins to swing [rad]."""

    end: float = 0.8
    """Where it is pinched: at this share of the way from its middle to its farther end."""

    pushed: float = 0.10
    """By how much it is pushed [m]."""

    pace: float = 0.05
    """At which speed [m/s]: twice as slow it comes to lie in the same place within a millimetre."""

    off: float = 0.25
    """How far off its middle, as a share of its width there."""

    low: float = 0.15
    """At which share of its height: there tall things slide and do not topple."""

    tilting: float = 0.1
    """Of the plane [rad/s]."""

    toppled: float = 0.12
    """Angle to the plane from which it has toppled [rad]."""

    height: float = 0.01
    """From which it falls [m]."""

    rest: float = 1.5
    """In which it comes to rest [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Subject:
    """An object as its files and its weight have it.

    Attributes:
        folder: of its asset.
        X_OA: (4, 4) of its frame in that of the true object, in which both are told what to do.
        inertia: mass, centre and inertia about it in its own frame, where its file does not say them; None: it does.
        uneven: standard deviation of its feet's radii about what its file says [m], which tells how much a trial tells.
    """

    folder: Path
    X_OA: Array
    inertia: tuple[float, Array, Array] | None = None
    uneven: float = 0.0


@dataclass(frozen=True)
class Task:
    """What is done, in the true object's frame and by its surface alone.

    Attributes:
        R_WO: (3, 3) in which it stands on its broadest face.
        low, high: (3,) corners of the box about it as it stands, its origin over the origin [m].
        pinch: (3,) in O, with an axis (3,).
        axis: of the pinch.
    """

    R_WO: Array
    low: Array
    high: Array
    pinch: Array
    axis: Array


def task_of(corners: Array, centre: Array) -> Task:
    """Return what is done with a true object: triangles (F, 3, 3) and centre of mass (3,) in O."""
    points = corners.reshape(-1, 3)
    hull = ConvexHull(points)
    faces: dict[tuple[float, ...], tuple[float, Array]] = {}
    for normal, simplex in zip(hull.equations[:, :3], hull.simplices, strict=True):
        a, b, c = points[simplex]
        key = tuple(np.round(normal, 1))
        area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a)))
        faces[key] = (faces.get(key, (0.0, normal))[0] + area, normal)
    down = max(faces.values(), key=lambda face: face[0])[1]
    z = -down / np.linalg.norm(down)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    R_WO = np.stack([x, np.cross(z, x), z])
    stands = points @ R_WO.T
    # Pinched near the end of its longest direction that is farther from its centre of mass.
    middle, axes = points.mean(axis=0), np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    along = (points - middle) @ axes[0]
    side = along.max() if along.max() > -along.min() else along.min()
    return Task(R_WO, stands.min(axis=0), stands.max(axis=0), middle + TUNING.end * side * axes[0], axes[2])


def period(subject: Subject, task: Task) -> float:
    """Return how long a swing in a pinch takes, there and back [s]: without friction, about a level axis."""
    plant = MultibodyPlant(0.0)
    body = _add(plant, subject)
    X_OA = RigidTransform(subject.X_OA)
    R_OP = RotationMatrix.MakeFromOneVector(task.axis, 2)
    X_AP = X_OA.inverse() @ RigidTransform(R_OP, task.pinch)
    level = RigidTransform(RotationMatrix.MakeFromOneVector(np.array([0.0, 1.0, 0.0]), 2), np.zeros(3))
    joint = plant.AddJoint(
        RevoluteJoint(
            "pinch",
            plant.AddFrame(_offset("level", plant.world_frame(), level)),
            plant.AddFrame(_offset("held", body.body_frame(), X_AP)),
            np.array([0.0, 0.0, 1.0]),
        )
    )
    plant.Finalize()
    context = plant.CreateDefaultContext()
    _weigh(plant, context, body, subject)
    # Its rest: where its centre hangs below the pinch.
    centre = plant.CalcSpatialInertia(context, joint.frame_on_child(), [body.index()]).get_com()
    hanging = float(np.arctan2(*reversed((level.rotation().inverse() @ np.array([0.0, 0.0, -1.0]))[:2])))
    joint.set_angle(context, hanging - float(np.arctan2(centre[1], centre[0])) + TUNING.begun)
    simulator = Simulator(plant, context)
    simulator.Initialize()
    times, rates = [], []
    for now in np.arange(0.0, TUNING.swing + 1.0, 0.002):
        simulator.AdvanceTo(now)
        times.append(now)
        rates.append(joint.get_angular_rate(context))
    # From one turning to the next: half a period.
    rate, time = np.array(rates), np.array(times)
    at = np.flatnonzero((rate[:-1] * rate[1:] < 0.0) & (time[:-1] > 0.01))
    turned = time[at] - rate[at] * (time[at + 1] - time[at]) / (rate[at + 1] - rate[at])
    return 2.0 * float(np.diff(np.concatenate([[0.0], turned])).mean()) if len(turned) else np.inf


def pushed(subject: Subject, task: Task) -> Array:
    """Return X_WO (4, 4) after it was pushed 10 cm off its middle; it stands on its broadest face at first."""
    width = float(task.high[1] - task.low[1])
    at_y = 0.5 * float(task.high[1] + task.low[1]) + TUNING.off * width
    height = max(0.012, TUNING.low * float(task.high[2] - task.low[2]))
    start = float(task.low[0]) - 0.02

    def fittings(plant: MultibodyPlant, driven: ModelInstanceIndex) -> None:
        tip = plant.AddRigidBody("tip", driven, SpatialInertia(5.0, np.zeros(3), UnitInertia.SolidSphere(0.01)))
        frame = plant.AddFrame(_offset("rail", plant.world_frame(), RigidTransform(np.array([start, at_y, height]))))
        joint = plant.AddJoint(PrismaticJoint("rail", frame, tip.body_frame(), np.array([1.0, 0.0, 0.0])))
        plant.AddJointActuator("rail", joint).set_controller_gains(PdControllerGains(p=1e6, d=1e4))
        plant.RegisterCollisionGeometry(tip, RigidTransform(), Sphere(0.01), "tip", _rough(TUNING.friction))

    way = TUNING.pushed + 0.01
    duration = 0.5 + way / TUNING.pace

    def desired(now: float) -> tuple[float, float]:
        moving = 0.5 < now < duration
        return TUNING.pace * float(np.clip(now - 0.5, 0.0, way / TUNING.pace)), TUNING.pace * moving

    return _run(subject, task, 0.001, duration + 0.2, TUNING.friction, fittings, desired)[-1]


def toppling(subject: Subject, task: Task) -> float:
    """Return by which angle a plane is tilted about x when what stands on it topples [rad]."""

    def desired(now: float) -> tuple[float, float]:
        return TUNING.tilting * max(now - 0.5, 0.0), TUNING.tilting * (now > 0.5)

    def topples(now: float, X_WO: Array) -> bool:
        angle = desired(now)[0]
        c, s = np.cos(angle), np.sin(angle)
        plane = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        off = plane.T @ X_WO[:3, :3] @ task.R_WO.T
        return bool(off[2, 2] < np.cos(TUNING.toppled))

    longest = 0.5 + 1.4 / TUNING.tilting
    poses = _run(subject, task, 0.001, longest, TUNING.rough, None, desired, topples)
    return desired(0.01 * (len(poses) - 1))[0]


def fallen(subject: Subject, task: Task) -> Array:
    """Return X_WO (4, 4) after it fell by a centimetre onto its broadest face."""
    return _run(subject, task, TUNING.height, TUNING.rest, TUNING.friction, None, None)[-1]


def _run(
    subject: Subject,
    task: Task,
    above: float,
    duration: float,
    friction: float,
    fittings: Callable[[MultibodyPlant, ModelInstanceIndex], None] | None,
    desired: Callable[[float], tuple[float, float]] | None,
    over: Callable[[float, Array], bool] | None = None,
) -> list[Array]:
    """Return X_WO (4, 4), one each hundredth of a second, of what is let go somewhat above a plane.

    Where `over` is told, which says when it is, the plane is tilted.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, TUNING.step)
    body = _add(plant, subject)
    ground, driven = plant.world_body(), plant.AddModelInstance("driven")
    if over is not None:
        ground = plant.AddRigidBody(
            "plane", driven, SpatialInertia(50.0, np.zeros(3), UnitInertia.SolidBox(2.0, 2.0, 0.1))
        )
        joint = plant.AddJoint(
            RevoluteJoint("tilt", plant.world_frame(), ground.body_frame(), np.array([1.0, 0.0, 0.0]))
        )
        plant.AddJointActuator("tilt", joint).set_controller_gains(PdControllerGains(p=1e6, d=1e5))
    X_WG = RigidTransform(np.array([0.0, 0.0, -0.05]))
    plant.RegisterCollisionGeometry(ground, X_WG, Box(4.0, 4.0, 0.1), "ground", _rough(friction))
    if fittings is not None:
        fittings(plant, driven)
    plant.Finalize()
    rub(plant, scene_graph, body, friction)
    _wear(plant, scene_graph, body, subject.uneven)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    _weigh(plant, context, body, subject)
    X_OA = RigidTransform(subject.X_OA)
    X_WO = RigidTransform(RotationMatrix(task.R_WO), np.array([0.0, 0.0, above - float(task.low[2])]))
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, X_WO @ X_OA)
    simulator = Simulator(diagram, root)
    simulator.Initialize()
    poses = []
    for k in range(round(duration / 0.01) + 1):
        if desired is not None:
            plant.get_desired_state_input_port(driven).FixValue(context, np.array(desired(0.01 * k)))
        simulator.AdvanceTo(0.01 * k)
        poses.append((body.EvalPoseInWorld(context) @ X_OA.inverse()).GetAsMatrix4())
        if over is not None and over(0.01 * k, poses[-1]):
            break
    return poses


def _add(plant: MultibodyPlant, subject: Subject) -> RigidBody:
    instance = add_model(plant, "subject", {}, str(subject.folder / "model.sdf"))[0]
    return plant.GetBodyByName("object", instance)


def _weigh(plant: MultibodyPlant, context: Context, body: RigidBody, subject: Subject) -> None:
    if subject.inertia is not None:
        mass, centre, inertia = subject.inertia
        about = inertia / mass
        unit = UnitInertia(about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2])
        moved = SpatialInertia(mass, centre, unit.ShiftFromCenterOfMass(-centre))
        body.SetSpatialInertiaInBodyFrame(context, moved)


def _wear(plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody, uneven: float) -> None:
    """Change the radii of a body's feet by a standard deviation [m]."""
    rng = np.random.default_rng(0)
    for shape in plant.GetCollisionGeometriesForBody(body) if uneven > 0.0 else ():
        foot = scene_graph.model_inspector().GetShape(shape)
        if isinstance(foot, Sphere):
            radius = foot.radius() + uneven * float(rng.standard_normal())
            scene_graph.ChangeShape(plant.get_source_id(), shape, Sphere(radius))


def _offset(name: str, frame: Frame, X: RigidTransform) -> FixedOffsetFrame:
    return FixedOffsetFrame(name, frame, X)


def _rough(friction: float) -> ProximityProperties:
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    return properties
