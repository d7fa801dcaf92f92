"""All turns of what fits in shape and not in colours: which is registered, and when what was found stays."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.registration_bench import frame, model, turn
from twin_diagram import scenario
from twin_diagram.perception.registration import turns_about as subject
from twin_diagram.perception.registration.global_search import Found
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.turns_about import TUNING, turned_about

Array = npt.NDArray[np.float64]
START, PLACE = turn(0.1, -0.2, 0.7), np.array([0.4, -0.1, 0.05])
SEGMENT = np.zeros((150, 3))


class Image:
    """An image in which colours say how like each of the turns is; what is registered stays where it was laid."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, likeness: Array, explained: float = 1.0) -> None:
        self.likeness, self.laid, self.registered = likeness, [], []  # type: ignore[var-annotated]
        monkeypatch.setattr(subject, "assess", self.assess)
        monkeypatch.setattr(subject, "register", self.register)
        monkeypatch.setattr(subject, "explained", lambda model, points, one: explained)
        monkeypatch.setattr(subject, "judged", lambda model, points, one: 0.9)
        monkeypatch.setattr(subject, "with_colours_aligned", lambda model, frame, found, points, params: found)

    def assess(self, model: Any, frame: Any, poses: Any, count: int) -> Any:
        self.laid.append(poses)
        return SimpleNamespace(likeness=self.likeness)

    def register(self, model: Any, frame: Any, R: Array, p: Array, params: Any, points_W: Array) -> RegisteredPose:
        self.registered.append((R, p))
        likeness = float(self.likeness.max())
        return RegisteredPose(R, p, np.eye(6), 2.0 * likeness, likeness, 1.0, 300.0)

    def turned(self, found: Found) -> Found:
        return turned_about(model(), frame(), found, SEGMENT, scenario.Registration())


def found_like(likeness: float) -> Found:
    one = RegisteredPose(START, PLACE, np.eye(6), 0.4, likeness, 1.0, 300.0)
    return Found(one, 0.4, likeness)


def likenesses(best: int, most: float) -> Array:
    result = np.full(TUNING.turns, 0.1)
    result[best] = most
    return result


@pytest.mark.parametrize("best", [1, 17, TUNING.turns - 1])
def test_the_turn_that_is_most_like_is_registered_and_what_was_found_stays_beside_it(
    monkeypatch: pytest.MonkeyPatch, best: int
) -> None:
    image, before = Image(monkeypatch, likenesses(best, 0.3)), found_like(0.1)
    after = image.turned(before)
    (laid,), ((R, p),) = image.laid, image.registered
    assert len(laid.R) == TUNING.turns
    np.testing.assert_allclose(R, turn(0.0, 0.0, 2.0 * np.pi * best / TUNING.turns) @ START, atol=1e-12)
    np.testing.assert_array_equal(p, PLACE)
    np.testing.assert_allclose(laid.R[0], START, atol=1e-12)
    assert (after.score, after.likeness) == (pytest.approx(0.6 * 0.9), pytest.approx(0.3 * 0.9))
    assert after.others == (before.registration,)


def test_what_was_found_stays_where_no_turn_is_much_more_like(monkeypatch: pytest.MonkeyPatch) -> None:
    for most, tried in ((0.1 * TUNING.better - 1e-9, 0), (0.1 * TUNING.better + 1e-9, 1)):
        image, before = Image(monkeypatch, likenesses(5, most)), found_like(0.2)
        assert image.turned(before) is before and len(image.registered) == tried


def test_what_a_segment_does_not_lie_on_is_not_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image(monkeypatch, likenesses(5, 0.5), explained=TUNING.explained - 0.01)
    before = replace(found_like(0.1), score=0.2)
    assert image.turned(before) is before and not image.laid
