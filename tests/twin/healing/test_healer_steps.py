"""The healer's steps one by one, with stand-ins for twin, tape and search: when each is due, and what it says."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from twin_diagram.errors import LogError, ModelError
from twin_diagram.scenario import Healing
from twin_diagram.twin.healing import healer
from twin_diagram.twin.healing.healer import Healer

GAP = {"torque_rms": {"holdout": {"before": {"a": 3.0, "b": 0.0}, "after": {"a": 2.0, "b": 2.0}}}}
WORSE = {"torque_rms": {"holdout": {"before": {"a": 3.0, "b": 0.0}, "after": {"a": 2.2, "b": 2.2}}}}


class Twin:
    """What a healer asks of a twin."""

    def __init__(self) -> None:
        self.measured_model = SimpleNamespace(present=("old",))
        self.records: list[dict[str, Any]] = []
        self.used: list[Any] = []
        self.diagram = SimpleNamespace(
            GetMyMutableContextFromRoot=lambda root: "own",
            GetOutputPort=lambda name: SimpleNamespace(Eval=lambda own: [0.0, 0.0, self.raised, 0.0]),
        )

    @property
    def raised(self) -> float:
        return max((record["time"] for record in self.records), default=-1.0)

    def alarms(self, own: str) -> list[dict[str, Any]]:
        assert own == "own"
        return [dict(record) for record in self.records]

    def parameters(self, own: str) -> dict[str, float]:
        return {"swaps": float(len(self.used))}

    def add_model(self, model: Any) -> int:
        if model.present == ("of another arm",):
            raise ModelError("7 joints where the filter has 6")
        return 5

    def use_model(self, own: str, number: int) -> None:
        self.used.append((own, number))


class Tape:
    """Remembers what was cut from it."""

    def __init__(self) -> None:
        self.cuts: list[tuple[float, float]] = []
        self.empty = False

    def take(self, context: Any) -> None:
        pass

    def cut(self, start: float, end: float) -> tuple[float, float]:
        if self.empty:
            raise LogError("the tape holds\nno messages")
        self.cuts.append((start, end))
        return (start, end)


class Search:
    """Stands for the process; the newest one is `Search.newest`."""

    newest: Search | None = None
    begun: int

    def __init__(self, *given: Any) -> None:
        self.given, self.age, self.waited, self.stopped = given, 0.0, list[float](), False
        self.outcome: Any = None
        Search.newest = self

    def poll(self) -> Any:
        return self.outcome

    def wait(self, seconds: float) -> Any:
        self.waited.append(seconds)
        return self.outcome

    def stop(self) -> None:
        self.stopped = True


class Bench:
    """A healer among stand-ins."""

    def __init__(self, folder: Path | None, **tuning: Any) -> None:
        self.twin, self.tape, self.events = Twin(), Tape(), list[dict[str, Any]]()
        params = Healing(**{"seconds": 2.0, "held_out": 0.25, "nice": 3, **tuning})
        packages = {"pkg": "somewhere"}
        self.healer = Healer(self.twin, params, self.events.append, self.tape, folder, packages)  # type: ignore[arg-type]

    def alarm(self, time: float, statistic: float = 3.0, shape: str = "step") -> None:
        self.twin.records.append({"time": time, "statistic": statistic, "shape": shape, "joint": "elbow"})

    def at(self, *times: float) -> list[str]:
        """Look at these times; return the names of the events that came of it."""
        known = len(self.events)
        for time in times:
            self.healer.poll(SimpleNamespace(get_time=lambda time=time: time))  # type: ignore[arg-type]
        return [event["event"] for event in self.events[known:]]

    @property
    def search(self) -> Search:
        assert Search.newest is not None
        return Search.newest


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(healer, "GapProcess", Search)
    monkeypatch.setattr(healer, "spec_of", lambda effect: effect)
    monkeypatch.setattr(healer, "sentence", lambda effect: f"has {effect}")
    Search.newest = None

    def make(**tuning: Any) -> Bench:
        return Bench(tmp_path, **tuning)

    return make


def outcome(verdict: str = "named", model: Any = "model", gap: Any = GAP, why: str = "") -> Any:
    answer = {"remainder": False, "effects": ["payload"], "gap": gap}
    return SimpleNamespace(verdict=verdict, model=model, answer=answer, seconds=4.26, why=why)


def finds(monkeypatch: pytest.MonkeyPatch, *present: Any) -> list[tuple[Any, Any]]:
    """The corrected model has these effects; return the list of what is loaded."""
    loaded: list[tuple[Any, Any]] = []

    def load(place: Any, packages: Any) -> Any:
        loaded.append((place, packages))
        return SimpleNamespace(present=present)

    monkeypatch.setattr(healer, "Model", SimpleNamespace(load=load))
    return loaded


# From the alarm to the search.


def test_each_alarm_is_told_once_the_one_at_zero_too(bench: Any) -> None:
    one = bench()
    assert one.at(0.0) == []
    one.alarm(0.0)
    assert one.at(0.0, 0.1) == ["alarm"]
    one.alarm(0.5, 2.0)
    assert one.at(0.5, 0.6, 0.7) == ["alarm"]
    assert [event["time"] for event in one.events] == [0.0, 0.5] and one.events[1]["statistic"] == 2.0


def test_a_search_begins_when_the_log_since_it_settled_is_whole(bench: Any, tmp_path: Path) -> None:
    one = bench()
    one.alarm(1.0)
    # 0.3 s to settle and 2 s of log; times that differ by less than 1e-6 s are the same.
    assert one.at(1.0, 1.1, 2.0, 3.3 - 1.4e-6) == ["alarm"] and Search.newest is None
    assert one.at(3.3 - 0.7e-6) == ["gap_started"]
    assert one.tape.cuts == [pytest.approx((1.3, 2.8)), pytest.approx((2.8, 3.3))]
    model, fit, holdout, folder, packages, nice = one.search.given
    assert model is one.twin.measured_model and (fit, holdout) == tuple(one.tape.cuts)
    assert folder == tmp_path / "1" and packages == {"pkg": "somewhere"} and nice == 3
    told = one.events[-1]
    assert told["fit"] == [1.3, 2.8] and told["holdout"] == [2.8, 3.3] and told["alarm"] == 1.0
    assert told["joint"] == "elbow" and told["folder"] == str(tmp_path / "1")


def test_an_alarm_twice_as_strong_begins_the_log_anew_and_a_weaker_one_does_not(bench: Any) -> None:
    for statistic, due in ((5.9, 3.3), (6.1, 2.0 + 2.3)):
        one = bench()
        one.alarm(1.0, 3.0)
        one.at(1.1)
        one.alarm(1.9, statistic)
        one.at(2.0)
        assert "gap_started" not in one.at(due - 0.001)
        assert "gap_started" in one.at(due + 0.001), statistic
        assert one.tape.cuts[0][0] == pytest.approx(due - 2.0)


def test_an_alarm_that_itself_grows_begins_the_log_anew(bench: Any) -> None:
    one = bench()
    one.alarm(0.2, 90.0)
    one.at(0.2, 2.5)
    one.search.outcome = outcome("none", None)
    one.at(2.6)  # what was answered long ago counts no more
    one.alarm(3.0, 3.0)
    one.at(3.1)
    one.twin.records[-1]["statistic"] = 6.2
    assert one.at(4.0, 4.0 + 2.299) == [] and one.at(4.0 + 2.301) == ["gap_started"]
    # Its new level counts from then on.
    one = bench()
    one.alarm(1.0, 3.0)
    one.at(1.1)
    one.alarm(1.9, 6.1)
    one.at(2.0)
    one.alarm(2.1, 12.0)
    one.at(2.2)
    assert one.at(4.301) == ["gap_started"]


def test_beyond_ten_times_the_threshold_an_alarm_is_plain_and_its_growth_no_news(bench: Any) -> None:
    for first, due in ((5.1, 3.3), (4.9, 2.0 + 2.3)):
        one = bench()
        one.alarm(1.0, first)
        one.at(1.1)
        one.alarm(1.9, 50.0)
        one.at(2.0)
        assert "gap_started" not in one.at(due - 0.001)
        assert "gap_started" in one.at(due + 0.001), first


def test_a_spike_is_over_unless_another_alarm_follows(bench: Any) -> None:
    one = bench()
    one.alarm(1.0, shape="spike")
    assert one.at(1.1, 3.301) == ["alarm", "alarm_passed"]
    assert one.events[-1]["alarm"] == 1.0
    assert one.at(3.4, 9.0) == [], "it is answered"
    one = bench()
    one.alarm(1.0, shape="spike")
    one.at(1.1)
    one.alarm(1.5)
    assert one.at(1.6, 3.301) == ["alarm", "gap_started"]
    one = bench()
    one.alarm(0.5, shape="spike")
    one.at(0.6, 2.801)
    one.alarm(3.0, shape="spike")
    assert one.at(3.1, 5.301) == ["alarm", "alarm_passed"], "an earlier alarm is none that follows"


def test_what_looked_like_a_step_may_turn_out_a_spike(bench: Any) -> None:
    one = bench()
    one.alarm(1.0)
    one.at(1.1)
    one.twin.records[0]["shape"] = "spike"
    assert one.at(3.301) == ["alarm_passed"]


def test_attempts_are_counted_and_numbered(bench: Any, tmp_path: Path) -> None:
    one = bench(attempts=2)
    for k in range(3):
        begin = 10.0 * k
        one.alarm(begin + 1.0)
        one.at(begin + 1.1, begin + 3.301)
        if k < 2:
            assert one.search.given[3] == tmp_path / str(k + 1)
            one.search.outcome = outcome("none", None)
        one.at(begin + 3.4)
    assert [event["event"] for event in one.events].count("gap_started") == 2


def test_a_tape_that_lacks_the_log_fails_the_search_in_one_line(bench: Any) -> None:
    one = bench()
    one.tape.empty = True
    one.alarm(1.0)
    assert one.at(1.1, 3.301) == ["alarm", "gap_failed"]
    assert one.events[-1]["why"] == "the tape holds no messages"
    assert one.at(3.4) == []


def test_an_alarm_between_microseconds_is_told_once(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clocks of logs and buses run finer than the records' times."""
    one = bench()
    one.alarm(1.234568)
    monkeypatch.setattr(Twin, "raised", 1.2345678)
    assert one.at(1.3, 1.4, 1.5) == ["alarm"]


def test_without_a_tape_alarms_are_told_and_no_folder_is_made(tmp_path: Path) -> None:
    twin, events = Twin(), list[dict[str, Any]]()
    for folder in (None, tmp_path):
        watcher = Healer(twin, None, events.append, None, folder)  # type: ignore[arg-type]
        assert watcher._temporary is None
    twin.records.append({"time": 1.0, "statistic": 3.0, "shape": "step", "joint": "elbow"})
    for time in (1.1, 100.0):
        watcher.poll(SimpleNamespace(get_time=lambda time=time: time))  # type: ignore[arg-type]
    assert [event["event"] for event in events] == ["alarm"]
    watcher.close()


def test_without_a_folder_the_search_has_one_that_goes_with_the_healer(bench: Any) -> None:
    bench()
    one = Bench(None)
    one.alarm(1.0)
    one.at(1.1, 3.301)
    folder = one.search.given[3].parent
    assert folder.is_dir() and one.events[-1]["folder"] is None
    one.healer.close()
    assert not folder.exists() and one.search.stopped and one.events[-1]["event"] == "gap_stopped"


# The verdict.


def searching(bench: Any, **tuning: Any) -> Bench:
    """A bench whose search began at 3.3 s."""
    one: Bench = bench(**tuning)
    one.alarm(1.0)
    one.at(1.1, 3.3)
    return one


def test_a_verdict_is_taken_as_soon_as_it_is_there(bench: Any) -> None:
    one = searching(bench, patience=10.0)
    one.search.age = 9.9
    assert one.at(3.4, 3.5) == [] and not one.search.waited
    one.search.outcome = outcome("none", None)
    assert one.at(3.6) == ["gap_verdict", "model_kept"]
    verdict = one.events[-2]
    assert verdict["verdict"] == "none" and verdict["seconds"] == 4.3 and verdict["time"] == 3.6
    assert verdict["effects"] == ["payload"] and verdict["gap"] == GAP and verdict["remainder"] is False
    assert "the verdict is none" in one.events[-1]["why"]


def test_a_verdict_that_is_awaited_is_taken_at_its_time(bench: Any) -> None:
    one = searching(bench, answer_after=0.5, patience=10.0)
    one.search.outcome, one.search.age = outcome("none", None), 4.0
    assert one.at(3.4, 3.8 - 1.4e-6) == [] and not one.search.waited
    assert one.at(3.8 - 0.7e-6) == ["gap_verdict", "model_kept"]
    assert one.search.waited == [6.0]
    one = searching(bench, answer_after=0.5, patience=10.0)
    one.search.age = 12.0
    assert one.at(3.81) == ["gap_stopped"] and one.search.waited == [0.0]


def test_patience_ends(bench: Any) -> None:
    one = searching(bench, patience=10.0)
    one.search.age = 10.0
    assert one.at(3.4) == ["gap_stopped"] and one.search.stopped
    assert one.events[-1]["why"] == "no verdict within 10 s"
    assert one.at(9.0) == [], "alarms from before are answered"
    one.alarm(9.5)
    assert one.at(9.6, 11.81) == ["alarm", "gap_started"]


def test_a_search_that_fails_says_why(bench: Any) -> None:
    one = searching(bench)
    one.search.outcome = outcome("failed", None, why="no log")
    assert one.at(3.4) == ["gap_failed"]
    assert one.events[-1]["why"] == "no log" and one.events[-1]["seconds"] == 4.3


def test_a_better_model_is_taken_over(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    new, given = SimpleNamespace(given=False), SimpleNamespace(given=True)
    loaded = finds(monkeypatch, given, new)
    one = searching(bench)
    one.search.outcome = outcome()
    assert one.at(3.4) == ["gap_verdict", "model_swapped"]
    assert one.twin.used == [("own", 5)] and loaded == [("model", {"pkg": "somewhere"})]
    swapped = one.events[-1]
    assert swapped["model"] == 5 and swapped["effects"] == [f"has {new}"]
    assert swapped["parameters_before"] == {"swaps": 0.0} and swapped["parameters_after"] == {"swaps": 1.0}
    assert one.healer.swaps == [3.4] and one.healer.model.present == (given, new)


KEPT: dict[str, tuple[Any, tuple[Any, ...], str]] = {
    "no better": (outcome(gap=WORSE), ("new",), "explains the held-out run no better"),
    "the same": (outcome(), ("old",), "is over"),
    "of another arm": (outcome(), ("of another arm",), "cannot use the corrected model: 7 joints"),
}


@pytest.mark.parametrize("case", KEPT)
def test_a_model_that_is_no_better_is_not(case: str, bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    found, present, why = KEPT[case]
    finds(monkeypatch, *present)
    one = searching(bench)
    one.search.outcome = found
    assert one.at(3.4) == ["gap_verdict", "model_kept"] and why in one.events[-1]["why"]
    assert one.twin.used == [] and one.healer.swaps == [] and one.healer.model is one.twin.measured_model


def test_smaller_is_by_the_sum_of_squares() -> None:
    assert healer.smaller(GAP) and not healer.smaller(WORSE)
    same = {"torque_rms": {"holdout": {"before": {"a": 1.0}, "after": {"a": 1.0}}}}
    assert not healer.smaller(same)
