"""What models describe: arms, what a model adds to a description, what stands still, and where."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document

ENDLESS = "endless"
"""In a field's metadata: its numbers may be infinite. Whoever makes sense of them refuses what is no number."""


@document
@dataclass
class Pose:
    """X_PB: frame B's pose in its parent P."""

    translation: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """p_PB [m]."""
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """Roll, pitch, yaw [rad], as in Drake's RollPitchYaw."""


@document
@dataclass
class EffectSpec:
    """One effect of the catalogue; a joint effect's parameters hold one value per joint, any other's the value."""

    name: str = ""
    """Of the catalogue or one's own, e.g. `coulomb_friction`."""
    joints: list[str] = field(default_factory=list)
    """Joints that it acts on, where it acts on joints."""
    links: list[str] = field(default_factory=list)
    """Links that it acts on, where it acts on links."""
    parameters: dict[str, list[float]] = field(default_factory=dict)
    """By name, a list of numbers each: one per joint, or a vector's components [SI units]."""
    onset: float | None = None
    """When it starts [s]; none: it was there before."""
    end: float | None = None
    """When it ends [s]; none: it stays."""
    log: str = ""
    """Which log `onset` and `end` are about, by its fingerprint; empty: any."""
    elsewhere: dict[str, float] = field(default_factory=dict, metadata={ENDLESS: True})
    """When the same change came in other logs [s]; .inf: after their end. In those that are not listed: before them."""
    module: str = ""
    """Where an effect of one's own is defined, for whoever reads this without it; empty for the catalogue's."""


@document
@dataclass
class ArmModel:
    """A robot arm, with or without a gripper, and what the model adds to its description."""

    model: str = "arms/panda_hand.urdf"
    """A path, `package://…`, or a path below the models that come along."""
    X_WB: Pose = field(default_factory=Pose)
    """Where the arm's base B stands in the world [m]."""
    joints: list[str] = field(default_factory=list)
    """The arm's joints in order; empty: every actuated joint of the model, in its order, but for fingers: prismatic
    ones that stand side by side and carry no other, and a revolute one at the end that others beside it follow."""
    gripper_joints: list[str] = field(default_factory=list)
    """Finger joints; empty: the actuated prismatic joints that are not the arm's, and such revolute ones."""
    tool_frame: str = "panda_tcp"
    """Frame that reaches goals; empty: the last link's own. For a pick it lies between the finger tips, z along the
    approach and y along the closing."""
    X_FG: Pose = field(default_factory=Pose)
    """Where in F, which is `tool_frame`, what reaches goals lies: for a description that names no such frame [m]."""
    effects: list[EffectSpec] = field(default_factory=list)
    """What the description alone lacks."""


@document
@dataclass
class Fixture:
    """A model that stands still: table, bin, pedestal."""

    model: str = "scenes/table.sdf"
    """URDF or SDF of something that never moves, such as a table."""
    X_WB: Pose = field(default_factory=Pose)
    """Where it stands in the world [m]."""
