"""Objects that are pushed along a path: a carriage with joints x, y and yaw under each, and what drives it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    JointActuator,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import WayPoint
from twin_diagram.signals.arrays import Array
from twin_diagram.station.add_models import transform


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    stiffness: float = 2e4
    """Of a carriage [N/m; N·m/rad for yaw]. Implicit, so that it may be stiff."""

    damping: float = 4e2
    """[N·s/m; N·m·s/rad]"""

    strength: float = 200.0
    """What a carriage pushes with at most, unless it is told [N; N·m]."""

    arm: float = 0.1
    """Where a force is told, a carriage turns with it at this distance at most [m]: half the edge of a box."""

    carriage: tuple[float, ...] = (1e-3, 0.01)
    """Mass [kg] and radius [m] of the ball that stands for a carriage: little beside any object."""

    planar: float = 1e-6
    """Way points whose z [m], roll or pitch [rad] differ by less lie in one plane: rounding."""


TUNING = Tuning()


class Path:
    """A smooth planar motion through way points, at rest before the first and after the last.

    Between way points the curve is a shape-preserving cubic: it does not overshoot them.
    """

    def __init__(self, waypoints: Sequence[WayPoint], field: str) -> None:
        """Check the way points and lay the curve.

        Args:
            waypoints: at least one, times strictly increasing.
            field: where they stand in the scenario, for the message.

        Raises:
            ScenarioError: times do not increase, or the object would leave its plane.
        """
        times = [w.time for w in waypoints]
        for i, (earlier, later) in enumerate(itertools.pairwise(times)):
            if not later > earlier:
                raise ScenarioError(f"{field}[{i + 1}].time", f"{later} is not after {earlier}")
        for i, waypoint in enumerate(waypoints):
            transform(waypoint.X_WO, f"{field}[{i}].X_WO")
        first = waypoints[0].X_WO
        for i, waypoint in enumerate(waypoints):
            fixed, still = ([p.translation[2], *p.rpy[:2]] for p in (waypoint.X_WO, first))
            if not np.allclose(fixed, still, rtol=0, atol=TUNING.planar):
                raise ScenarioError(f"{field}[{i}].X_WO", "it is pushed in x, y and yaw alone; z, roll and pitch stay")
        self.z = float(first.translation[2])
        self.rpy = np.array(first.rpy)
        yaw = np.unwrap([w.X_WO.rpy[2] for w in waypoints])
        self.points = np.vstack([np.array([w.X_WO.translation[:2] for w in waypoints]).T, yaw])
        self.start = np.array(self.points[:, 0])
        self._times = times
        if len(times) == 2:
            rest = np.zeros((3, 2))
            self._curve = PiecewisePolynomial.CubicHermite(times, self.points, rest)
        elif len(times) > 2:
            self._curve = PiecewisePolynomial.CubicShapePreserving(times, self.points, True)
        else:
            self._curve = None

    def state(self, time: float) -> tuple[Array, Array]:
        """Return (x, y, yaw) [m, m, rad] and its rate at `time`."""
        if self._curve is None or time <= self._times[0]:
            return self.points[:, 0], np.zeros(3)
        if time >= self._times[-1]:
            return self.points[:, -1], np.zeros(3)
        return self._curve.value(time)[:, 0], self._curve.EvalDerivative(time, 1)[:, 0]


def add_carriage(
    plant: MultibodyPlant,
    instance: ModelInstanceIndex,
    name: str,
    path: Path,
    body: RigidBody,
    push: float | None = None,
) -> list[JointActuator]:
    """Put a free body on a carriage that stands at the start of its path.

    Args:
        plant: not yet finalized.
        instance: that all carriages share.
        name: of the object.
        path: where it goes.
        body: the object's only body.
        push: what the carriage pushes with at most [N]; None for `Tuning.strength`.

    Returns:
        Actuators of x, y and yaw.
    """
    inertia = SpatialInertia.SolidSphereWithMass(*TUNING.carriage)
    parent = plant.world_frame()
    actuators: list[JointActuator] = []
    for k, axis in enumerate(("x", "y", "yaw")):
        carriage = plant.AddRigidBody(f"{name}_{axis}", instance, inertia)
        if axis == "yaw":
            joint = plant.AddJoint(RevoluteJoint(f"{name}_{axis}", parent, carriage.body_frame(), [0, 0, 1]))
        else:
            direction = np.eye(3)[k]
            joint = plant.AddJoint(PrismaticJoint(f"{name}_{axis}", parent, carriage.body_frame(), direction))
        joint.set_default_positions([path.start[k]])
        limit = TUNING.strength if push is None else push * (TUNING.arm if axis == "yaw" else 1.0)
        actuator = plant.AddJointActuator(f"{name}_{axis}", joint, limit)
        actuator.set_controller_gains(PdControllerGains(p=TUNING.stiffness, d=TUNING.damping))
        actuators.append(actuator)
        parent = carriage.body_frame()
    R_YO = RollPitchYaw(path.rpy[0], path.rpy[1], 0.0)
    plant.WeldFrames(parent, body.body_frame(), RigidTransform(R_YO, [0, 0, path.z]))
    return actuators


class MoverDriver(LeafSystem):
    """Says where the carriages of all moved objects should be.

    .. pydrake_system::

        name: MoverDriver
        output_ports:
        - desired_state

    `desired_state`: (2·3K) positions of all carriages' joints, then their speeds [m, m, rad], a function of time alone.
    """

    def __init__(self, paths: Mapping[str, Path]) -> None:
        """`paths` by object, in the order of their carriages."""
        super().__init__()
        self._paths = list(paths.values())
        size = 6 * len(self._paths)
        self.DeclareVectorOutputPort("desired_state", size, self._calc, prerequisites_of_calc={self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        states = [path.state(context.get_time()) for path in self._paths]
        output.SetFromVector(np.concatenate([x for x, _ in states] + [v for _, v in states]))
