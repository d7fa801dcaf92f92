"""What the arm is to do, and tuning of the planner."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.models import Pose


@document
@dataclass
class Planner:
    """Tuning of the MPC."""

    rate: float = 15.0
    """How often a plan is made [Hz]."""
    knots: int = 16
    """Points in time of a plan."""
    step: float = 0.12
    """Time between knots [s]."""
    clearance: float = 0.04
    """Distance kept from everything [m]."""
    influence: float = 0.20
    """Pairs farther apart than this are left out [m]."""
    velocity_share: float = 0.4
    """Share of the joints' velocity limits that is used."""
    acceleration: float | None = None
    """No joint is accelerated by more than this [rad/s²]; null: by what its description and its torque allow."""
    torque_share: float = 0.7
    """Share of the joints' torque limits that plans use; the arm's own controller needs the rest."""
    route_after: float = 0.2
    """A way that had to be searched for counts so long after it was asked for [s of the loop's own time]: as long as a
    search takes on a slow core. A simulation waits for one that is late, so that equal runs are equal."""
    seed: int = 0
    """Of the search for routes around obstacles."""


@document
@dataclass
class TaskStep:
    """One step of a task. The tool frame's z axis points along the approach, its y axis along the fingers' opening."""

    kind: str = "reach"
    """`reach` a pose, `follow` an object, `hold` still, `pick` an object up, `place` what was picked."""
    object: str = ""
    """Of the library: what is followed or picked; of `place`, what is held, or nothing."""
    upon: str = ""
    """Of `place`: the object of the library that is to bear it, wherever that stands by then; nothing: what never moves
    does."""
    goal: Pose | None = None
    """`reach`: X_WG of the tool frame; `follow`: X_OG, the tool frame in the object's; `place`: X_WO, where the object
    is to stand, or X_UO in the frame of the one that it stands upon, none: on the middle of its top, turned as it was
    taken; `pick`: X_OG of the grasp, none: from above, where the object is narrow; `hold`: none."""
    position_tolerance: float = 0.01
    """A goal counts as reached within this [m]."""
    rotation_tolerance: float = 0.1
    """The same for its direction [rad]."""
    time_limit: float = 20.0
    """Not done for so long the step has failed, and with it the task [s]."""
    seconds: float = 1.0
    """How long `follow` and `hold` go on [s]."""
    tries: int = 2
    """How often `pick` closes the fingers before it gives up."""
    force: float = 40.0
    """What `pick` squeezes with at most, and what the object is held with from there on [N]."""


@document
@dataclass
class Task:
    """What the arm is to do: one goal, or a list of steps, which may also stand in the task's own place."""

    X_WG: Pose | None = None
    """Where the tool frame is to go; none: stay. Not beside `steps`."""
    start: float = 0.5
    """When to set off [s]."""
    position_tolerance: float = 0.01
    """[m]"""
    rotation_tolerance: float = 0.1
    """[rad]"""
    steps: list[TaskStep] = field(default_factory=list)
    """One after the other; the first that fails ends the task, with the arm at rest. Empty: `X_WG` is all."""
