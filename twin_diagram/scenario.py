"""Scenarios: one typed YAML file in two parts, the world and what the twin is told about it.

``world:`` holds what a simulated station needs (true poses, hidden effects, sensor defects); ``twin:`` holds all
that the twin knows. The twin is built from ``twin:`` alone. All units SI, angles in radians, X_AB as in Drake.
"""

# No `from __future__ import annotations` here: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field


@dataclass
class Pose:
    """X_PB: frame B's pose in its parent P."""

    translation: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """p_PB [m]."""
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """Roll, pitch, yaw [rad], as in Drake's RollPitchYaw."""


@dataclass
class EffectSpec:
    """One effect of the catalogue; a joint effect's parameters hold one value per joint, any other's the value."""

    name: str = ""
    joints: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    parameters: dict[str, list[float]] = field(default_factory=dict)
    onset: float | None = None
    """When it starts [s]; none: it was there before."""
    end: float | None = None
    """When it ends [s]; none: it stays."""
    log: str = ""
    """Which log `onset` and `end` are about; empty: any."""


@dataclass
class ArmModel:
    """A robot arm, with or without a gripper, and what the model adds to its description."""

    model: str = "arms/panda_hand.urdf"
    """A path, `package://…`, or a path below the models that come along."""
    X_WB: Pose = field(default_factory=Pose)
    joints: list[str] = field(default_factory=list)
    """The arm's joints in order; empty: every actuated revolute joint of the model, in the model's order."""
    gripper_joints: list[str] = field(default_factory=list)
    """Finger joints; empty: every actuated prismatic joint."""
    tool_frame: str = "panda_tcp"
    effects: list[EffectSpec] = field(default_factory=list)


@dataclass
class Camera:
    """A pinhole RGB-D camera; optical frame C: X right, Y down, Z forward."""

    name: str = "camera"
    X_WC: Pose = field(default_factory=Pose)
    width: int = 640
    height: int = 480
    focal: float = 600.0
    """Focal length [pixel], the same in x and y; the principal point is the image's centre."""
    rate: float = 15.0
    """Frames per second."""
    latency: float = 0.035
    """From capture to delivery [s]."""
    depth_range: list[float] = field(default_factory=lambda: [0.2, 3.0])
    """Nearest and farthest depth that is measured [m]."""


@dataclass
class CameraDefects:
    """What the simulated camera does to its images."""

    depth_noise: float = 0.0008
    """Standard deviation of depth at 1 m [m]; grows with depth squared."""
    depth_unit: float = 0.00025
    """Depth is a whole number of these [m]."""
    colour_noise: float = 2.0
    """Standard deviation per channel, of 255."""
    edge_dropout: float = 0.5
    """Probability that a pixel at a depth discontinuity has no depth."""
    covered: list[list[float]] = field(default_factory=list)
    """Intervals [start, end] in which the lens is covered [s]."""


@dataclass
class ArmDefects:
    """What the simulated arm's sensors do to their signals."""

    encoder_bits: int = 19
    """Encoder counts per revolution, as a power of two."""
    velocity_noise: float = 1e-3
    """[rad/s]"""
    torque_noise: float = 0.05
    """White noise of the measured torque [N·m]."""
    torque_bias: list[float] = field(default_factory=list)
    """Constant error of the measured torque per joint [N·m]; empty: none."""


@dataclass
class SensorDefects:
    """What a further sensor of the simulated arm does to its readings."""

    noise: list[float] = field(default_factory=list)
    """White noise of the reading's first and second half: `imu` [rad/s], [m/s²]; `wrench` [N·m], [N]. Empty: the kind's
    own."""
    bias: list[float] = field(default_factory=list)
    """Constant error of all six; empty: none."""
    missing: list[list[float]] = field(default_factory=list)
    """Intervals [start, end] without readings [s]."""


@dataclass
class WayPoint:
    """Where a moving object is at a time; between way points it moves on a smooth curve."""

    time: float = 0.0
    X_WO: Pose = field(default_factory=Pose)


@dataclass
class WorldObject:
    """A real object of a simulated world."""

    asset: str = ""
    """Folder of the asset."""
    X_WO: Pose = field(default_factory=Pose)
    path: list[WayPoint] = field(default_factory=list)
    """Empty: it lies free on the table. Otherwise it is pushed along (x, y and yaw only)."""


@dataclass
class Fixture:
    """A model that stands still: table, bin, pedestal."""

    model: str = "scenes/table.sdf"
    X_WB: Pose = field(default_factory=Pose)


@dataclass
class World:
    """What a simulated station needs, and nobody else may know."""

    arm: ArmModel = field(default_factory=ArmModel)
    q0: list[float] = field(default_factory=list)
    """Joint angles at the start [rad]; empty: the twin's `home`."""
    time_step: float = 0.0025
    objects: dict[str, WorldObject] = field(default_factory=dict)
    fixtures: list[Fixture] = field(default_factory=list)
    X_WC: Pose | None = None
    """The camera's true pose, where it differs from the twin's calibration."""
    camera_defects: CameraDefects = field(default_factory=CameraDefects)
    arm_defects: ArmDefects = field(default_factory=ArmDefects)
    sensor_defects: dict[str, SensorDefects] = field(default_factory=dict)
    """By the port of a sensor of ``twin.sensors``; those that are not listed have their kind's usual noise alone."""


@dataclass
class Driver:
    """The arm's own controller, as its data sheet tells: joint impedance about the commanded position."""

    stiffness: list[float] = field(default_factory=list)
    """[N·m/rad] per joint; empty: 600 for the first four joints, 250 for the rest, scaled to the effort limits."""
    damping: list[float] = field(default_factory=list)
    """[N·m·s/rad]; empty: two times the square root of stiffness."""
    rate: float = 400.0
    """Status messages per second [1/s]."""


@dataclass
class LinkSensor:
    """A sensor on the arm besides its own, as its data sheet tells; the simulated station has a port for it."""

    kind: str = "imu"
    """`imu`: port `<body>.imu`; `wrench`: port `wrist.wrench_measured`."""
    body: str = ""
    """Link that it is fixed to; empty: the last one."""
    X_BS: Pose = field(default_factory=Pose)
    rate: float = 200.0
    """Readings per second [1/s]."""
    latency: float = 0.0
    """From reading to delivery, rounded up to whole periods [s]."""


@dataclass
class Perception:
    """Tuning of segmentation."""

    stride: int = 2
    """Every n-th pixel in x and y is used."""
    workspace: list[list[float]] = field(default_factory=lambda: [[0.1, -0.6, -0.02], [1.0, 0.6, 0.6]])
    """Lowest and highest corner of the box in W in which objects are looked for [m]."""
    table_height: float = 0.0
    """Height of the table's top in W [m], refined from each image."""
    table_clearance: float = 0.006
    """Points this near to the table belong to it [m]."""
    robot_clearance: float = 0.025
    """Points this near to the robot's model belong to it [m]."""
    cluster_gap: float = 0.02
    """Points farther apart than this are two objects [m]."""
    smallest: int = 60
    """Points that make an object."""


@dataclass
class Registration:
    """Tuning of the ICP pose estimator."""

    model_points: int = 600
    iterations: int = 12
    reach: float = 0.02
    """Correspondences farther apart than this are cut [m]."""
    colour_weight: float = 0.3
    """Share of the colour term."""
    minimum_quality: float = 0.5
    search_period: float = 0.2
    """An object not found is searched for again after this long [s]."""


@dataclass
class SensorSpec:
    """A further sensor for the filter; its readings come in by ports of its name."""

    kind: str = ""
    """`body_pose`, `imu`, `wrench` or `torque`."""
    name: str = ""
    """Empty: as its kind is called."""
    body: str = ""
    """Link or frame that it is fixed to; for `body_pose` the one whose pose it gives. Empty: the last link."""
    X_BS: Pose = field(default_factory=Pose)
    std: list[float] = field(default_factory=list)
    """`body_pose`: position [m], rotation [rad]; `imu`: gyroscope [rad/s], accelerometer [m/s²]; `wrench`: force [N],
    moment [N·m]; `torque`: [N·m]. Empty: the kind's own."""


@dataclass
class Filter:
    """Tuning of the adaptive EKF."""

    rate: float = 200.0
    encoder_std: float = 2e-5
    velocity_std: float = 2e-3
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
    """How far back a late reading is fused at its own time [s]."""
    sensors: list[SensorSpec] = field(default_factory=list)
    """Further sensors, besides the arm's own."""


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


@dataclass
class SceneUpdater:
    """Tuning of the scene-graph updater."""

    rate: float = 60.0
    stale_after: float = 0.5
    """Unseen for this long while it should be visible [s]."""
    lost_after: float = 5.0
    acceleration_std: float = 0.3
    """Of an object that moves [m/s²]."""
    angular_acceleration_std: float = 1.0
    """[rad/s²]"""
    position_floor: float = 0.0005
    """Error that all measurements of an object share, so that averaging does not remove it [m]."""
    rotation_floor: float = 0.005
    """[rad]"""
    rest_walk: float = 1e-4
    """Random walk of an object at rest [m/√s]."""
    rest_turn: float = 1e-3
    """[rad/√s]"""
    stale_walk: float = 0.01
    """Random walk of an object that nobody sees: how fast its covariance grows [m/√s]."""
    stale_turn: float = 0.05
    """[rad/√s]"""
    rest_speed: float = 0.015
    """An object slower than this for some images is at rest [m/s]."""
    rest_spin: float = 0.2
    """[rad/s]"""


@dataclass
class Planner:
    """Tuning of the MPC."""

    rate: float = 15.0
    knots: int = 16
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
    task: Task = field(default_factory=Task)
    perception: Perception = field(default_factory=Perception)
    registration: Registration = field(default_factory=Registration)
    filter: Filter = field(default_factory=Filter)
    drift: Drift = field(default_factory=Drift)
    scene: SceneUpdater = field(default_factory=SceneUpdater)
    planner: Planner = field(default_factory=Planner)


@dataclass
class ReplayStation:
    """A recorded log (CSV or .npz), or a recording's folder with images."""

    log: str = ""


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
    control: str = "position"
    """What is commanded, as the driver was started: `position` or `position_and_torque`."""
    image_channel: str = "CAMERA_IMAGES"
    depth_unit: float = 0.00025
    """Depths that arrive are rounded to a whole number of these [m]."""


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
