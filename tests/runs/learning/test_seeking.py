"""What was lost outside of the bins is looked for: where it ends up is known to who puts others beside it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.errors import StationError
from twin_diagram.runs.learning import seeking
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.looking_about import LyingAbout
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.picking import Taken
from twin_diagram.runs.learning.seeking import seek
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.scenario import Learning

POINTS = np.array([[0.5, 0.0, 0.2], [0.52, 0.02, 0.22]])
FELL = PutDown((0.1, 0.6), 0.05, 0.1)


NO_PICTURE: Any = None


def no_room(*told: Any) -> PutDown:
    raise NoWay("no room in the other bin")


@pytest.mark.parametrize(("falls", "looks"), [(FELL, 1), (None, 3)])
def test_what_cannot_be_put_away_is_known_to_lie_where_it_was_let_fall(
    monkeypatch: pytest.MonkeyPatch, falls: PutDown | None, looks: int
) -> None:
    thing, looks_taken = SeenThing(POINTS, POINTS, np.zeros((2, 2), np.int64), np.zeros(3)), []
    lying = LyingAbout(thing, 0.18, NO_PICTURE)

    def look(*told: Any) -> LyingAbout:
        looks_taken.append(told[-1])
        return lying

    monkeypatch.setattr(seeking, "look_about", look)
    monkeypatch.setattr(seeking, "go_home", lambda tools: None)
    monkeypatch.setattr(seeking, "_take_fallen", lambda *told: (Taken(np.eye(4), 0.02, 0), ""))
    monkeypatch.setattr(seeking, "put_away", no_room)
    monkeypatch.setattr(seeking, "let_go", lambda tools: falls)
    mover = SimpleNamespace(stand=lambda *told: None)
    tools: Any = SimpleNamespace(cell=None, mover=mover, learning=Learning(tries=3), faces=None, robot=None)
    places = [POINTS[0]]
    found = seek(tools, [], places)
    assert found.put == falls and len(looks_taken) == looks and all(known is places for known in looks_taken)
    assert found.told.endswith("no room in the other bin") and found.lying is lying


def test_where_the_camera_has_stopped_nobody_knows_where_it_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    def dark(*told: Any) -> None:
        raise StationError("camera 'scan' measures no depth")

    def no_way(tools: Any) -> None:
        raise NoWay("no way past what stands about")

    monkeypatch.setattr(seeking, "look_about", dark)
    monkeypatch.setattr(seeking, "go_home", no_way)
    mover = SimpleNamespace(stand=lambda *told: None)
    tools: Any = SimpleNamespace(cell=None, mover=mover, learning=Learning(), faces=None, robot=None)
    found = seek(tools, [])
    assert found.put is None and found.told == "nobody sees where it lies: camera 'scan' measures no depth"
