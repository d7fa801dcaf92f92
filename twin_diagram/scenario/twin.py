"""All that the twin is told."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field, replace

from twin_diagram.scenario.braking import Braking
from twin_diagram.scenario.camera import Camera
from twin_diagram.scenario.estimation import Drift, Filter, Healing
from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.growing import Growing
from twin_diagram.scenario.learning import Learning
from twin_diagram.scenario.models import ArmModel, Fixture
from twin_diagram.scenario.perception import Perception, Registration, SceneUpdater, Slots
from twin_diagram.scenario.planning import Planner, Task
from twin_diagram.scenario.sensors import Driver, Lidar, LinkSensor


@document
@dataclass
class Twin:
    """All that the twin is told."""

    arm: ArmModel = field(default_factory=ArmModel)
    """The arm as the twin is told of it."""
    home: list[float] = field(default_factory=list)
    """Joint angles at rest [rad]; empty: zeros."""
    driver: Driver = field(default_factory=Driver)
    """Gains of the driver that moves it."""
    sensors: list[LinkSensor] = field(default_factory=list)
    """On the arm, besides its own; what the filter makes of them is said in ``filter.sensors``."""
    fixtures: list[Fixture] = field(default_factory=list)
    """What never moves around it."""
    library: dict[str, str] = field(default_factory=dict)
    """Folders of the known objects' assets, by the name of the object."""
    camera: Camera | None = field(default_factory=Camera)
    """The camera that perception looks through, as calibrated; null: none, but for those of ``cameras``."""
    cameras: dict[str, Camera] = field(default_factory=dict)
    """Further cameras as calibrated, by name. Through those whose `role` is `perception` the twin looks, too; of the
    others a picture is rendered where somebody asks for one."""
    lidar: Lidar | None = None
    """Its clouds reach the filter where ``filter.sensors`` says so, kind `lidar`."""
    task: Task = field(default_factory=Task)
    """What the arm is to do."""
    perception: Perception = field(default_factory=Perception)
    """How images become clouds."""
    registration: Registration = field(default_factory=Registration)
    """How clouds become poses."""
    slots: Slots = field(default_factory=Slots)
    """How many instances and unknown things it holds at a time."""
    filter: Filter = field(default_factory=Filter)
    """Tuning of the adaptive EKF."""
    drift: Drift = field(default_factory=Drift)
    """Tuning of the drift monitor."""
    healing: Healing | None = None
    """None: alarms are told, and nothing more."""
    growth: Growing | None = None
    """Whether unknown things become assets while it runs; null: they stay unknown."""
    scene: SceneUpdater = field(default_factory=SceneUpdater)
    """How objects live and are forgotten."""
    planner: Planner = field(default_factory=Planner)
    """Tuning of the planner."""
    stop_monitor: Braking | None = field(default_factory=Braking)
    """What stops the arm in time whatever the planner does; null: nothing."""
    learning: Learning | None = None
    """Where objects are learned by handling them (`twin-diagram learn`); null: nowhere."""

    @property
    def perceiving(self) -> dict[str, Camera]:
        """The cameras that the running twin looks through, by name: ``camera`` first, then those of ``cameras``."""
        own = {} if self.camera is None else {self.camera.name: self.camera}
        others = {k: replace(one, name=k) for k, one in self.cameras.items() if one.role == "perception"}
        return own | others
