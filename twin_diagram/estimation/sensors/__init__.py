"""Sensor models, one to a file: what each should read, how that depends on the state, its noise and its gate."""

from __future__ import annotations

from twin_diagram.estimation.sensors.body_pose import BodyPose, PoseBias
from twin_diagram.estimation.sensors.cloud_pose import CloudError, DepthCloud, PointNoise
from twin_diagram.estimation.sensors.joints import JointEncoder, JointState, JointVelocity, StateSensor
from twin_diagram.estimation.sensors.lidar_pose import LIDAR_NOISE, LidarPose
from twin_diagram.estimation.sensors.link_imu import ImuBias, LinkImu
from twin_diagram.estimation.sensors.motor_torque import MotorTorque
from twin_diagram.estimation.sensors.sensor import Instant, Linear, Sensor
from twin_diagram.estimation.sensors.wrist_wrench import KnownTool, WrenchBias, WristWrench

__all__ = [
    "LIDAR_NOISE",
    "BodyPose",
    "CloudError",
    "DepthCloud",
    "ImuBias",
    "Instant",
    "JointEncoder",
    "JointState",
    "JointVelocity",
    "KnownTool",
    "LidarPose",
    "Linear",
    "LinkImu",
    "MotorTorque",
    "PointNoise",
    "PoseBias",
    "Sensor",
    "StateSensor",
    "WrenchBias",
    "WristWrench",
]
