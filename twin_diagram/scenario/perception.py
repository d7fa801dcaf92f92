"""Tuning of what turns images into objects with a life."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document


@document
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
    robot_clearance: float = 0.01
    """Points this near to the robot's model belong to it, unless a thing's surface goes on there [m]."""
    cluster_gap: float = 0.02
    """Points farther apart than this are two objects [m]."""
    smallest: int = 60
    """Points that make an object."""
    latency: float = 0.0
    """From an image's delivery until what it shows counts [s], less than from image to image by 2 ms: so long a process
    of its own may look at it, beside the simulator. For one camera."""


@document
@dataclass
class Registration:
    """Tuning of the ICP pose estimator."""

    model_points: int = 600
    """Points of an object that are registered at most."""
    iterations: int = 12
    """Steps of a registration at most."""
    reach: float = 0.02
    """Correspondences farther apart than this are cut [m]."""
    colour_weight: float = 0.3
    """Share of the colour term."""
    minimum_quality: float = 0.5
    """Share of an object's visible points that must fit for its pose to be believed [0 to 1]."""
    search_period: float = 0.2
    """An object not found is searched for again after this long [s]."""
    told_by_shape: bool = False
    """Whether what is painted otherwise than its asset, or grey, is told by its shape. It goes by the likeliest of the
    turns that shape leaves alike, which may be a wrong one, also of what is painted as told and badly lit."""


@document
@dataclass
class Slots:
    """How many things the twin holds at a time; slots are filled, shaped and freed while it runs."""

    instances: int = 16
    """Objects of the library, alikes counted each; never fewer than the library has objects."""
    unknown: int = 16
    """Things that no library knows, each of up to eight convex pieces; 0: what is unknown is ignored."""
    forget_after: float = 10.0
    """An object whose place has been seen empty for so long is removed; until then it is looked for [s]."""

    def further(self, objects: int) -> int:
        """Return how many slots there are for further instances, beside the first of each of so many objects."""
        return max(self.instances - objects, 0)


@document
@dataclass
class SceneUpdater:
    """Tuning of the scene-graph updater."""

    rate: float = 60.0
    """How often the twin's scene is brought up to date [Hz]."""
    stale_after: float = 0.5
    """Unseen for this long while it should be visible [s]."""
    lost_after: float = 5.0
    """An object in view that is not found for so long is lost [s]."""
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
