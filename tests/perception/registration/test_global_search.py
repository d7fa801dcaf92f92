"""The search's own rules, with registration replaced by figures that are given."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.registration_bench import TABLE, frame, model, turn, view
from twin_diagram import scenario
from twin_diagram.perception.registration import global_search
from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.global_search import (
    Found,
    best_of,
    explained,
    nearby,
    search,
    starts,
    well_apart,
    with_colours_beside,
)
from twin_diagram.perception.registration.point_kernels import COARSE
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.resting import _down
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segmentation import level

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()


def test_the_smallest_turn_brings_a_normal_down() -> None:
    rng = np.random.default_rng(2131)
    for normal in [*rng.normal(size=(20, 3)), np.array([0, 0, 1.0]), np.array([0, 0, -1.0]), np.array([1.0, 0, 0])]:
        n = normal / np.linalg.norm(normal)
        R = _down(n)
        np.testing.assert_allclose(R @ n, [0.0, 0.0, -1.0], atol=1e-9)
        assert np.trace(R) == pytest.approx(1.0 - 2.0 * n[2])  # by the angle between them, no more
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_starts_stand_on_the_table_with_their_visible_points_about_the_segments_middle() -> None:
    cloud, image, camera = model(), frame(), view()
    rng = np.random.default_rng(2132)
    middle = np.array([0.02, 0.03, 0.05])
    sight = camera.p_WC - middle
    across = np.array([-sight[1], sight[0], 0.0]) / np.hypot(*sight[:2])
    orientations = [(np.eye(3), 0.06), (turn(0.5 * np.pi, 0.0, 0.0), 0.05)]
    for width, count in ((0.12, 48), (0.03, 144)):
        points = middle + rng.uniform(-0.5, 0.5, (4000, 1)) * width * across + rng.normal(0.0, 1e-3, (4000, 3))
        found = starts(cloud, image, points, orientations)
        centre = points.mean(axis=0)
        to_camera = (camera.p_WC - centre) / np.linalg.norm(camera.p_WC - centre)
        side = np.array([-to_camera[1], to_camera[0], 0.0]) / np.hypot(*to_camera[:2])
        along = (points - centre) @ side
        low, high = np.percentile(along, 2.0), np.percentile(along, 98.0)
        wanted: list[tuple[Array, Array, float]] = []
        aside: list[list[tuple[Array, Array, float]]] = [[], []]
        for R_rest, height in orientations:
            for k in range(24):
                R = turn(0.0, 0.0, np.radians(15.0 * k)) @ R_rest
                which = max(range(6), key=lambda d: cloud.directions[d] @ (R.T @ to_camera))
                chosen = cloud.views[which, :110]
                r, n = cloud.points[chosen] @ R.T, cloud.normals[chosen] @ R.T
                facing = np.maximum(n @ to_camera, 0.05)
                p = centre - facing @ r / facing.sum()
                wanted.append((R, p, height))
                slack = np.ptp(r @ side) - (high - low)
                if abs(slack) > 0.015:
                    for rows, sign in zip(aside, (1.0, -1.0), strict=True):
                        rows.append((R, p + ((low + high) / 2.0 + sign * slack / 2.0) * side, height))
        rows = wanted + aside[0] + aside[1]
        # What begins this high above a table in view may lie on something: as many starts are laid there.
        assert len(found.p) == len(rows)
        found = starts(cloud, replace(image, planes=(level(0.0),)), points, orientations)
        low = np.percentile(points[:, 2] - np.column_stack([points[:, :2], np.ones(len(points))]) @ TABLE, 2.0)
        assert low > 0.02 and len(found.p) == 2 * len(rows)
        np.testing.assert_allclose(found.R[len(rows) :], found.R[: len(rows)])
        np.testing.assert_allclose(found.p[len(rows) :], found.p[: len(rows)] + [0.0, 0.0, low])
        found = found[: len(rows)]
        assert len(rows) == count or width == 0.12
        for R, p, (R_wanted, p_wanted, height) in zip(found.R, found.p, rows, strict=True):
            np.testing.assert_allclose(R, R_wanted, atol=1e-9)
            np.testing.assert_allclose(p[:2], p_wanted[:2], atol=1e-9)
            assert p[2] == pytest.approx(TABLE @ [p[0], p[1], 1.0] + height)


def test_what_reaches_down_to_the_table_is_looked_for_on_it_alone() -> None:
    points = np.random.default_rng(2146).uniform(-0.05, 0.05, (4000, 3)) + [0.0, 0.0, 0.06]
    found = starts(model(), frame(), points, [(np.eye(3), 0.06)])
    np.testing.assert_allclose(found.p[:, 2], found.p[:, :2] @ TABLE[:2] + TABLE[2] + 0.06)


def test_what_stands_on_a_lid_that_is_part_of_its_segment_is_looked_for_there() -> None:
    normal = np.array([-TABLE[0], -TABLE[1], 1.0]) / np.linalg.norm([-TABLE[0], -TABLE[1], 1.0])
    lid, top = (Plane(normal, (TABLE[2] + up) * normal[2], 0.01, 0) for up in (0.05, 0.11))
    points = np.random.default_rng(2147).uniform(-0.05, 0.05, (4000, 3)) + [0.0, 0.0, 0.06]
    points[:, 2] += points[:, :2] @ TABLE[:2]
    for planes, wanted in (((lid, top), [0.0, 0.05]), ((top,), [0.0]), ((replace(lid, part=-1),), [0.0])):
        found = starts(model(), replace(frame(), planes=planes), points, [(np.eye(3), 0.06)])
        above = found.p[:, 2] - found.p[:, :2] @ TABLE[:2] - TABLE[2] - 0.06
        np.testing.assert_allclose(np.unique(np.round(above, 2)), wanted, atol=1e-9)


def found_at(p: Any = (0.0, 0.0, 0.0), **changes: Any) -> RegisteredPose:
    good = RegisteredPose(np.eye(3), np.asarray(p, dtype=float), np.eye(6), 0.9, 0.8, 1.0, 300.0)
    return replace(good, **changes)


def test_what_is_explained_lies_within_8_mm_and_half_the_spacing() -> None:
    cloud = model()
    R, p = turn(0.3, 0.2, 0.1), np.array([0.1, 0.2, 0.3])
    points = p + np.random.default_rng(2133).normal(0.0, 0.05, (2000, 3))
    away = np.array([np.linalg.norm(cloud.points @ R.T + p - y, axis=1).min() for y in points])
    wanted = np.mean(away < 0.008 + 0.005)
    assert 0.1 < wanted < 0.9
    assert explained(cloud, points, found_at(p, R=R)) == pytest.approx(wanted)
    assert explained(cloud, points, found_at(p, R=R), 0.02) == pytest.approx(np.mean(away < 0.025))


# Which segments are searched, and from where.


class Spied:
    """What `best_of` was asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[Any] = []
        self.answer: Any = "the best"

        def best(*given: Any) -> Any:
            self.asked[:] = given
            return self.answer

        monkeypatch.setattr(global_search, "best_of", best)


def ring(radius: float, count: int = 900) -> Array:
    turned = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.stack([radius * np.cos(turned), radius * np.sin(turned), 0.02 + 0.0 * turned], axis=1)


def test_a_segment_far_too_large_for_the_object_is_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    spied = Spied(monkeypatch)
    most = 2.0 * model().radius + PARAMS.reach
    orientations = [(np.eye(3), 0.06)]
    assert search(model(), frame(), ring(1.01 * most), orientations, PARAMS) is None and not spied.asked
    assert search(model(), frame(), ring(0.99 * most), [], PARAMS) is None and not spied.asked
    assert search(model(), frame(), ring(0.99 * most), orientations, PARAMS) == "the best"  # type: ignore[comparison-overlap]
    _, _, laid, thin, prior, *_ = spied.asked
    assert 0 < len(laid.p) <= 96 and len(thin) == 225, "about 200 points: every fourth of 900"
    # It rests: what tips by 0.03 rad, turns by 0.15 rad, slides by 4 cm, floats by 3 mm.
    np.testing.assert_allclose(prior**-0.5, [0.03, 0.03, 0.15, 0.04, 0.04, 0.003])
    search(model(), frame(), ring(0.05, 150), orientations, PARAMS)
    assert len(spied.asked[3]) == 150


def test_of_many_starts_those_that_look_best_are_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    spied = Spied(monkeypatch)
    rng = np.random.default_rng(2134)
    count = 150
    laid = Poses(np.tile(np.eye(3), (count, 1, 1)), rng.normal(size=(count, 3)))
    likeness, points = rng.uniform(0.1, 1.0, count), rng.integers(0, 60, count).astype(float)

    def assessed(cloud: Any, image: Any, at: Poses, number: int, level: int, slack: float) -> Any:
        assert number == 110 and level == COARSE and slack == 0.015
        return SimpleNamespace(likeness=likeness, points=points)

    monkeypatch.setattr(global_search, "starts", lambda *_: laid)
    monkeypatch.setattr(global_search, "assess", assessed)
    search(model(), frame(), ring(0.05), [(np.eye(3), 0.06)], PARAMS)
    score = [a * min(b, 20.0) for a, b in zip(likeness, points, strict=True)]
    wanted = sorted(range(count), key=lambda k: -score[k])[:96]
    np.testing.assert_array_equal(spied.asked[2].p, laid.p[wanted])


def test_around_a_rough_pose_starts_lie_where_points_lead_and_3_cm_about(monkeypatch: pytest.MonkeyPatch) -> None:
    spied = Spied(monkeypatch)
    R, p = turn(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3])
    points = ring(0.05)
    led: list[tuple[Array, Array]] = []

    def approached(cloud: Any, image: Array, normals: Array, start: Poses, prior: Array) -> tuple[Poses, Array]:
        led.append((image, normals))
        np.testing.assert_array_equal(start.p[0], p)
        np.testing.assert_allclose(prior**-0.5, [0.3] * 3 + [0.05] * 3)
        return start.moved(np.array([[0.0, 0.0, 0.1, 0.01, 0.0, 0.0]])), np.diag([1e6, 1e6, 1.0, 1e8, 1e8, 1e8])

    monkeypatch.setattr(global_search, "approach", approached)
    asked: list[Any] = []

    def settled(cloud: Any, image: Any, candidates: list[RegisteredPose], points: Array, params: Any) -> Any:
        asked[:] = candidates
        return SimpleNamespace(registration="settled", hypotheses=("a", "b"))

    first, other = found_at((0.1, 0.2, 0.3)), found_at((0.2, 0.2, 0.3))
    spied.answer = Found(first, 0.9, 0.8, others=(other,))
    monkeypatch.setattr(global_search, "settle", settled)
    result = nearby(model(), frame(), R, p, points, 3.0 * points, PARAMS)
    assert result is not None and (result.registration, result.hypotheses) == ("settled", ("a", "b"))
    assert asked[0] is first and asked[1] is other and result.score == 0.9
    np.testing.assert_array_equal(led[0][1], 3.0 * led[0][0])
    _, _, laid, thin, prior, _, sure = spied.asked
    assert sure == 0.95, "slides along a box score high, too"
    assert len(laid.p) == 13 + 9 and len(thin) == 225
    np.testing.assert_allclose(laid.p[0], p + [0.01, 0.0, 0.0])
    np.testing.assert_allclose(laid.R[0], turn(0.0, 0.0, 0.1) @ R, atol=1e-12)
    shifts = {tuple(np.round(one - p, 9) + 0.0) for one in laid.p[13:]}
    assert shifts == {(x, y, 0.0) for x in (-0.03, 0.0, 0.03) for y in (-0.03, 0.0, 0.03)}
    np.testing.assert_array_equal(laid.R[13:], np.repeat(R[None], 9, axis=0))
    np.testing.assert_allclose(prior**-0.5, [0.2] * 3 + [0.03] * 3)


@pytest.mark.parametrize("each", [4.0, 12.0])
def test_colours_count_more_beside_depth_whose_points_err_alike(monkeypatch: pytest.MonkeyPatch, each: float) -> None:
    monkeypatch.setattr(global_search, "votes", lambda *_: each)
    rough = Poses(np.eye(3)[None], np.array([[0.0, 0.0, 0.02]]))
    share = with_colours_beside(model(), frame(), rough, PARAMS).colour_weight
    assert share / (1.0 - share) == pytest.approx(0.3 / 0.7 * each / 4.0)
    aside = replace(frame(), shift=ColourShift.told(2.0))
    assert with_colours_beside(model(), aside, rough, PARAMS) is PARAMS, "what lies aside pulls no harder"


# Which start is the best.


def test_the_first_few_that_differ_by_a_centimetre_or_ten_degrees_are_refined() -> None:
    def apart(shift: float, degrees: float) -> int:
        R = np.stack([np.eye(3), turn(0.0, 0.0, np.radians(degrees))])
        return len(well_apart(Poses(R, np.array([[0.0, 0.0, 0.0], [shift, 0.0, 0.0]])), np.array([0, 1])))

    assert [apart(0.0099, 9.8), apart(0.0101, 0.0), apart(0.0, 10.1)] == [1, 2, 2]
    many = Poses(np.tile(np.eye(3), (9, 1, 1)), np.arange(9.0)[:, None] * [0.1, 0.0, 0.0])
    assert well_apart(many, np.array([8, 3, 5, 1, 0, 2])) == [8, 3, 5, 1], "four at most, in their order"
    near = Poses(np.tile(np.eye(3), (3, 1, 1)), np.array([[0.0, 0, 0], [0.008, 0, 0], [0.016, 0, 0]]))
    assert well_apart(near, np.array([1, 0, 2])) == [1] and well_apart(near, np.array([0, 1, 2])) == [0, 2]


class Judged:
    """A search in which coarse figures and registrations of each start are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, coarse: list[tuple[float, float, float]]) -> None:
        """Likeness, visible share and points of each start."""
        self.registered: list[int] = []
        count = len(coarse)
        self.laid = Poses(np.tile(np.eye(3), (count, 1, 1)), np.arange(count)[:, None] * [0.1, 0.0, 0.0])
        self.results = [found_at((0.1 * k, 0.0, 0.0)) for k in range(count)]
        self.shares = [1.0] * count
        table = np.array(coarse).T
        fit = SimpleNamespace(likeness=table[0], visible_share=table[1], points=table[2])

        def refined(*given: Any, **more: Any) -> Poses:
            assert given[3:5] == (110, 6) and more == {"coarse_only": True}
            return self.laid

        def assessed(cloud: Any, image: Any, at: Poses, number: int, level: int, slack: float) -> Any:
            assert (number, level, slack) == (110, COARSE, 0.005)
            return fit

        def register(cloud: Any, image: Any, R: Array, p: Array, *_: Any, **__: Any) -> RegisteredPose:
            self.registered.append(round(p[0] / 0.1))
            return self.results[self.registered[-1]]

        monkeypatch.setattr(global_search, "refine", refined)
        monkeypatch.setattr(global_search, "assess", assessed)
        monkeypatch.setattr(global_search, "register", register)
        monkeypatch.setattr(global_search, "explained", lambda *_: self.shares[self.registered[-1]])

    def best(self) -> Any:
        return best_of(model(), frame(), self.laid, np.zeros((3, 3)), np.ones(6), PARAMS)


def test_starts_are_tried_in_the_order_of_what_they_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """Likeness, less where under a fifth is visible or fewer than twenty points fit."""
    judged = Judged(monkeypatch, [(0.7, 1.0, 50.0), (0.9, 0.16, 50.0), (0.9, 0.3, 21.0), (0.9, 0.5, 17.0)])
    judged.results = [replace(r, quality=0.5) for r in judged.results]
    judged.best()
    assert judged.registered == [2, 3, 1, 0]  # 0.9, 0.765, 0.72, 0.7


def test_a_start_of_less_than_six_tenths_of_the_best_is_hopeless(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch, [(0.9, 1.0, 50.0), (0.55, 1.0, 50.0), (0.53, 1.0, 50.0)])
    judged.results = [replace(r, quality=0.5) for r in judged.results]
    judged.best()
    assert judged.registered == [0, 1]


@pytest.mark.parametrize(("quality", "tried"), [(0.84, 2), (0.86, 1)])
def test_what_is_sure_ends_the_search(quality: float, tried: int, monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch, [(0.9, 1.0, 50.0), (0.8, 1.0, 50.0)])
    judged.results = [replace(r, quality=quality) for r in judged.results]
    judged.best()
    assert len(judged.registered) == tried


def test_the_score_counts_what_is_visible_and_how_much_of_the_segment_is_explained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for share, visible, points, wanted in (
        (1.0, 1.0, 300.0, 1.0),
        (0.5, 1.0, 300.0, 0.7),
        (0.0, 1.0, 300.0, 0.4),
        (1.0, 0.1, 300.0, 0.5),
        (1.0, 0.21, 61.0, 1.0),
        (1.0, 1.0, 30.0, 0.5),
        (0.5, 0.15, 45.0, 0.7 * 0.75 * 0.75),
    ):
        judged = Judged(monkeypatch, [(0.9, 1.0, 50.0)])
        judged.results = [found_at(visible_share=visible, points=points)]
        judged.shares = [share]
        best = judged.best()
        assert best.score == pytest.approx(0.9 * wanted) and best.likeness == pytest.approx(0.8 * wanted)


def test_the_likeliest_of_those_tried_is_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch, [(0.9, 1.0, 50.0), (0.8, 1.0, 50.0), (0.7, 1.0, 50.0)])
    for k, likeness in enumerate((0.5, 0.7, 0.6)):
        judged.results[k] = replace(judged.results[k], likeness=likeness, quality=0.6)
    assert judged.best().registration is judged.results[1]
