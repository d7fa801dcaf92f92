"""The camera's calibration is found again from a rendered arm and table, and what is found reaches poses and claims."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F

from tests.small_loop import SMALL_IMAGES
from twin_diagram.perception.calibration import calibrate
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.runs.camera_score import true_errors
from twin_diagram.scenario import Camera, Perception
from twin_diagram.scenario.file import load_scenario
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.signals.calibration_error import CALIBRATION_SIZE, SIZE, point_shifts
from twin_diagram.station import ports
from twin_diagram.station.make_station import make_station
from twin_diagram.twin.arm_sensing.camera_calibrator import TUNING, CameraCalibrator, tells_more
from twin_diagram.twin.arm_sensing.known_surfaces import TABLE, ArmParts, ArmView

Array = npt.NDArray[np.float64]
PLACES = np.array([[0.5, 0.0, 0.05], [0.65, 0.3, 0.05], [0.65, -0.3, 0.05], [0.35, 0.1, 0.1]])


def found_again(seed: int) -> tuple[Array, Array, Array, Pinhole]:
    """Errors of a camera, what was found of them in one image of arm and table, its covariance, the camera as told."""
    plan = load_scenario("real_camera", [*SMALL_IMAGES, f"seed={seed}", "twin.camera.centre_std=0.5"])
    plan.world.objects = {}
    assert plan.twin.camera is not None
    station = make_station(plan)
    simulator = Simulator(station)
    simulator.AdvanceTo(0.1)
    image: Any = station.GetOutputPort(ports.depth_image("camera")).Eval(simulator.get_context())
    told, parts, q = Pinhole.from_scenario(plan.twin.camera), ArmParts(plan.twin.arm), np.array(plan.twin.home)
    view = parts.sample(image.data[..., 0], told, 1.0, 0.0, q, np.zeros(7))
    assert (view.parts == TABLE).sum() > 50 and len(np.unique(view.parts)) > 4
    found = calibrate(parts.surfaces([view], 0.0), told, calibration_error(plan.twin.camera))
    return true_errors(plan, told), found.errors, found.covariance, told


@pytest.mark.long
@pytest.mark.usefixtures("egl")
def test_one_image_of_arm_and_table_halves_what_is_shown_aside() -> None:
    scale = []
    for seed in (1, 5):
        errors, found, covariance, told = found_again(seed)
        assert np.linalg.norm(errors[3:6]) == pytest.approx(0.005) and abs(errors[6]) == pytest.approx(0.01)
        J = point_shifts((PLACES - told.p_WC) @ told.R_WC, told.R_WC, told.fx, told.fy)
        left = errors - found
        before, after = (np.linalg.norm(J @ e, axis=1) for e in (errors, left))
        assert after.max() < 0.5 * before.max() and after.mean() < 0.45 * before.mean()
        nees = [float((j @ left) @ np.linalg.solve(j @ covariance @ j.T, j @ left)) / 3.0 for j in J]
        assert np.mean(nees) < 3.0
        scale.append(left[6] / errors[6])
    assert np.sqrt(np.mean(np.square(scale))) < 0.5


def view_of(q: Array) -> ArmView:
    return ArmView(q, np.zeros(2), np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def test_an_image_tells_more_where_the_arm_has_not_been_seen_often() -> None:
    rest, other = np.zeros(2), np.array([0.0, TUNING.turned * 1.01])
    kept = [view_of(rest)] * TUNING.alike
    assert tells_more(kept[:-1], rest) and not tells_more(kept, rest + 0.5 * TUNING.turned)
    assert tells_more(kept, other) and not tells_more([view_of(k * other) for k in range(TUNING.images)], 99.0 * other)


@pytest.fixture(scope="module")
def calibrator() -> CameraCalibrator:
    camera = Camera(width=16, height=12, focal=15.0, rate=10.0, latency=0.02, X_WC_std=[0.005, 0.0087])
    return CameraCalibrator(load_scenario("tabletop").twin.arm, camera, Perception())


def test_an_arm_at_rest_alone_is_looked_at(calibrator: CameraCalibrator) -> None:
    """Blank images tell nothing, but are kept; an arm that moves, an old image and a new Context leave no trace."""
    simulator = Simulator(calibrator)
    context = simulator.get_mutable_context()
    prior = np.array(calibrator.GetOutputPort("calibration").Eval(context))
    assert prior.shape == (CALIBRATION_SIZE,) and not prior[:SIZE].any()
    np.testing.assert_allclose(np.trace(prior[SIZE:].reshape(SIZE, SIZE)[3:6, 3:6]), 0.005**2)
    calibrator.GetInputPort("depth_image").FixValue(context, ImageDepth32F(16, 12))
    counts = []
    q = np.zeros(7)
    for k in range(14):
        if 5 <= k < 10:
            q = q + 0.1  # moving
        calibrator.GetInputPort("image_time").FixValue(context, [0.1 * min(k, 12)])
        calibrator.GetInputPort("arm_state").FixValue(context, np.r_[q, np.zeros(7)])
        simulator.AdvanceTo(0.1 * k + 0.05)
        counts.append(len(calibrator.samples(np.array(context.get_discrete_state(0).value()))))
    assert counts == [1, 2, 3, 4, 5, 5, 5, 5, 5, 5, 6, 7, 8, 8]
    np.testing.assert_allclose(calibrator.GetOutputPort("calibration").Eval(context), prior, atol=1e-15)
    fresh = calibrator.CreateDefaultContext()
    assert calibrator.samples(np.array(fresh.get_discrete_state(0).value())) == []
    assert not calibrator.HasAnyDirectFeedthrough()


def test_parts_move_as_fast_as_their_middles_do(calibrator: CameraCalibrator) -> None:
    parts, rng = calibrator._parts, np.random.default_rng(5)
    q, v, h = rng.uniform(-1.0, 1.0, 7), rng.uniform(-1.0, 1.0, 7), 1e-6
    middles = [middle for middle, _ in parts._balls]
    ends = [
        np.array([R @ middle + p for (R, p), middle in zip(parts.poses(at), middles, strict=True)])
        for at in (q - h * v, q + h * v)
    ]
    wanted = np.linalg.norm(ends[1] - ends[0], axis=1) / (2.0 * h)
    np.testing.assert_allclose(parts.speeds(q, v), wanted, rtol=1e-6, atol=1e-8)
    assert wanted.max() > 0.3


def test_where_encoders_were_off_the_camera_is_found_anew() -> None:
    """Images of an arm that was 20 mrad elsewhere than was thought say that the camera is off; it is not."""
    plan = load_scenario("real_camera").twin
    assert plan.camera is not None
    calibrator = CameraCalibrator(plan.arm, plan.camera, Perception())
    parts, told = calibrator._parts, Pinhole.from_scenario(plan.camera)
    q, off = np.array(plan.home), 0.02 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 0.0])
    points, numbers = [], []
    for k, (R, p) in enumerate(parts.poses(q)):
        own, normals = parts._surfaces[k][1] @ R.T + p, parts._surfaces[k][2] @ R.T
        seen = np.einsum("ni,ni->n", normals, told.p_WC - own) > 0.5 * np.linalg.norm(told.p_WC - own, axis=1)
        points.append(own[seen][:40])
        numbers.append(np.full(len(points[-1]), k))
    u, v, z = told.project(np.concatenate(points))
    pixels = np.column_stack([u, v])
    context = calibrator.CreateDefaultContext()
    kept = np.zeros(1 + TUNING.images * calibrator._row)
    for k in range(3):
        view = ArmView(q + off, np.zeros(7), pixels, z, np.concatenate(numbers))
        kept[1 + k * calibrator._row :][: calibrator._row] = calibrator._packed(view)
    kept[0] = 3
    context.SetDiscreteState(0, kept)
    calibrator.recount(context, np.zeros(7))
    wrong = np.array(calibrator.GetOutputPort("calibration").Eval(context))[:SIZE]
    calibrator.recount(context, -off)
    right = np.array(calibrator.GetOutputPort("calibration").Eval(context))[:SIZE]
    J = point_shifts((PLACES - told.p_WC) @ told.R_WC, told.R_WC, told.fx, told.fy)
    assert np.linalg.norm(J @ wrong, axis=1).max() > 0.003, "it shows things aside by so much, and nobody knows"
    assert np.linalg.norm(J @ right, axis=1).max() < 3e-4
    np.testing.assert_allclose(calibrator.samples(np.array(context.get_discrete_state(0).value()))[2].q, q, atol=1e-12)
