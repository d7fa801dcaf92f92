"""The system that watches a station's ports and hands what is new on them to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort, System
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import StationError
from twin_diagram.scenario import Scenario
from twin_diagram.station import ports
from twin_diagram.station.add_models import twin_arm
from twin_diagram.station.replay.recording import RecordingWriter
from twin_diagram.station.replay.recording_folder import (
    Manifest,
    RecordedCamera,
    RecordedLidar,
    place_of,
    read_manifest,
)


def open_recording(scenario: Scenario, folder: str | Path, rows: BinaryIO | None = None) -> RecordingWriter:
    """Open a recording of what a scenario's station will show.

    Args:
        scenario: the one that the station is made from.
        folder: where the recording goes.
        rows: as of `RecordingWriter`.

    Returns:
        The writer, for `add_recorder`; use it as a context manager about the run.

    Raises:
        ScenarioError: the twin's arm cannot be loaded, or it looks through several cameras.
        StationError: the folder cannot be used.
    """
    plant = MultibodyPlant(0.0)
    arm = twin_arm(scenario, plant)
    last_link = plant.get_body(arm.last_link).name()
    sensors = [ports.of_sensor(sensor, last_link) for sensor in scenario.twin.sensors]
    camera = ports.only_camera(scenario.twin, "a recording holds")
    recorded = None
    if camera is not None:
        unit = depth_unit(scenario)
        size = None if camera.depth is None else list(camera.depth_size)
        recorded = RecordedCamera(camera.name, camera.width, camera.height, camera.rate, camera.latency, unit, size)
    lidar = scenario.twin.lidar
    scanned = None if lidar is None else RecordedLidar(lidar.name, lidar.columns, lidar.rows)
    manifest = Manifest(list(arm.joints), list(arm.gripper_joints), recorded, sensors, scanned)
    return RecordingWriter(folder, manifest, rows)


def depth_unit(scenario: Scenario) -> float:
    """Return the length of which the depths on the station's port are whole numbers [m]."""
    if scenario.station == "lcm":
        return scenario.lcm.depth_unit
    if scenario.station == "replay" and (folder := Path(scenario.replay.log)).is_dir():
        camera = read_manifest(place_of(folder)).camera
        return 1.0 if camera is None else camera.depth_unit  # nothing is shown of a camera that was not recorded
    return scenario.world.camera_defects.depth_unit


class Recorder(LeafSystem):
    """Writes each new message, image and scan of a station.

    .. pydrake_system::

        name: Recorder
        input_ports:
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
        - arm.position_commanded

    Looks at the end of each step of the simulator. A message that is new there came to stand on the ports by an
    update at the start of that step, which is where the step before ended: that is its delivery time, to the bit.
    Where there is no command yet, the measured position is written as the command: the arm holds its pose. Keeps no
    state in the Context; what it has written is the writer's. One run, one recorder.

    Attributes:
        sensors: further sensors that it looks at, by their ports; the lidar, too.
    """

    def __init__(self, writer: RecordingWriter) -> None:
        """`writer`: open."""
        super().__init__()
        manifest = writer.manifest
        n, g = len(manifest.joints), len(manifest.gripper_joints)
        camera = None if manifest.camera is None else manifest.camera.name
        self._writer = writer
        self.sensors = tuple(manifest.sensors)
        self._vectors = {
            name: self.DeclareVectorInputPort(port, n)
            for name, port in (
                ("position_measured", ports.POSITION_MEASURED),
                ("velocity_estimated", ports.VELOCITY_ESTIMATED),
                ("torque_measured", ports.TORQUE_MEASURED),
            )
        }
        self._time = self.DeclareVectorInputPort(ports.MEASUREMENT_TIME, 1)
        self._command = self.DeclareVectorInputPort(ports.POSITION_COMMANDED, n)
        if g:
            self._vectors["gripper"] = self.DeclareVectorInputPort(ports.GRIPPER_MEASURED, 2 * g)
        self._sensors = [
            (
                name,
                self.DeclareVectorInputPort(name, ports.SENSOR_SIZE),
                self.DeclareVectorInputPort(ports.time_of(name), 1),
            )
            for name in manifest.sensors
        ]
        self._read = dict.fromkeys(manifest.sensors, -1.0)  # times of the newest readings that were written
        self._image_time = None
        if camera is not None:
            self._rgb = self.DeclareAbstractInputPort(ports.rgb_image(camera), Value(ImageRgba8U()))
            self._depth = self.DeclareAbstractInputPort(ports.depth_image(camera), Value(ImageDepth32F()))
            self._image_time = self.DeclareVectorInputPort(ports.image_time(camera), 1)
        self._scan_time = None
        if manifest.lidar is not None:
            port = ports.lidar(manifest.lidar.name)
            self.sensors += (port,)
            self._ranges = self.DeclareVectorInputPort(port, manifest.lidar.columns * manifest.lidar.rows)
            self._scan_time = self.DeclareVectorInputPort(ports.time_of(port), 1)
        self._message, self._image, self._scan = -1.0, -1.0, -1.0  # times of the newest that were written
        self._before = 0.0  # end of the step before
        self.DeclarePerStepPublishEvent(self._look)

    def _look(self, context: Context) -> EventStatus:
        now = context.get_time()
        if now < self._before:
            raise StationError(f"a recording holds one run; time went back from {self._before} to {now} s")
        time = float(self._time.Eval(context)[0])
        if time > self._message:
            self._message = time
            signals = {name: port.Eval(context) for name, port in self._vectors.items()}
            command = self._command.Eval(context) if self._command.HasValue(context) else None
            held = command is None or not all(abs(x) < float("inf") for x in command)
            signals["position_commanded"] = signals["position_measured"] if held else command
            self._writer.message(time, self._before, signals)
        for name, reading, taken in self._sensors:
            time = float(taken.Eval(context)[0]) if taken.HasValue(context) else -1.0
            if time > self._read[name]:
                self._read[name] = time
                self._writer.reading(name, time, self._before, reading.Eval(context))
        if self._image_time is not None:
            time = float(self._image_time.Eval(context)[0])
            if time > self._image:
                self._image = time
                rgb, depth = self._rgb.Eval(context).data, self._depth.Eval(context).data[..., 0]
                self._writer.image(time, self._before, rgb, depth)
        if self._scan_time is not None:
            time = float(self._scan_time.Eval(context)[0]) if self._scan_time.HasValue(context) else -1.0
            if time > self._scan:
                self._scan = time
                self._writer.scan(time, self._before, self._ranges.Eval(context))
        self._before = now
        return EventStatus.Succeeded()


def add_recorder(
    builder: DiagramBuilder,
    station: System,
    writer: RecordingWriter,
    position_commanded: OutputPort | None = None,
) -> Recorder:
    """Add a recorder and connect it.

    Args:
        builder: where the station is.
        station: whose ports are recorded.
        writer: open.
        position_commanded: what commands the station; None: nothing does.
    """
    recorder = Recorder(writer)
    builder.AddNamedSystem("recorder", recorder)
    for name in ports.input_names(recorder):
        if name != ports.POSITION_COMMANDED and (station.HasOutputPort(name) or not _further(recorder, name)):
            builder.Connect(station.GetOutputPort(name), recorder.GetInputPort(name))
    if position_commanded is not None:
        builder.Connect(position_commanded, recorder.GetInputPort(ports.POSITION_COMMANDED))
    return recorder


def _further(recorder: Recorder, name: str) -> bool:
    """Return whether an input is a further sensor's: not every station has those."""
    return any(name in (sensor, ports.time_of(sensor)) for sensor in recorder.sensors)
