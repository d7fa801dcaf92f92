"""Stations that are no simulation."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document


@document
@dataclass
class ReplayStation:
    """A recorded log (CSV or .npz), or a recording's folder with images."""

    log: str = ""
    """A measured log, or a recording's folder."""
    columns: str = ""
    """What a foreign log's columns mean: a YAML file or a preset; empty: the log format's own names."""
    torque_constants: list[str] = field(default_factory=list)
    """Torque at a joint over the current that a log holds [N·m/A], in the arm's order, as `JOINT=K`, or a YAML file."""


@document
@dataclass
class LcmStation:
    """A real arm's driver, speaking Drake's own messages."""

    url: str = ""
    """Empty: LCM's default; `memq://` stays within the process."""
    arm: str = "panda"
    """`panda` or `iiwa`: which messages."""
    status_channel: str = ""
    """Empty: the public driver's own."""
    command_channel: str = ""
    """Empty: the public driver's own."""
    control: str = "position"
    """What is commanded, as the driver was started: `position` or `position_and_torque`."""
    image_channel: str = "CAMERA_IMAGES"
    """Where images come from."""
    depth_unit: float = 0.00025
    """Depths that arrive are rounded to a whole number of these [m]."""
