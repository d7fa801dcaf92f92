"""Where an arm learns objects by handling them: from which bin into which, before which cameras."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document


@document
@dataclass
class Learning:
    """What `twin-diagram learn` is told of its cell; boxes are a lowest and a highest corner in W [m]."""

    bin_camera: str = "bin"
    """Of ``cameras``: looks into the bin that is emptied."""
    scan_camera: str = "scan"
    """Of ``cameras``: objects are shown to it; it sees the platform, too."""
    gripper: str = "wsg50"
    """A gripper that comes along, or a YAML file with its figures."""
    from_bin: list[list[float]] = field(default_factory=lambda: [[0.3, -0.5, 0.0], [0.5, -0.3, 0.1]])
    """The inside of the bin that is emptied; its lowest z is the bottom's upper side."""
    into_bin: list[list[float]] = field(default_factory=lambda: [[0.3, 0.3, 0.0], [0.5, 0.5, 0.1]])
    """The inside of the bin that is filled."""
    platform: list[list[float]] = field(default_factory=lambda: [[0.45, -0.1, 0.0], [0.65, 0.1, 0.05]])
    """Where objects are set down to be taken anew; its highest z is the top."""
    display: list[float] = field(default_factory=lambda: [0.5, 0.0, 0.42])
    """Where the finger tips are while an object is shown [m]."""
    force: float = 75.0
    """With which each finger presses [N]."""
    tries: int = 3
    """Grasps of one object before another is taken."""
    grasps: int = 2
    """In how many each object is shown at least."""
    most_grasps: int = 4
    """In how many at most, where less than `seen_share` of it was seen and the last one still showed more."""
    seen_share: float = 0.98
    """Of the surface that some pose would show: less asks for a further grasp."""
    grasp_selection: str = "pair"
    """Which further grasp: `pair`, the one that shows most of what fingers and palm hid so far; `pca`, one whose axis
    lies along another principal axis of the object."""
    frames: int = 14
    """Pictures of a full turn."""
    turn_speed: float = 1.0
    """Of the last joint while an object is shown [rad/s]."""
    weigh_seconds: float = 10.0
    """How long an object is swung to be weighed, and the empty hand as long; 0: not at all [s]."""
