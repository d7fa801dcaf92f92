"""Tuning of the filter, of the drift monitor, and of the mending that an alarm leads to."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.models import Pose


@document
@dataclass
class SensorSpec:
    """A further sensor for the filter; its readings come in by ports of its name."""

    kind: str = ""
    """`imu` or `wrench`, where ``twin.sensors`` has one, `depth`, what the twin's camera sees of a link, or `lidar`,
    what ``twin.lidar`` meets of one. A filter by itself also takes `body_pose` and `torque`."""
    name: str = ""
    """Empty: as its kind is called."""
    body: str = ""
    """Link or frame that it is fixed to; for `body_pose` the one whose pose it gives. Empty: the last link."""
    X_BS: Pose = field(default_factory=Pose)
    """Where the sensor S sits on that body B [m]."""
    std: list[float] = field(default_factory=list)
    """`body_pose`, `depth`, `lidar`: position [m], rotation [rad]; `imu`: gyroscope [rad/s], accelerometer [m/s²];
    `wrench`: force [N], moment [N·m]; `torque`: [N·m]. Empty: the kind's own."""


@document
@dataclass
class Filter:
    """Tuning of the adaptive EKF."""

    rate: float = 200.0
    """How often the filter takes a message of the arm [Hz]."""
    encoder_std: float = 2e-5
    """Noise of the joint encoders [rad], of prismatic joints [m]."""
    velocity_std: float = 2e-3
    """Noise of the estimated joint velocities [rad/s], of prismatic joints [m/s]."""
    torque_std: float = 0.3
    """Unmodelled joint torque, as white noise over one filter step [N·m]."""
    parameters: list[str] = field(default_factory=lambda: ["payload"])
    """Effects whose parameters are learned online."""
    mass_std: float = 1.0
    """Prior of a payload's mass [kg]."""
    com_std: float = 0.1
    """Prior of a payload's centre, from the tool frame's side of the last link [m]."""
    excitation: float = 0.003
    """A joint slower than this rests: stiction hides its load, and it teaches no parameter (see `estimation`)
    [rad/s]."""
    noise_time: float = 2.0
    """Over which the noise of all sensors and the white torque are adapted, within a tenth to ten times what is given;
    0: not at all [s]."""
    torque_drift_std: float = 0.1
    """Unmodelled joint torque that stays for a while, such as an error of friction; 15 % of dry friction is added
    [N·m]."""
    torque_drift_time: float = 1.0
    """How long it stays [s]."""
    parameter_walk: float = 0.002
    """Random walk of the parameters while the arm moves, in standard deviations of their prior [1/√s]."""
    opening: float = 2.0
    """The parameters' covariance opens where innovations squared are this many times their covariance for a tenth of a
    second."""
    parameter_rate: float = 50.0
    """How often the physics takes over the parameters learnt; in between, their change acts to first order [1/s]."""
    rule: str = "covariance"
    """`covariance`, or `gradient`: the outline's rule, for comparison."""
    learning_rate: float = 0.01
    """η of the gradient rule, in standard deviations of the prior."""
    history: float = 0.1
    """How far back a late reading is fused at its own time [s]; less where further sensors read between the arm's
    messages: as many steps are kept as messages come in that time."""
    sensors: list[SensorSpec] = field(default_factory=list)
    """Further sensors, besides the arm's own."""


@document
@dataclass
class Drift:
    """Tuning of the drift monitor."""

    period: float = 0.5
    """Between rollouts [s]."""
    horizon: float = 0.1
    """Length of a rollout [s]."""
    learning_time: float = 2.0
    """Normal operation from which the threshold is learnt [s]."""
    sigma: float = 6.0
    """k of the threshold mean + k · standard deviation."""
    false_alarms: float = 0.5
    """How many are accepted where nothing is wrong: thresholds are widened as what was seen then asks for [1/h]."""


@document
@dataclass
class Healing:
    """How the twin mends its own model while it runs: after an alarm it looks for what the model lacks."""

    seconds: float = 16.0
    """Log since the alarm in which it is looked for [s]."""
    held_out: float = 0.35
    """Share of it, the last, that is kept for the proof."""
    attempts: int = 3
    """Searches in one run at most."""
    patience: float = 300.0
    """A search that takes longer is stopped [s of the clock on the wall]."""
    answer_after: float | None = None
    """A verdict is taken exactly this long after its search began, for which a simulation waits if need be, so that two
    runs are alike; none: as soon as it is there, for which a replay waits, too [s]."""
    nice: int = 5
    """How far the search stands back behind the loop: see the command `nice`."""
