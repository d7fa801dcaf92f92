"""Which thing of a heap is taken first: the highest one that can be taken for sure."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.runs.learning import which_first as tried
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.choosing import ASIDE, ONE_SIDED, PUSHING, ROOMY, SURE, TIGHT, TIPS, UNSURE
from twin_diagram.runs.learning.picking import Reach
from twin_diagram.runs.learning.which_first import which_first

TOOLS: Any = SimpleNamespace(learning=None, faces=None, robot=None, gripper=SimpleNamespace(opening_most=0.115))


def square(row: int, height: float) -> SeenThing:
    """What fills ten rows of a picture from one on, ten pixels wide."""
    rows, columns = np.meshgrid(np.arange(row, row + 10), np.arange(10), indexing="ij")
    pixels = np.column_stack([rows.ravel(), columns.ravel()])
    points = np.column_stack([0.01 * pixels, np.full(100, height)])
    return SeenThing(points, np.zeros_like(points), pixels, np.zeros(3))


class Searched:
    """What a thing's grasps come to: a kind, or none; and who was looked at for which."""

    def __init__(self, k: int, kind: str | None, looked: list[tuple[int, str]]) -> None:
        self._k, self._kind, self._looked = k, kind, looked

    def one(self, kind: str) -> Reach | None:
        self._looked.append((self._k, kind))
        nowhere = np.zeros((2, 7))
        told = Reach(self._k, np.eye(4), nowhere, nowhere, sure=kind in SURE, roomy=kind == ROOMY)
        return told if kind == self._kind else None

    def best(self) -> Reach | None:
        return next((told for kind in (*SURE, *UNSURE) if (told := self.one(kind)) is not None), None)


def asked(
    monkeypatch: pytest.MonkeyPatch,
    things: list[SeenThing],
    sure: Sequence[bool | str | None],
    roomy: Sequence[bool] = (),
) -> tuple[SeenThing, Reach | None, list[tuple[int, str]]]:
    """Choose among things of which a sure grasp, one by the tips (False), of a kind, or none is reached.

    Returns the thing, its grasp, and what was looked for of which.
    """
    looked: list[tuple[int, str]] = []

    def choice(tools: Any, thing: SeenThing, others: Sequence[SeenThing]) -> Searched:
        k = next(k for k, one in enumerate(things) if one is thing)
        room = roomy[k] if roomy else True
        kinds = {True: ROOMY if room else TIGHT, False: TIPS}
        return Searched(k, told if isinstance(told := sure[k], str) else kinds.get(told), looked)  # type: ignore[arg-type]

    monkeypatch.setattr(tried, "choice_of", choice)
    monkeypatch.setattr(tried, "lying", lambda *told: things)
    thing, chosen = which_first(TOOLS, SimpleNamespace(), things)  # type: ignore[arg-type]
    return thing, chosen.best(), looked


def test_the_highest_goes_first_where_it_is_held_for_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    things = [square(0, 0.1), square(30, 0.05)]
    thing, reach, looked = asked(monkeypatch, things, [True, True])
    assert thing is things[0] and reach is not None and {k for k, _ in looked} == {0}, "no other is looked at"


def test_what_is_held_for_sure_goes_before_what_tips_of_pads_may_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    things = [square(0, 0.1), square(30, 0.06), square(60, 0.05)]
    thing, reach, _ = asked(monkeypatch, things, [False, None, True])
    assert thing is things[2] and reach is not None and reach.sure
    thing, reach, _ = asked(monkeypatch, things, [False, None, False])
    assert thing is things[0] and reach is not None and reach.grasp == 0, "the highest, where none is sure"
    thing, reach, _ = asked(monkeypatch, things, [None, None, False])
    assert thing is things[2] and reach is not None and reach.grasp == 2, "what may be held, where the highest is not"
    thing, reach, _ = asked(monkeypatch, things, [None, None, None])
    assert thing is things[0] and reach is None


def test_a_raised_edge_of_what_is_wider_than_the_hand_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fingers closed on nothing at a cracker box's edge, met the bin's wall, and moved it by 7 mm."""
    rows, columns = np.meshgrid(np.arange(30, 46), np.arange(16), indexing="ij")
    pixels = np.column_stack([rows.ravel(), columns.ravel()])
    points = np.column_stack([0.01 * pixels, np.full(256, 0.1)])
    wide = SeenThing(points, np.zeros_like(points), pixels, np.zeros(3))
    things = [wide, square(0, 0.06)]
    thing, reach, _ = asked(monkeypatch, things, [False, False])
    assert thing is things[1] and reach is not None and reach.grasp == 1
    thing, reach, _ = asked(monkeypatch, things, [False, None])
    assert thing is wide and reach is not None and not reach.sure


def test_what_the_hand_has_room_for_goes_before_what_it_may_touch_others_beside(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The hand met bin and cracker box beside a bottle, while a ring lay free."""
    things = [square(0, 0.1), square(30, 0.06), square(60, 0.05)]
    thing, reach, _ = asked(monkeypatch, things, [False, True, True], [True, False, True])
    assert thing is things[2] and reach is not None and reach.roomy
    thing, reach, _ = asked(monkeypatch, things, [False, True, True], [True, False, False])
    assert thing is things[1] and reach is not None and reach.sure, "the higher of two that are as tight"
    thing, reach, _ = asked(monkeypatch, things, [False, False, False], [True, False, False])
    assert thing is things[0] and reach is not None and not reach.sure


def test_what_lies_below_another_is_not_drawn_from_under_it(monkeypatch: pytest.MonkeyPatch) -> None:
    things = [square(0, 0.1), square(10, 0.05)]
    thing, _, looked = asked(monkeypatch, things, [False, True])
    assert thing is things[0] and {k for k, _ in looked} == {0}


def test_what_is_sure_of_a_low_thing_spares_all_other_searches_for_a_high_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four things were looked at in every way before the third was taken: two minutes of a busy machine."""
    things = [square(0, 0.1), square(30, 0.06), square(60, 0.05)]
    thing, _, looked = asked(monkeypatch, things, [False, None, True])
    assert thing is things[2] and looked[:3] == [(0, ROOMY), (1, ROOMY), (2, ROOMY)]
    assert all(k == 2 for k, _ in looked[3:]), "what is chosen alone is asked for once more"


def test_where_nothing_is_sure_what_touches_least_goes_first_whichever_thing_it_is_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A ring was taken with the palm on the bin's rim, while a bottle left it room over that."""
    things = [square(0, 0.1), square(30, 0.06), square(60, 0.05)]
    for kinds, taken in (([PUSHING, ASIDE, None], 1), ([TIPS, None, PUSHING], 2), ([PUSHING, ASIDE, ONE_SIDED], 2)):
        thing, reach, _ = asked(monkeypatch, things, kinds)
        assert thing is things[taken] and reach is not None and not reach.sure and reach.grasp == taken
