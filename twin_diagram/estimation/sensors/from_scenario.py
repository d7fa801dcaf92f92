"""Sensors as a scenario names them."""

from __future__ import annotations

from typing import Any

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.sensors.body_pose import BodyPose
from twin_diagram.estimation.sensors.link_imu import LinkImu
from twin_diagram.estimation.sensors.motor_torque import MotorTorque
from twin_diagram.estimation.sensors.sensor import Sensor
from twin_diagram.estimation.sensors.wrist_wrench import WristWrench
from twin_diagram.scenario import SensorSpec
from twin_diagram.scenario.poses import pose

FIGURES = {"body_pose": ("std_p", "std_r"), "imu": ("gyro_std", "accel_std"), "wrench": ("force_std", "moment_std")}
"""What the numbers of `SensorSpec.std` are, by kind."""


def make_sensor(terms: ArmTerms, spec: SensorSpec) -> Sensor:
    """Make one.

    Raises:
        ScenarioError: a kind that does not exist, or figures that do not fit it.
        ModelError: the plant has no such link or frame.
    """
    wanted = len(FIGURES.get(spec.kind, ("std",)))
    if spec.kind not in (*FIGURES, "torque"):
        raise ScenarioError("twin.filter.sensors.kind", f"{spec.kind!r} is none of {', '.join(FIGURES)}, torque")
    if spec.std and (len(spec.std) != wanted or not all(std > 0.0 for std in spec.std)):
        raise ScenarioError("twin.filter.sensors.std", f"{spec.std} is not {wanted} positive numbers")
    name, body, X_BS = spec.name or spec.kind, spec.body or terms.link_frame, pose(spec.X_BS)
    figures: dict[str, Any] = dict(zip(FIGURES.get(spec.kind, ("std",)), spec.std, strict=False))
    if spec.kind == "body_pose":
        return BodyPose(terms, body, X_BO=X_BS, name=name, **figures)
    if spec.kind == "imu":
        return LinkImu(terms, body, X_BS, name=name, **figures)
    if spec.kind == "wrench":
        return WristWrench(terms, body, X_BS, name=name, **figures)
    return MotorTorque(terms.n, name=name, **figures)
