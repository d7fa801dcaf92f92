"""Holds what a twin is told against what its numbers may be, whichever way the scenario was made.

Types are checked where a file is read; a world's values where it is built, for only a simulated station reads them.
"""

from __future__ import annotations

import dataclasses
import math
import re
from numbers import Real
from typing import Any

from twin_diagram.errors import ScenarioError, expect
from twin_diagram.scenario import (
    Braking,
    Camera,
    DepthCamera,
    DepthNoise,
    Drift,
    Driver,
    Filter,
    Growing,
    Healing,
    Learning,
    Lidar,
    LinkSensor,
    Perception,
    Planner,
    Pose,
    Registration,
    SceneUpdater,
    Slots,
    Task,
    TaskStep,
    Twin,
)
from twin_diagram.scenario.depth_sheets import SHEETS
from twin_diagram.scenario.lenses import colour_lens, depth_lens
from twin_diagram.scenario.models import ENDLESS
from twin_diagram.scenario.task_steps import check_steps

POSITIVE: dict[type, tuple[str, ...]] = {
    Braking: ("rate", "acceleration", "torque_share", "state_periods", "image_periods", "plan_periods", "jump"),
    Camera: ("width", "height", "focal", "fx", "fy", "rate"),
    DepthCamera: ("width", "height", "fx", "fy", "scale"),
    Drift: ("period", "horizon", "learning_time", "sigma", "false_alarms"),
    Driver: ("rate",),
    Filter: (
        "rate",
        "encoder_std",
        "velocity_std",
        "torque_std",
        "mass_std",
        "com_std",
        "torque_drift_time",
        "opening",
        "parameter_rate",
    ),
    Growing: ("things", "attempts", "patience"),
    Healing: ("seconds", "patience"),
    Learning: ("force", "tries", "grasps", "most_grasps", "frames", "turn_speed"),
    Lidar: ("columns", "rows", "width", "height", "rate", "latency"),
    LinkSensor: ("rate",),
    Perception: ("stride", "cluster_gap", "smallest"),
    Planner: ("rate", "knots", "step", "influence", "velocity_share", "torque_share", "acceleration"),
    Registration: ("model_points", "iterations", "reach"),
    SceneUpdater: ("rate", "stale_after", "lost_after"),
    Task: ("position_tolerance", "rotation_tolerance"),
    TaskStep: ("position_tolerance", "rotation_tolerance", "time_limit", "tries", "force"),
}
"""Fields that must be above zero, where they are told, by their dataclass."""
NOT_NEGATIVE: dict[type, tuple[str, ...]] = {
    Braking: ("clearance", "delay", "unforeseen", "resume_after"),
    Camera: ("latency", "focal_std", "centre_std", "depth_scale_std", "colour_std"),
    DepthNoise: ("floor", "growth", "correlated", "lasting"),
    Filter: ("excitation", "torque_drift_std", "parameter_walk", "learning_rate", "history", "noise_time"),
    Growing: ("answer_after", "nice"),
    Healing: ("attempts", "nice"),
    Learning: ("weigh_seconds",),
    LinkSensor: ("latency",),
    Perception: ("table_clearance", "robot_clearance", "latency"),
    Planner: ("clearance", "route_after", "seed"),
    Registration: ("search_period",),
    SceneUpdater: (
        "acceleration_std",
        "angular_acceleration_std",
        "position_floor",
        "rotation_floor",
        "rest_walk",
        "rest_turn",
        "stale_walk",
        "stale_turn",
        "rest_speed",
        "rest_spin",
    ),
    Slots: ("instances", "unknown", "forget_after"),
    Task: ("start",),
    TaskStep: ("seconds",),
}
"""Fields that may be zero, but not below."""
MOST_RATE = 1e5
"""What comes more often than this [1/s] was told in another unit, and fills the memory."""
MOST_TURN = 2 * math.pi + 1e-3
"""An angle of a pose beyond a whole turn, and rounding [rad], was told in degrees."""
MOST_AWAY = 100.0
"""What stands further from the world's origin than this [m] was told in millimetres: no arm works in such a hall."""
BEFORE_NEXT = 0.002
"""What an image shows is to count so long before the next is delivered [s]: twice the millisecond after which images
are looked at."""
SHARE: dict[type, tuple[str, ...]] = {
    Braking: ("torque_share",),
    Healing: ("held_out",),
    Learning: ("seen_share",),
    Planner: ("velocity_share", "torque_share"),
    Registration: ("colour_weight", "minimum_quality"),
}
"""From 0 to 1."""


def check_twin(twin: Twin) -> None:
    """Check all that a twin is told.

    Raises:
        ScenarioError: a number that cannot be, or a list of another length; it names the field.
    """
    expect(twin, Twin, "twin", "a Twin (of a Scenario its field `twin`)")
    _walk(twin, "twin")
    check_steps(twin.task, twin.library)
    _corners(twin.perception.workspace, "twin.perception.workspace")
    if twin.driver.torque_side not in ("motor", "link"):
        raise ScenarioError("twin.driver.torque_side", f"{twin.driver.torque_side!r} is none of motor, link")
    if not all(name.strip() for name in twin.library):
        raise ScenarioError("twin.library", "an object has an empty name")
    if twin.growth is not None and not twin.perceiving:
        raise ScenarioError("twin.growth", "nothing is seen grow without a camera: twin.camera is null")
    if twin.growth is not None and len(twin.perceiving) > 1:
        raise ScenarioError("twin.growth", f"things grow before one camera, not {', '.join(twin.perceiving)}")
    if twin.growth is not None and not twin.slots.unknown:
        raise ScenarioError("twin.growth", "nothing grows where what is unknown is ignored: twin.slots.unknown is 0")
    if twin.healing is not None:
        _healing(twin.healing, "twin.healing")
    if twin.camera is not None:
        check_optics(twin.camera, "twin.camera")
    _cameras(twin)
    if twin.perception.latency > 0.0:
        _lateness(twin)
    if twin.learning is not None:
        _learning(twin.learning, twin.cameras, "twin.learning")
    if twin.lidar is not None:
        _near_far(twin.lidar.range, "twin.lidar.range")
        if not twin.lidar.latency < 1.0 / twin.lidar.rate:
            why = f"{twin.lidar.latency} s is not less than the time between scans, {1.0 / twin.lidar.rate:.4g} s"
            raise ScenarioError("twin.lidar.latency", why)


def _lateness(twin: Twin) -> None:
    """Check that what an image shows counts before the next one is delivered."""
    late, cameras = twin.perception.latency, list(twin.perceiving.values())
    if len(cameras) > 1:
        raise ScenarioError(
            "twin.perception.latency", f"{late} s go with one camera, not with {', '.join(twin.perceiving)}"
        )
    if cameras and not late <= 1.0 / cameras[0].rate - BEFORE_NEXT:
        most = f"{1.0 / cameras[0].rate - BEFORE_NEXT:.4g} s"
        raise ScenarioError("twin.perception.latency", f"{late} s is more than {most}: the next image would be there")


def _cameras(twin: Twin) -> None:
    """Check the cameras beside the first: role, name, optics."""
    for name, camera in twin.cameras.items():
        field = f"twin.cameras.{name}"
        if not re.fullmatch(r"\w[\w-]*", name):  # ports are called so
            raise ScenarioError(field, f"{name!r} is not a name of letters, digits, _ and -")
        if camera.role not in ("perception", "pictures"):
            raise ScenarioError(f"{field}.role", f"{camera.role!r} is none of perception, pictures")
        if twin.camera is not None and name == twin.camera.name:
            raise ScenarioError(field, f"twin.camera is called {name!r}, too")
        check_optics(camera, field)


def check_optics(camera: Camera, name: str) -> None:
    """Check what a camera's calibration and data sheet tell, beyond the signs of its numbers.

    Raises:
        ScenarioError: a list of another length, a data sheet that nobody knows, or a lens that folds its image over
            itself; it names the field.
    """
    _near_far(camera.depth_range, f"{name}.depth_range")
    if len(camera.X_WC_std) != 2 or not min(camera.X_WC_std) >= 0:
        raise ScenarioError(f"{name}.X_WC_std", f"{camera.X_WC_std} is not a length and an angle")
    if camera.depth_noise.sheet not in SHEETS:
        raise ScenarioError(f"{name}.depth_noise.sheet", f"{camera.depth_noise.sheet!r} is none of {', '.join(SHEETS)}")
    colour_lens(camera, name)
    depth_lens(camera, name)


def _near_far(values: list[float], name: str) -> None:
    if len(values) != 2 or not 0 < values[0] < values[1]:
        raise ScenarioError(name, f"{values} is not [nearest, farthest]")


def check_filter(params: Filter) -> None:
    """Check a filter's tuning by itself, for filters that are made without a scenario.

    Raises:
        ScenarioError: a number that cannot be; it names the field.
    """
    expect(params, Filter, "filter", "a Filter (of a Scenario its field `twin.filter`)")
    _walk(params, "twin.filter")


def _walk(value: Any, name: str) -> None:
    if dataclasses.is_dataclass(value):
        _check_fields(value, name)
        for field in dataclasses.fields(value):
            if ENDLESS not in field.metadata:
                _walk(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, dict):
        for key, sub in value.items():
            _walk(sub, f"{name}.{key}")
    elif isinstance(value, list):
        for index, sub in enumerate(value):
            _walk(sub, f"{name}.{index}")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ScenarioError(name, f"{value} is not a finite number")


def _check_fields(value: Any, name: str) -> None:
    for field in (*POSITIVE.get(type(value), ()), *NOT_NEGATIVE.get(type(value), ()), *SHARE.get(type(value), ())):
        expect(getattr(value, field), (Real, type(None)), f"{name}.{field}", "a number")
    for field in POSITIVE.get(type(value), ()):
        if getattr(value, field) is not None and not getattr(value, field) > 0:
            raise ScenarioError(f"{name}.{field}", f"{getattr(value, field)} is not positive")
    if "rate" in POSITIVE.get(type(value), ()) and (value.rate or 0.0) > MOST_RATE:
        raise ScenarioError(f"{name}.rate", f"{value.rate:g} is more than {MOST_RATE:g} a second")
    for field in NOT_NEGATIVE.get(type(value), ()):
        if getattr(value, field) is not None and not getattr(value, field) >= 0:
            raise ScenarioError(f"{name}.{field}", f"{getattr(value, field)} is negative")
    for field in SHARE.get(type(value), ()):
        if not 0 <= getattr(value, field) <= 1:
            raise ScenarioError(f"{name}.{field}", f"{getattr(value, field)} is not between 0 and 1")
    if isinstance(value, Pose):
        for field in ("translation", "rpy"):
            if len(getattr(value, field)) != 3:
                raise ScenarioError(f"{name}.{field}", f"{getattr(value, field)} is not three numbers")
        if max(map(abs, value.rpy)) > MOST_TURN:
            raise ScenarioError(f"{name}.rpy", f"{value.rpy} looks like degrees; angles are in rad")
        if max(map(abs, value.translation)) > MOST_AWAY:
            said = f"{value.translation} is more than {MOST_AWAY:g} m away: it looks like millimetres; lengths are in m"
            raise ScenarioError(f"{name}.translation", said)


def _learning(learning: Learning, cameras: dict[str, Camera], name: str) -> None:
    for field in ("bin_camera", "scan_camera"):
        if getattr(learning, field) not in cameras:
            told = ", ".join(cameras) or "none"
            raise ScenarioError(f"{name}.{field}", f"{getattr(learning, field)!r} is none of twin.cameras: {told}")
    for field in ("from_bin", "into_bin", "platform"):
        _corners(getattr(learning, field), f"{name}.{field}")
    if len(learning.display) != 3:
        raise ScenarioError(f"{name}.display", f"{learning.display} is not three numbers")
    if learning.grasp_selection not in ("pair", "pca"):
        raise ScenarioError(f"{name}.grasp_selection", f"{learning.grasp_selection!r} is none of pair, pca")


def _healing(healing: Healing, name: str) -> None:
    if not 0.05 <= healing.held_out <= 0.95:
        raise ScenarioError(f"{name}.held_out", f"{healing.held_out} leaves nothing to fit or nothing to prove")
    if healing.answer_after is not None and not healing.answer_after >= 0.0:
        raise ScenarioError(f"{name}.answer_after", f"{healing.answer_after} s is before the search")


def _corners(box: list[list[float]], name: str) -> None:
    if [len(corner) for corner in box] != [3, 3] or not all(low < high for low, high in zip(*box, strict=True)):
        raise ScenarioError(name, f"{box} is not the lowest and the highest corner of a box")
