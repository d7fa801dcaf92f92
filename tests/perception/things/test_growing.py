"""An unknown thing is followed by what was seen of it: its pose, its pictures, and what is not claimed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.perception.registration.test_whole_image import SUGAR, VIEW, shot, standing
from tests.synthetic_scene import Thing
from twin_diagram import scenario
from twin_diagram.assets.building.growth import TUNING as GROWTH
from twin_diagram.assets.building.growth import Growth, Support
from twin_diagram.assets.building.growth_file import read_growth, write_growth
from twin_diagram.errors import FramesError
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.view import View
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, advance
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things import growing
from twin_diagram.perception.things.growing import TUNING, GrowingThing, grown_on, picture_of, shown
from twin_diagram.perception.things.memory import Life
from twin_diagram.signals import rotations
from twin_diagram.signals.things import things_of

Array = npt.NDArray[np.float64]
PLACE = np.array([0.45, -0.1])
BALL = [(np.array([0.95, -0.05, 0.45]), 0.19)]
"""Before the thing."""


class Watched:
    """Images of a scene without a library, and what grows of it."""

    def __init__(self) -> None:
        self.told = ImageSettings((), scenario.Registration(), 60, scenario.Slots(), Life(0.5, 5.0))
        self.beside, self.k = OtherMemory.empty(self.told), 0
        self.growing: dict[int, GrowingThing] = {}

    def see(self, things: list[Thing], balls: list[tuple[Array, float]] | None = None) -> Segments:
        segments = shot(things, self.k, balls)
        outcome = advance([], self.beside, segments, self.told)
        self.beside, self.k = outcome.beside, self.k + 1
        shows = shown(things_of(outcome.things), segments, [])
        view = View(segments, Frame.of(segments), self.told.registration, self.told.smallest)
        self.growing = grown_on(self.growing, shows, view, 4)
        return segments


def yaw_of(R: Array) -> float:
    return float(np.arctan2(R[1, 0], R[0, 0]))


def test_a_thing_that_turns_is_followed_and_each_new_side_kept_once() -> None:
    watched, step = Watched(), 0.07
    for k in range(14):
        watched.see([standing(SUGAR, PLACE + [0.001 * k, 0.0], step * k)])
    (thing,) = watched.growing.values()
    begun = round(thing.begun * 15)
    assert yaw_of(thing.slot.R) == pytest.approx(step * (13 - begun), abs=0.04)
    sides = int(step * (13 - begun) / GROWTH.apart)  # noise may hold the last one back
    assert len(thing.growth) in (sides, sides + 1)
    R, p = thing.placed(np.eye(3), np.zeros(3), thing.slot.seen)
    np.testing.assert_array_equal(R, thing.slot.R)
    np.testing.assert_array_equal(p, thing.slot.p)
    # It stood all the time: the plane under it is where it was.
    assert thing.growth.up is not None
    np.testing.assert_allclose(thing.growth.up, [0.0, 0.0, 1.0], atol=1e-3)


def test_what_stands_still_has_one_picture_and_its_far_side_is_not_claimed() -> None:
    watched = Watched()
    for _ in range(6):
        watched.see([standing(SUGAR, PLACE, 0.4)])
    (thing,) = watched.growing.values()
    assert len(thing.growth) == 1 and not thing.growth.ready
    part = thing.growth.partial()
    away = VIEW.p_WC - np.array([*PLACE, SUGAR.size[2] / 2])
    assert (part.normals @ away / np.linalg.norm(away)).min() > -0.2
    assert 0.2 < part.seen < 0.6


def test_half_hidden_no_picture_is_kept() -> None:
    watched = Watched()
    for k in range(3):
        watched.see([standing(SUGAR, PLACE, 0.02 * k)])
    for k in range(3, 12):
        watched.see([standing(SUGAR, PLACE, 0.06 * k)], BALL)
    assert all(len(thing.growth) == 1 for thing in watched.growing.values())


def test_two_unknown_things_grow_each_for_itself_and_further_ones_wait() -> None:
    watched = Watched()
    pair = [standing(SUGAR, PLACE, 0.4), standing(SUGAR, np.array([0.6, 0.22]), -0.5)]
    for _ in range(3):
        watched.see(pair)
    assert len(watched.growing) == 2
    view = View(shot(pair, 9), Frame.of(shot(pair, 9)), watched.told.registration, 60)
    own = np.flatnonzero(view.segments.labels == 0)
    assert grown_on(watched.growing, {99: own}, view, 2).keys() == watched.growing.keys()
    assert 99 in grown_on(watched.growing, {99: own}, view, 3)


def test_a_picture_keeps_the_thing_and_its_plane_and_nothing_else() -> None:
    other = standing(SUGAR, PLACE + [0.0, 0.14], 0.1)
    segments = shot([standing(SUGAR, PLACE, 0.4), other], 0)
    points = segments.points_W
    mine = [np.linalg.norm(points[segments.labels == k].mean(axis=0)[:2] - PLACE) for k in range(segments.count)]
    own = np.flatnonzero(segments.labels == int(np.argmin(mine)))
    frame, support = picture_of(segments, own, np.eye(3), np.array([*PLACE, 0.0]))
    assert support is not None and frame.mask is not None and frame.rgb is not None
    np.testing.assert_allclose(support.plane, [0, 0, 1, 0], atol=0.01)
    assert frame.rgb.shape[:2] == frame.depth.shape == frame.mask.shape == support.shown.shape
    assert not (frame.mask & support.shown).any()
    assert ((frame.depth > 0) == (frame.mask | support.shown)).all()
    u, v, z = frame.camera.project(points[own])
    there = frame.depth[np.round(v).astype(int), np.round(u).astype(int)]
    np.testing.assert_allclose(there, z, atol=1e-4)  # its camera is that of the window


@pytest.mark.parametrize("tilt, snaps", [(0.05, True), (0.2, False)])
def test_what_stood_stands_but_for_what_was_tipped(tilt: float, snaps: bool) -> None:
    plane = np.array([0.0, 0.0, 1.0, -0.1])
    growth = Growth(supports=(Support(plane, np.zeros((2, 2), bool)),))
    R = rotations.matrix(rotations.exp(np.array([tilt, 0.0, 0.0]))) @ rotations.matrix(
        rotations.exp(np.array([0.0, 0.0, 0.7]))
    )
    found = RegisteredPose(R, np.array([0.4, 0.1, 0.105]), np.eye(6), 1.0, 1.0, 1.0, 100.0)
    after, seems = growing.standing(found, growth, Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1.0))
    assert seems == pytest.approx(tilt, abs=1e-9)
    if snaps:
        np.testing.assert_allclose(after.R[:, 2], [0, 0, 1], atol=1e-12)
        assert after.p[2] == pytest.approx(0.1)
        assert yaw_of(after.R) == pytest.approx(0.7, abs=0.01)
    else:
        assert after is found
    assert growing.standing(found, growth, None) == (found, 0.0)
    assert growing.standing(found, Growth(), Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1.0)) == (found, 0.0)
    assert TUNING.snaps < TUNING.tipped


def test_pictures_survive_a_file(tmp_path: Path) -> None:
    watched = Watched()
    for _ in range(3):
        watched.see([standing(SUGAR, PLACE, 0.4)])
    (thing,) = watched.growing.values()
    path = tmp_path / "growth.npz"
    write_growth(path, thing.growth)
    again = read_growth(path)
    assert len(again) == len(thing.growth) and again.seen == thing.growth.seen
    for one, other in zip(again.frames, thing.growth.frames, strict=True):
        np.testing.assert_array_equal(one.depth, other.depth)
        np.testing.assert_array_equal(one.mask, other.mask)
        np.testing.assert_array_equal(one.rgb, other.rgb)
        np.testing.assert_array_equal(one.camera.p_WC, other.camera.p_WC)
        assert replace(one.camera, R_WC=0, p_WC=0) == replace(other.camera, R_WC=0, p_WC=0)
    path.write_bytes(b"no pictures")
    with pytest.raises(FramesError, match="no pictures of a thing"):
        read_growth(path)


def test_a_thing_that_was_turned_over_is_seen_without_its_plane() -> None:
    watched = Watched()
    for _ in range(3):
        watched.see([standing(SUGAR, PLACE, 0.4)])
    (thing,) = watched.growing.values()
    frame, support = thing.growth.frames[0], thing.growth.supports[0]
    assert support is not None
    over = replace(support, plane=np.array([1.0, 0.0, 0.0, -0.1]))
    lifted = Growth((frame, frame), thing.growth.directions * 2, (support, over))
    assert lifted.up is None
    alone = lifted.alone()
    assert frame.mask is not None
    for one in alone.frames:
        assert ((one.depth > 0) <= frame.mask).all()
    assert (
        replace(lifted, supports=(support, None)).up is None and replace(lifted, supports=(support,) * 2).up is not None
    )
