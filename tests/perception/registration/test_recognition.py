"""Recognition's own rules: hues counted one by one, the order of segments, who keeps which points."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.registration_bench import model, turn
from twin_diagram import scenario
from twin_diagram.perception.registration import recognition
from twin_diagram.perception.registration.global_search import Found
from twin_diagram.perception.registration.hues import alike, hues
from twin_diagram.perception.registration.recognition import _owned, recognise
from twin_diagram.perception.registration.registration import RegisteredPose

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()


def test_hues_are_counted_in_cells_of_a_twelfth_of_red_and_green() -> None:
    colours = np.random.default_rng(2171).uniform(0.0, 1.0, (300, 3)) ** 2
    colours[:20] *= 0.05
    colours[20:24] = np.eye(3)[[0, 1, 2, 0]]
    cells = np.zeros(144)
    for r, g, b in colours:
        if r + g + b > 0.1:
            cells[12 * min(int(12 * r / (r + g + b)), 11) + min(int(12 * g / (r + g + b)), 11)] += 1.0
    np.testing.assert_allclose(hues(colours), cells / cells.sum())
    assert hues(np.zeros((4, 3))).sum() == 0.0 and hues(np.zeros((0, 3))).shape == (144,)
    assert hues(np.full((1, 3), 0.5)).sum() == pytest.approx(1.0), "one point is all"
    other = hues(colours[::2])
    assert alike(hues(colours), other) == pytest.approx(sum(np.sqrt(hues(colours) * other)))
    assert alike(other, other) == pytest.approx(1.0)


def test_an_objects_points_are_those_within_12_mm() -> None:
    cloud = model()
    R, p = turn(0.2, 0.1, -0.3), np.array([0.1, 0.0, 0.2])
    points = p + np.random.default_rng(2172).normal(0.0, 0.05, (800, 3))
    away = np.array([np.linalg.norm(cloud.points @ R.T + p - y, axis=1).min() for y in points])
    found = Found(RegisteredPose(R, p, np.eye(6), 1.0, 1.0, 1.0, 1.0), 1.0, 1.0)
    segments: Any = SimpleNamespace(points=points)
    np.testing.assert_array_equal(_owned(cloud, segments, found), np.flatnonzero(away < 0.012))


class Scene:
    """Segments of given hues, in which a search of object by segment scores as given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, hued: list[Array], sizes: list[int]) -> None:
        self.scores: dict[tuple[int, int], float] = {}
        self.owned: dict[tuple[int, int], Any] = {}
        self.searched: list[tuple[int, int, int]] = []
        self.labels = np.repeat(np.arange(len(sizes)), sizes)
        self.segments: Any = SimpleNamespace(
            labels=self.labels,
            count=len(sizes),
            points_W=np.repeat(self.labels[:, None].astype(float), 3, axis=1),
            colours=np.array(hued)[self.labels],
        )
        monkeypatch.setattr(recognition, "search", self.search)
        monkeypatch.setattr(recognition, "search_past_tears", lambda cloud, view, points, ways, found: found)
        monkeypatch.setattr(recognition, "turned_about", lambda cloud, frame, found, points, params: found)
        monkeypatch.setattr(recognition, "claimed", self.claimed)
        monkeypatch.setattr(recognition, "hangs", lambda frame, points: False)

    def search(
        self, cloud: Any, frame: Any, points: Array, orientations: Any, params: Any, least: float
    ) -> Found | None:
        s = int(points[0, 0])
        assert orientations == [cloud.number] and frame == "frame" and params is PARAMS and least == 0.0
        self.searched.append((cloud.number, s, len(points)))
        score = self.scores.get((cloud.number, s))
        place = np.array([float(cloud.number), float(s), 0.0])
        return None if score is None else Found(RegisteredPose(np.eye(3), place, np.eye(6), 1, 1, 1, 1), score, score)

    def claimed(self, cloud: Any, segments: Any, R: Array, p: Array, reach: float) -> Any:
        key = (int(p[0]), int(p[1]))
        assert cloud.number == key[0] and reach == 0.012
        return self.owned.get(key, np.flatnonzero(self.labels == key[1]))

    def run(self, objects: dict[int, Array], free: Any = None, smallest: int = 10) -> dict[int, int]:
        wanted: Any = {
            k: SimpleNamespace(number=k, coloured=True, hues=hues(np.array([colour] * 5)))
            for k, colour in objects.items()
        }
        known: Any = {k: [k] for k in objects}
        free = np.ones(len(self.labels), dtype=bool) if free is None else free
        before = free.copy()
        found = recognise(wanted, known, self.segments, "frame", free, PARAMS, smallest)  # type: ignore[arg-type]
        np.testing.assert_array_equal(free, before)
        return {k: int(one.registration.p[1]) for k, one in found.items()}


RED, GREEN, BLUE = np.eye(3)


def test_segments_of_its_own_hue_are_searched_first_and_a_sure_one_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for score, tried in ((0.85, [1]), (0.84, [1, 0, 2])):
        scene = Scene(monkeypatch, [GREEN, RED, BLUE], [20, 20, 20])
        scene.scores = {(7, 1): score, (7, 0): 0.3, (7, 2): 0.2}
        assert scene.run({7: RED}) == {7: 1}
        assert [s for _, s, _ in scene.searched] == tried


def test_segments_too_small_or_taken_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch, [RED, RED, RED], [10, 9, 30])
    free = np.ones(49, dtype=bool)
    free[19:24] = False
    scene.run({1: RED}, free)
    assert sorted(scene.searched) == [(1, 0, 10), (1, 2, 25)]
    # What is sure takes its points at once, before the next object is looked for.
    scene = Scene(monkeypatch, [RED], [30])
    scene.scores = {(1, 0): 0.85, (2, 0): 0.95}
    assert scene.run({1: RED, 2: RED}) == {1: 0} and scene.searched == [(1, 0, 30)]


def test_scores_from_six_tenths_on_are_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    for score, accepted in ((0.6, {1: 0}), (0.599, {})):
        scene = Scene(monkeypatch, [RED], [30])
        scene.scores = {(1, 0): score}
        assert scene.run({1: RED}) == accepted


def test_the_better_of_two_keeps_a_segment_and_half_of_its_points_must_be_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The other may have it, too, where half of what it explains, and of the smallest object, is still free."""
    for left, second in ((20, True), (19, False)):
        scene = Scene(monkeypatch, [RED], [100])
        scene.scores = {(1, 0): 0.7, (2, 0): 0.8}
        scene.owned = {(2, 0): np.arange(50), (1, 0): np.arange(50 + left - 40, 50 + left)}
        assert scene.run({1: RED, 2: RED}) == ({1: 0, 2: 0} if second else {2: 0})
    for smallest, second in ((20, True), (22, False)):
        scene = Scene(monkeypatch, [RED], [100])
        scene.scores = {(1, 0): 0.7, (2, 0): 0.8}
        scene.owned = {(2, 0): np.arange(50), (1, 0): np.arange(44, 60)[:16]}
        scene.owned[1, 0] = np.arange(44, 60)
        assert scene.run({1: RED, 2: RED}, smallest=smallest) == ({1: 0, 2: 0} if second else {2: 0})
