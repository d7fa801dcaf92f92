"""All that the twin is told."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.estimation import Drift, Filter, Healing
from twin_diagram.scenario.models import ArmModel, Fixture
from twin_diagram.scenario.perception import Perception, Registration, SceneUpdater
from twin_diagram.scenario.planning import Planner, Task
from twin_diagram.scenario.sensors import Camera, Driver, Lidar, LinkSensor


@dataclass
class Twin:
    """All that the twin is told."""

    arm: ArmModel = field(default_factory=ArmModel)
    home: list[float] = field(default_factory=list)
    """Joint angles at rest [rad]; empty: zeros."""
    driver: Driver = field(default_factory=Driver)
    sensors: list[LinkSensor] = field(default_factory=list)
    """On the arm, besides its own; what the filter makes of them is said in ``filter.sensors``."""
    fixtures: list[Fixture] = field(default_factory=list)
    library: dict[str, str] = field(default_factory=dict)
    """Folders of the known objects' assets, by the name of the object."""
    camera: Camera | None = field(default_factory=Camera)
    lidar: Lidar | None = None
    """Its clouds reach the filter where ``filter.sensors`` says so, kind `lidar`."""
    task: Task = field(default_factory=Task)
    perception: Perception = field(default_factory=Perception)
    registration: Registration = field(default_factory=Registration)
    filter: Filter = field(default_factory=Filter)
    drift: Drift = field(default_factory=Drift)
    healing: Healing | None = None
    """None: alarms are told, and nothing more."""
    scene: SceneUpdater = field(default_factory=SceneUpdater)
    planner: Planner = field(default_factory=Planner)
