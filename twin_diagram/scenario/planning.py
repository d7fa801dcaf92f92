"""What the arm is to do, and tuning of the planner."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass

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
    acceleration: float = 4.0
    """[rad/s²]"""
    seed: int = 0
    """Of the search for routes around obstacles."""


@document
@dataclass
class Task:
    """What the arm is to do."""

    X_WG: Pose | None = None
    """Where the tool frame is to go; none: stay."""
    start: float = 0.5
    """When to set off [s]."""
    position_tolerance: float = 0.01
    """[m]"""
    rotation_tolerance: float = 0.1
    """[rad]"""
