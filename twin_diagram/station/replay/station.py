"""The replay station: a recorded run or a measured log, shown on the ports of every station as it came."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.scenario import Lidar, Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import ports
from twin_diagram.station.add_models import twin_arm
from twin_diagram.station.depth_units import units_to_depth
from twin_diagram.station.ignored_commands import IgnoredCommands
from twin_diagram.station.replay.reading import (
    Frames,
    Messages,
    Readings,
    newest,
    read_frames,
    read_log,
    read_recording,
    read_sensors,
)
from twin_diagram.station.replay.recording_folder import depth_file, place_of, read_manifest, rgb_file
from twin_diagram.station.replay.scan_player import ScanPlayer, Scans, read_scans


class MessagePlayer(LeafSystem):
    """Shows recorded messages of an arm.

    .. pydrake_system::

        name: MessagePlayer
        output_ports:
        - position_measured
        - velocity_estimated
        - torque_measured
        - measurement_time
        - gripper_measured

    Units and sizes as on any station; zeros and `NEVER` before the first message. Each message stands from its
    delivery to the next one's. A function of time alone.
    """

    def __init__(self, messages: Messages) -> None:
        """`messages`: at least one."""
        super().__init__()
        self._delivery = messages.delivery
        signals = {
            "position_measured": messages.position,
            "velocity_estimated": messages.velocity,
            "torque_measured": messages.torque,
            "measurement_time": messages.time[:, None],
        }
        if messages.gripper is not None:
            signals["gripper_measured"] = messages.gripper
        for name, values in signals.items():
            before = np.full(values.shape[1], NEVER if name == "measurement_time" else 0.0)

            def calc(context: Context, output: BasicVector, values: Array = values, before: Array = before) -> None:
                k = newest(self._delivery, context.get_time())
                output.SetFromVector(values[k] if k >= 0 else before)

            self.DeclareVectorOutputPort(name, values.shape[1], calc, {self.time_ticket()})


class ReadingPlayer(LeafSystem):
    """Shows recorded readings of a further sensor.

    .. pydrake_system::

        name: ReadingPlayer
        output_ports:
        - reading
        - time

    As on any station; zeros and `NEVER` before the first. Each stands from its delivery to the next one's. A function
    of time alone.
    """

    def __init__(self, readings: Readings) -> None:
        """`readings`: may be empty."""
        super().__init__()
        self._readings = readings
        ticket = {self.time_ticket()}
        self.DeclareVectorOutputPort("reading", ports.SENSOR_SIZE, self._calc_reading, ticket)
        self.DeclareVectorOutputPort("time", 1, self._calc_time, ticket)

    def _calc_reading(self, context: Context, output: BasicVector) -> None:
        k = newest(self._readings.delivery, context.get_time())
        output.SetFromVector(self._readings.values[k] if k >= 0 else np.zeros(ports.SENSOR_SIZE))

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        k = newest(self._readings.delivery, context.get_time())
        output[0] = self._readings.time[k] if k >= 0 else NEVER


class ImagePlayer(LeafSystem):
    """Shows recorded images.

    .. pydrake_system::

        name: ImagePlayer
        output_ports:
        - rgb_image
        - depth_image
        - image_time

    As on any station; black, empty and `NEVER` before the first. Each image stands from its delivery to the next
    one's. A function of time alone; the image that was read last is kept.
    """

    def __init__(self, frames: Frames) -> None:
        """`frames`: may be empty."""
        super().__init__()
        self._frames = frames
        self._kept: dict[str, tuple[int, npt.NDArray[np.uint8] | npt.NDArray[np.float32]]] = {}
        ticket = {self.time_ticket()}
        rgb, depth = ImageRgba8U(frames.width, frames.height), ImageDepth32F(*frames.depth_size)
        self.DeclareAbstractOutputPort("rgb_image", Value(rgb).Clone, self._calc_rgb, ticket)
        self.DeclareAbstractOutputPort("depth_image", Value(depth).Clone, self._calc_depth, ticket)
        self.DeclareVectorOutputPort("image_time", 1, self._calc_time, ticket)

    def _newest(self, context: Context) -> int:
        return newest(self._frames.delivery, context.get_time())

    def _read(self, kind: str, name: str, k: int) -> npt.NDArray[np.uint8] | npt.NDArray[np.float32]:
        """Return one of the newest frame's images; a frame's images never change, so that keeping them is no state."""
        kept = self._kept.get(kind)
        if kept is not None and kept[0] == k:
            return kept[1]
        path = self._frames.folder / name
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        width, height = self._frames.depth_size if kind == "depth" else (self._frames.width, self._frames.height)
        wanted = (height, width)
        if image is None or image.shape[:2] != wanted:
            raise StationError(f"{path}: not a PNG image of {wanted[1]}×{wanted[0]} pixels")
        if kind == "depth":
            if image.dtype != np.uint16 or image.ndim != 2:
                raise StationError(f"{path}: not a depth image of 16 bits")
            result = units_to_depth(image, self._frames.depth_unit)
        else:
            if image.dtype != np.uint8 or image.ndim != 3:
                raise StationError(f"{path}: not a colour image of 8 bits")
            result = np.dstack([image[..., 2::-1], np.full(wanted, 255, np.uint8)])
        self._kept[kind] = (k, result)
        return result

    def _calc_rgb(self, context: Context, output: Value) -> None:
        image = ImageRgba8U(self._frames.width, self._frames.height)
        k = self._newest(context)
        image.mutable_data[:] = self._read("rgb", rgb_file(self._frames.index[k]), k) if k >= 0 else (0, 0, 0, 255)
        output.set_value(image)

    def _calc_depth(self, context: Context, output: Value) -> None:
        image = ImageDepth32F(*self._frames.depth_size)
        k = self._newest(context)
        if k >= 0:
            image.mutable_data[..., 0] = self._read("depth", depth_file(self._frames.index[k]), k)
        else:
            image.mutable_data[:] = 0.0
        output.set_value(image)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        k = self._newest(context)
        output[0] = self._frames.capture[k] if k >= 0 else NEVER


class ReplayArmStation(Diagram):
    """A recorded run behind the ports of every station; commands are taken and ignored.

    .. pydrake_system::

        name: ReplayArmStation
        input_ports:
        - arm.position_commanded
        - arm.torque_commanded
        - gripper.position_commanded
        output_ports:
        - arm.position_measured
        - arm.velocity_estimated
        - arm.torque_measured
        - arm.measurement_time
        - gripper.state_measured
        - <camera>.rgb_image
        - <camera>.depth_image
        - <camera>.image_time
        - <body>.imu
        - <body>.imu_time
        - wrist.wrench_measured
        - wrist.wrench_time
        - <lidar>.lidar
        - <lidar>.lidar_time

    A recording's folder shows everything at the times at which the live station showed it, bit for bit. A bare log's
    times are counted from its first sample, and each sample stands from its own time on; angles that jump by a turn go
    on, and it has no images. Reads `twin` and `replay` of the scenario, never `world`.

    Attributes:
        end: time of the last message [s].
    """

    end: float

    def __init__(self, scenario: Scenario) -> None:
        """Open the log or recording that ``replay.log`` names.

        Raises:
            ScenarioError: no log is named.
            StationError, LogError: it is missing, malformed, or of another arm or camera.
        """
        super().__init__()
        path = _existing(scenario.replay.log)
        plant = MultibodyPlant(0.0)
        arm = twin_arm(scenario, plant)
        camera = ports.only_camera(scenario.twin, "the replay station plays")
        folder = place_of(path) if path.is_dir() else None
        sensors: dict[str, Readings] = {}
        scans: Scans | None = None
        if folder is not None:
            manifest = read_manifest(folder)
            messages = read_recording(folder, manifest, arm.joints, arm.gripper_joints)
            frames = read_frames(folder, manifest, camera)
            sensors = read_sensors(folder, manifest)
            scans = read_scans(folder, manifest, scenario.twin.lidar)
        else:
            revolute = ~np.isin(arm.joints, list(arm.prismatic(plant)))
            messages = read_log(path, arm.joints, revolute, scenario.replay.columns, scenario.replay.torque_constants)
            frames = read_frames(path.parent, None, camera)
        self.end = float(messages.delivery[-1])
        n, g = len(arm.joints), len(arm.gripper_joints)

        builder = DiagramBuilder()
        player = builder.AddNamedSystem("messages", MessagePlayer(messages))
        commands = ports.expected(n, g, ())[0]
        ignored = builder.AddNamedSystem("ignored_commands", IgnoredCommands(commands))
        for name in commands:
            builder.ExportInput(ignored.GetInputPort(name), name)
        builder.ExportOutput(player.GetOutputPort("position_measured"), ports.POSITION_MEASURED)
        builder.ExportOutput(player.GetOutputPort("velocity_estimated"), ports.VELOCITY_ESTIMATED)
        builder.ExportOutput(player.GetOutputPort("torque_measured"), ports.TORQUE_MEASURED)
        builder.ExportOutput(player.GetOutputPort("measurement_time"), ports.MEASUREMENT_TIME)
        if g:
            if messages.gripper is not None:
                gripper = player.GetOutputPort("gripper_measured")
            else:
                still = builder.AddNamedSystem("no_gripper", ConstantVectorSource(np.full(2 * g, np.nan)))
                gripper = still.get_output_port()
            builder.ExportOutput(gripper, ports.GRIPPER_MEASURED)
        if camera is not None:
            images = builder.AddNamedSystem("images", ImagePlayer(frames))
            builder.ExportOutput(images.GetOutputPort("rgb_image"), ports.rgb_image(camera.name))
            builder.ExportOutput(images.GetOutputPort("depth_image"), ports.depth_image(camera.name))
            builder.ExportOutput(images.GetOutputPort("image_time"), ports.image_time(camera.name))
        further = _add_further_sensors(builder, sensors, scans, scenario.twin.lidar)
        builder.BuildInto(self)
        self.set_name("station")
        ports.check(self, n, g, (camera.name,) if camera else (), further)


def _existing(log: str) -> Path:
    if not log:
        raise ScenarioError("replay.log", "names no log; give a CSV or .npz file or a recording's folder")
    path = Path(log).expanduser()
    if not path.exists():
        raise StationError(f"replay.log: {path}: no such file or folder")
    return path


def _add_further_sensors(
    builder: DiagramBuilder, sensors: dict[str, Readings], scans: Scans | None, lidar: Lidar | None
) -> dict[str, int]:
    """Add what plays the readings of sensors on links, and scans; return the sizes of their ports by name."""
    further: dict[str, int] = {}
    for name, readings in sensors.items():
        sensor = builder.AddNamedSystem(name, ReadingPlayer(readings))
        builder.ExportOutput(sensor.GetOutputPort("reading"), name)
        builder.ExportOutput(sensor.GetOutputPort("time"), ports.time_of(name))
        further |= {name: ports.SENSOR_SIZE, ports.time_of(name): 1}
    if scans is not None and lidar is not None:
        name = ports.lidar(lidar.name)
        player = builder.AddNamedSystem(name, ScanPlayer(scans))
        builder.ExportOutput(player.GetOutputPort("ranges"), name)
        builder.ExportOutput(player.GetOutputPort("scan_time"), ports.time_of(name))
        further |= {name: scans.size, ports.time_of(name): 1}
    return further
