"""Time left is told from the work done so far, and never where it would be a guess."""

from __future__ import annotations

import pytest

from twin_diagram.runtime.stages import Pace, Stages, spoken


def told(times: dict[str, float], done: dict[str, float]) -> list[str]:
    now = [100.0]
    lines: list[str] = []
    stages = Stages(done, lines.append, lambda: now[0])
    for stage, at in times.items():
        now[0] = 100.0 + at
        stages(stage)
    return lines


def test_what_is_left_follows_from_what_the_work_before_took() -> None:
    lines = told({"a": 0.0, "b": 10.0, "c": 60.0, "d": 180.0}, {"a": 0.0, "b": 0.25, "c": 0.5, "d": 0.9})
    assert lines == [
        "a",
        "b (10 s so far, about 30 s left)",
        "c (60 s so far, about 60 s left)",
        "d (3 min so far, about 20 s left)",
    ]


def test_too_early_too_short_or_unknown_is_told_without() -> None:
    assert told({"a": 50.0}, {"a": 0.02}) == ["a"]
    assert told({"a": 8.0}, {"a": 0.13}) == ["a"]  # of 28 s in all, say: 54 s would be told
    assert told({"a": 1.5}, {"a": 0.3}) == ["a"]
    assert told({"a": 10.0}, {"a": 0.9}) == ["a"]
    assert told({"x": 10.0}, {"a": 0.5}) == ["x"]


def test_a_stage_that_comes_again_takes_nothing_back() -> None:
    lines = told({"late": 40.0, "early": 60.0}, {"early": 0.1, "late": 0.5})
    assert lines[1] == "early (60 s so far, about 60 s left)"


@pytest.mark.parametrize(("seconds", "words"), [(3.4, "3 s"), (89.0, "89 s"), (90.1, "2 min"), (600.0, "10 min")])
def test_times_as_people_say_them(seconds: float, words: str) -> None:
    assert spoken(seconds) == words


def test_frames_are_told_now_and_then_and_the_slow_first_one_counts_for_nothing() -> None:
    now, lines = [0.0], list[str]()
    pace = Pace(40, lines.append, lambda: now[0])
    for frame in range(1, 41):
        now[0] += 30.0 if frame == 1 else 1.0
        pace(frame)
    assert lines == ["1 of 40 frames", "11 of 40 frames, about 29 s left", "21 of 40 frames, about 19 s left"] + [
        "31 of 40 frames, about 9 s left"
    ]
