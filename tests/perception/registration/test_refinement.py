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
from tests.registration_kernels import inward, linearise, unexplained
from twin_diagram import scenario
from twin_diagram.perception.registration import refinement_kernels, registration
from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.registration import claimed, information, refine, register
from twin_diagram.perception.registration.silhouette import Silhouette

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration(reach=0.02, iterations=12)
KERNELS = SimpleNamespace(
    **{name: getattr(refinement_kernels, name).py_func for name in ("refine_poses", "refine_one")}
)
"""The loops as they are written, uncompiled: what they call can be put in their place."""
FREE = np.zeros(6)
"""A prior that holds nothing."""


class Course:
    """Steps (turn [rad], shift [m]) that the image asks for, one after the other; what was asked of it meanwhile."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, steps: list[tuple[float, float]], information: float = 1e9
    ) -> None:
        self.steps, self.information = steps, information
        self.asked: list[tuple[int, float]] = []
        self.explained: list[int] = []
        monkeypatch.setattr(refinement_kernels, "normal_equations", self.normal_equations)
        monkeypatch.setattr(registration, "refine_poses", KERNELS.refine_poses)
        monkeypatch.setattr(refinement_kernels, "refine_one", KERNELS.refine_one)

    def normal_equations(self, R: Array, p: Array, *given: Any) -> None:
        _, _, _, points_W, rules, (level, reach), _, (H, b) = given
        assert rules.terms.colour_factor == PARAMS.colour_weight / (1.0 - PARAMS.colour_weight) / 0.05**2
        # A tenth of the pull of points is point-to-point.
        assert rules.pairs == (0.1, 2.0 * 0.0007, model().spacing)
        turned, shifted = self.steps[min(len(self.asked), len(self.steps) - 1)]
        self.asked.append((level, round(reach, 9)))
        self.explained.append(len(points_W))
        H[0], b[0] = self.information * np.eye(6), [0.0, 0.0, turned, shifted, 0.0, 0.0]
        b *= self.information

    def run(self, count: int = 12, prior: Array = FREE, **more: Any) -> Poses:
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


@pytest.mark.parametrize(("gain", "ends"), [(0.14, True), (0.16, False)])
def test_a_step_that_makes_the_pose_hardly_likelier_is_the_last(
    gain: float, ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    information = 2.0 * gain / 0.002**2
    course = Course(monkeypatch, [(0.0, 0.0), (0.0, 0.002), WIDE], information)
    course.run(3)
    assert len(course.asked) == (2 if ends else 3)
    # Not while the reach is wide.
    course = Course(monkeypatch, [WIDE, WIDE, WIDE, WIDE, (0.0, 0.002)], information)
    course.run(12)
    assert len(course.asked) == (8 if ends else 12)


@pytest.mark.parametrize(
    ("step", "was"), [((0.029, 0.0039), True), ((0.031, 0.0), False), ((0.0, 0.0041), False), ((0.0, 0.0), True)]
)
def test_a_start_that_is_right_needs_no_wide_reach(
    step: tuple[float, float], was: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = Course(monkeypatch, [step]).run(1, right=True)
    np.testing.assert_allclose(at.p[0], [step[1] if was else 0.0, 0.0, 0.0], atol=1e-12)
    course = Course(monkeypatch, [step, WIDE])
    course.run(3, right=True)
    assert course.asked == [(COARSE, 0.007), *([(FINE, 0.007)] * 2 if was else [(COARSE, 0.02)] * 2)]


def test_steps_are_cut_at_what_the_look_ups_know(monkeypatch: pytest.MonkeyPatch) -> None:
    for step, share in (((0.6, 0.0), 0.5), ((0.29, 0.029), 1.0), ((0.1, 0.06), 0.5), ((0.6, 0.12), 0.25)):
        at = Course(monkeypatch, [step]).run(1)
        np.testing.assert_allclose(at.p[0], [share * step[1], 0.0, 0.0], atol=1e-12)
        turned = Rotation.from_matrix(at.R[0]).as_rotvec()
        np.testing.assert_allclose(turned, [0.0, 0.0, share * step[0]], atol=1e-12)


def test_many_starts_stay_coarse_and_wide_where_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    course = Course(monkeypatch, [(0.0, 0.0)])
    course.run(6, coarse_only=True)
    assert course.asked == [(COARSE, 0.02)] * 6


def test_a_prior_holds_and_points_are_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Course(monkeypatch, [(0.0, 0.02)], 1.0).run(1, np.full(6, 3.0))
    np.testing.assert_allclose(at.p[0], [0.02 / 4.0, 0.0, 0.0])
    for points in (5, 0):
        course = Course(monkeypatch, [(0.0, 0.02)])
        course.run(1, points_W=np.zeros((points, 3)))
        assert course.explained == [points]


@pytest.mark.parametrize("aside", [0.0, 1.5])
@pytest.mark.parametrize("some", [True, False])
def test_a_step_solves_the_sum_of_all_terms(aside: float, some: bool) -> None:
    """Depth, colours whatever their shift, what sticks out, points that pull, and the prior."""
    image, cloud = replace(frame(), shift=ColourShift.told(aside), colour_slopes=(1e-4, 2e-5)), model()
    at, held = poses(), np.array([9.0, 8.0, 7.0, 600.0, 500.0, 400.0])
    points = at.p[0] + 0.06 * np.random.default_rng(5).normal(size=(30, 3)) if some else None
    found = refine(cloud, image, at, 40, 1, held, PARAMS, points_W=points)
    for k in range(len(at.p)):
        own = at[np.array([k])]
        looked = look(cloud, image, own, 40, COARSE)
        data, _ = linearise(looked, image, COARSE, PARAMS.reach, PARAMS.colour_weight)
        drawn = inward(Silhouette.of(cloud, image, at), looked, image.camera)
        H, b = data.H[0] + drawn.H[0] + np.diag(held), data.b[0] + drawn.b[0]
        if points is not None:
            pulled = unexplained(cloud, points, own, image.camera.p_WC, PARAMS.reach, 0.1)
            H, b = H + pulled.H[0], b + pulled.b[0]
        step = np.linalg.solve(H, b)
        share = min(1.0, 0.3 / np.linalg.norm(step[:3]), 0.03 / np.linalg.norm(step[3:]))
        wanted = own.moved(share * step[None])
        np.testing.assert_allclose(found.R[k], wanted.R[0], atol=1e-9)
        np.testing.assert_allclose(found.p[k], wanted.p[0], atol=1e-9)


def test_a_prior_pulls_back_to_where_it_began() -> None:
    at = poses()
    nothing = replace(frame(), depth=np.zeros_like(frame().depth))
    found = refine(model(), nothing, at, 40, 3, np.full(6, 2.0), PARAMS)
    np.testing.assert_allclose(found.R, at.R, atol=1e-12)
    R, p = turn(0.2, -0.1, 0.3) @ at.R[0], at.p[0] + [0.01, -0.02, 0.03]
    H, b = np.zeros((6, 6)), np.zeros(6)
    held = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    refinement_kernels.add_prior(R, p, (at.R[0], at.p[0]), held, H, b)
    np.testing.assert_allclose(H, np.diag(held))
    back = np.linalg.solve(H, b)
    np.testing.assert_allclose(Rotation.from_rotvec(back[:3]).as_matrix() @ R, at.R[0], atol=1e-9)
    np.testing.assert_allclose(p + back[3:], at.p[0], atol=1e-12)


def test_information_is_the_inverse_variance() -> None:
    np.testing.assert_allclose(information(0.5, 0.1), [4.0, 4.0, 4.0, 100.0, 100.0, 100.0])


def test_a_registration_begins_where_it_is_told_and_says_what_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    at = poses()[np.array([2])]
    H = np.diag(np.arange(1.0, 7.0)) * 1e4

    def refined(*given: Any, **more: Any) -> Poses:
        asked[:] = [*given, more["points_W"]]
        return at

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
    segments: Any = SimpleNamespace(points=points)
    for reach in (0.012, 0.03):
        away = np.array([np.linalg.norm(cloud.points @ R.T + p - y, axis=1).min() for y in points])
        np.testing.assert_array_equal(claimed(cloud, segments, R, p, reach), np.flatnonzero(away < reach))
    # Of many, those within the ball are thinned out before.
    ball = np.flatnonzero(np.linalg.norm(points - p, axis=1) < cloud.radius + 0.012)
    away = np.array([np.linalg.norm(cloud.points @ R.T + p - y, axis=1).min() for y in points])
    for most in (50, 10_000):
        some = ball[:: max(1, len(ball) // most)]
        np.testing.assert_array_equal(claimed(cloud, segments, R, p, 0.012, most), some[away[some] < 0.012])
    nowhere: Any = SimpleNamespace(points=points + 9.0)
    assert claimed(cloud, nowhere, R, p, 0.012).size == 0
    # The ball is as large as the object and the reach.
    edge: Any = SimpleNamespace(points=p + np.array([[0.0619, 0.0, 0.0], [0.0, 0.0621, 0.0]]))
    lone: Any = replace(cloud, radius=0.05, points=np.array([[0.0, 0.06, 0.0], [0.06, 0.0, 0.0]]))
    assert claimed(lone, edge, np.eye(3), p, 0.012).tolist() == [0]
