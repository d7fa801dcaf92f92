"""A scenario, whole."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.station import LcmStation, ReplayStation
from twin_diagram.scenario.twin import Twin
from twin_diagram.scenario.world import World


@document
@dataclass
class Scenario:
    """A scenario, whole."""

    seed: int = 0
    """Of everything random in the simulated station."""
    duration: float = 10.0
    """How long it runs [s]."""
    packages: dict[str, str] = field(default_factory=dict)
    """Local folders for `package://` names."""
    station: str = "sim"
    """`sim`, `replay` or `lcm`."""
    replay: ReplayStation = field(default_factory=ReplayStation)
    """Of a replayed station."""
    lcm: LcmStation = field(default_factory=LcmStation)
    """Of a real arm's driver."""
    world: World = field(default_factory=World)
    """What a simulated station needs to know, and the twin never sees."""
    twin: Twin = field(default_factory=Twin)
    """What the twin is told."""
