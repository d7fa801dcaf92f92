"""Sensor models, one to a file: what each should read, how that depends on the state, its noise and its gate."""

from __future__ import annotations

from twin_diagram.estimation.sensors.body_pose import BodyPose
from twin_diagram.estimation.sensors.cloud_pose import CloudError, DepthCloud
from twin_diagram.estimation.sensors.joints import JointEncoder, JointState, JointVelocity, StateSensor
from twin_diagram.estimation.sensors.lidar_pose import LidarPose
from twin_diagram.estimation.sensors.link_imu import LinkImu
from twin_diagram.estimation.sensors.motor_torque import MotorTorque
from twin_diagram.estimation.sensors.sensor import Instant, Linear, Sensor
from twin_diagram.estimation.sensors.wrist_wrench import WristWrench

__all__ = [
    "BodyPose",
    "CloudError",
    "DepthCloud",
    "Instant",
    "JointEncoder",
    "JointState",
    "JointVelocity",
    "LidarPose",
    "Linear",
    "LinkImu",
    "MotorTorque",
    "Sensor",
    "StateSensor",
    "WristWrench",
]
