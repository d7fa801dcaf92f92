"""How fast unknown things move: what rests is not told to go, whatever hides it; what goes is told soon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.perception.registration.test_whole_image import SUGAR, TALL, standing
from tests.synthetic_scene import Thing, camera, picture
from twin_diagram import scenario
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, advance
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.flow import Flow
from twin_diagram.perception.things.memory import Life
from twin_diagram.perception.things.motion import ShownMotion, axes_of, shown_again, velocity_of
from twin_diagram.signals import things
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.depth_sensor import DepthSensor

Array = npt.NDArray[np.float64]
PERIOD = 1.0 / 15.0
VIEW = replace(camera(320, 240, 300.0), depth_noise=DepthSigma.of(scenario.DepthNoise(sheet="d435")))
GRID = Grid.of(VIEW, 1)
PLACE = np.array([0.45, 0.0])


class Watched:
    """Images of a scene without a library before a D435, an arm of balls before it, and what is told of its things."""

    def __init__(self, seed: int) -> None:
        told = scenario.Camera(width=320, height=240, focal=300.0)
        off = faults(scenario.CameraDefects(profile="d435"))
        self._sensor = DepthSensor(VIEW.optics, told, off, 0.001, 1.0, seed)
        self._told = ImageSettings((), scenario.Registration(), 60, scenario.Slots(), Life(0.5, 5.0))
        self._beside, self._k = OtherMemory.empty(self._told), 0

    def segments(self, standing_: list[Thing], balls: list[tuple[Array, float]]) -> Segments:
        rgb, depth, _ = picture(VIEW, standing_, None, balls=balls)
        depth = self._sensor.measured(depth, self._k)

        def near_robot(points: Array, margin: float) -> npt.NDArray[np.bool_]:
            near = [np.linalg.norm(points - centre, axis=1) < radius + margin for centre, radius in balls]
            return np.any(near, axis=0) if near else np.zeros(len(points), dtype=bool)

        return segment(rgb, depth, self._k * PERIOD, GRID, scenario.Perception(smallest=60), near_robot)

    def see(self, standing_: list[Thing], balls: list[tuple[Array, float]] | None = None) -> list[things.Thing]:
        outcome = advance([], self._beside, self.segments(standing_, balls or []), self._told)
        self._beside, self._k = OtherMemory.unpack(outcome.beside.pack(), self._told), self._k + 1
        return [one for one in things.things_of(outcome.things) if one.stands]


def arm(y: float, height: float) -> list[tuple[Array, float]]:
    """A row of balls above the table, as a forearm that comes down from behind the camera's view."""
    foot, top = np.array([0.7, y, height]), np.array([0.75, y, 0.9])
    return [(foot + share * (top - foot), 0.06) for share in np.linspace(0.0, 1.0, 12)]


@pytest.mark.parametrize("height", [0.12, 0.22])
@pytest.mark.long
def test_what_rests_is_not_told_to_move_while_an_arm_sweeps_before_it(height: float) -> None:
    frames = wrong = 0
    for seed in range(4):
        watched = Watched(seed)
        box = standing(TALL if seed % 2 else SUGAR, PLACE, 0.4 * seed)
        speed = (0.25, 0.5, 0.8, 1.2)[seed]
        y = -0.4
        way = [y] * 4
        while len(way) < 50:
            y += speed * PERIOD
            speed = -speed if abs(y) > 0.4 else speed
            way.append(y)
        for y in way:
            told = watched.see([box], arm(y, height))
            frames += 1
            wrong += any(one.velocity.any() for one in told)
    assert wrong <= 0.01 * frames, f"{wrong} of {frames}"


@pytest.mark.parametrize("speed", [0.1, *(pytest.param(v, marks=pytest.mark.long) for v in (0.2, 0.35)), 0.5])
@pytest.mark.parametrize("direction", [0.0, *(pytest.param(d, marks=pytest.mark.long) for d in (0.8, 2.5)), 1.57])
def test_what_moves_is_told_within_three_tenths_of_a_second(speed: float, direction: float) -> None:
    watched = Watched(7)
    v = speed * np.array([np.cos(direction), np.sin(direction)])
    start = PLACE - 0.3 * v
    for _ in range(8):
        watched.see([standing(TALL, start, 0.3)])
    told = [watched.see([standing(TALL, start + v * PERIOD * (k + 1), 0.3)]) for k in range(9)]
    for seen in told[4:]:  # 0.3 s after it set off
        (one,) = seen
        assert np.linalg.norm(one.velocity[:2] - v) < 0.25 * speed, (one.velocity, v)
        assert one.velocity_variance < speed**2
    assert told[-1][0].status == ObjectStatus.MOVING


def test_what_comes_back_after_it_was_hidden_does_not_go_on_as_it_did() -> None:
    watched, v = Watched(5), np.array([0.0, 0.4])
    wall = [(np.array([0.95, -0.05, 0.45]), 0.19)]
    place = PLACE - 0.2 * v
    for k in range(8):
        place = PLACE + v * PERIOD * (k - 8)
        watched.see([standing(TALL, place, 0.3)])
    (before,) = watched.see([standing(TALL, place, 0.3)])
    assert before.velocity[1] > 0.2
    for _ in range(8):  # seen, it would have come to rest
        assert all(one.velocity[1] == before.velocity[1] for one in watched.see([], [*wall, *arm(0.0, 0.1)]))
    (after,) = watched.see([standing(TALL, place, 0.3)])
    assert not after.velocity.any()


def test_what_turns_in_place_does_not_go() -> None:
    watched = Watched(3)
    fastest = 0.0
    for k in range(30):
        for one in watched.see([standing(SUGAR, PLACE, 1.0 * k * PERIOD)]):
            fastest = max(fastest, float(np.linalg.norm(one.velocity)))
    assert fastest < 0.06  # its corners go 0.1 m/s


def edges_of(balls: list[tuple[Array, float]], place: Array) -> list[bool]:
    """Which edges along the image's rows count, left then right, of a box there."""
    segments = Watched(2).segments([standing(TALL, place, 0.3)], balls)
    own = np.flatnonzero(np.linalg.norm(segments.points_W[:, :2] - place, axis=1) < 0.12)
    row = shown_again(ShownMotion(), own, segments).rows[-1]
    counts = row[10:].reshape(3, 3)
    return [bool(counts[0, 0]), bool(counts[2, 0])]


def test_edges_that_something_nearer_or_the_border_cuts_off_do_not_count() -> None:
    assert edges_of([], PLACE) == [True, True]
    right, left = edges_of(arm(0.06, 0.1), PLACE), edges_of(arm(-0.06, 0.1), PLACE)
    assert sorted((right, left)) == [[False, True], [True, False]]
    behind = [(centre - [0.45, 0.0, 0.0], radius) for centre, radius in arm(0.06, 0.1)]
    assert edges_of(behind, PLACE) == [True, True]
    assert sorted(edges_of([], np.array([0.45, 0.62]))) == [False, True]


def test_a_motion_survives_its_vector() -> None:
    watched = Watched(1)
    motion = ShownMotion()
    for _ in range(3):
        segments = watched.segments([standing(SUGAR, PLACE, 0.4)], [])
        watched._k += 1
        motion = shown_again(motion, np.flatnonzero(segments.labels == 0), segments)
    again = ShownMotion.unpack(motion.pack())
    for name in ("rows", "jitter", "count", "most"):
        np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
    assert len(motion.rows) == 3


def test_things_are_carried_on_for_a_while() -> None:
    v = np.array([0.2, -0.1, 0.0])
    piece = np.eye(3)
    thing = things.Thing(3, ObjectStatus.MOVING, 0.5, 1.0, np.ones(3), (piece,), v, 1e-4)
    for after, shift, speed in ((0.1, 0.1 * v, v), (0.25, 0.25 * v, v), (2.0, things.COAST * v, 0 * v)):
        (now,) = things.things_of(things.carried(thing.pack(), 1.0 + after))
        np.testing.assert_allclose(now.shift, shift, atol=1e-12)
        np.testing.assert_allclose(now.velocity, speed, atol=1e-12)
        np.testing.assert_array_equal(now.pieces[0], piece)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_comes_into_view_goes_as_fast_as_it_does(side: float) -> None:
    """The part of it that is seen goes half as fast at first, and its edge at the border not at all."""
    v = np.array([0.0, -0.3 * side])
    for seed in (4, 5):
        watched, told = Watched(seed), []
        for k in range(20):
            place = np.array([0.45, 0.68 * side]) + v * max(0, k - 5) * PERIOD
            told += [one for one in watched.see([standing(TALL, place, 0.3)]) if one.velocity.any()]
        assert len(told) >= 8
        for one in told[2:]:
            off = one.velocity[:2] - v
            assert np.linalg.norm(off) < max(0.3 * 0.3, 3.5 * np.sqrt(one.velocity_variance)), (one.velocity, v)


def test_where_the_surface_contradicts_the_edges_it_counts() -> None:
    """What comes in over the border below: one edge stands, the middle goes half as far as the thing does."""
    segments = Watched(1).segments([standing(TALL, PLACE, 0.3)], [])
    away = axes_of(segments)[1]
    rows = np.zeros((5, 19))
    rows[:, 0], rows[:, 10:] = segments.time + PERIOD * np.arange(-4.0, 1.0), 1.0
    for side, share in enumerate((0.04, 0.3, 0.7)):
        rows[:, 1 + 3 * side + 1] = share * 0.33 * rows[:, 0]
    shown = ShownMotion(rows, np.full((3, 3), 1e-6), 10.0)
    alone, variance = velocity_of(shown, np.zeros(3), segments)
    assert alone @ away < 0.02 and variance < 0.01**2  # so sure are they
    surface = Flow(0.33 * away, np.eye(3) / 0.02**2)
    told, variance = velocity_of(shown, np.zeros(3), segments, surface)
    np.testing.assert_allclose(told, 0.33 * away, atol=0.02)
    assert 0.01**2 < variance < 0.03**2
    # Where it does not know better, they count.
    for vague in (Flow(0.33 * away, np.eye(3) / 0.2**2), Flow(0.04 * away, np.eye(3) / 0.02**2)):
        np.testing.assert_array_equal(velocity_of(shown, np.zeros(3), segments, vague)[0], alone)
    # And it may tell that nothing goes.
    rows[:, 1:10] = np.tile((0.3 * rows[:, 0])[:, None], (1, 9))
    for one, goes in ((Flow(np.zeros(3), np.eye(3) / 0.02**2), False), (None, True)):
        assert velocity_of(shown, np.zeros(3), segments, one)[0].any() == goes


def test_a_velocity_that_nothing_shows_is_no_surer_than_it_was() -> None:
    nothing, before = ShownMotion(np.zeros((1, 19))), np.array([0.3, -0.1, 0.0])  # an image in which no edge counts
    segments, variance = Watched(2).segments([standing(TALL, PLACE, 0.3)], []), 0.02
    for _ in range(6):
        told, after = velocity_of(nothing, before, segments, doubted=variance)
        assert 0 < np.linalg.norm(told) < np.linalg.norm(before) and variance < after < 0.1
        before, variance = told, after
    still, none = velocity_of(nothing, np.zeros(3), segments)
    assert not still.any() and none == 0.0
