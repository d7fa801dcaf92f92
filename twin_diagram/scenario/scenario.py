"""A scenario, whole."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.station import LcmStation, ReplayStation
from twin_diagram.scenario.twin import Twin
from twin_diagram.scenario.world import World


@dataclass
class Scenario:
    """A scenario, whole."""

    seed: int = 0
    duration: float = 10.0
    packages: dict[str, str] = field(default_factory=dict)
    """Local folders for `package://` names."""
    station: str = "sim"
    """`sim`, `replay` or `lcm`."""
    replay: ReplayStation = field(default_factory=ReplayStation)
    lcm: LcmStation = field(default_factory=LcmStation)
    world: World = field(default_factory=World)
    twin: Twin = field(default_factory=Twin)
