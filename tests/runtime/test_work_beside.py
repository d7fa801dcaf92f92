"""Work in a process of its own: the same answers to the bit, and whatever happens to it is told in one line."""

from __future__ import annotations

import logging
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from twin_diagram.runtime.work_beside import TUNING, WorkBeside, alike
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Picture:
    """A question as those of a run are: arrays in a dataclass."""

    number: int
    values: Array


class Warmed:
    """Says how often it was warmed up."""

    times = 0

    def warm_up(self) -> None:
        """Count."""
        self.times += 1

    def answer(self, question: Picture) -> Array:
        return question.values * self.times


class Slow(Warmed):
    """Never begins."""

    def warm_up(self) -> None:
        time.sleep(600.0)


class Squares:
    """Squares numbers; hangs over 13, falls over 14."""

    def answer(self, question: tuple[int, bytes]) -> Array:
        number, values = question
        if number == 13:
            time.sleep(600.0)
        if number == 14:
            raise ArithmeticError("no such square")
        return np.frombuffer(values) ** 2 + number


def asked(number: int) -> tuple[int, bytes]:
    return number, np.random.default_rng(number).random(200_000).tobytes()


@pytest.fixture
def beside() -> Iterator[WorkBeside[tuple[int, bytes], Array]]:
    with WorkBeside[tuple[int, bytes], Array](Squares(), "squares") as made:
        yield made


def test_answers_are_those_that_are_found_here(beside: WorkBeside[tuple[int, bytes], Array]) -> None:
    for number in (1, 2, 3):
        beside.ask(asked(number))
    for number in (3, 1, 2, 2):  # in any order, and again
        answer = beside.answer(asked(number))
        assert answer is not None
        np.testing.assert_array_equal(answer, Squares().answer(asked(number)))
    assert beside.answer(asked(4)) is None, "nobody asked for it"


def test_old_answers_make_room(beside: WorkBeside[tuple[int, bytes], Array]) -> None:
    for number in range(20, 21 + TUNING.kept):
        beside.ask((number, b""))
        assert beside.answer((number, b"")) is not None
    assert beside.answer((20, b"")) is None and beside.answer((21, b"")) is not None


def test_one_that_falls_over_is_told_of_in_one_line(
    beside: WorkBeside[tuple[int, bytes], Array], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "twin_diagram"):
        beside.ask(asked(14))
        assert beside.answer(asked(14)) is None
        beside.ask(asked(1))
        assert beside.answer(asked(1)) is None, "nor are there any from then on"
    assert len(caplog.messages) == 1 and "\n" not in caplog.messages[0]
    assert "no such square" in caplog.messages[0] and "goes on here" in caplog.messages[0]


def test_one_that_hangs_is_ended(caplog: pytest.LogCaptureFixture) -> None:
    with WorkBeside[tuple[int, bytes], Array](Squares(), "squares", patience=0.5) as beside:
        beside.ask(asked(13))
        with caplog.at_level(logging.WARNING, "twin_diagram"):
            assert beside.answer(asked(13)) is None
        assert beside._worker.process.wait(10.0) is not None
    assert len(caplog.messages) == 1 and "within 0.5 s" in caplog.messages[0]


def test_the_first_answer_may_take_longer(beside: WorkBeside[tuple[int, bytes], Array]) -> None:
    assert beside._patience == TUNING.beginning > TUNING.patience, "it begins, and may compile"
    beside.ask(asked(1))
    assert beside.answer(asked(1)) is not None
    assert beside._patience == TUNING.patience


def test_it_is_warmed_up_once_before_it_counts_as_begun() -> None:
    with WorkBeside[Picture, Array](Warmed(), "warms up") as beside:
        beside.wait()
        assert beside._worker.begun.is_set() and not beside.why
        picture = Picture(1, np.array([1.0, np.nan]))
        beside.ask(picture)
        np.testing.assert_array_equal(beside.answer(Picture(1, np.array([1.0, np.nan]))), picture.values)
        assert beside.answer(Picture(1, np.array([1.0, 2.0]))) is None
        assert beside.answer(Picture(2, picture.values)) is None


def test_one_that_never_begins_is_ended(caplog: pytest.LogCaptureFixture) -> None:
    with WorkBeside[Picture, Array](Slow(), "sleeps", patience=0.5) as beside:
        with caplog.at_level(logging.WARNING, "twin_diagram"):
            beside.wait()
        assert beside._worker.process.wait(10.0) is not None
    assert len(caplog.messages) == 1 and "did not begin within 0.5 s" in caplog.messages[0]


def test_questions_are_alike_to_the_bit() -> None:
    values = np.arange(6.0).reshape(2, 3)
    same = (values, values.copy(), np.asfortranarray(values))
    assert all(alike(Picture(1, values), Picture(1, each)) for each in same)
    other: tuple[Any, ...] = (values[:1], values.astype(np.float32), values + 1e-15, -values, values.ravel())
    assert not any(alike(Picture(1, values), Picture(1, each)) for each in other)
    assert alike((1, b"2"), (1, b"2")) and not alike((1, b"2"), (1, b"3")) and not alike(1, True)


def test_images_are_compared_to_the_bit_without_a_copy() -> None:
    image = np.random.default_rng(0).random((480, 640)).astype(np.float32)
    image[0, 0], same = np.nan, image.copy()
    same[0, 0] = np.nan
    tracemalloc.start()
    assert alike(Picture(1, image), Picture(1, same))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < image.nbytes / 2
    for changed in (-same, np.where(same > 0.9999, np.float32(0.0), same)):
        assert not alike(Picture(1, image), Picture(1, changed))
    for odd in (np.zeros(0), np.float64(0.0) * np.ones(()), np.ones(3, np.uint8)):
        assert alike(Picture(1, odd), Picture(1, odd.copy()))
    assert not alike(Picture(1, np.zeros(2)), Picture(1, -np.zeros(2)))


def test_it_ends_with_its_user(caplog: pytest.LogCaptureFixture) -> None:
    with WorkBeside[tuple[int, bytes], Array](Squares(), "squares") as beside:
        beside.ask(asked(13))
        begin = time.monotonic()
    assert beside._worker.process.poll() is not None and time.monotonic() - begin < 2.0
    assert not caplog.messages  # that is no failure
