"""What was lost on its way and is found again is gone on with: shown, weighed and put away, as if it had not been."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.runs.learning.held_box import HALF, shown, turned
from tests.runs.learning.test_pipeline import PICTURE, thing
from twin_diagram.runs.learning import handling, one_object, seeking, swinging
from twin_diagram.runs.learning.display import NothingHeld
from twin_diagram.runs.learning.following import Followed, follow
from twin_diagram.runs.learning.looking_about import LyingAbout
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.one_object import OneObject
from twin_diagram.runs.learning.picking import Taken
from twin_diagram.runs.learning.record import SWUNG, LearningRecord
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.runs.learning.shown_object import Picked, ShownObject
from twin_diagram.scenario import Learning, Scenario

PLACE = PutDown((0.4, 0.4), 0.05, 0.1)
NOTHING: Any = None


class Cell:
    """Stand-ins of all stages: told what fails when, they note what was done."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, fails: Mapping[str, list[Any]]) -> None:
        self.done, self.fails, self.folder = list[str](), dict(fails), folder
        self.known, self.one = True, NOTHING
        lying = LyingAbout(thing(0.7), 0.0, PICTURE)
        for module, name, stage in (
            (handling, "show_first", self.show_first),
            (handling, "show_again", lambda tools, what, firm: self._did("again", True)),
            (handling, "show_found", lambda tools, what, found, taken: self._did("found", self.known)),
            (handling, "write_frames", self.write_frames),
            (handling, "put_away", lambda tools, what, standing: self._did("put away", PLACE)),
            (handling, "let_go", lambda tools: None),
            (swinging, "weigh_held", self.weigh_held),
            (seeking, "put_away", lambda tools, what, standing: self._did("put away", PLACE)),
            (seeking, "let_go", lambda tools: None),
            (seeking, "go_home", lambda tools: None),
            (seeking, "look_about", lambda *told: self._did("look", lying)),
            (seeking, "_take_fallen", lambda *told: (Taken(np.eye(4), 0.05, 0), "")),
        ):
            monkeypatch.setattr(module, name, stage)
        monkeypatch.setattr(one_object, "asks_for_more", lambda *told: "again" not in self.done)

    def _did(self, what: str, result: Any = None) -> Any:
        self.done.append(what)
        if self.fails.get(what):
            raise self.fails[what].pop(0)
        return result

    def show_first(self, tools: Any, picked: Picked) -> ShownObject:
        self._did("first")
        followed = Followed(shown=[shown(turned(0.0), np.eye(4), 0)], X_ST=[np.eye(4)])
        return ShownObject(followed, [np.eye(4)], [0.05], seen_shares=[1.0])

    def write_frames(self, folder: Path, *told: Any) -> None:
        folder.mkdir()
        self._did("written")

    def weigh_held(self, tools: Any, what: ShownObject, folder: Path, gentle: float) -> float:
        self._did("weigh")
        (folder / SWUNG).touch()
        what.swung = SimpleNamespace(use={})  # type: ignore[assignment]
        return 0.5

    def learn(self) -> OneObject:
        """Learn one object, and return it."""
        record = LearningRecord(self.folder, Scenario())
        record.begin()
        (self.folder / SWUNG).touch()  # the empty hand was swung before
        cell = SimpleNamespace(look=lambda name: PICTURE, opening=0.05, shut=True, q=None, moment=lambda name: None)
        mover = SimpleNamespace(tool=lambda q: np.eye(4), stand=lambda *told: None)
        more: dict[str, Any] = {"cameras": {}, "faces": None, "robot": None, "gripper": None}
        tools: Any = SimpleNamespace(cell=cell, mover=mover, learning=Learning(grasps=2), **more)
        self.one = OneObject(tools, record, "object_01", self.stage, lambda name, folder: None, [])
        self.one.learn(Picked(thing(0.0), Taken(np.eye(4), 0.05, 0)))
        return self.one  # type: ignore[no-any-return]

    @contextmanager
    def stage(self, name: str, stage: str) -> Iterator[dict[str, Any]]:
        yield {}


WHOLE = ["first", "again", "written", "weigh", "put away"]


def test_what_was_lost_before_it_was_shown_is_learned_from_where_it_fell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = Cell(tmp_path / "run", monkeypatch, {"first": [NothingHeld("it fell on its way to the camera")]})
    one = cell.learn().one
    assert cell.done == ["first", "look", *WHOLE]
    assert one.standing == PLACE.numbers() and one.state == "handled"
    assert one.why == "it fell on its way to the camera; it was found outside of the bins and put away"


@pytest.mark.parametrize("known", [True, False])
def test_what_was_lost_while_it_was_swung_is_weighed_where_it_is_known_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known: bool
) -> None:
    cell = Cell(tmp_path / "run", monkeypatch, {"weigh": [NothingHeld("it was lost while it was swung")]})
    cell.known = known
    one = cell.learn().one
    rest = ["found", "weigh", "put away"] if known else ["found", "put away"]
    assert cell.done == [*WHOLE[:-1], "look", *rest], "its pictures were written before"
    assert one.standing == PLACE.numbers()


def test_what_was_weighed_when_it_was_lost_is_only_put_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Cell(tmp_path / "run", monkeypatch, {"put away": [NothingHeld("it was lost on the platform")]})
    one = cell.learn().one
    assert cell.done == [*WHOLE, "look", "put away"] and one.standing == PLACE.numbers()


def test_what_is_lost_once_more_is_put_away_as_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lost = [NothingHeld("it fell"), NothingHeld("it fell once more")]
    cell = Cell(tmp_path / "run", monkeypatch, {"first": lost})
    one = cell.learn().one
    assert cell.done == ["first", "look", "first", "look", "put away"]
    assert one.standing == PLACE.numbers() and one.state == "failed", "nothing was shown of it"


def test_what_was_lost_and_bars_the_way_home_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Cell(tmp_path / "run", monkeypatch, {"first": [NothingHeld("it fell")]})

    def stuck(tools: Any) -> None:
        raise NoWay("no way past what stands about")

    monkeypatch.setattr(seeking, "let_go", stuck)
    monkeypatch.setattr(seeking, "_take_fallen", lambda *told: stuck(None))
    one = cell.learn().one
    assert one.why == "it fell; then the arm could not go home: no way past what stands about" and not one.standing


@pytest.mark.long
def test_how_what_was_found_is_held_is_told_by_what_was_seen_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A box that was shown fell onto its side: its pose is found there, and a display in that grasp goes on from it."""
    pictures = [shown(turned(a), np.eye(4), k) for k, a in enumerate(np.linspace(0.0, 2 * np.pi, 13)[:-1])]
    followed = follow(Followed(), pictures, np.eye(4))
    held = ShownObject(followed, [followed.X_ST[-1]], [0.06], seen_shares=[0.9])
    # It lies on its broad side, seen from above: S is the tool's frame of the first grasp, and stands as the box does.
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-1, 1, (2000, 2)) * [HALF[1], HALF[2]], np.full(2000, 2 * HALF[0])])
    side = np.column_stack([np.full(900, HALF[1]), rng.uniform(-1, 1, 900) * HALF[2], rng.uniform(0, 2, 900) * HALF[0]])
    normals = np.vstack([np.tile([0.0, 0.0, 1.0], (2000, 1)), np.tile([1.0, 0.0, 0.0], (900, 1))])
    order = rng.permutation(2900)
    lies = replace(thing(0.0), points=np.vstack([flat, side])[order], normals=normals[order])
    seen = LyingAbout(lies, 0.0, PICTURE)
    told: dict[str, Any] = {}

    def show_held(tools: Any, what: ShownObject, X_ST: Any, R_WS: Any) -> None:
        told.update(X_ST=X_ST, R_WS=R_WS)
        what.X_ST.append(X_ST)
        more = {"shown": [*followed.shown, pictures[0]], "explained": [*followed.explained, good]}
        what.followed = replace(what.followed, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(handling, "_show_held", show_held)
    X_WT = np.eye(4)
    X_WT[:3, 3] = [0.0, 0.0, 0.05]
    for good in (0.9, 0.1):
        before = (held.followed, [*held.X_ST])
        assert handling.show_found(NOTHING, held, seen, Taken(X_WT, 0.05, 0)) == (good > 0.5)
        assert told["R_WS"] @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0, 0, told["R_WS"][2, 0]], abs=0.05)
        p_WS = X_WT[:3, 3] - told["R_WS"] @ told["X_ST"][:3, 3]
        assert p_WS == pytest.approx([0.0, 0.0, HALF[0]], abs=0.004)
        assert (held.followed is before[0]) == (good < 0.5) and (len(held.X_ST) == len(before[1])) == (good < 0.5)
        held.followed, held.X_ST = before
