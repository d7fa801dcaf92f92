"""The course of registration with steps that are given: scales, reach, cuts, ends; and what belongs to an object."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from tests.registration_bench import frame, model, poses, turn
from twin_diagram import scenario
from twin_diagram.perception.registration import registration
from twin_diagram.perception.registration.data_association import COARSE, FINE, Poses
from twin_diagram.perception.registration.registration import claimed, information, refine, register
from twin_diagram.perception.registration.residuals import Normal

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration(reach=0.02, iterations=12)
FREE = np.zeros(6)
"""A prior that holds nothing."""


class Course:
    """Steps (turn [rad], shift [m]) that the image asks for, one after the other; what was asked of it meanwhile."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, steps: list[tuple[float, float]]) -> None:
        self.steps = steps
        self.asked: list[tuple[int, float]] = []
        self.pulls: list[tuple[float, float]] = []
        monkeypatch.setattr(registration, "look", lambda *given: given)
        none = Normal(np.zeros((1, 6, 6)), np.zeros((1, 6)))
        monkeypatch.setattr(registration, "inward", lambda *given: none)
        monkeypatch.setattr(registration, "linearise", self.linearise)
        monkeypatch.setattr(registration, "unexplained", self.unexplained)

    def linearise(self, looked: Any, image: Any, level: int, reach: float, share: float) -> tuple[Normal, Array]:
        assert share == PARAMS.colour_weight and looked[4] == level
        turned, shifted = self.steps[min(len(self.asked), len(self.steps) - 1)]
        self.asked.append((level, round(reach, 9)))
        step = np.array([[0.0, 0.0, turned, shifted, 0.0, 0.0]])
        return Normal(np.eye(6)[None], step), np.zeros((1, 1))

    def unexplained(self, cloud: Any, points: Array, at: Poses, p_WC: Array, reach: float, share: float) -> Normal:
        self.pulls.append((round(reach, 9), share))
        return Normal(np.eye(6)[None], np.array([[0.0, 0.0, 0.0, 0.0, 0.003, 0.0]]))

    def run(self, count: int = 12, prior: Array = FREE, **more: Any) -> tuple[Poses, Normal]:
        start = Poses(np.eye(3)[None], np.zeros((1, 3)))
        return refine(model(), frame(), start, 10, count, prior, PARAMS, **more)


WIDE = (0.2, 0.02)
REACHES = [0.02, 0.012, 0.0072, 0.007, 0.007]
"""At each fine step three fifths of the one before, but no less than 7 mm."""


def test_colours_are_coarse_for_four_steps_and_the_reach_then_shrinks(monkeypatch: pytest.MonkeyPatch) -> None:
    course = Course(monkeypatch, [WIDE])
    course.run()
    wanted = [(COARSE, 0.02)] * 4 + [(FINE, reach) for reach in REACHES] + [(FINE, 0.007)] * 3
    assert course.asked == wanted


@pytest.mark.parametrize(
    ("step", "fine"), [((0.029, 0.0039), True), ((0.031, 0.0), False), ((0.0, 0.0041), False), ((0.0, 0.0), True)]
)
def test_small_steps_end_the_coarse_ones_sooner(
    step: tuple[float, float], fine: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(monkeypatch, [step, WIDE])
    course.run(2)
    assert course.asked[1][0] == (FINE if fine else COARSE)


@pytest.mark.parametrize(
    ("step", "reach"), [((0.0099, 0.0019), 0.007), ((0.011, 0.0), 0.02), ((0.0, 0.0021), 0.02), ((0.0, 0.0), 0.007)]
)
def test_a_prediction_that_was_right_needs_no_wide_reach(
    step: tuple[float, float], reach: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(monkeypatch, [step, WIDE])
    course.run(2)
    assert course.asked == [(COARSE, 0.02), (FINE, reach)]


@pytest.mark.parametrize(
    ("step", "ends"), [((0.9e-3, 1.9e-4), True), ((1.1e-3, 0.0), False), ((0.0, 2.1e-4), False), ((0.0, 0.0), True)]
)
def test_a_step_that_is_lost_in_the_noise_is_the_last(
    step: tuple[float, float], ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(monkeypatch, [(0.0, 0.0), step, WIDE])
    course.run(3)
    assert len(course.asked) == (2 if ends else 3)
    # Not while the reach is wide.
    course = Course(monkeypatch, [WIDE, WIDE, WIDE, WIDE, step])
    course.run(12)
    assert len(course.asked) == (8 if ends else 12)


def test_steps_are_cut_at_what_the_look_ups_know(monkeypatch: pytest.MonkeyPatch) -> None:
    for step, share in (((0.6, 0.0), 0.5), ((0.29, 0.029), 1.0), ((0.1, 0.06), 0.5), ((0.6, 0.12), 0.25)):
        at, _ = Course(monkeypatch, [step]).run(1)
        np.testing.assert_allclose(at.p[0], [share * step[1], 0.0, 0.0], atol=1e-12)
        turned = Rotation.from_matrix(at.R[0]).as_rotvec()
        np.testing.assert_allclose(turned, [0.0, 0.0, share * step[0]], atol=1e-12)


def test_many_starts_stay_coarse_and_wide_where_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    course = Course(monkeypatch, [(0.0, 0.0)])
    course.run(6, coarse_only=True)
    assert course.asked == [(COARSE, 0.02)] * 6


def test_a_prior_holds_and_points_pull(monkeypatch: pytest.MonkeyPatch) -> None:
    at, data = Course(monkeypatch, [(0.0, 0.02)]).run(1, np.full(6, 3.0))
    np.testing.assert_allclose(at.p[0], [0.02 / 4.0, 0.0, 0.0])
    np.testing.assert_allclose(data.H[0], np.eye(6))
    course = Course(monkeypatch, [(0.0, 0.02)])
    at, data = course.run(1, points_W=np.zeros((5, 3)))
    np.testing.assert_allclose(at.p[0], [0.01, 0.0015, 0.0])
    np.testing.assert_allclose(data.H[0], 2.0 * np.eye(6))
    # A tenth of the pull is point-to-point.
    assert course.pulls == [(0.02, 0.1)]
    course = Course(monkeypatch, [(0.0, 0.02)])
    course.run(1, points_W=np.zeros((0, 3)))
    assert course.pulls == []


def test_information_is_the_inverse_variance() -> None:
    np.testing.assert_allclose(information(0.5, 0.1), [4.0, 4.0, 4.0, 100.0, 100.0, 100.0])


def test_a_registration_begins_where_it_is_told_and_says_what_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    at = poses()[np.array([2])]
    H = np.diag(np.arange(1.0, 7.0)) * 1e4

    def refined(*given: Any, **more: Any) -> tuple[Poses, Normal]:
        asked[:] = [*given, more["points_W"]]
        return at, Normal(H[None], np.zeros((1, 6)))

    fit = SimpleNamespace(quality=[1.3], likeness=[0.7], visible_share=[0.4], points=[55.0], shape=[1.4])
    monkeypatch.setattr(registration, "refine", refined)
    monkeypatch.setattr(registration, "judge", lambda *given: fit)
    monkeypatch.setattr(registration, "residual_excess", lambda *given: 3.0)
    claims: list[Any] = []
    monkeypatch.setattr(registration, "claim", lambda *given: claims.append(given) or (H, None))
    R, p = turn(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3])
    found = register(model(), frame(), R, p, PARAMS)
    np.testing.assert_array_equal(asked[2].R[0], R)
    np.testing.assert_array_equal(asked[2].p[0], p)
    np.testing.assert_allclose(asked[5], information(0.3, 0.05))
    assert asked[3:5] == [PARAMS.model_points, 12] and asked[7] is None
    assert (found.quality, found.likeness, found.visible_share, found.points) == (1.0, 0.7, 0.4, 55.0)
    assert found.shape == 1.0
    np.testing.assert_array_equal(found.covariance, H)
    # At the pose found, within the last reach, with colours; residuals are three times what the data sheet says.
    assert claims[0][3] is at and claims[0][4:] == (None, 0.007, 0.3, 3.0)
    np.testing.assert_array_equal(found.p, at.p[0])
    register(model(), frame(), R, p, PARAMS, prior=np.ones(6), points_W=np.zeros((2, 3)))
    np.testing.assert_array_equal(asked[5], np.ones(6))
    assert asked[7].shape == (2, 3)


def test_an_objects_own_points_are_those_near_its_surface() -> None:
    cloud = model()
    R, p = turn(0.3, -0.4, 0.5), np.array([0.2, -0.1, 0.3])
    rng = np.random.default_rng(2122)
    points = p + rng.normal(0.0, 0.05, (900, 3))
    segments: Any = SimpleNamespace(points_W=points)
    for reach in (0.012, 0.03):
        away = np.array([np.linalg.norm(cloud.points @ R.T + p - y, axis=1).min() for y in points])
        np.testing.assert_array_equal(claimed(cloud, segments, R, p, reach), np.flatnonzero(away < reach))
    # Of many, those within the ball are thinned out before.
    ball = np.flatnonzero(np.linalg.norm(points - p, axis=1) < cloud.radius + 0.012)
    away = np.array([np.linalg.norm(cloud.points @ R.T + p - y, axis=1).min() for y in points])
    for most in (50, 10_000):
        some = ball[:: max(1, len(ball) // most)]
        np.testing.assert_array_equal(claimed(cloud, segments, R, p, 0.012, most), some[away[some] < 0.012])
    nowhere: Any = SimpleNamespace(points_W=points + 9.0)
    assert claimed(cloud, nowhere, R, p, 0.012).size == 0
    # The ball is as large as the object and the reach.
    lone: Any = replace(cloud, radius=0.05, tree=_Everything())
    edge: Any = SimpleNamespace(points_W=p + np.array([[0.0619, 0.0, 0.0], [0.0, 0.0621, 0.0]]))
    assert claimed(lone, edge, R, p, 0.012).tolist() == [0]


class _Everything:
    """A search tree to which all is near."""

    def query(self, points: Array, **_: Any) -> tuple[Array, Array]:
        return np.zeros(len(points)), np.zeros(len(points), dtype=int)
