"""Further sensors of a simulated arm: an IMU on a link, and force and moment at the wrist.

What ideal sensors would read is a pure function of the motion; the LeafSystem adds rate, latency, noise, bias and
outages.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialForce, SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem

from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.model.description import add_arm as description
from twin_diagram.scenario import LinkSensor, Scenario, SensorDefects
from twin_diagram.scenario import poses as scenario_poses
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import ports
from twin_diagram.station.sim.arm_plant import ArmPlant
from twin_diagram.station.sim.noise import Stream, generator

SIZE = ports.SENSOR_SIZE
"""Numbers in a reading: two vectors."""
NOISE = {"imu": (1e-3, 1e-2), "wrench": (0.01, 0.1)}
"""Where the scenario says nothing: angular velocity [rad/s], specific force [m/s²]; moment [N·m], force [N]."""


@dataclass(frozen=True)
class Load:
    """A body as described: what a force sensor is compensated for.

    Attributes:
        index: in the world's plant.
        mass: [kg].
        com: p_BoBcm_B (3,) [m].
        inertia: about Bo, in B (3, 3) [kg·m²].
    """

    index: int
    mass: float
    com: Array
    inertia: Array


def specific_force(omega: Array, alpha: Array, a: Array, p: Array, gravity: Array) -> Array:
    """Return the acceleration less gravity of a point fixed to a body (3,) [m/s²]; all in one frame.

    Args:
        omega: angular velocity [rad/s].
        alpha: angular acceleration [rad/s²].
        a: acceleration of the body's origin [m/s²].
        p: from there to the point [m].
        gravity: [m/s²].
    """
    return np.asarray(a + np.cross(alpha, p) + np.cross(omega, np.cross(omega, p)) - gravity)


def load_wrench(load: Load, R: Array, omega: Array, alpha: Array, a: Array, gravity: Array) -> tuple[Array, Array]:
    """Return the moment about the body's origin and force, in W, that moving a body takes.

    By Newton's and Euler's laws.

    Args:
        load: the body.
        R: R_WB.
        omega: angular velocity in W [rad/s].
        alpha: angular acceleration in W [rad/s²].
        a: acceleration of the origin in W [m/s²].
        gravity: in W [m/s²].
    """
    h = load.mass * (R @ load.com)
    inertia = R @ load.inertia @ R.T
    lift = a - gravity
    force = load.mass * lift + np.cross(alpha, h) + np.cross(omega, np.cross(omega, h))
    moment = np.cross(h, lift) + inertia @ alpha + np.cross(omega, inertia @ omega)
    return moment, force


class LinkSensorSystem(LeafSystem):
    """Samples an IMU or a wrist's force sensor, with its defects.

    .. pydrake_system::

        name: LinkSensorSystem
        input_ports:
        - body_poses
        - body_velocities
        - body_accelerations
        - reaction_forces
        output_ports:
        - reading
        - time

    A reading is taken at k / rate, k = 1, 2, …, and stands on the ports `LinkSensor.latency` later, rounded up to whole
    periods. `reading` (6): for an IMU angular velocity [rad/s] and specific force a − g [m/s²], for a wrench moment
    [N·m] and force [N] about So, both in sensor frame S; `time` (1) [s] when it was taken, `NEVER` before the first. In
    an outage the newest reading stays. The wrench is what the last link exerts on all that is not described: the
    description's own share, hand included, is compensated for, as wrist sensors do. Noise is a function of seed,
    sensor and message alone.
    """

    def __init__(
        self,
        sensor: LinkSensor,
        defects: SensorDefects,
        plant: MultibodyPlant,
        arm: ArmPlant,
        place: int,
        scenario: Scenario,
    ) -> None:
        """Build the sensor.

        Args:
            sensor: as its data sheet tells.
            defects: what it really does.
            plant: the world's, finalized.
            arm: in it.
            place: of the sensor among all, for its noise.
            scenario: its seed, and its description of the arm.

        Raises:
            ScenarioError: no such kind or body, or a number that makes no sense.
        """
        super().__init__()
        field = f"twin.sensors[{place}]"
        if sensor.kind not in NOISE:
            raise ScenarioError(f"{field}.kind", f"{sensor.kind!r} is none of {', '.join(NOISE)}")
        if not 0.0 < sensor.rate < np.inf or not 0.0 <= sensor.latency < np.inf:
            raise ScenarioError(field, f"rate {sensor.rate} must be positive, latency {sensor.latency} not negative")
        last_link = plant.get_body(arm.arm.last_link).name()
        links = [plant.get_body(k) for instance in arm.arm.instances for k in plant.GetBodyIndices(instance)]
        self._noise, self._bias = _checked(defects, sensor.kind, ports.of_sensor(sensor, last_link))
        self._missing = [tuple(span) for span in defects.missing]
        self._kind, self._rate, self._seed, self._place = sensor.kind, sensor.rate, scenario.seed, place
        named = [int(link.index()) for link in links if link.name() == sensor.body]
        if sensor.body and not named:
            raise ScenarioError(f"{field}.body", f"the world's arm has no link {sensor.body!r}")
        self._body = named[0] if sensor.body else int(arm.arm.last_link)
        X_BS = scenario_poses.pose(sensor.X_BS)
        self._R_BS, self._p_BS = X_BS.rotation().matrix(), X_BS.translation()
        self._gravity = plant.gravity_field().gravity_vector()
        joint = arm.joints[-1]
        self._child = int(joint.child_body().index())
        # Reaction forces are listed by ordinal, which joints removed in between do not count in.
        self._joint = [int(index) for index in plant.GetJointIndices()].index(int(joint.index()))
        X_CJ = joint.frame_on_child().GetFixedPoseInBodyFrame()
        self._R_CJ, self._p_CJ = X_CJ.rotation().matrix(), X_CJ.translation()
        self._loads = _loads(plant, arm, scenario) if sensor.kind == "wrench" else []
        self._poses = self.DeclareAbstractInputPort("body_poses", Value([RigidTransform()]))
        self._velocities = self.DeclareAbstractInputPort("body_velocities", Value([SpatialVelocity()]))
        self._accelerations = self.DeclareAbstractInputPort("body_accelerations", Value([SpatialAcceleration()]))
        self._reactions = self.DeclareAbstractInputPort("reaction_forces", Value([SpatialForce()]))
        self._rows = int(np.ceil(sensor.latency * sensor.rate - 1e-9)) + 1
        start: Any = np.zeros((self._rows, SIZE + 1))
        start[:, SIZE] = NEVER
        state = self.DeclareDiscreteState(start.ravel())
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / sensor.rate, 0.0, self._update)
        ticket = {self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort("reading", SIZE, self._reader(slice(0, SIZE)), ticket)
        self.DeclareVectorOutputPort("time", 1, self._reader(slice(SIZE, SIZE + 1)), ticket)

    @staticmethod
    def _reader(part: slice) -> Any:
        def read(context: Context, output: BasicVector) -> None:
            output.SetFromVector(context.get_discrete_state_vector().value()[: SIZE + 1][part])

        return read

    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        now = context.get_time()
        tick = round(now * self._rate)
        if tick == 0:  # as the arm's own sensors: no step of the plant has ended yet
            return
        rows: Any = context.get_discrete_state_vector().value().reshape(self._rows, SIZE + 1).copy()
        newest = rows[-1].copy()
        if not any(start <= now < end for start, end in self._missing):
            key = self._seed + (self._place + 1) * 1_000_003
            noise = generator(key, Stream.LINK, tick).standard_normal(SIZE) * self._noise
            newest = np.concatenate([self.ideal(context) + self._bias + noise, [now]])
        rows[:-1] = rows[1:]
        rows[-1] = newest
        discrete.set_value(rows.ravel())

    def ideal(self, context: Context) -> Array:
        """Return (6,) what a perfect sensor would read now."""
        poses: Any = self._poses.Eval(context)
        velocities: Any = self._velocities.Eval(context)
        accelerations: Any = self._accelerations.Eval(context)
        R_WB = poses[self._body].rotation().matrix()
        R_WS, arm = R_WB @ self._R_BS, R_WB @ self._p_BS
        V, A = velocities[self._body], accelerations[self._body]
        if self._kind == "imu":
            force = specific_force(V.rotational(), A.rotational(), A.translational(), arm, self._gravity)
            return np.concatenate([R_WS.T @ V.rotational(), R_WS.T @ force])
        reactions: Any = self._reactions.Eval(context)
        F, X_WC = reactions[self._joint], poses[self._child]
        R_WC = X_WC.rotation().matrix()
        R_WJ, p_WJ = R_WC @ self._R_CJ, X_WC.translation() + R_WC @ self._p_CJ
        p_WS = poses[self._body].translation() + arm
        force = R_WJ @ F.translational()
        moment = R_WJ @ F.rotational() + np.cross(p_WJ - p_WS, force)
        for load in self._loads:
            X, V, A = poses[load.index], velocities[load.index], accelerations[load.index]
            m, f = load_wrench(
                load, X.rotation().matrix(), V.rotational(), A.rotational(), A.translational(), self._gravity
            )
            moment = moment - m - np.cross(X.translation() - p_WS, f)
            force = force - f
        return np.concatenate([R_WS.T @ moment, R_WS.T @ force])


def add_link_sensors(
    builder: DiagramBuilder, plant: MultibodyPlant, arm: ArmPlant, scenario: Scenario
) -> dict[str, int]:
    """Add the sensors of ``twin.sensors`` to a station and export their ports.

    Returns:
        Sizes of these ports by name.

    Raises:
        ScenarioError: a sensor cannot be built, two are alike, or defects are of a sensor that there is not.
    """
    found: dict[str, int] = {}
    for place, sensor in enumerate(scenario.twin.sensors):
        name = ports.of_sensor(sensor, plant.get_body(arm.arm.last_link).name())
        if name in found:
            raise ScenarioError(f"twin.sensors[{place}]", f"there is a port {name} already")
        defects = scenario.world.sensor_defects.get(name, SensorDefects())
        system = builder.AddNamedSystem(name, LinkSensorSystem(sensor, defects, plant, arm, place, scenario))
        builder.Connect(plant.get_body_poses_output_port(), system.GetInputPort("body_poses"))
        builder.Connect(plant.get_body_spatial_velocities_output_port(), system.GetInputPort("body_velocities"))
        builder.Connect(plant.get_body_spatial_accelerations_output_port(), system.GetInputPort("body_accelerations"))
        builder.Connect(plant.get_reaction_forces_output_port(), system.GetInputPort("reaction_forces"))
        builder.ExportOutput(system.GetOutputPort("reading"), name)
        builder.ExportOutput(system.GetOutputPort("time"), ports.time_of(name))
        found |= {name: SIZE, ports.time_of(name): 1}
    for name in scenario.world.sensor_defects:
        if name not in found:
            raise ScenarioError("world.sensor_defects", f"{name!r} is no sensor of twin.sensors: {sorted(found)}")
    return found


def _checked(defects: SensorDefects, kind: str, name: str) -> tuple[Array, Array]:
    """Return the noise and bias (6,) each."""
    field = f"world.sensor_defects.{name}"
    noise = defects.noise or list(NOISE[kind])
    if len(noise) != 2 or not all(0.0 <= std < np.inf for std in noise):
        raise ScenarioError(f"{field}.noise", f"{noise} is not two numbers, none of them negative")
    bias = defects.bias or [0.0] * SIZE
    if len(bias) != SIZE or not np.all(np.isfinite(bias)):
        raise ScenarioError(f"{field}.bias", f"{bias} is not six finite numbers")
    if any(len(span) != 2 or not span[0] <= span[1] for span in defects.missing):
        raise ScenarioError(f"{field}.missing", f"{defects.missing}: each is to be [start, end]")
    return np.repeat(np.array(noise, dtype=float), 3), np.array(bias, dtype=float)


def _loads(plant: MultibodyPlant, arm: ArmPlant, scenario: Scenario) -> list[Load]:
    """Return all bodies beyond the last arm joint, as the twin's description has them."""
    told = MultibodyPlant(0.0)
    try:
        placed = description.add_arm(told, scenario.twin.arm, scenario.packages)
    except ModelError as error:
        raise description.scenario_error("twin.arm", error) from error
    told.Finalize()
    beyond = [told.get_body(index) for index in told.GetBodiesKinematicallyAffectedBy([placed.joint_indices[-1]])]
    described = {body.name(): body for body in beyond}
    loads = []
    for index in plant.GetBodiesKinematicallyAffectedBy([arm.joints[-1].index()]):
        name = plant.get_body(index).name()
        if name not in described:
            continue
        inertia = described[name].default_spatial_inertia()
        mass = inertia.get_mass()
        if np.isfinite(mass) and mass > 0.0:
            moment = inertia.CalcRotationalInertia().CopyToFullMatrix3()
            loads.append(Load(int(index), mass, inertia.get_com(), moment))
    return loads
