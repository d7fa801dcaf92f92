"""Looks for what was lost outside of the bins, wherever a camera sees, and puts it away."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import StationError
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.display import NothingHeld
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.handling import TUNING as HANDLING
from twin_diagram.runs.learning.handling import Tools, go_home, let_go, put_away, take_up, walls_about
from twin_diagram.runs.learning.looking_about import LyingAbout, look_about
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.picking import Taken, reach_of, take
from twin_diagram.runs.learning.regrasping import PLATFORM
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.thing_grasps import downward, grasps_of_thing, why_not
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Sought:
    """What came of looking for something outside of the bins.

    Attributes:
        told: in words.
        lying: what was seen last, and how; None: nothing.
        put: where it was put; None: it was not.
    """

    told: str
    lying: LyingAbout | None = None
    put: PutDown | None = None


GoOn = Callable[[LyingAbout, Taken], PutDown]
"""Goes on with what lay somewhere and is held again, and puts it away; raises where it does not come to that."""


def seek(tools: Tools, standing: Sequence[PutDown], known: Sequence[Array] = (), go_on: GoOn | None = None) -> Sought:
    """Look for something on the platform and all about it, take it, and put it away beside what stands there.

    Args:
        tools: whose hand is empty.
        standing: what stands in the other bin.
        known: middles (3,) of what lay on the table before: it is left there [m].
        go_on: what is done with it once it is held, the first time; later, and if it is None, it is put away as it lay.
    """
    lying, why = None, ""
    for attempt in range(tools.learning.tries):
        with contextlib.suppress(NoWay):
            go_home(tools)  # what is behind the arm is not seen
        try:
            found = look_about(tools.cell, tools.learning, tools.faces, tools.robot, known)
        except StationError as error:
            tools.mover.stand(PLATFORM, [], 0.0)
            return Sought(f"nobody sees where it lies: {error}", lying)
        if found is None:
            tools.mover.stand(PLATFORM, [], 0.0)
            nothing = "nothing is seen on the platform, nor on the table about it"
            return Sought(nothing if lying is None else f"{why}, and then {nothing}", lying)
        lying = found
        thing, support = found.thing, found.support
        tools.mover.stand(PLATFORM, [thing.points], support)
        try:
            taken, why = _take_fallen(tools, thing, support, attempt)
            if taken is not None:
                tools.mover.stand(PLATFORM, [], 0.0)
                once, go_on = go_on, None
                if once is not None:
                    put = once(found, taken)
                else:
                    put = put_away(tools, as_lying(thing, support, taken), standing)
                return Sought("it was found outside of the bins and put away", found, put)
        except (NoWay, NothingHeld, StationError) as error:
            why = str(error)
            fell = let_go(tools)
            tools.mover.stand(PLATFORM, [], 0.0)
            if fell is not None:
                return Sought(f"it was let fall into the other bin: {why}", found, fell)
    tools.mover.stand(PLATFORM, [], 0.0)
    return Sought(f"it lies outside of the bins: {why}", lying)


def _take_fallen(tools: Tools, thing: SeenThing, support: float, attempt: int) -> tuple[Taken | None, str]:
    """Try to take what lies somewhere; what is held, or why nothing is."""
    reach, why = None, ""
    for around in walls_about(tools, thing):
        grasps = grasps_of_thing(thing, tools.gripper, support + HANDLING.floor, around, attempt)
        order = np.roll(downward(grasps), -2 * attempt)
        why = "out of reach" if len(order) else why_not(thing, tools.gripper, grasps)
        if (reach := reach_of(tools.mover, tools.cell, grasps, order.tolist())) is not None:
            break
    if reach is None:
        return None, why
    taken = take(tools.mover, tools.cell, reach)
    if taken is None:
        return None, "the fingers held nothing"
    take_up(tools, thing, taken)
    return taken, ""


def as_lying(thing: SeenThing, support: float, taken: Taken) -> ShownObject:
    """Return what is known of a thing that was only seen as it lay: enough to set it down as it lay."""
    below = thing.points.copy()
    below[:, 2] = support  # what no picture shows of it goes down to there
    points = (np.vstack([thing.points, below]) - taken.X_WT[:3, 3]) @ taken.X_WT[:3, :3]
    followed = Followed(points=points, normals=np.zeros_like(points))
    return ShownObject(followed, [np.eye(4)], [taken.opening], R_WT=taken.X_WT[:3, :3])
