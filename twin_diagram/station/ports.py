"""The names of a station's ports, and a check that a Diagram has them all.

Every station exports exactly these; only a simulated one adds `truth.*`, to which nothing but plots, scores and tests
may connect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from pydrake.systems.framework import Diagram, System

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.scenario import Camera, LinkSensor, Twin

POSITION_COMMANDED: Final = "arm.position_commanded"
"""(n,) joint angles [rad] or travel [m]."""
TORQUE_COMMANDED: Final = "arm.torque_commanded"
"""(n,) feed-forward torque [N·m] or force [N]."""
GRIPPER_COMMANDED: Final = "gripper.position_commanded"
"""(g,) travel of the fingers [m]."""
GRIPPER_FORCE_LIMIT: Final = "gripper.force_limit"
"""(1,) what the fingers squeeze with at most [N]: a force gauge between them shows it, and each presses with it. A
station may have this port or not; unconnected, or not a number: what the description allows."""

POSITION_MEASURED: Final = "arm.position_measured"
"""(n,) [rad or m]."""
VELOCITY_ESTIMATED: Final = "arm.velocity_estimated"
"""(n,) the driver's own estimate [rad/s or m/s]."""
TORQUE_MEASURED: Final = "arm.torque_measured"
"""(n,) positive along the joint, gravity's part included [N·m or N]."""
MEASUREMENT_TIME: Final = "arm.measurement_time"
"""When the three above were measured [s]; `NEVER` before the first message."""
GRIPPER_MEASURED: Final = "gripper.state_measured"
"""(2g,) positions [m], then speeds [m/s]."""

WRENCH_MEASURED: Final = "wrist.wrench_measured"
"""(6,) moment [N·m], then force [N] at the wrist sensor."""

ARM_STATE: Final = "truth.arm_state"
"""(2n,) true positions, then speeds."""
OBJECT_POSES: Final = "truth.object_poses"
"""(7K,) true X_WO as (qw, qx, qy, qz, px, py, pz)."""
QUERY_OBJECT: Final = "truth.query_object"
"""Drake's QueryObject of the true scene."""
CONTACT_RESULTS: Final = "truth.contact_results"
"""Drake's ContactResults of the true plant."""
SENSOR_SIZE: Final = 6
"""Numbers in a further sensor's reading."""
OPTIONAL: Final = {GRIPPER_FORCE_LIMIT: 1}
"""Input ports that a station with a gripper may have, with their sizes."""
TRUTH: Final = "truth."
"""What every port starts with that only a simulated station has."""


def rgb_image(camera: str) -> str:
    """Return the name of a camera's colour port."""
    return f"{camera}.rgb_image"


def depth_image(camera: str) -> str:
    """Return the name of a camera's depth port."""
    return f"{camera}.depth_image"


def image_time(camera: str) -> str:
    """Return the name of the port that gives the capture time of a camera's newest image."""
    return f"{camera}.image_time"


def imu(body: str) -> str:
    """Return the name of the port of an IMU on a link."""
    return f"{body}.imu"


def lidar(name: str) -> str:
    """Return the name of the port of a lidar's ranges."""
    return f"{name}.lidar"


def of_sensor(sensor: LinkSensor, last_link: str) -> str:
    """Return the name of the port of a further sensor; `last_link` of the arm is where one is that names no link."""
    return imu(sensor.body or last_link) if sensor.kind == "imu" else WRENCH_MEASURED


def time_of(port: str) -> str:
    """Return the name of the port that gives when a further sensor's newest reading was taken."""
    return f"{port.removesuffix('_measured')}_time"


def only_camera(twin: Twin, whose: str) -> Camera | None:
    """Return the one camera that a twin looks through, under its name; None: none.

    Args:
        twin: what it is told.
        whose: what knows no more than one, for the message: "the replay station plays".

    Raises:
        ScenarioError: there are several.
    """
    cameras = twin.perceiving
    if len(cameras) > 1:
        raise ScenarioError("twin.cameras", f"{whose} the pictures of one camera, not of {', '.join(cameras)}")
    return next(iter(cameras.values()), None)


def input_names(system: System) -> list[str]:
    """Return the names of a system's input ports, in order."""
    return [system.get_input_port(i).get_name() for i in range(system.num_input_ports())]


def output_names(system: System) -> list[str]:
    """Return the names of a system's output ports, in order."""
    return [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]


def expected(arm_size: int, gripper_size: int, cameras: Sequence[str]) -> tuple[dict[str, int], dict[str, int]]:
    """Return the contract: input and output ports by name, with their sizes (0 for an abstract port).

    Args:
        arm_size: n, number of arm joints.
        gripper_size: g, number of finger joints; 0 where there is no gripper.
        cameras: the cameras' names.
    """
    inputs = {POSITION_COMMANDED: arm_size, TORQUE_COMMANDED: arm_size}
    outputs = dict.fromkeys((POSITION_MEASURED, VELOCITY_ESTIMATED, TORQUE_MEASURED), arm_size)
    outputs[MEASUREMENT_TIME] = 1
    if gripper_size:
        inputs[GRIPPER_COMMANDED] = gripper_size
        outputs[GRIPPER_MEASURED] = 2 * gripper_size
    for camera in cameras:
        outputs |= {rgb_image(camera): 0, depth_image(camera): 0, image_time(camera): 1}
    return inputs, outputs


def check(
    station: Diagram, arm_size: int, gripper_size: int, cameras: Sequence[str], further: Mapping[str, int] | None = None
) -> None:
    """Check a station against the contract; `truth.*` and the ports of `further` sensors, by size, may come on top.

    Raises:
        StationError: a port is missing, surplus or of the wrong size; the message names it.
    """
    inputs, outputs = expected(arm_size, gripper_size, cameras)
    outputs |= further or {}
    optional = OPTIONAL if gripper_size else {}
    for kind, wanted, allowed, ports in (
        ("input", inputs, optional, [station.get_input_port(i) for i in range(station.num_input_ports())]),
        ("output", outputs, {}, [station.get_output_port(i) for i in range(station.num_output_ports())]),
    ):
        found = {port.get_name(): int(port.size()) for port in ports if not port.get_name().startswith(TRUTH)}
        for name in wanted.keys() - found.keys():
            raise StationError(f"the station has no {kind} port {name}; it has {', '.join(sorted(found))}")
        for name in found.keys() - wanted.keys() - allowed.keys():
            raise StationError(f"the station has an {kind} port {name} that the contract does not know")
        for name, size in (allowed | wanted).items():
            if found.get(name, size) != size:
                raise StationError(f"the station's {kind} port {name} has size {found[name]}, not {size}")
