"""Finds what was set down on the platform, there or wherever it fell: on the table all about, where a camera sees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.errors import StationError
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.runs.learning.beside_bin import TUNING as BESIDE
from twin_diagram.runs.learning.beside_bin import support_of, things_beside
from twin_diagram.runs.learning.bin_view import SeenThing, things_within
from twin_diagram.runs.learning.camera_check import KnownFaces
from twin_diagram.runs.learning.cell import Cell, Picture
from twin_diagram.runs.learning.steady_picture import steady_picture
from twin_diagram.scenario import Learning
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    around: float = 0.05
    """Beside the platform in which what lies on it is looked for [m]: it may reach out over the edge."""

    over: float = 0.01
    """Beside the platform in which the middle of what lies on it may be [m]: beyond that it would fall."""

    before: float = 0.03
    """Between the platform and where things that fell off it towards the camera are looked for [m]."""

    depth: float = 0.2
    """How far before the platform they are looked for [m]: as far as the arm reaches down."""

    aside: float = 0.15
    """The same to both sides [m]."""

    tall: float = 0.3
    """Height of what may stand there [m]."""

    same: float = 0.04
    """A thing within this of one that lay there before is that one [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class LyingAbout:
    """A thing that lies on the platform or on the table, the height of what it lies on [m], and the picture of it."""

    thing: SeenThing
    support: float
    picture: Picture


def look_about(
    cell: Cell, learning: Learning, faces: KnownFaces, robot: RobotShape, known: Sequence[Array] = ()
) -> LyingAbout | None:
    """Return what lies on the platform, else before it, else anywhere on the table; of several the largest.

    What is near to the arm in a picture is the arm's, and a camera that has stopped sees nothing.

    Args:
        cell: whose arm is best out of the cameras' sight.
        learning: where bins and platform are; this stands on the table.
        faces: of what stands still.
        robot: the arm's shapes.
        known: middles (3,) in W of what lay on the table before: another thing than what is looked for [m].

    Raises:
        StationError: the scanning camera measures nothing, and the other one sees nothing.
    """
    for found in _found(cell, learning, faces, robot):
        new = [one for one in found if all(np.linalg.norm(one.thing.middle - place) > TUNING.same for place in known)]
        if new:
            return max(new, key=lambda one: len(one.thing.points))
    return None


def _found(cell: Cell, learning: Learning, faces: KnownFaces, robot: RobotShape) -> Iterator[list[LyingAbout]]:
    """Yield what lies where, the likeliest place first; raises as `look_about`."""
    scan, dark = None, StationError("")
    try:
        scan = steady_picture(cell, learning.scan_camera)
        yield on_platform(scan, learning, robot)
        yield before_platform(scan, learning, robot)
    except StationError as why:
        dark = why
    try:
        above = steady_picture(cell, learning.bin_camera)
        yield [
            LyingAbout(one, support_of(one, learning), above) for one in things_beside(above, learning, faces, robot)
        ]
    except StationError:
        pass  # the other camera sees most of the table, too
    if scan is None:
        raise dark
    yield [LyingAbout(one, support_of(one, learning), scan) for one in things_beside(scan, learning, faces, robot)]


def on_platform(picture: Picture, learning: Learning, robot: RobotShape) -> list[LyingAbout]:
    """Return what a picture shows on the platform."""
    low, high = (np.array(corner) for corner in learning.platform)
    box = np.array([*(low[:2] - TUNING.around), high[2]]), high + [TUNING.around, TUNING.around, TUNING.tall]
    found = [LyingAbout(one, float(high[2]), picture) for one in _but_the_arm(picture, robot, *box)]
    return [
        one
        for one in found
        if (np.abs(one.thing.middle - 0.5 * (low + high)) < 0.5 * (high - low) + TUNING.over)[:2].all()
    ]


def before_platform(picture: Picture, learning: Learning, robot: RobotShape) -> list[LyingAbout]:
    """Return what a picture shows on the table before the platform, tall things whole, which hide it."""
    low, high = (np.array(corner) for corner in learning.platform)
    near = np.array([high[0] + TUNING.before, low[1] - TUNING.aside, low[2]])
    far = np.array([near[0] + TUNING.depth, high[1] + TUNING.aside, low[2] + TUNING.tall])
    found = _but_the_arm(picture, robot, near, far)
    return [LyingAbout(replace(one, beside=True), float(low[2]), picture) for one in found]


def _but_the_arm(picture: Picture, robot: RobotShape, low: Array, high: Array) -> list[SeenThing]:
    """Return what a picture shows within a box, but for the arm over it."""
    return [
        one
        for one in things_within(picture, low, high)
        if robot.near(one.points, picture.q, BESIDE.robot, picture.fingers).mean() < 0.5
    ]
