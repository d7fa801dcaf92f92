"""What each camera remembers, and what is handed from one to the other."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.instances import Instance
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory
from twin_diagram.perception.several_views import view_memory
from twin_diagram.perception.several_views.view_memory import ViewMemory, all_sides, contradicted, entering, left
from twin_diagram.perception.things.memory import Life, Remembered
from twin_diagram.signals.layouts import NEVER, ObjectStatus
from twin_diagram.signals.things import Thing

KNOWN = cast(Any, SimpleNamespace(model=SimpleNamespace(asset=SimpleNamespace(symmetric_axis=None, symmetries=()))))
TOLD = ImageSettings(
    (KNOWN, KNOWN), scenario.Registration(), 10, scenario.Slots(instances=3, unknown=2), Life(1.0, 5.0)
)
P = np.array([0.5, 0.1, 0.05])


def slot(seen: float, p: Any = P, **more: Any) -> Slot:
    return Slot(True, np.eye(3), np.asarray(p, dtype=float), seen=seen, **more)


def view(*slots: Slot, time: float = 1.0, **more: Any) -> ViewMemory:
    """A camera's memory; slots that are not told are empty."""
    empty = ViewMemory.empty(TOLD, 2.0)
    return replace(empty, slots=(*slots, *empty.slots[len(slots) :]), time=time, **more)


def test_a_memory_packs_and_unpacks() -> None:
    thing = Remembered(Thing(4, ObjectStatus.TRACKED, 0.5, 0.9), samples=np.ones((3, 3)))
    one = view(slot(1.0, alike=0.7, odds=2.0), slot(0.8), identities=(3,), things=(thing, Remembered()))
    back = ViewMemory.unpack(one.pack(), TOLD)
    np.testing.assert_array_equal(back.pack(), one.pack())
    assert back.identities == (3,) and back.things[0].thing.identity == 4 and back.slots[0].odds == 2.0


def test_one_camera_alone_goes_on_from_what_it_remembers() -> None:
    own = view(slot(1.0, velocity=np.full(6, 0.1)), slot(0.3, next_search=2.0, attempts=3))
    entry = entering([own], 0, OtherMemory.empty(TOLD), TOLD, 1.07)
    assert [one.pack().tolist() for one in entry.slots] == [one.pack().tolist() for one in own.slots[:2]]
    assert entry.elsewhere == [] and entry.beside.shift is own.shift


def test_who_sees_an_object_itself_goes_on_from_there() -> None:
    """Calibrations that differ are no motion: neither pose nor velocity of the other camera counts."""
    own, other = view(slot(1.0)), view(slot(1.03, P + 0.006, velocity=np.full(6, 0.2)), time=1.03)
    entry = entering([own, other], 0, OtherMemory.empty(TOLD), TOLD, 1.07)
    assert entry.slots[0] is own.slots[0] and entry.elsewhere == []


def test_what_only_the_other_follows_is_handed_to_it_and_not_searched() -> None:
    own = view(slot(0.4, P + 0.2, alike=0.6, attempts=2, next_search=0.9))
    other = view(slot(1.03, P, velocity=np.array([0, 0, 0, 0.3, 0, 0.0]), odds=4.0), time=1.03)
    (handed, _), found = entering([own, other], 0, OtherMemory.empty(TOLD), TOLD, 1.07).slots[:2], None
    np.testing.assert_allclose(handed.p, P + [0.012, 0, 0])
    assert found is None and handed.alike == 0.6 and handed.odds == 4.0 and handed.next_search == np.inf
    entry = entering([own, other], 0, OtherMemory.empty(TOLD), TOLD, 1.07)
    assert len(entry.elsewhere) == 1 and np.allclose(entry.elsewhere[0][2], handed.p)
    after, _ = left(own, entry.beside, entry.slots, entry.beside, 1.07)
    assert after.slots[0].next_search == NEVER and not after.follows(0, 1.1)


def test_what_no_camera_follows_is_looked_for_where_it_was_seen_last() -> None:
    own, other = view(slot(0.4, P + 0.2)), view(slot(0.9, P), time=1.03)
    entry = entering([own, other], 0, OtherMemory.empty(TOLD), TOLD, 1.07)
    np.testing.assert_array_equal(entry.slots[0].p, P)
    assert entry.slots[0].seen == 0.9 and entry.slots[0].next_search == NEVER and entry.elsewhere == []


def test_a_camera_that_stopped_hands_on_no_more_than_where_it_was() -> None:
    own, other = view(slot(0.4, P + 0.2), time=5.0), view(slot(1.0, P), time=1.0)
    entry = entering([own, other], 0, OtherMemory.empty(TOLD), TOLD, 5.07)
    assert entry.elsewhere == [] and entry.slots[0].seen == 1.0


def test_a_slot_that_changed_hands_is_empty_for_all() -> None:
    own = view(slot(1.0), slot(1.0), slot(1.0, P + 0.1), identities=(1,))
    entry = entering([own], 0, replace(OtherMemory.empty(TOLD), further=(Instance(2, 0),)), TOLD, 1.07)
    assert not entry.beside.further[0].slot.known and entry.beside.further[0].identity == 2


def test_colours_lie_aside_for_each_camera_by_itself() -> None:
    own = view(shift=ColourShift(np.array([1.0, 2.0]), np.eye(2)))
    entry = entering([view(), own], 1, OtherMemory.empty(TOLD), TOLD, 1.07)
    np.testing.assert_array_equal(entry.beside.shift.mean, [1.0, 2.0])


def test_a_place_that_another_camera_sees_to_be_empty_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    own, far = view(slot(1.0)), view(slot(1.0, P + [0.1, 0, 0]))
    for empty, wrong in ((0.8, [(1, 0)]), (0.0, [])):
        monkeypatch.setattr(view_memory, "emptiness", lambda *_, empty=empty: empty)
        assert contradicted([own, far], 0, cast(Any, None), [KNOWN] * 3) == wrong
    near = view(slot(1.0, P + [0.01, 0, 0]))
    assert contradicted([own, near], 0, cast(Any, None), [KNOWN] * 3) == []


def test_of_two_that_turn_it_otherwise_the_surer_is_believed() -> None:
    turned = replace(slot(1.0, odds=0.5), R=np.diag([-1.0, -1.0, 1.0]))
    own, other = view(slot(1.0, odds=4.0)), view(turned)
    assert contradicted([own, other], 0, cast(Any, None), [KNOWN] * 3) == [(1, 0)]
    assert contradicted([own, other], 1, cast(Any, None), [KNOWN] * 3) == []


def thing(identity: int, last: float, status: ObjectStatus = ObjectStatus.TRACKED, at: float = 0.0, **more: Any) -> Any:
    piece = np.array([[at, 0, 0], [at + 0.05, 0, 0], [at, 0.05, 0], [at, 0, 0.05]])
    return Remembered(Thing(identity, status, 0.5, last, np.full(3, at), (piece,)), **more)


def test_a_thing_that_one_camera_has_just_brought_is_not_forgotten_by_another() -> None:
    new, free = thing(1, 1.0, ObjectStatus.UNSEEN), Remembered()
    beside = replace(OtherMemory.empty(TOLD), things=(free, free))
    _, common = left(view(), (entry := replace(beside, things=(new, free))), [Slot()] * 2, beside, 1.0)
    assert common.things[0].thing.identity == 1
    creator = view(things=(new, free))
    _, common = left(creator, entry, [Slot()] * 2, beside, 1.07)
    assert not common.things[0].thing.identity  # it saw it once, and never again


def test_each_camera_keeps_its_own_sides_of_a_thing_and_all_count() -> None:
    mine, other = thing(1, 1.0, at=0.3), thing(1, 1.03, at=0.36)
    views = [view(things=(mine, Remembered())), view(things=(other, Remembered()), time=1.03)]
    beside = replace(OtherMemory.empty(TOLD), things=(other, Remembered()))
    entered = entering(views, 0, beside, TOLD, 1.07).beside.things[0]
    np.testing.assert_array_equal(entered.thing.pieces[0], mine.thing.pieces[0])
    assert entered.thing.last_seen == 1.03  # by whichever camera
    assert len(all_sides(views, beside.things)[0].pieces) == 2
    moved = replace(other, moved=1.02)
    assert len(all_sides(views, [moved, Remembered()])[0].pieces) == 1  # what was seen of it before, lies elsewhere
    again = entering(views, 0, replace(beside, things=(moved, Remembered())), TOLD, 1.07).beside.things[0]
    np.testing.assert_array_equal(again.thing.pieces[0], other.thing.pieces[0])


def test_images_that_show_a_place_empty_are_counted_for_each_camera() -> None:
    """An image of another camera that cannot see the place does not begin the count anew; one that sees it does."""
    mine = view(things=(thing(1, 0.5, empty=2), Remembered()))
    common = replace(OtherMemory.empty(TOLD), things=(thing(1, 0.5, empty=0), Remembered()))
    assert entering([mine, view()], 0, common, TOLD, 1.07).beside.things[0].empty == 2
    seen = replace(common, things=(thing(1, 1.03), Remembered()))
    assert entering([mine, view()], 0, seen, TOLD, 1.07).beside.things[0].empty == 0
