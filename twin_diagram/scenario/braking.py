"""How the arm is stopped in time, whatever its planner does."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass

from twin_diagram.scenario.field_table import document


@document
@dataclass
class Braking:
    """Tuning of the stop monitor, which stands between the planner and the arm."""

    rate: float = 50.0
    """How often it looks [Hz]."""
    clearance: float = 0.005
    """What is to be left to anything once the arm stands [m]; less than the planner keeps."""
    delay: float = 0.035
    """From a command to where the arm is: driver, arm and bus [s]; a period of its own comes on top."""
    acceleration: float | None = None
    """No joint is braked with more than this [rad/s²]; null: a quarter more than plans take; torques allowing."""
    torque_share: float = 0.9
    """Share of the motors' torque limits that braking may take."""
    unforeseen: float = 0.02
    """Whatever may move is taken to come nearer by this beside what is known of its motion [m/s]."""
    state_periods: float = 10.0
    """Periods of the arm's driver without a message after which its state counts as stale."""
    image_periods: float = 5.0
    """Periods of the camera without an image, beyond its latency, after which the scene counts as stale."""
    plan_periods: float = 5.0
    """Periods of the planner without a new plan after which it counts as hanging."""
    jump: float = 0.02
    """A command that is so far from where it was heading is a jump [rad]."""
    resume_after: float = 0.2
    """Nothing must stand against it for so long before the arm goes on [s]."""
