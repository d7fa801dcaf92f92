"""What is remembered of unknown things: how far down they reach, when they move, when they are gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from tests.perception.registration.test_whole_image import SUGAR
from tests.synthetic_scene import Thing, picture, yawed
from twin_diagram import scenario
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import clusters, unexplained
from twin_diagram.perception.things.growing import picture_of
from twin_diagram.perception.things.memory import Life, Remembered, observe
from twin_diagram.signals.layouts import ObjectStatus

DOWN = Pinhole(160, 120, 150.0, np.diag([1.0, -1.0, -1.0]), np.array([0.5, 0.0, 1.2]))
PERCEPTION = scenario.Perception(stride=1, smallest=20)


@pytest.mark.parametrize("height", [0.02, 0.2])
def test_a_thing_does_not_stand_on_its_own_lid(height: float) -> None:
    """A camera that looks straight down took a box for a sheet at the height of its lid, free below."""
    thing = Thing(replace(SUGAR, size=np.array([0.2, 0.14, height])), 1, yawed(0.3), np.array([0.5, 0.0, height / 2]))
    rgb, depth, _ = picture(DOWN, [thing])
    slots, next_identity = [Remembered()], 1
    for time in (0.0, 0.1):
        seen = segment(rgb, depth, time, Grid.of(DOWN, 1), PERCEPTION)
        assert len(seen.planes) == 2
        [own] = clusters(seen, unexplained(seen, []))
        after = observe(slots, seen, [own], [], next_identity, Life(0.5, 5.0))
        slots, next_identity = after.slots, after.next_identity
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 3)) * thing.asset.size * 0.98
    places, held = inside @ thing.R.T + thing.p, np.zeros(2000, dtype=bool)
    for piece in slots[0].thing.pieces:
        sides = ConvexHull(piece).equations
        held |= (places @ sides[:, :3].T + sides[:, 3] <= 0.0).all(axis=1)
    assert held.mean() > 0.95
    _, support = picture_of(seen, own, np.eye(3), np.zeros(3))
    # A low thing's picture keeps the table with it, a high one's nothing: never its lid.
    assert (support is None) == (height > 0.1)
    assert support is None or abs(support.plane[3]) < 0.005


BOX = Thing(replace(SUGAR, size=np.array([0.2, 0.14, 0.1])), 1, np.eye(3), np.array([0.5, 0.0, 0.05]))


def parted(things: list[Thing], time: float, lost: slice = slice(0)) -> Segments:
    """A picture taken apart, without depth in some of its columns."""
    rgb, depth, _ = picture(DOWN, things)
    depth[:, lost] = 0.0
    return segment(rgb, depth, time, Grid.of(DOWN, 1), PERCEPTION)


def followed(*images: Segments) -> list[ObjectStatus]:
    """How a thing's status goes on, image by image."""
    slots, next_identity, statuses = [Remembered()], 1, []
    for seen in images:
        after = observe(slots, seen, clusters(seen, unexplained(seen, [])), [], next_identity, Life(0.5, 5.0))
        slots, next_identity = after.slots, after.next_identity
        statuses.append(slots[0].thing.status)
    assert next_identity == 2
    return statuses


def test_a_place_is_empty_once_it_was_seen_so_in_three_images_running() -> None:
    there, empty = [parted([BOX], 0.1 * k) for k in range(2)], [parted([], 0.2 + 0.1 * k) for k in range(5)]
    blind = parted([], 0.4, slice(None))
    told = followed(*there, *empty[:2], replace(blind, time=0.4), *empty[2:])
    assert ObjectStatus.GONE not in told[:-1] and told[-1] == ObjectStatus.GONE


def test_what_is_half_hidden_only_seems_to_move() -> None:
    moved = replace(BOX, p=BOX.p + [0.05, 0.0, 0.0])
    begin = [parted([BOX], 0.1 * k) for k in range(2)]
    assert followed(*begin, parted([BOX], 0.2, slice(80, None)))[-1] == ObjectStatus.TRACKED
    assert followed(*begin, parted([moved], 0.2))[-1] == ObjectStatus.MOVING


def test_a_thing_of_which_a_part_is_not_counted_in_each_image_keeps_its_pieces() -> None:
    """Making them anew takes longer than all else that is done for it; a handle is now its own segment, now not."""
    whole = [parted([BOX], 0.1 * k) for k in range(2)]
    slots, next_identity, made = [Remembered()], 1, []
    for k in range(6):
        seen = replace(whole[k % 2], time=0.1 * k)
        [own] = clusters(seen, unexplained(seen, []))
        x = seen.points_W[own, 0]
        own = own if k % 2 else own[x < np.quantile(x, 0.8)]
        after = observe(slots, seen, [own], [], next_identity, Life(0.5, 5.0))
        slots, next_identity = after.slots, after.next_identity
        made.append(slots[0].thing.pieces)
    assert made[1] is not made[0] and all(one is made[1] for one in made[2:]), "all of it was seen in the second"
    assert slots[0].thing.status == ObjectStatus.TRACKED
    shoved = parted([replace(BOX, p=BOX.p + [0.04, 0.0, 0.0])], 0.7)
    after = observe(slots, shoved, clusters(shoved, unexplained(shoved, [])), [], next_identity, Life(0.5, 5.0))
    assert after.slots[0].thing.pieces is not made[1] and after.slots[0].thing.status == ObjectStatus.MOVING
