"""Rules of tracking and recognition, each against what its words say; no images needed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.registration_kernels import colour_at, counted
from twin_diagram import scenario
from twin_diagram.perception.registration import recognition, tracking
from twin_diagram.perception.registration.colour_shift import ALIGNED
from twin_diagram.perception.registration.frame import Frame, blur_within
from twin_diagram.perception.registration.global_search import Found
from twin_diagram.perception.registration.hues import hues
from twin_diagram.perception.registration.model_cloud import fibonacci_sphere
from twin_diagram.perception.registration.recognition import recognise
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.residuals import tukey
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.slots import Slot, measurement, postponed, predict, seen, stands_still
from twin_diagram.perception.registration.where_expected import believable

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()
P = np.array([0.5, 0.1, 0.05])


def pose(R: Array | None = None, p: Array = P, **changes: Any) -> RegisteredPose:
    good = RegisteredPose(np.eye(3) if R is None else R, p, 1e-14 * np.eye(6), 0.9, 0.9, 1.0, 300.0)
    return replace(good, **changes)


def slot(velocity: Array | None = None) -> Slot:
    return Slot(True, np.eye(3), P, np.zeros(6) if velocity is None else velocity, 1.0)


# From image to image.


def test_a_pose_is_predicted_for_a_short_while() -> None:
    moving = slot(np.array([0, 0, 0.6, 0.2, -0.1, 0]))
    for ahead, moved in ((0.1, 0.1), (0.29, 0.29), (0.31, 0.0), (-0.1, 0.0)):
        R, p = predict(moving, 1.0 + ahead)
        np.testing.assert_allclose(p, P + moved * np.array([0.2, -0.1, 0]), atol=1e-12)
        np.testing.assert_allclose(R, exp(np.array([0, 0, 0.6 * moved])), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "believed"),
    [
        ({}, True),
        ({"quality": PARAMS.minimum_quality - 0.01}, False),
        ({"quality": PARAMS.minimum_quality + 0.01}, True),
        # Colours are no veto where the shape is there, where it should be.
        ({"quality": 0.1, "shape": 0.9, "p": P + [0.0, 0.019, 0.0]}, True),
        ({"quality": 0.1, "shape": 0.9, "p": P + [0.0, 0.021, 0.0]}, False),
        ({"quality": 0.1, "shape": 0.9, "R": exp(np.array([0.0, 0.19, 0.0]))}, True),
        ({"quality": 0.1, "shape": 0.9, "R": exp(np.array([0.0, 0.21, 0.0]))}, False),
        ({"quality": 0.1, "shape": PARAMS.minimum_quality + 0.01}, True),
        ({"quality": 0.1, "shape": PARAMS.minimum_quality - 0.01}, False),
        ({"visible_share": 0.11}, False),
        ({"visible_share": 0.13}, True),
        ({"points": 29.0}, False),
        ({"points": 30.0}, True),
        ({"p": P + [0.0, 0.079, 0.0]}, True),
        ({"p": P + [0.0, 0.081, 0.0]}, False),
        ({"R": exp(np.array([0.0, 0.69, 0.0]))}, True),
        ({"R": exp(np.array([0.0, 0.71, 0.0]))}, False),
    ],
)
def test_a_registration_is_believed_within_its_limits(change: dict[str, Any], believed: bool) -> None:
    assert believable(replace(pose(), **change), PARAMS, np.eye(3), P) == believed


def test_the_velocity_is_a_running_mean_and_forgotten_over_a_gap() -> None:
    before = slot(np.array([0, 0, 0.5, 0.1, 0, 0]))
    found = pose(exp(np.array([0, 0, 0.1])), P + [0.0, 0.02, 0.0])
    after = seen(before, found, 1.1)
    np.testing.assert_allclose(after.velocity, [0, 0, 0.4 * 0.5 + 0.6 * 1.0, 0.04, 0.6 * 0.2, 0], atol=1e-9)
    assert after.known and after.seen == 1.1 and after.attempts == 0
    assert not seen(before, found, 1.35).velocity.any()
    assert not seen(replace(before, known=False), found, 1.1).velocity.any()
    # Slower than 0.1 rad/s and 12 mm/s is standing still; either one is motion.
    for turn, shift, still in ((0.15, 0.018, True), (0.18, 0.0, False), (0.0, 0.022, False)):
        moved = pose(exp(np.array([0, 0, turn * 0.1])), P + [0.1 * shift, 0, 0])
        assert (not seen(slot(), moved, 1.1).velocity.any()) == still


def test_what_an_image_does_not_tell_is_not_taken_for_motion() -> None:
    """A turn known to 0.2 rad, as far as things turn from image to image, counts half."""
    found = pose(exp(np.array([0, 0, 0.1])), P + [0.0, 0.02, 0.0])
    for std, share in ((0.2, 0.5), (1.0, 0.04 / 1.04), (1e-7, 1.0)):
        vague = replace(found, covariance=np.diag([1e-14, 1e-14, std**2, *[1e-14] * 3]))
        np.testing.assert_allclose(seen(slot(), vague, 1.1).velocity, [0, 0, 0.6 * share, 0, 0.12, 0], atol=1e-6)


def test_searches_in_vain_wait_longer_and_longer_up_to_four_periods() -> None:
    waits, now = [], slot()
    for _ in range(12):
        now = postponed(now, 2.0, PARAMS)
        waits.append((now.next_search - 2.0) / PARAMS.search_period)
    assert now.attempts == 12
    np.testing.assert_allclose(waits, [1, 1, 1, 2, 2, 3, 3, 4, 4, 4, 4, 4])


def test_what_goes_out_is_the_pose_found_or_the_last_with_no_quality() -> None:
    found = measurement(slot(), pose(exp(np.array([0, 0, 1.0])), P + 0.1), 2.0)
    np.testing.assert_allclose(found.pose, [np.cos(0.5), 0, 0, np.sin(0.5), *(P + 0.1)])
    assert found.quality == 0.9 and found.time == 2.0
    none = measurement(slot(), None, 2.0)
    np.testing.assert_allclose(none.pose, [1, 0, 0, 0, *P])
    assert none.quality == 0.0
    np.testing.assert_allclose(np.sqrt(np.diag(none.covariance)), [1.0] * 3 + [0.05] * 3)


# Recognition.


class Points:
    """Of a segmented image as much as recognition looks at, but the registration."""

    def __init__(self, sizes: list[int]) -> None:
        self.labels = np.repeat(np.arange(len(sizes)), sizes)
        self.count = len(sizes)
        self.points_W = np.repeat(np.arange(len(sizes), dtype=float)[:, None], 3, axis=1)[self.labels]
        self.colours = np.full((len(self.labels), 3), 0.5)


def recognised(
    monkeypatch: pytest.MonkeyPatch, scores: dict[tuple[str, int], float], sizes: list[int]
) -> dict[int, int]:
    """Which object is which segment, where a search of object by segment scores as given."""

    class Model:
        def __init__(self, name: str) -> None:
            self.name, self.coloured = name, True
            self.hues = hues(np.full((10, 3), 0.5))

    def search(model: Any, frame: Any, points_W: Array, orientations: Any, params: Any, least: float) -> Found | None:
        at = int(points_W[0, 0])
        score = scores.get((model.name, at))
        return None if score is None else Found(pose(p=np.full(3, float(at))), score, score)

    def owned(model: Any, segments: Any, found: Found) -> npt.NDArray[np.int64]:
        return np.flatnonzero(segments.labels == int(found.registration.p[0]))

    monkeypatch.setattr(recognition, "search", search)
    monkeypatch.setattr(recognition, "search_past_tears", lambda model, view, points_W, ways, found: found)
    monkeypatch.setattr(recognition, "turned_about", lambda model, frame, found, points_W, params: found)
    monkeypatch.setattr(recognition, "_owned", owned)
    monkeypatch.setattr(recognition, "hangs", lambda frame, points: False)
    points, names = Points(sizes), sorted({name for name, _ in scores})
    wanted: Any = {k: Model(name) for k, name in enumerate(names)}
    free = np.ones(len(points.labels), dtype=bool)
    found = recognise(wanted, {k: [(np.eye(3), 0.1)] for k in wanted}, points, None, free, PARAMS, 60)  # type: ignore[arg-type]
    return {k: int(one.registration.p[0]) for k, one in found.items()}


def test_an_object_is_the_segment_that_it_fits_best(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recognised(monkeypatch, {("a", 0): 0.7, ("a", 1): 0.95, ("a", 2): 0.65}, [80, 80, 80]) == {0: 1}
    assert recognised(monkeypatch, {("a", 0): 0.65, ("a", 1): 0.7, ("a", 2): 0.62}, [80, 80, 80]) == {0: 1}
    assert recognised(monkeypatch, {("a", 0): 0.59}, [80]) == {}
    assert recognised(monkeypatch, {("a", 0): 0.61}, [80]) == {0: 0}
    assert recognised(monkeypatch, {("a", 0): 0.9}, [59]) == {}
    # What is sure goes first; of two that want one segment, the better has it.
    assert recognised(monkeypatch, {("a", 0): 0.7, ("b", 0): 0.9}, [80]) == {1: 0}
    assert recognised(monkeypatch, {("a", 0): 0.7, ("b", 0): 0.8, ("b", 1): 0.65}, [80, 80]) == {1: 0}


def test_only_dark_colours_have_no_hue() -> None:
    dark, dim = np.full((5, 3), 0.03), np.full((5, 3), 0.04)
    assert hues(dark).sum() == 0.0 and hues(dim).sum() == pytest.approx(1.0)
    share = hues(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.26, 0.26, 0.48]]))
    np.testing.assert_allclose(share[[11 * 12, 11, 3 * 12 + 3]], 1 / 3)


@pytest.mark.parametrize(("part", "least"), [(slice(0, 3), 0.1), (slice(3, 6), 0.012)])
def test_what_images_cannot_tell_from_standing_still_is(part: slice, least: float) -> None:
    """From 1.5 deviations on of what two poses a fifteenth of a second apart tell, three fifths of it new."""
    for deviation in (0.0, 0.02):
        covariance = np.zeros((6, 6))
        for k in range(6)[part]:
            covariance[k, k] = deviation**2
        told = max(least, 1.5 * 0.6 * np.sqrt(2.0 * 3.0) * deviation * 15.0)
        way = np.array([2.0, -1.0, 2.0]) / 3.0
        for share, still in ((0.99, True), (1.01, False)):
            velocity = np.zeros(6)
            velocity[part] = share * told * way
            assert stands_still(velocity, covariance, 1.0 / 15.0) is still


# Look-ups.


def test_colours_derivatives_are_those_of_the_image() -> None:
    v, u = np.mgrid[0:40, 0:60].astype(np.float32)
    image = np.stack([0.01 * u, 0.02 * v, 0.005 * u - 0.01 * v + 0.5], axis=2).astype(np.float32)
    frame = object.__new__(Frame)
    object.__setattr__(frame, "colours", (image, 2 * image))
    object.__setattr__(frame, "corner", (100, 200))
    object.__setattr__(frame, "shift", ALIGNED)
    at_u, at_v = np.array([[110.0, 120.5], [130.25, 115.0]]), np.array([[210.0, 220.5], [215.0, 230.75]])
    for level in (0, 1):
        found, du, dv = colour_at(frame, at_u, at_v, level)
        x, y = at_u - 100, at_v - 200
        expected = (level + 1) * np.stack([0.01 * x, 0.02 * y, 0.005 * x - 0.01 * y + 0.5], axis=2)
        np.testing.assert_allclose(found, expected, atol=1e-3)
        np.testing.assert_allclose(du, (level + 1) * np.broadcast_to([0.01, 0, 0.005], du.shape), atol=1e-5)
        np.testing.assert_allclose(dv, (level + 1) * np.broadcast_to([0, 0.02, -0.01], dv.shape), atol=1e-5)


def test_blur_keeps_to_the_mask() -> None:
    image, mask = np.full((30, 30, 3), 0.8, np.float32), np.zeros((30, 30), np.float32)
    image[:, 15:] = 0.1
    mask[5:25, 5:15] = 1.0
    blurred = blur_within(counted(image, mask), 3)
    np.testing.assert_allclose(blurred[5:25, 5:15], 0.8, atol=1e-5)
    assert blurred[0, 25].max() == 0.0


def test_directions_are_spread_evenly() -> None:
    directions = fibonacci_sphere(160)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.abs(directions.mean(axis=0)).max() < 0.01 and abs(directions[:, 2].mean()) < 1e-12
    anywhere = np.random.default_rng(0).standard_normal((2000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    assert np.degrees(np.arccos((anywhere @ directions.T).max(axis=1).min())) < 12.5
    between = directions @ directions.T - 2 * np.eye(160)
    assert np.degrees(np.arccos(between.max(axis=1))).min() > 10.0


def test_tukey_is_one_in_the_middle_and_nothing_from_the_cut_on() -> None:
    np.testing.assert_allclose(tukey(np.array([0.0, 1.0, 2.0, -2.0, 3.0]), 2.0), [1.0, 0.5625, 0.0, 0.0, 0.0])


def test_a_search_comes_when_its_time_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """An object that is not known is searched at once, then after each wait, upright and otherwise in turn."""
    asked = []

    class View:
        time, labels = 0.0, np.zeros(100, dtype=int)

    def nothing(wanted: Any, orientations: Any, *rest: Any) -> dict[int, Found]:
        asked.append((View.time, dict(orientations)))
        return {}

    monkeypatch.setattr(tracking, "recognise", nothing)
    monkeypatch.setattr(tracking, "search_by_shape", lambda *_: {})
    monkeypatch.setattr(Frame, "of", staticmethod(lambda segments: SimpleNamespace(shift=ALIGNED)))
    known: Any = [tracking.Known(SimpleNamespace(coloured=True), [(np.eye(3), 0.1)], [(np.eye(3), 0.2)])]  # type: ignore[arg-type]
    slots = [Slot()]
    for k in range(40):
        View.time = k * PARAMS.search_period / 4
        slots, found, _ = tracking.step(known, slots, View, PARAMS, 60)  # type: ignore[arg-type]
        assert found[0].quality == 0.0
    periods = [time / PARAMS.search_period for time, _ in asked if _]
    np.testing.assert_allclose(periods, [0, 1, 2, 3, 5, 7], atol=1e-9)
    assert [heights[0][0][1] for _, heights in asked if heights] == [0.1, 0.2, 0.1, 0.2, 0.1, 0.2]
    # Too few points are no object, and no attempt.
    slots, _, _ = tracking.step(known, [Slot()], View, PARAMS, 101)  # type: ignore[arg-type]
    assert slots[0].attempts == 0
