"""Wires a station and the twin to one closed loop, each port to its namesake."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from twin_diagram.model.model import Model
from twin_diagram.perception.segmentation.learned import Segmenter
from twin_diagram.scenario.file import check_scenario
from twin_diagram.scenario.scenario import Scenario
from twin_diagram.station import ports
from twin_diagram.station.make_station import make_station
from twin_diagram.twin.fused_sensors import sensors_of, silence
from twin_diagram.twin.own_systems import check_station
from twin_diagram.twin.twin import TwinDiagram, make_twin

OWN = "own"
"""In the place of a scenario's `station`: the loop was given one."""


@dataclass(frozen=True, repr=False)
class ClosedLoop:
    """A station and the twin that watches and drives it; with a station of one's own `scenario.station` is `OWN`."""

    diagram: Diagram
    scenario: Scenario
    station: System
    twin: TwinDiagram

    def __repr__(self) -> str:
        """Say in one line what is in it: a notebook shows it."""
        return f"ClosedLoop(station={self.scenario.station!r}, twin={self.twin!r})"

    @property
    def model(self) -> Model:
        """The twin's model of the arm."""
        return self.twin.model


def make_closed_loop(
    scenario: Scenario,
    add: Callable[[DiagramBuilder, System, TwinDiagram], None] | None = None,
    *,
    station: System | None = None,
    controller: System | None = None,
    perception: System | None = None,
    segmenter: Segmenter | None = None,
) -> ClosedLoop:
    """Build the station that a scenario asks for and the twin, and connect each port to its namesake.

    Args:
        scenario: of the station and the twin.
        add: called with the builder, the station and the twin before the Diagram is built: adds visualisers, loggers.
        station: one's own, a driver for example, in the place of the one that the scenario asks for; its ports: see
            `own_systems`.
        controller: one's own in the place of `Mpc`: see `make_twin`.
        perception: one's own in the place of the twin's: see `make_twin`.
        segmenter: one's own, of images: see `make_twin`.

    Raises:
        TwinError: something that the scenario names does not exist or does not fit; the message names the field.
    """
    check_scenario(scenario)
    builder = DiagramBuilder()
    twin = make_twin(
        scenario.twin, scenario.packages, controller=controller, perception=perception, segmenter=segmenter
    )
    if station is None:
        station = make_station(scenario)
    else:
        check_station(station, twin.diagram, sensors_of(twin.fused))
        scenario = replace(scenario, station=OWN)
    connect(builder, station, twin)
    if add is not None:
        add(builder, station, twin)
    diagram = builder.Build()
    diagram.set_name("twin_diagram")
    return ClosedLoop(diagram, scenario, station, twin)


def connect(builder: DiagramBuilder, station: System, twin: TwinDiagram) -> None:
    """Add a station and the twin to `builder` and connect namesakes; nothing of ``truth.*`` is connected.

    Sensors that the filter fuses and that the station does not have are silent.

    Args:
        builder: of the Diagram that is to hold both; they are named `station` and `twin` there.
        station: with the ports of `station.ports`.
        twin: as `make_twin` returns it.
    """
    builder.AddNamedSystem("station", station)
    builder.AddNamedSystem("twin", twin.diagram)
    for name in ports.output_names(station):
        if twin.diagram.HasInputPort(name):
            builder.Connect(station.GetOutputPort(name), twin.diagram.GetInputPort(name))
    for name in ports.input_names(station):
        if twin.diagram.HasOutputPort(name):
            builder.Connect(twin.diagram.GetOutputPort(name), station.GetInputPort(name))
    silence(builder, twin.diagram, station, twin.fused)
