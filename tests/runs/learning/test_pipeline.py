"""A run over a bin ends, whatever fails in it, and tells why: stages fail on purpose, nothing is simulated."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.runs.learning.held_box import shown, turned
from twin_diagram.errors import StationError, TwinError
from twin_diagram.estimation.weighing import WeighingError
from twin_diagram.runs.learning import handling, one_object, pipeline, swinging
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.choosing import SURE
from twin_diagram.runs.learning.display import NothingHeld
from twin_diagram.runs.learning.finishing import finish
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.one_object import OneObject
from twin_diagram.runs.learning.picking import Taken
from twin_diagram.runs.learning.pipeline import Learner
from twin_diagram.runs.learning.record import SWUNG, Learned, LearningError, LearningRecord, RunState
from twin_diagram.runs.learning.seeking import Sought
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.runs.learning.shape_jobs import Done
from twin_diagram.runs.learning.shape_worker import SHAPE
from twin_diagram.runs.learning.shown_object import Picked, ShownObject
from twin_diagram.runs.learning.weighing import Slipping
from twin_diagram.runtime.stopping import Stopped
from twin_diagram.scenario import Learning, Scenario

PICTURE = shown(turned(0.0), np.eye(4), 0).picture
SURE_CHOICE = SimpleNamespace(one=lambda kind: "a grasp")


def thing(x: float) -> SeenThing:
    points = np.array([[x, 0.0, 0.0], [x, 0.02, 0.02]])
    return SeenThing(points, points, np.array([[9, 9], [20, 20]]), np.zeros(3))


@dataclass
class Bin:
    """Things at places that fail when they are shown; each place is told of its failures."""

    places: list[float]
    rolls: float = 0.0
    failures: list[float] = field(default_factory=list)
    let_go: Callable[[Any], None] = lambda tools: None

    def look(self, tools: Any, given_up: Sequence[Sequence[float]]) -> tuple[Any, list[SeenThing]]:
        seen = [thing(x) for x in self.places]
        return PICTURE, [t for t in seen if all(np.linalg.norm(t.middle - np.array(g)) > 0.04 for g in given_up)]

    def show(self, tools: Any, picked: Picked) -> Any:
        self.failures.append(float(picked.thing.points[0, 0]))
        assert len(self.failures) < 50, "it goes on for ever"
        self.places = [x + self.rolls if x == self.failures[-1] else x for x in self.places]
        raise NothingHeld("it was lost")


def learner(bin_: Bin, folder: Path, monkeypatch: pytest.MonkeyPatch, tries: int = 3) -> Learner:
    cell = SimpleNamespace(time=0.0, snapshot=dict, look=lambda name: PICTURE, wait=lambda seconds: None)
    taken = Taken(np.eye(4), 0.05, 0)
    monkeypatch.setattr(handling, "look_into_bin", bin_.look)
    monkeypatch.setattr(handling, "pick", lambda tools, one, things, attempt, failed, known: Picked(one, taken))
    monkeypatch.setattr(pipeline, "which_first", lambda tools, picture, things: (things[0], SURE_CHOICE))
    monkeypatch.setattr(handling, "show_first", bin_.show)
    monkeypatch.setattr(handling, "let_go", bin_.let_go)
    monkeypatch.setattr(handling, "keep_clear", lambda tools, standing: None)
    monkeypatch.setattr(one_object, "seek", lambda *told: Sought("nothing is seen"))
    monkeypatch.setattr("twin_diagram.runs.learning.pipeline.correct_cameras", lambda *told: [])
    for way in ("nudge", "drag"):
        monkeypatch.setattr(f"twin_diagram.runs.learning.pipeline.plan_{way}", lambda *told: None)
    record = LearningRecord(folder, Scenario())
    hand = SimpleNamespace(opening_most=0.115)
    tools: Any = SimpleNamespace(cell=cell, learning=Learning(tries=tries), cameras={}, faces=None, gripper=hand)
    return Learner(tools, record, record.begin(), lambda text: None)


def test_what_fails_again_and_again_is_left_in_the_bin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_ = Bin([0.0, 0.3])
    run = learner(bin_, tmp_path / "run", monkeypatch)
    run.run()
    assert bin_.failures == [0.0] * 3 + [0.3] * 3
    assert run.state.finished and [g[0] for g in run.state.given_up] == [0.0, 0.3]
    assert [one.state for one in run.state.learned] == ["failed"] * 6
    assert '"give up", "why": "it was lost; nothing is seen"' in (tmp_path / "run" / "events.jsonl").read_text()
    assert LearningRecord(tmp_path / "run", Scenario()).resume().failed_at == run.state.failed_at != []


def test_what_rolls_elsewhere_at_each_failure_is_left_at_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_ = Bin([0.0], rolls=0.1)
    monkeypatch.setattr(bin_, "look", lambda tools, given_up: (PICTURE, [] if given_up else [thing(bin_.places[0])]))
    run = learner(bin_, tmp_path / "run", monkeypatch, tries=2)
    run.run()
    assert len(bin_.failures) == 6 and run.state.finished


def test_an_arm_that_cannot_go_home_leaves_a_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stuck(tools: Any) -> None:
        raise NoWay("no way past what stands about")

    run = learner(Bin([0.0], let_go=stuck), tmp_path / "run", monkeypatch, tries=1)
    run.run()
    (one,) = LearningRecord(tmp_path / "run", Scenario()).resume().learned
    assert one.state == "failed" and one.why.startswith("it was lost; then the arm could not go home: no way past")


def test_a_bin_that_cannot_be_looked_into_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def stuck(tools: Any) -> None:
        raise NoWay("no way past what stands about")

    monkeypatch.setattr(handling, "go_home", stuck)
    tools: Any = SimpleNamespace()
    with pytest.raises(LearningError, match=r"cannot go home.*no way past.*twin\.home") as error:
        handling.look_into_bin(tools, [])
    assert "\n" not in str(error.value)
    # What no stage catches ends the command with a line, not with a traceback.
    assert issubclass(NoWay, TwinError) and issubclass(NothingHeld, TwinError)


def test_an_error_that_ends_the_run_is_the_last_event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def blind(tools: Any, given_up: Any) -> Any:
        raise LearningError("the arm cannot go\nhome")

    bin_ = Bin([0.0])
    monkeypatch.setattr(bin_, "look", blind)
    with pytest.raises(LearningError):
        learner(bin_, tmp_path / "run", monkeypatch).run()
    last = (tmp_path / "run" / "events.jsonl").read_text().splitlines()[-1]
    assert '"stage": "stop", "outcome": "the arm cannot go home"' in last


def test_what_a_camera_that_stops_cannot_show_is_marked_before_the_run_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bin_, written = Bin([0.0, 0.3]), list[str]()
    run = learner(bin_, tmp_path / "run", monkeypatch)
    followed = Followed(shown=[shown(turned(0.0), np.eye(4), 0)], X_ST=[np.eye(4)])
    held = ShownObject(followed, [np.eye(4)], [0.05], seen_shares=[0.9])

    def stops(*told: Any) -> Any:
        raise StationError("camera 'scan' measures no depth")

    def show_first(tools: Any, picked: Picked) -> ShownObject:
        monkeypatch.setattr(bin_, "look", stops)
        monkeypatch.setattr(handling, "look_into_bin", stops)
        return held

    monkeypatch.setattr(handling, "show_first", show_first)
    monkeypatch.setattr(handling, "show_again", stops)
    monkeypatch.setattr(handling, "write_frames", lambda folder, *told: written.append(folder.parent.name))
    monkeypatch.setattr("twin_diagram.runs.learning.one_object.seek", lambda *told: Sought("nothing"))
    run._jobs = SimpleNamespace(poll=list, pending=[], add=lambda *told: None, close=lambda: None)  # type: ignore[assignment]
    with pytest.raises(StationError, match="'scan' measures no depth"):
        run.run()
    (one,) = LearningRecord(tmp_path / "run", Scenario()).resume().learned
    assert (one.state, one.why) == ("handled", "camera 'scan' measures no depth; nothing")
    assert written == ["object_01"], "what was seen of it is kept"


def test_nothing_is_taken_that_the_scanning_camera_could_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    dark = SimpleNamespace(depth=np.zeros((2, 2), np.float32))
    lies = [thing(0.0)]
    monkeypatch.setattr(handling, "go_home", lambda tools: None)
    monkeypatch.setattr(handling, "resting_picture", lambda cell, name, low, high: PICTURE)
    monkeypatch.setattr(handling, "lying", lambda *told: lies)
    cell = SimpleNamespace(look=lambda name: dark)
    tools: Any = SimpleNamespace(cell=cell, learning=Learning(), faces=None, robot=None)
    with pytest.raises(StationError, match="measures no depth"):
        handling.look_into_bin(tools, [])
    lies.clear()
    assert handling.look_into_bin(tools, [])[1] == [], "an empty bin is done with all the same"


def test_an_object_put_away_gives_what_was_given_up_another_chance_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = learner(Bin([0.0]), tmp_path / "run", monkeypatch)
    run.state.given_up, run.state.taken = [[0.0, 0.01, 0.01]], 1
    run.run()
    assert [one.state for one in run.state.learned] == ["failed"] * 3 and isinstance(run.state, RunState)


def test_what_was_barred_has_another_chance_when_what_lay_on_it_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bin_, barred = Bin([0.3, 0.0]), list[bool]()
    run = learner(bin_, tmp_path / "run", monkeypatch, tries=2)

    def pick(tools: Any, one: SeenThing, *rest: Any) -> Picked:
        below = one.points[0, 0] == 0.3
        barred.append(bool(below and 0.0 in bin_.places))
        return Picked(one, why="barred") if barred[-1] else Picked(one, Taken(np.eye(4), 0.05, 0))

    def show(tools: Any, picked: Picked) -> Any:
        bin_.places.remove(float(picked.thing.points[0, 0]))
        raise NothingHeld("it fell beside the bin")

    monkeypatch.setattr(handling, "pick", pick)
    monkeypatch.setattr(handling, "show_first", show)
    monkeypatch.setattr("twin_diagram.runs.learning.pipeline.plan_tipping", lambda *told: None)
    run.run()
    assert barred == [True, True, False, False] and not bin_.places and run.state.finished


def test_an_object_put_away_ends_the_count_of_failures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_ = Bin([0.0])
    run = learner(bin_, tmp_path / "run", monkeypatch)
    held = ShownObject(Followed(shown=[shown(turned(0.0), np.eye(4), 0)]), [np.eye(4)])

    def put_away(tools: Any, what: ShownObject, standing: Sequence[PutDown]) -> PutDown:
        bin_.places = []
        return PutDown((0.4, 0.4), 0.05, 0.1)

    for name, stage in (
        ("show_first", lambda tools, picked: held if len(bin_.failures) == 2 else bin_.show(tools, picked)),
        ("write_frames", lambda folder, what, gripper: None),
        ("put_away", put_away),
    ):
        monkeypatch.setattr(handling, name, stage)
    jobs: Any = SimpleNamespace(add=lambda name, folder: None, poll=list, pending=[], close=lambda: None)
    run._jobs, learning = jobs, Learning(grasps=1, weigh_seconds=0.0)
    cell = SimpleNamespace(**vars(run.tools.cell), opening=0.05, q=np.zeros(7), moment=lambda name: None)
    mover = SimpleNamespace(tool=lambda q: np.eye(4))
    tools: Any = SimpleNamespace(cell=cell, learning=learning, mover=mover, gripper=None, cameras={}, faces=None)
    run.tools = tools
    run.run()
    assert [one.state for one in run.state.learned] == ["failed", "failed", "handled"]
    assert run.state.failed_at == [] and run.state.given_up == []
    assert LearningRecord(tmp_path / "run", Scenario()).resume().taken == 1, "a run that goes on knows it, too"


@pytest.mark.parametrize("again", [True, False])
def test_what_one_grasp_leaves_no_place_for_is_put_away_in_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, again: bool
) -> None:
    """An L was weighed, found no place beside three that stood there, and was let fall from where the hand was."""
    bin_, grasps = Bin([0.0]), [0]
    run = learner(bin_, tmp_path / "run", monkeypatch, tries=1)
    held = ShownObject(Followed(shown=[shown(turned(0.0), np.eye(4), 0)]), [np.eye(4)])

    def put_away(tools: Any, what: ShownObject, standing: Sequence[PutDown]) -> PutDown:
        if grasps[0] == 0:
            raise NoWay("something is in the way of setting it down")
        bin_.places = []
        return PutDown((0.4, 0.4), 0.05, 0.1)

    def show_again(tools: Any, what: ShownObject, firm: bool) -> bool:
        assert firm
        if not again:
            raise NoWay("no place to set it down is reached")
        grasps[0] += 1
        return True

    for name, stage in (
        ("show_first", lambda tools, picked: held),
        ("write_frames", lambda folder, what, gripper: None),
        ("put_away", put_away),
        ("show_again", show_again),
    ):
        monkeypatch.setattr(handling, name, stage)
    jobs: Any = SimpleNamespace(add=lambda name, folder: None, poll=list, pending=[], close=lambda: None)
    run._jobs, learning = jobs, Learning(tries=1, grasps=1, weigh_seconds=0.0)
    cell = SimpleNamespace(**vars(run.tools.cell), opening=0.05, shut=True, q=np.zeros(7), moment=lambda name: None)
    mover = SimpleNamespace(tool=lambda q: np.eye(4))
    tools: Any = SimpleNamespace(cell=cell, learning=learning, mover=mover, gripper=None, cameras={}, faces=None)
    run.tools = tools
    monkeypatch.setattr(one_object, "seek", lambda *told: Sought("nothing lies there"))
    run.run()
    (one,) = run.state.learned
    assert bool(one.standing) == again and grasps == [int(again)]
    assert one.why == ("" if again else "something is in the way of setting it down; nothing lies there")
    stages = [line for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines() if "put away" in line]
    assert len(stages) == 1 + again


@pytest.mark.parametrize(("free", "highest"), [(0.0, 0.22), (0.3, 0.4), (1.0, None)])
def test_what_cannot_be_set_down_is_let_fall_over_what_stands_in_the_bin(
    monkeypatch: pytest.MonkeyPatch, free: float, highest: float | None
) -> None:
    went, learning = list[float](), Learning()
    floor = learning.into_bin[0][2]

    def path(q: Any, goals: Any) -> Any:
        if not len(goals):
            raise NoWay("out of reach")
        return goals

    mover = SimpleNamespace(
        goals=lambda X, near: [X[2, 3] - floor] if X[2, 3] - floor > free else [],
        path=path,
        timed=lambda way: way,
        tool=lambda q: np.eye(4),
        hold=lambda points: None,
    )
    cell = SimpleNamespace(
        shut=True, opening=0.05, commanded=None, q=None, about=lambda *told: nullcontext(), grip=lambda share: None
    )
    monkeypatch.setattr(handling, "go", lambda cell, way: went.extend(way))
    monkeypatch.setattr(handling, "go_home", lambda tools: None)
    tools: Any = SimpleNamespace(cell=cell, mover=mover, learning=learning)
    fell = handling.let_go(tools)
    assert went == pytest.approx([] if highest is None else [highest]) and (fell is None) == (highest is None)


@pytest.mark.parametrize(("wide", "sure"), [(False, True), (False, False), (True, True), (True, False)])
def test_what_cannot_be_taken_is_tipped_up_a_few_times_before_it_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wide: bool, sure: bool
) -> None:
    tipped, tries = list[float](), list[float]()

    def pick(tools: Any, one: SeenThing, *rest: Any) -> Picked:
        tries.append(float(one.points[0, 0]))
        return Picked(one, why="too wide")

    def plan_tipping(tools: Any, one: SeenThing, picture: Any) -> float | None:
        place = float(one.points[0, 0])
        return place if place == 0.3 else None  # the other one is not flat

    run = learner(Bin([0.0, 0.3]), tmp_path / "run", monkeypatch)
    monkeypatch.setattr(handling, "pick", pick)
    choice = SURE_CHOICE if sure else SimpleNamespace(one=lambda kind: None if kind in SURE else "a", best=lambda: "a")
    monkeypatch.setattr(pipeline, "which_first", lambda tools, picture, things: (things[0], choice))
    run.tools.gripper.opening_most = -0.01 if wide else 0.115  # type: ignore[misc]
    monkeypatch.setattr("twin_diagram.runs.learning.pipeline.plan_tipping", plan_tipping)
    monkeypatch.setattr("twin_diagram.runs.learning.pipeline.tip_up", lambda tools, plan: tipped.append(plan))
    run.run()
    # What is wider than the hand is tipped up at once, before any try of which nothing sure is known; all else when it
    # would be reported; of what has no grasp, two searches are made.
    assert tipped == [0.3, 0.3, 0.3] and tries.count(0.3) == ((3 if sure else 0) + 2 if wide else 4 * 2)
    assert [one.why for one in run.state.learned] == ["too wide", "too wide"] and run.state.finished


@pytest.mark.parametrize("wide", [False, True])
def test_what_has_no_grasp_and_is_not_tipped_up_is_pushed_off_a_few_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wide: bool
) -> None:
    """A cracker box flat across a ring and the rim was reported, and the ring below it with it."""
    stages = list[str]()

    def pick(tools: Any, one: SeenThing, *rest: Any) -> Picked:
        stages.append("pick")
        return Picked(one, why="too wide")

    def nudge_off(tools: Any, plan: str) -> str:
        stages.append(plan)
        return "pushed by 15 cm"

    run = learner(Bin([0.0, 0.3]), tmp_path / "run", monkeypatch)
    monkeypatch.setattr(handling, "pick", pick)
    choice = SimpleNamespace(one=lambda kind: None, best=lambda: None)
    monkeypatch.setattr(pipeline, "which_first", lambda tools, picture, things: (things[0], choice))
    run.tools.gripper.opening_most = -0.01 if wide else 0.115  # type: ignore[misc]
    monkeypatch.setattr(pipeline, "plan_tipping", lambda *told: None)
    monkeypatch.setattr(pipeline, "plan_nudge", lambda tools, one, picture: "push" if one.points[0, 0] == 0.3 else None)
    monkeypatch.setattr(pipeline, "nudge_off", nudge_off)
    run.run()
    searches = ["pick", "pick"]
    assert stages == searches + 3 * (["push"] if wide else [*searches, "push"]) + searches, "each in its turn"
    assert [one.why for one in run.state.learned] == ["too wide", "too wide"] and run.state.finished
    events = (tmp_path / "run" / "events.jsonl").read_text()
    assert events.count('"stage": "push off"') == 3 and events.count("pushed by 15 cm") == 3


def test_what_cannot_be_taken_is_dragged_off_walls_before_it_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A can in a corner was reported, in three held-back bins."""
    stages = list[str]()

    def pick(tools: Any, one: SeenThing, *rest: Any) -> Picked:
        stages.append("pick")
        return Picked(one, why="no grasp")

    def drag_off(tools: Any, plan: str) -> str:
        stages.append(plan)
        return "dragged by 6 cm"

    run = learner(Bin([0.3]), tmp_path / "run", monkeypatch)
    monkeypatch.setattr(handling, "pick", pick)
    monkeypatch.setattr(pipeline, "plan_tipping", lambda *told: None)
    monkeypatch.setattr(pipeline, "plan_drag", lambda *told: "drag")
    monkeypatch.setattr(pipeline, "drag_off", drag_off)
    run.run()
    assert stages == 3 * ["pick", "pick", "drag"] + ["pick", "pick"]
    assert [one.why for one in run.state.learned] == ["no grasp"] and run.state.finished
    events = (tmp_path / "run" / "events.jsonl").read_text()
    assert events.count('"stage": "drag off"') == 3 and events.count("dragged by 6 cm") == 3


def test_what_is_finished_while_the_next_one_is_in_the_hand_is_kept_with_the_world_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def done_with(record: LearningRecord, one: Learned, model: Any, learned: list[Learned]) -> None:
        one.state = "finished"

    run = learner(Bin([]), tmp_path / "run", monkeypatch)
    run.state.learned, run.state.world = [Learned("object_01")], {"positions": np.array([1.0, 2.0])}
    run.record.save(run.state)
    done = [[], [Done("object_01", None)], []]
    jobs: Any = SimpleNamespace(poll=lambda: done.pop(0), pending=[], close=lambda: None)
    run._jobs, run.tools = jobs, SimpleNamespace(**vars(run.tools), model=None)  # type: ignore[assignment]
    monkeypatch.setattr("twin_diagram.runs.learning.pipeline.finish", done_with)
    for expected in ("handled", "finished", "finished"):
        with run._stage("object_02", "display"):
            pass
        kept = LearningRecord(tmp_path / "run", Scenario()).resume()
        assert [one.state for one in kept.learned] == [expected] and kept.world["positions"].tolist() == [1.0, 2.0]


def test_an_object_whose_asset_fails_in_any_way_is_reported_and_the_next_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing: Any = None

    def write(name: str, *rest: Any) -> dict[str, Any]:
        if name == "object_01":
            raise np.linalg.LinAlgError("Singular matrix")
        return {"mass": 0.4}

    def weigh(*told: Any) -> None:
        raise ValueError("no\nroot")

    said = list[str]()
    run = learner(Bin([]), tmp_path / "run", monkeypatch)
    second = Learned("object_02", figures={"not weighed": "of a first try", "notes": ["one grasp only"]})
    run.state.learned = [Learned("object_01", why="it was lost"), second]
    for one in run.state.learned:
        folder = run.record.fresh(one.name)
        (folder / SHAPE).touch()
        (folder / SWUNG).touch()
    run._jobs = SimpleNamespace(poll=lambda: [Done(one.name, None) for one in run.state.learned])  # type: ignore[assignment]
    run.tools, run._say = SimpleNamespace(**vars(run.tools), model=None), said.append  # type: ignore[assignment]
    for name, what in (("read_shape", lambda f: None), ("read_swung", lambda f: None), ("inertia_of", weigh)):
        monkeypatch.setattr(f"twin_diagram.runs.learning.finishing.{name}", what)
    monkeypatch.setattr("twin_diagram.runs.learning.finishing.write_learned", write)
    assert run._collect()
    first = run.state.learned[0]
    assert (first.state, first.why, first.no_asset) == ("failed", "it was lost", "LinAlgError: Singular matrix")
    figures = {"mass": 0.4, "not weighed": "ValueError: no root", "notes": ["one grasp only"]}
    assert second.state == "finished" and second.figures == figures
    assert said[0] == "object_01: failed, it was lost; LinAlgError: Singular matrix"
    (run.record.of("object_02") / SWUNG).unlink()
    finish(run.record, second, nothing)
    assert "not weighed" not in second.figures, "what an earlier try said of it is gone"


def test_no_asset_is_written_between_a_signal_and_the_arms_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, done, finished = learner(Bin([]), tmp_path / "run", monkeypatch), [Done("object_01", None)], list[str]()
    run.state.learned = [Learned("object_01")]
    run.record.save(run.state)
    jobs: Any = SimpleNamespace(poll=lambda: [done.pop() for _ in done[:]], pending=[], close=done.clear)
    run._jobs, run.tools = jobs, SimpleNamespace(**vars(run.tools), model=None)  # type: ignore[assignment]
    monkeypatch.setattr(
        "twin_diagram.runs.learning.pipeline.finish", lambda record, one, model: finished.append(one.name)
    )
    with pytest.raises(Stopped), run._stage("object_02", "display"):
        raise Stopped(signal.SIGINT)
    assert not finished, "it takes seconds, of which there are ten"
    assert LearningRecord(tmp_path / "run", Scenario()).resume().named("object_01").state == "handled"


def test_what_is_hardly_held_is_taken_anew_before_it_is_weighed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, held = learner(Bin([]), tmp_path / "run", monkeypatch), ShownObject(X_ST=[np.eye(4)])
    grasps: list[int] = []

    def show_again(tools: Any, what: ShownObject, firm: bool) -> bool:
        assert firm, "whatever it shows, the further grasp is to hold the weight"
        what.X_ST.append(np.eye(4))
        return True

    def weigh_held(tools: Any, what: ShownObject, folder: Path, gentle: float) -> float:
        assert gentle == 1.0
        grasps.append(len(what.X_ST))
        raise WeighingError("no motion keeps the limit of grip")

    monkeypatch.setattr(handling, "show_again", show_again)
    monkeypatch.setattr(swinging, "weigh_held", weigh_held)
    one = OneObject(run.tools, run.record, "object_01", run._stage, run._jobs.add, [])
    one.shown = held
    one.weigh()
    assert grasps == [1, 2] and held.notes == ["not weighed: no motion keeps the limit of grip"] * 2
    grasps.clear()
    held.X_ST = [np.eye(4)] * run.tools.learning.most_grasps
    one.weigh()
    assert grasps == [run.tools.learning.most_grasps], "no more grasps than there may be"


@pytest.mark.parametrize(("grasps", "swung"), [(1, [(1, 1.0), (2, 1.0), (2, 0.5)]), (4, [(4, 1.0), (4, 0.5)])])
def test_what_turns_in_its_last_grasp_too_is_swung_more_gently(
    grasps: int, swung: list[tuple[int, float]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flask of 1.1 kg turned in two grasps, the last that there might be, and was put away unweighed."""
    run, held, tried = learner(Bin([]), tmp_path / "run", monkeypatch), ShownObject(), list[tuple[int, float]]()
    held.X_ST = [np.eye(4)] * grasps

    def weigh_held(tools: Any, what: Any, folder: Path, gentle: float) -> float:
        tried.append((len(what.X_ST), gentle))
        if gentle == 1.0:
            raise Slipping("it turns between the fingers when it is swung; grip elsewhere")
        what.swung = SimpleNamespace(use={})
        return 1.1

    monkeypatch.setattr(handling, "show_again", lambda tools, what, firm: what.X_ST.append(np.eye(4)) or True)
    monkeypatch.setattr(swinging, "weigh_held", weigh_held)
    one = OneObject(run.tools, run.record, "object_01", run._stage, run._jobs.add, [])
    one.shown = held
    one.weigh()
    assert tried == swung and held.swung is not None


def test_all_else_that_the_picture_shows_is_in_the_way_of_a_pick(monkeypatch: pytest.MonkeyPatch) -> None:
    thing, given_up = (
        SimpleNamespace(points=np.full((3, 3), x), middle=np.full(3, x), beside=False, beyond=np.zeros((0, 3)))
        for x in (0.1, 0.2)
    )
    stood, kept_clear = list[Any](), list[Any]()

    def choice(*told: Any) -> Any:
        kept_clear.append(told[6])
        return SimpleNamespace(best=lambda: None, why="barred")

    monkeypatch.setattr(handling, "lying", lambda *told: [given_up, thing])
    monkeypatch.setattr(handling, "Choice", choice)
    monkeypatch.setattr(handling, "why_barred", lambda why, one, others: f"{why} by {len(others)}")
    mover = SimpleNamespace(stand=lambda what, points, floor: stood.extend(points))
    tools: Any = SimpleNamespace(learning=Learning(), mover=mover, gripper=None, cell=None, faces=None, robot=None)
    nothing: Any = None
    assert handling.pick(tools, thing, nothing, 0, []).why == "barred by 1"  # type: ignore[arg-type]
    assert len(stood) == 2 and len(kept_clear) == 1 and len(kept_clear[0]) == 1
    np.testing.assert_array_equal([*stood, *kept_clear[0]], [thing.points, given_up.points, given_up.points])
