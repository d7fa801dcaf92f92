"""Which of the arm's further sensors the filter fuses, and by which of a station's ports their readings come.

``twin.sensors`` says what is on the arm, ``twin.filter.sensors`` what the filter makes of it; an entry of the second
belongs to the one of the first that is of its kind and on its link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.scenario import LinkSensor, Pose, SensorSpec, Twin
from twin_diagram.signals import NEVER
from twin_diagram.station import ports

USED = "torque"
"""The kind whose reading the twin's filter has used already."""


@dataclass(frozen=True)
class Fused:
    """One sensor of the filter.

    Attributes:
        spec: with name, link and pose filled in.
        reading, time: the station's ports.
    """

    spec: SensorSpec
    reading: str
    time: str


def fused_sensors(twin: Twin, last_link: str) -> list[Fused]:
    """The filter's further sensors, in its order.

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
        fused = _on_arm(spec, twin.sensors, last_link, field)
        if any(other.reading == fused.reading for other in found):
            raise ScenarioError(field, f"{fused.reading} is fused already; a reading counts once")
        if any(other.spec.name == fused.spec.name for other in found):
            raise ScenarioError(f"{field}.name", f"there is a sensor {fused.spec.name!r} already; name this one")
        found.append(fused)
    return found


def export(builder: DiagramBuilder, ekf: AdaptiveEkf, fused: Sequence[Fused]) -> None:
    """Makes the filter's inputs those of the twin, by the station's names."""
    for sensor in fused:
        builder.ExportInput(ekf.GetInputPort(f"{sensor.spec.name}.reading"), sensor.reading)
        builder.ExportInput(ekf.GetInputPort(f"{sensor.spec.name}.time"), sensor.time)


def silence(builder: DiagramBuilder, twin: Diagram, station: Diagram, fused: Sequence[Fused]) -> list[str]:
    """Stands in for sensors that a station does not have, a bare log for example: they never measure anything.

    Args:
        builder: holds both.
        twin: with the ports of `export`.
        station: any.
        fused: sensors of the twin.

    Returns:
        The sensors' ports that the station lacks.
    """
    missing = [sensor for sensor in fused if not station.HasOutputPort(sensor.reading)]
    for sensor in missing:
        size = twin.GetInputPort(sensor.reading).size()
        for port, value in ((sensor.reading, [0.0] * size), (sensor.time, [NEVER])):
            source = builder.AddNamedSystem(f"no {port}", ConstantVectorSource(value))
            builder.Connect(source.get_output_port(), twin.GetInputPort(port))
    return [sensor.reading for sensor in missing]


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
