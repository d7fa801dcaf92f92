"""Alikes are told apart and things that no library knows are held by pieces, image by image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import ConvexHull

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets.asset import Asset
from twin_diagram.assets.description import read_spec
from twin_diagram.perception.registration import instances
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, Outcome, advance, sizes
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import HeldPlaces, Segments
from twin_diagram.perception.things.memory import Life
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import FURTHER_MEASUREMENT_SIZE, things_of

Array = npt.NDArray[np.float64]
VIEW = camera(320, 240, 300.0)
GRID = Grid.of(VIEW, 1)
PERIOD = 1.0 / 15.0
A, B, C = np.array([0.45, -0.2]), np.array([0.6, 0.22]), np.array([0.4, 0.1])


def asset_of(name: str) -> Asset:
    return Asset.load(models_dir() / "objects" / name)


SUGAR, TALL = asset_of("sugar_box"), asset_of("mover")


@pytest.fixture(scope="module")
def library() -> tuple[Known, ...]:
    return (Known.of(ModelCloud.of(SUGAR, scenario.Registration().model_points)),)


def standing(asset: Asset, place: Array, yaw: float) -> Thing:
    seed = int(read_spec(asset.folder).texture_seed or 0)
    return Thing(asset, seed, yawed(yaw), np.array([*place, asset.size[2] / 2]))


def shot(things: list[Thing], k: int, balls: list[tuple[Array, float]] | None = None) -> Segments:
    """The k-th image."""
    rgb, depth, _ = picture(VIEW, things, np.random.default_rng(k), balls=balls)
    return segment(rgb, depth, k * PERIOD, GRID, scenario.Perception(smallest=60))


def run(library: tuple[Known, ...], images: list[Segments], slots: scenario.Slots | None = None) -> list[Outcome]:
    """Everything after each image; memory goes through its vector each time."""
    told = ImageSettings(library, scenario.Registration(), 60, slots or scenario.Slots(), Life(0.2, 0.5))
    memory, beside, out = [Slot() for _ in library], OtherMemory.empty(told), []
    for segments in images:
        outcome = advance(memory, beside, segments, told)
        assert (len(outcome.further), len(outcome.things)) == sizes(told)
        memory, beside = outcome.slots, OtherMemory.unpack(outcome.beside.pack(), told)
        np.testing.assert_allclose(beside.pack(), outcome.beside.pack(), rtol=0, atol=1e-12)
        out.append(outcome)
    return out


def places(outcome: Outcome) -> dict[int, Array]:
    """Where each instance is that was found: 0 the library's own, further ones by their identity."""
    found = {0: outcome.poses[0].pose[4:6]} if outcome.poses[0].quality > 0 else {}
    for row in outcome.further.reshape(-1, FURTHER_MEASUREMENT_SIZE):
        if row[0] > 0 and row[2] > 0:
            found[int(row[0])] = row[8:10]
    return found


def near(found: Array, place: Array) -> bool:
    return bool(np.linalg.norm(found - place) < 0.006)


@pytest.mark.long
def test_two_alikes_are_two_and_stay_who_they_are(library: tuple[Known, ...]) -> None:
    a, b = standing(SUGAR, A, 0.4), standing(SUGAR, B, -0.5)
    ball = [(np.array([0.95, 0.0, 0.45]), 0.19)]  # before everything
    images = [shot([a, b], k) for k in range(4)]
    images += [shot([a, b], k, ball) for k in range(4, 10)]
    images += [shot([a, b], k) for k in range(10, 14)]
    out = run(library, images)
    first = places(out[3])
    assert set(first) == {0, 1}
    where = {0: A, 1: B} if near(first[0], A) else {0: B, 1: A}
    for outcome in (out[3], out[13]):
        assert set(places(outcome)) == {0, 1}
        assert all(near(p, where[who]) for who, p in places(outcome).items())
    # Hidden is not gone, and makes nothing new.
    assert all(one.poses[0].quality >= 0.0 for one in out)
    assert out[-1].beside.identities[0] == 2


@pytest.mark.long
def test_the_one_that_is_left_stays_itself_and_the_one_that_comes_back_is_the_old_one(
    library: tuple[Known, ...],
) -> None:
    a, b = standing(SUGAR, A, 0.4), standing(SUGAR, B, -0.5)
    out = run(library, [shot([a, b], k) for k in range(3)])
    first = places(out[-1])
    taken, left = (a, b) if near(first[0], A) else (b, a)
    back = standing(SUGAR, C, 1.0)
    images = [shot([a, b], k) for k in range(3)] + [shot([left], k) for k in range(3, 12)]
    images += [shot([left, back], k) for k in range(12, 28)]
    out = run(library, images)
    for outcome in out[3:12]:
        # The slot of the one taken away does not jump to its like, and sees that its place is empty.
        assert set(places(outcome)) == {1} and near(places(outcome)[1], left.p[:2])
        assert outcome.poses[0].quality < -0.3
    assert set(places(out[-1])) == {0, 1} and out[-1].beside.identities[0] == 2
    assert near(places(out[-1])[0], C) and near(places(out[-1])[1], left.p[:2])
    assert not np.allclose(taken.p, back.p)


def test_a_further_instance_whose_place_stays_empty_frees_its_slot(library: tuple[Known, ...]) -> None:
    a, b = standing(SUGAR, A, 0.4), standing(SUGAR, B, -0.5)
    out = run(library, [shot([a, b], k) for k in range(3)])
    stays = a if near(places(out[-1])[0], A) else b
    images = [shot([a, b], k) for k in range(3)] + [shot([stays], k) for k in range(3, 14)]
    out = run(library, images, scenario.Slots(forget_after=0.4))
    held = [int(one.further.reshape(-1, FURTHER_MEASUREMENT_SIZE)[0, 0]) for one in out]
    assert held[3:8] == [1] * 5 and held[-1] == 0 and near(places(out[-1])[0], stays.p[:2])


def test_what_is_recognised_where_an_alike_was_lost_is_that_one(library: tuple[Known, ...]) -> None:
    a, b = standing(SUGAR, A, 0.4), standing(SUGAR, B, -0.5)
    told = ImageSettings(library, scenario.Registration(), 60, scenario.Slots(), Life(0.2, 0.5))
    out = run(library, [shot([a, b], k) for k in range(3)])[-1]
    # Turned by more than registration finds back, and no search of its own is due.
    lost = {"R": yawed(-0.5 + 1.3), "seen": -1.0, "next_search": 99.0}
    memory, beside = [replace(out.slots[0], **lost)], out.beside
    if near(places(out)[1], B):
        memory = list(out.slots)
        further = [replace(one, slot=replace(one.slot, **lost)) if one.identity else one for one in beside.further]
        beside = replace(beside, further=tuple(further))
    for k in range(3, 12):
        out = advance(memory, beside, shot([a, b], k), told)
        memory, beside = out.slots, out.beside
    assert set(places(out)) == {0, 1} and beside.identities[0] == 2


def thing_inside(pieces: tuple[Array, ...], thing: Thing) -> float:
    """Share of a thing's volume that its pieces hold."""
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 3)) * thing.asset.size @ thing.R.T + thing.p
    held = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        sides = ConvexHull(piece).equations
        held |= (points @ sides[:, :3].T + sides[:, 3] <= 1e-9).all(axis=1)
    return float(held.mean())


def test_an_unknown_thing_stands_by_the_second_image_and_goes_when_its_place_is_seen_empty(
    library: tuple[Known, ...],
) -> None:
    box, tall = standing(SUGAR, A, 0.4), standing(TALL, B, 0.2)
    ball = [(np.array([0.95, 0.12, 0.5]), 0.16)]
    images = [shot([box, tall], k) for k in range(3)]
    images += [shot([box, tall], k, ball) for k in range(3, 13)]
    images += [shot([box], k) for k in range(13, 18)]
    out = run(library, images)
    # The ball is another unknown thing, for as long as it is there.
    things = [[thing for thing in things_of(one.things) if thing.identity == 1] for one in out]
    assert [thing.stands for thing in things[0]] == [False]
    for k in range(1, 13):
        assert [thing.identity for thing in things[k]] == [1] and things[k][0].stands
        assert thing_inside(things[k][0].pieces, tall) > 0.95
    assert things[2][0].status == ObjectStatus.TRACKED
    # Hidden for long it is lost from sight, and is still kept clear of.
    assert things[8][0].status == ObjectStatus.STALE and things[12][0].status == ObjectStatus.LOST
    assert things[15][0].status == ObjectStatus.GONE and not things[15][0].stands and things[16] == []


def test_an_unknown_thing_that_is_moved_takes_its_pieces_along(library: tuple[Known, ...]) -> None:
    ways = [standing(TALL, B - [0.0, 0.02 * max(k - 3, 0)], 0.2) for k in range(10)]
    out = run(library, [shot([standing(SUGAR, A, 0.4), one], k) for k, one in enumerate(ways)])
    for one, outcome in zip(ways[1:], out[1:], strict=True):
        (thing,) = (thing for thing in things_of(outcome.things) if thing.identity)
        assert thing.identity == 1 and thing_inside(thing.pieces, one) > 0.9
    assert thing.status == ObjectStatus.MOVING


def carried(late: float, told: bool, beside: bool = False) -> list[Segments]:
    """Images of a box that a hand takes away at 1.8 m/s, a ball 5 cm beside it; the hand is `told`, depth is `late`."""
    start, step = standing(SUGAR, A, 0.4), np.array([0.04, 0.1, 0.05])

    def at(k: float) -> Thing:
        return replace(start, p=start.p + max(k - 2.0, 0.0) * step)

    out = []
    for k in range(6):
        rng, there = np.random.default_rng(k), [at(k - s * late) for s in (0.0, 0.5, 1.0)]
        balls = [[(one.p + [0.0, 0.0, 0.23], 0.09)] if beside else [] for one in there]
        rgb, _, _ = picture(VIEW, there[:1], rng, balls=balls[0])
        _, depth, _ = picture(VIEW, there[2:], rng, balls=balls[2])
        segments = segment(rgb, depth, k * PERIOD, GRID, scenario.Perception(smallest=60))
        held = HeldPlaces(0, np.stack([one.R for one in there]), np.stack([one.p for one in there]))
        out.append(replace(segments, held=held if told and k else None))
    return out


def test_what_the_hand_takes_away_is_looked_for_where_the_hand_has_it(library: tuple[Known, ...]) -> None:
    unaware, aware = (run(library, carried(0.0, told)) for told in (False, True))
    assert unaware[-1].poses[0].quality <= 0.0 and any(thing.stands for thing in things_of(unaware[-1].things))
    for k, one in enumerate(aware):
        assert one.poses[0].quality > 0.0 and not any(thing.identity for thing in things_of(one.things))
        there = standing(SUGAR, A, 0.4).p + max(k - 2, 0) * np.array([0.04, 0.1, 0.05])
        assert np.linalg.norm(one.poses[0].pose[4:] - there) < 0.005


def test_what_is_held_is_no_thing_though_depth_is_late_and_what_is_beside_it_is_one(library: tuple[Known, ...]) -> None:
    for told, beside in ((False, False), (True, False), (True, True)):
        out = run(library, carried(0.5, told, beside))
        assert any(thing.stands for thing in things_of(out[-1].things)) == (beside or not told)
        assert not told or beside or not any(thing.identity for one in out for thing in things_of(one.things))


@pytest.mark.long
def test_the_place_that_a_hand_took_a_thing_from_does_not_tell_that_it_is_gone(library: tuple[Known, ...]) -> None:
    unaware, aware = ([one.poses[0].quality for one in run(library, carried(0.5, told))] for told in (False, True))
    assert min(unaware) < 0.0 and min(aware) >= 0.0
    shown = carried(0.5, True)
    for k in (4, 5):  # but where the hand has it no more, images show that, too
        fallen = np.array([0.0, -0.15, 0.0])
        shown[k] = replace(shown[k], held=HeldPlaces(0, shown[k].held.R, shown[k].held.p + fallen))  # type: ignore[union-attr]
    assert min(one.poses[0].quality for one in run(library, shown)) < 0.0


def test_what_finds_no_slot_is_counted_and_nothing_breaks(library: tuple[Known, ...]) -> None:
    things = [standing(SUGAR, A, 0.4), standing(SUGAR, B, -0.5), standing(TALL, C + [0.3, -0.3], 0.2)]
    images = [shot(things, k) for k in range(5)]
    out = run(library, images, scenario.Slots(instances=1, unknown=1))
    assert all(one.beside.turned_away == (0, 1) for one in out)  # two are unknown, and one slot there is
    assert [len(places(one)) for one in out] == [1] * 5
    out = run(library, images, scenario.Slots(instances=2, unknown=0))
    assert all(one.things.size == 0 and one.beside.turned_away[1] > 0 for one in out)


def test_an_image_like_the_last_one_makes_the_same_of_the_same(library: tuple[Known, ...]) -> None:
    images = [shot([standing(SUGAR, A, 0.4), standing(TALL, B, 0.2)], k) for k in range(3)]
    one, two = run(library, images), run(library, [replace(image) for image in images])
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.beside.pack(), b.beside.pack())
        np.testing.assert_array_equal(a.things, b.things)


def test_a_thing_is_compared_with_what_is_as_tall_first(
    library: tuple[Known, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One comparison is made in an image: of two of ten grey things, a mug had waited for up to twenty."""
    points = scenario.Registration().model_points
    grey = [replace(one, colours=np.full_like(one.colours, 0.5)) for one in (SUGAR, TALL, asset_of("mug"))]
    known = {k: Known.of(ModelCloud.of(one, points)) for k, one in enumerate(grey)}
    asked: list[tuple[int, bool]] = []
    for k, one in known.items():
        segments = shot([standing(one.model.asset, A, 0.4)], 0)
        monkeypatch.setattr(
            instances,
            "recognise",
            lambda models, ways, *_: asked.append((*models, ways[min(models)] is known[min(models)].upright)) or {},
        )
        of, usual = np.flatnonzero(segments.labels >= 0), dict.fromkeys(known, 0.0)
        done = instances.recognised(known, of, 0, segments, scenario.Registration(), 60, usual, Frame.of(segments))
        assert done == (-1, None, 1) and asked[-1] == (k, True)
