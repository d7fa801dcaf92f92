"""Which of the arm's further sensors the filter fuses, and by which of a station's ports their readings come.

``twin.sensors`` says what is on the arm, ``twin.filter.sensors`` what the filter makes of it; an entry of the second
belongs to the one of the first that is of its kind and on its link. `depth` and `lidar` are none of these: they are
what the twin's camera sees of a link, and what its lidar meets of one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.sensors import LIDAR_NOISE
from twin_diagram.model.model import Model
from twin_diagram.scenario import Camera, Lidar, LinkSensor, Pose, SensorSpec, Twin, poses
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import ports
from twin_diagram.station.scan_cloud import ScanCloud
from twin_diagram.twin.arm_sensing.cloud_measurement import feed
from twin_diagram.twin.arm_sensing.depth_pose import TUNING as DEPTH_POSE
from twin_diagram.twin.arm_sensing.depth_pose import ArmCloud
from twin_diagram.twin.arm_sensing.lidar_pose import ArmScan
from twin_diagram.twin.arm_sensing.link_surface import link_surface, other_surfaces

Packages = Mapping[str, str | Path]

USED = "torque"
"""The kind whose reading the twin's filter has used already."""
DEPTH = "depth"
"""The kind that is the twin's camera."""
LIDAR = "lidar"
"""The kind that is the twin's lidar."""


@dataclass(frozen=True)
class Fused:
    """One sensor of the filter.

    Attributes:
        spec: with name, link and pose filled in, as the filter is told.
        reading, time: the station's ports; of a camera that of its depth image.
        camera, lidar: whether the reading is made of images, or of scans.
    """

    spec: SensorSpec
    reading: str
    time: str
    camera: bool = False
    lidar: bool = False


def fused_sensors(twin: Twin, last_link: str) -> list[Fused]:
    """Return the filter's further sensors, in its order.

    Args:
        twin: what the twin is told.
        last_link: of the arm: where a sensor is that names no link.

    Raises:
        ScenarioError: the filter is to fuse what no sensor on the arm measures, or one reading twice.
    """
    found: list[Fused] = []
    for index, spec in enumerate(twin.filter.sensors):
        field = f"twin.filter.sensors.{index}"
        if spec.kind == USED:
            raise ScenarioError(field, "the twin's filter predicts with the torque measured; a reading counts once")
        if spec.kind == DEPTH:
            fused = _seen(spec, _first(twin), last_link, field)
        elif spec.kind == LIDAR:
            fused = _met(spec, twin.lidar, last_link, field)
        else:
            fused = _on_arm(spec, twin.sensors, last_link, field)
        place = (fused.reading, fused.spec.body)
        if any((other.reading, other.spec.body) == place for other in found):
            raise ScenarioError(field, f"{fused.reading} is fused already; a reading counts once")
        if any(other.spec.name == fused.spec.name for other in found):
            raise ScenarioError(f"{field}.name", f"there is a sensor {fused.spec.name!r} already; name this one")
        found.append(fused)
    return found


def export(
    builder: DiagramBuilder,
    ekf: AdaptiveEkf,
    fused: Sequence[Fused],
    twin: Twin,
    model: Model,
    packages: Packages | None,
) -> None:
    """Make the filter's further inputs those of the twin, by the station's names; call it when those of images exist.

    Args:
        builder: of the twin.
        ekf: in it.
        fused: its further sensors.
        twin: what it is told.
        model: of the arm.
        packages: local folders for `package://` names.

    Raises:
        ModelError: a link of which nothing is to be seen.
    """
    for sensor in fused:
        name = sensor.spec.name
        reading, time = ekf.GetInputPort(f"{name}.reading"), ekf.GetInputPort(f"{name}.time")
        if sensor.lidar:
            assert twin.lidar is not None
            surface = link_surface(twin.arm, sensor.spec.body, packages)
            others = other_surfaces(twin.arm, sensor.spec.body, packages)
            cloud = builder.AddNamedSystem(f"{name}_cloud", ScanCloud(twin.lidar))
            floor_p, floor_r = sensor.spec.std or DEPTH_POSE.floor
            noise = replace(LIDAR_NOISE, floor_p=floor_p, floor_r=floor_r)
            scan = ArmScan.AddToBuilder(
                builder, ekf, name, sensor.spec.body, surface, poses.pose(twin.lidar.X_WS), others, noise
            )
            builder.ExportInput(cloud.get_input_port(), sensor.reading)
            builder.ExportInput(scan.GetInputPort("scan_time"), sensor.time)
            builder.Connect(cloud.get_output_port(), scan.GetInputPort("point_cloud"))
            continue
        if not sensor.camera:
            builder.ExportInput(reading, sensor.reading)
            builder.ExportInput(time, sensor.time)
            continue
        camera = _first(twin)
        assert camera is not None
        surface = link_surface(twin.arm, sensor.spec.body, packages)
        cloud = builder.AddNamedSystem(f"{name}_cloud", ArmCloud(model, sensor.spec, camera, surface))
        builder.ConnectInput(sensor.reading, cloud.GetInputPort("depth_image"))
        builder.ConnectInput(sensor.time, cloud.GetInputPort("image_time"))
        builder.ConnectInput(sensor.time, time)
        builder.Connect(ekf.GetOutputPort("arm_state"), cloud.GetInputPort("arm_state"))
        feed(builder, cloud.get_output_port(), ekf, name)


def sensors_of(fused: Sequence[Fused]) -> list[str]:
    """Return the ports of further sensors, readings and times, for which `silence` may stand in."""
    return [port for sensor in fused if not sensor.camera for port in (sensor.reading, sensor.time)]


def silence(builder: DiagramBuilder, twin: Diagram, station: System, fused: Sequence[Fused]) -> list[str]:
    """Stand in for sensors that a station does not have, a bare log for example: they never measure anything.

    Args:
        builder: holds both.
        twin: with the ports of `export`.
        station: any.
        fused: sensors of the twin.

    Returns:
        The sensors' ports that the station lacks.
    """
    missing = [sensor for sensor in fused if not sensor.camera and not station.HasOutputPort(sensor.reading)]
    for sensor in missing:
        size = twin.GetInputPort(sensor.reading).size()
        for port, value in ((sensor.reading, [0.0] * size), (sensor.time, [NEVER])):
            source = builder.AddNamedSystem(f"no {port}", ConstantVectorSource(value))
            builder.Connect(source.get_output_port(), twin.GetInputPort(port))
    return [sensor.reading for sensor in missing]


def _first(twin: Twin) -> Camera | None:
    """Return the camera that the arm is seen by: the first of those that the twin looks through."""
    return next(iter(twin.perceiving.values()), None)


def _seen(spec: SensorSpec, camera: Camera | None, last_link: str, field: str) -> Fused:
    if camera is None:
        raise ScenarioError(field, "twin.camera is null: there is nothing to see the arm with")
    if spec.std and (len(spec.std) != len(DEPTH_POSE.floor) or not min(spec.std) > 0.0):
        raise ScenarioError(f"{field}.std", f"{spec.std} is not two positive numbers")
    filled = replace(spec, kind="body_pose", name=spec.name or spec.kind, body=spec.body or last_link)
    return Fused(filled, ports.depth_image(camera.name), ports.image_time(camera.name), camera=True)


def _met(spec: SensorSpec, lidar: Lidar | None, last_link: str, field: str) -> Fused:
    if lidar is None:
        raise ScenarioError(field, "twin.lidar is null: there is nothing to scan the arm with")
    if spec.X_BS != Pose():
        raise ScenarioError(f"{field}.X_BS", "a lidar finds the link's own frame")
    if spec.std and (len(spec.std) != len(DEPTH_POSE.floor) or not min(spec.std) > 0.0):
        raise ScenarioError(f"{field}.std", f"{spec.std} is not two positive numbers")
    filled = replace(spec, kind="body_pose", name=spec.name or spec.kind, body=spec.body or last_link)
    port = ports.lidar(lidar.name)
    return Fused(filled, port, ports.time_of(port), lidar=True)


def _on_arm(spec: SensorSpec, sensors: Sequence[LinkSensor], last_link: str, field: str) -> Fused:
    body = spec.body or last_link
    for sensor in sensors:
        if sensor.kind == spec.kind and (sensor.body or last_link) == body:
            port = ports.of_sensor(sensor, last_link)
            X_BS = sensor.X_BS if spec.X_BS == Pose() else spec.X_BS
            filled = replace(spec, name=spec.name or spec.kind, body=body, X_BS=X_BS)
            return Fused(filled, port, ports.time_of(port))
    known = ", ".join(f"{sensor.kind} on {sensor.body or last_link}" for sensor in sensors) or "none"
    raise ScenarioError(field, f"no {spec.kind or 'such sensor'} on {body} among twin.sensors; there: {known}")
