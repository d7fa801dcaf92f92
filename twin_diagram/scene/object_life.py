"""What a filter cannot tell of an object's life: that its place is empty, that it is held. Pure functions on arrays.

A place that the camera saw through in some images running is empty: the object is *gone*, no obstacle any more, and
looked for elsewhere. An object near the tool that moves as the tool moves is *held*: it goes along with the tool, seen
or not, until it is seen not to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twin_diagram.scene.object_filter import FilterLayout, Mode
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE, ObjectStatus


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand for 15 images a second."""

    empty_images: int = 3
    """A place seen empty in so many images running is empty: depth comes half a frame late."""

    reach: float = 0.12
    """What is held is no farther than this from the tool's origin [m], beside its own radius …"""

    slowest: float = 0.04
    """… while the tool moves faster than this there [m/s] …"""

    slip: float = 0.3
    """… and the object goes along, but for this share of that speed …"""

    slip_floor: float = 0.02
    """… and this [m/s], the noise of a velocity."""

    images: int = 4
    """In so many images running it must go along to count as held, or stay behind to count as let go."""


TUNING = Tuning()


class LifeLayout:
    """Where a life's numbers stand in its vector."""

    EMPTY = 0
    """Images running that showed its place empty."""
    GONE_SINCE = 1
    """[s]; `NEVER` while it is there."""
    IMAGE_TIME = 2
    """Of the newest image that was counted [s]."""
    ALONG = 3
    """Images running in which it went along with the tool; negative: stayed behind."""
    HELD = 4
    """1 while it is held."""
    X_TO = slice(5, 5 + POSE_SIZE)
    """Its pose in the tool's frame, while it is held."""
    X_WO = slice(12, 12 + POSE_SIZE)
    """Its pose in W at the last tick, while it is held: carried by the tool."""
    IDENTITY = 19
    """Of what the row holds; 0: nothing."""


LIFE_SIZE: Final = 20
"""Numbers of a life, see `LifeLayout`."""

_UNSEEN, _HELD, _GONE = (float(s) for s in (ObjectStatus.UNSEEN, ObjectStatus.HELD, ObjectStatus.GONE))


class Tool(NamedTuple):
    """The tool's motion in W."""

    pose: Array
    """(7) X_WT."""
    velocity: Array
    """(6) angular [rad/s], linear [m/s]."""


def initial_lives(identities: Array) -> Array:
    """Return (R, LIFE_SIZE) for rows that hold these identities (R,)."""
    lives = np.zeros((len(identities), LIFE_SIZE))
    lives[:, [LifeLayout.GONE_SINCE, LifeLayout.IMAGE_TIME]] = NEVER
    lives[:, [LifeLayout.X_TO.start, LifeLayout.X_WO.start]] = 1.0
    lives[:, LifeLayout.IDENTITY] = identities
    return lives


def after_image(life: Array, quality: float, time: float) -> Array:
    """Return a life after an image.

    Args:
        life: (LIFE_SIZE,).
        quality: of the object's measurement: above 0 where it was found, below 0 where its place was seen empty.
        time: of the image [s].
    """
    if not time > life[LifeLayout.IMAGE_TIME]:
        return life
    after = life.copy()
    after[LifeLayout.IMAGE_TIME] = time
    after[LifeLayout.EMPTY] = life[LifeLayout.EMPTY] + 1.0 if quality < 0.0 else 0.0
    if quality > 0.0:
        after[LifeLayout.GONE_SINCE] = NEVER
    elif after[LifeLayout.EMPTY] >= TUNING.empty_images and life[LifeLayout.GONE_SINCE] < 0.0:
        after[LifeLayout.GONE_SINCE] = time
        after[LifeLayout.HELD] = 0.0
    return after


def along_with(life: Array, filter_: Array, tool: Tool, radius: float) -> Array:
    """Return a life after the object was found anew: whether it goes along with the tool.

    Args:
        life: (LIFE_SIZE,).
        filter_: (FILTER_SIZE,) of the object, with the measurement taken in.
        tool: now.
        radius: of the object about its origin [m].
    """
    p, v = filter_[FilterLayout.POSE][4:], filter_[FilterLayout.VELOCITY][3:]
    arm = p - tool.pose[4:]
    there = tool.velocity[3:] + np.cross(tool.velocity[:3], arm)
    speed = float(np.linalg.norm(there))
    if speed < TUNING.slowest:
        return life  # a tool at rest tells nothing
    moving = filter_[FilterLayout.MODE] == Mode.MOVING
    near = float(np.linalg.norm(arm)) < TUNING.reach + radius
    slip = float(np.linalg.norm((v if moving else 0.0 * v) - there))
    along = near and moving and slip < TUNING.slip * speed + TUNING.slip_floor
    after, count = life.copy(), life[LifeLayout.ALONG]
    count = max(count, 0.0) + 1.0 if along else min(count, 0.0) - 1.0
    after[LifeLayout.ALONG] = np.clip(count, -TUNING.images, TUNING.images)
    if count >= TUNING.images:
        after[LifeLayout.HELD] = 1.0
    elif count <= -TUNING.images:
        after[LifeLayout.HELD] = 0.0
    if after[LifeLayout.HELD]:
        after[LifeLayout.X_TO] = in_tool(filter_[FilterLayout.POSE], tool.pose)
    return after


def gripped(life: Array, X_TO: Array, tool: Tool) -> Array:
    """Return the life of an object that the fingers hold: no image of its old place makes it gone.

    Args:
        life: (LIFE_SIZE,).
        X_TO: (7) its pose in the tool's frame.
        tool: now.
    """
    after = life.copy()
    after[LifeLayout.EMPTY], after[LifeLayout.GONE_SINCE], after[LifeLayout.HELD] = 0.0, NEVER, 1.0
    after[LifeLayout.X_TO], after[LifeLayout.X_WO] = X_TO, with_tool(X_TO, tool.pose)
    return after


def in_tool(pose: Array, tool: Array) -> Array:
    """Return X_TO (7) of an object at X_WO (7) beside a tool at X_WT (7)."""
    turn = rotations.matrix(tool[:4])
    inverse = tool[:4] * [1.0, -1.0, -1.0, -1.0]
    q = rotations.normalized(rotations.multiply(inverse, pose[:4]))
    return np.concatenate([q, turn.T @ (pose[4:] - tool[4:])])


def with_tool(X_TO: Array, tool: Array) -> Array:
    """Return X_WO (7), the inverse of `in_tool`."""
    q = rotations.normalized(rotations.multiply(tool[:4], X_TO[:4]))
    return np.concatenate([q, tool[4:] + rotations.matrix(tool[:4]) @ X_TO[4:]])


def statuses(lives: Array, of_filters: Array) -> Array:
    """Return (R,) `ObjectStatus`: what the filters say (R,), unless an object is held or gone."""
    status = of_filters.copy()
    status[lives[:, LifeLayout.HELD] > 0.0] = _HELD
    status[lives[:, LifeLayout.GONE_SINCE] >= 0.0] = _GONE
    status[of_filters == _UNSEEN] = _UNSEEN
    return status
