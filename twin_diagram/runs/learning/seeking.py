"""Looks for what was lost outside of the bins, where the scanning camera sees, and puts it away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import StationError
from twin_diagram.runs.learning.bin_view import SeenThing, downward, grasps_of_thing, things_within, why_not
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.handling import PLATFORM, Tools, go_home, let_go, put_away
from twin_diagram.runs.learning.handling import TUNING as HANDLING
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.picking import Taken, reach_of, take
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.steady_picture import steady_picture


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    before: float = 0.03
    """Between the platform and where things that fell off it are looked for [m]."""

    depth: float = 0.2
    """How far before the platform they are looked for [m]: as far as the arm reaches down."""

    aside: float = 0.15
    """The same to both sides [m]."""

    tall: float = 0.3
    """Height of what may stand there [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Sought:
    """What came of looking for something outside of the bins.

    Attributes:
        told: in words.
        thing: what was seen last; None: nothing.
        put: where it was put; None: it was not.
    """

    told: str
    thing: SeenThing | None = None
    put: PutDown | None = None


def seek(tools: Tools, standing: Sequence[PutDown]) -> tuple[Sought, Picture]:
    """Look for something on the platform and before it, take it, and put it away beside what stands there."""
    thing, why = None, ""
    for attempt in range(tools.learning.tries):
        try:
            picture = steady_picture(tools.cell, tools.learning.scan_camera)
        except StationError as error:
            tools.mover.stand(PLATFORM, [], 0.0)
            return Sought(f"nobody sees where it lies: {error}"), tools.cell.look(tools.learning.scan_camera)
        found = fallen(tools, picture)
        if found is None:
            return Sought("nothing lies on the platform or before it" if thing is None else why, thing), picture
        thing, support = found
        tools.mover.stand(PLATFORM, [thing.points], support)
        try:
            taken, why = _take_fallen(tools, thing, support, attempt)
            tools.mover.stand(PLATFORM, [], 0.0)
            if taken is not None:
                put = put_away(tools, _as_lying(thing, support, taken), standing)
                return Sought("it was found outside of the bins and put away", thing, put), picture
            go_home(tools)
        except NoWay as error:
            why = str(error)
            fell = let_go(tools)
            tools.mover.stand(PLATFORM, [], 0.0)
            if fell is not None:
                return Sought(f"it was let fall into the other bin: {why}", thing, fell), picture
    tools.mover.stand(PLATFORM, [], 0.0)
    return Sought(f"it lies outside of the bins: {why}", thing), picture


def fallen(tools: Tools, picture: Picture) -> tuple[SeenThing, float] | None:
    """Return what lies on the platform or on the table before it, and the height of what it lies on; None: nothing."""
    low, high = (np.array(corner) for corner in tools.learning.platform)
    before = np.array([high[0] + TUNING.before, low[1] - TUNING.aside, low[2]])
    far = np.array([high[0] + TUNING.before + TUNING.depth, high[1] + TUNING.aside, low[2] + TUNING.tall])
    for box in ((np.array([low[0], low[1], high[2]]), high + [0.0, 0.0, TUNING.tall]), (before, far)):
        things = things_within(picture, *box)
        if things:
            return max(things, key=lambda one: len(one.points)), float(box[0][2])
    return None


def _take_fallen(tools: Tools, thing: SeenThing, support: float, attempt: int) -> tuple[Taken | None, str]:
    """Try to take what lies somewhere; what is held, or why nothing is."""
    grasps = grasps_of_thing(thing, tools.gripper, support + HANDLING.floor, np.zeros((0, 3)), attempt)
    order = np.roll(downward(grasps), -2 * attempt)
    if not len(order):
        return None, why_not(thing, tools.gripper, grasps)
    reach = reach_of(tools.mover, tools.cell, grasps, order.tolist())
    if reach is None:
        return None, "out of reach"
    taken = take(tools.mover, tools.cell, reach)
    if taken is None:
        return None, "the fingers held nothing"
    tools.mover.hold((thing.points - taken.X_WT[:3, 3]) @ taken.X_WT[:3, :3])
    return taken, ""


def _as_lying(thing: SeenThing, support: float, taken: Taken) -> ShownObject:
    """Return what is known of a thing that was only seen as it lay: enough to set it down as it lay."""
    below = thing.points.copy()
    below[:, 2] = support  # what no picture shows of it goes down to there
    points = (np.vstack([thing.points, below]) - taken.X_WT[:3, 3]) @ taken.X_WT[:3, :3]
    followed = Followed(points=points, normals=np.zeros_like(points))
    return ShownObject(followed, [np.eye(4)], [taken.opening], R_WT=taken.X_WT[:3, :3])
