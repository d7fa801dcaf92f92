"""Several cameras' measurements of one object become one, which claims what it may."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.perception.several_views.fusion import SeenBy, fuse
from twin_diagram.signals import rotations
from twin_diagram.signals.layouts import NEVER, PoseMeasurement

Array = npt.NDArray[np.float64]
RNG = np.random.default_rng(5)


def seen(
    step: list[float] | Array = (0.0,) * 6,
    noise: float = 1e-3,
    rest: float = 0.0,
    quality: float = 0.9,
    time: float = 1.0,
    velocity: list[float] | None = None,
    odds: float = 3.0,
    period: float = 1.0 / 15.0,
) -> SeenBy:
    """An object at `step` (turn, shift) from a place; `noise` and `rest` are standard deviations."""
    step = np.asarray(step, dtype=float)
    pose = np.concatenate([rotations.exp(step[:3]), [0.5, 0.1, 0.05] + step[3:]])
    measured = PoseMeasurement(quality, time, pose, noise**2 * np.eye(6))
    speed = np.zeros(6) if velocity is None else np.array(velocity)
    return SeenBy(measured, rest**2 * np.eye(6), speed, odds, period)


def place(fused: object) -> Array:
    return np.asarray(fused.measured.pose[4:]) - [0.5, 0.1, 0.05]  # type: ignore[attr-defined]


def test_one_that_finds_it_is_passed_on_as_it_is() -> None:
    one, blind = seen(rest=2e-3), seen(quality=0.0)
    fused = fuse([blind, one])
    assert fused.measured is one.measured and fused.rest is one.rest
    np.testing.assert_array_equal(fused.weights, [np.zeros((6, 6)), np.eye(6)])


def test_poses_are_weighted_by_noise_and_calibration_together() -> None:
    fused = fuse([seen([0, 0, 0, 4e-3, 0, 0], noise=1e-3, rest=0.0), seen(noise=1e-3, rest=np.sqrt(2.0) * 1e-3)])
    np.testing.assert_allclose(place(fused), [3e-3, 0, 0], atol=1e-12)  # variances of 1 and 3
    assert fused.rest is not None
    np.testing.assert_allclose(fused.rest[0, 0], 2e-6 / 16, rtol=1e-6)
    np.testing.assert_allclose(fused.measured.covariance[0, 0], (9 + 1) / 16 * 1e-6, rtol=1e-6)
    np.testing.assert_allclose(fused.weights.sum(axis=0), np.eye(6), atol=1e-12)


def test_each_direction_is_told_by_who_sees_it_best() -> None:
    """Two cameras at right angles, each a tenth as sure along its line of sight."""
    first, second = seen([0, 0, 0, 5e-3, 0, 0]), seen([0, 0, 0, 0, 5e-3, 0])
    first.measured.covariance[3, 3], second.measured.covariance[4, 4] = 1e-4, 1e-4
    assert np.abs(place(fuse([first, second]))).max() < 1e-4


def test_noise_and_calibrations_pass_on_as_a_cameras_share_in_the_pose_does() -> None:
    """That share is what a small step of one camera's pose makes of the fused one."""
    noises, rests = (
        [A @ A.T + 1e-8 * np.eye(6) for A in RNG.standard_normal((2, 6, 6)) * size] for size in (5e-4, 1e-3)
    )

    def fused_at(which: int, step: Array) -> tuple[Array, Array, Array]:
        cameras = [seen(step if v == which else np.zeros(6)) for v in range(2)]
        told = [PoseMeasurement(0.9, 1.0, one.measured.pose, noises[v]) for v, one in enumerate(cameras)]
        fused = fuse([SeenBy(one, rests[v], np.zeros(6), 3.0, 1.0 / 15.0) for v, one in enumerate(told)])
        assert fused.rest is not None
        turn = 2.0 * fused.measured.pose[1:4] * np.sign(fused.measured.pose[0])
        return np.concatenate([turn, place(fused)]), fused.measured.covariance, fused.rest

    shares = [np.stack([fused_at(v, 1e-5 * axis)[0] / 1e-5 for axis in np.eye(6)], axis=1) for v in range(2)]
    _, covariance, rest = fused_at(0, np.zeros(6))
    for claimed, own in ((covariance, noises), (rest, rests)):
        wanted = sum(W @ part @ W.T for W, part in zip(shares, own, strict=True))
        np.testing.assert_allclose(claimed, wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max())


def test_the_claim_holds_over_many_draws() -> None:
    """Squared errors over the claimed covariance, noise and rest together: χ² of 6."""
    squares = []
    for _ in range(400):
        cameras = []
        for _ in range(2):
            A, B = (RNG.standard_normal((6, 6)) * s for s in (5e-4, 1e-3))
            noise, rest = A @ A.T + 1e-8 * np.eye(6), B @ B.T + 1e-8 * np.eye(6)
            one = seen(RNG.multivariate_normal(np.zeros(6), noise + rest))
            cameras.append(
                SeenBy(PoseMeasurement(0.9, 1.0, one.measured.pose, noise), rest, np.zeros(6), 3.0, 1.0 / 15.0)
            )
        fused = fuse(cameras)
        assert fused.rest is not None
        off = np.concatenate([rotations.difference(fused.measured.pose[:4], rotations.exp(np.zeros(3))), place(fused)])
        squares.append(off @ np.linalg.solve(fused.measured.covariance + fused.rest, off))
    assert 5.4 < np.mean(squares) < 6.6


def test_what_cannot_be_seen_is_no_evidence_and_what_is_seen_empty_is() -> None:
    hidden, empty = seen(quality=0.0, time=1.02), seen(quality=-0.8, time=1.0)
    fused = fuse([hidden, empty])
    assert fused.measured.quality == -0.8 and fused.measured.time == 1.0  # of that image, to be counted once
    assert fuse([hidden, seen(quality=0.9)]).measured.quality == 0.9
    assert fuse([empty, seen(quality=0.9)]).measured.quality == 0.9
    assert fuse([hidden, seen(quality=0.0)]).measured.quality == 0.0
    assert fuse([seen(quality=0.0, time=NEVER)] * 2).measured.time == NEVER


def test_a_camera_that_fell_silent_counts_no_more() -> None:
    silent, goes_on = seen([0, 0, 0, 0.01, 0, 0], time=1.0), seen(time=1.4)
    assert fuse([silent, goes_on]).measured is goes_on.measured
    assert fuse([seen(quality=-0.9, time=1.0), seen(quality=0.0, time=1.4)]).measured.quality == 0.0


def test_what_moves_is_where_the_newest_image_shows_it() -> None:
    before = seen(time=0.97, velocity=[0, 0, 0, 0.2, 0, 0])
    newest = seen([0, 0, 0, 6e-3, 0, 0], time=1.0, velocity=[0, 0, 0, 0.2, 0, 0])
    assert fuse([before, newest]).measured is newest.measured


@pytest.mark.parametrize("step", [[0, 0, 0, 0.06, 0, 0], [0, 0, 3.0, 0, 0, 0]])
def test_of_two_that_contradict_each_other_one_is_believed(step: list[float]) -> None:
    sure, wrong = seen(noise=5e-4, odds=4.0), seen(step, odds=0.5)
    for both in ([sure, wrong], [wrong, sure]):
        assert fuse(both).measured is sure.measured


def test_a_round_thing_is_not_turned_by_being_seen_from_two_sides() -> None:
    fused = fuse([seen(), seen([0, 0, 2.5, 2e-3, 0, 0])], symmetric_about_z=True)
    np.testing.assert_allclose(place(fused), [1e-3, 0, 0], atol=1e-9)
    assert rotations.difference(fused.measured.pose[:4], np.array([1.0, 0, 0, 0])) == pytest.approx(np.zeros(3))


def test_what_is_farther_apart_than_claimed_is_claimed_less() -> None:
    near = fuse([seen(noise=1e-3, rest=1e-3), seen([0, 0, 0, 1e-3, 0, 0], noise=1e-3, rest=1e-3)])
    far = fuse([seen(noise=1e-3, rest=1e-3), seen([0, 0, 0, 0.03, 0, 0], noise=1e-3, rest=1e-3)])
    assert near.rest is not None and far.rest is not None
    assert np.trace(far.rest) > 5.0 * np.trace(near.rest)


def test_cameras_told_to_be_exact_that_lie_apart_claim_less_too() -> None:
    """Two poses 20 mm apart, each told to a millimetre: their mean is 10 mm off one of them."""
    fused = fuse([seen(noise=1e-3), seen([0, 0, 0, 0.02, 0, 0], noise=1e-3)])
    assert fused.rest is not None
    np.testing.assert_allclose(fused.measured.covariance, 0.5e-6 * np.eye(6))  # images alone are no noisier
    wide = 0.02**2 / (2.0 * 1e-6) / 22.458  # χ² of 6 stays below that with a probability of 0.999
    np.testing.assert_allclose(fused.measured.covariance + fused.rest, wide * 0.5e-6 * np.eye(6), rtol=1e-4)


@pytest.mark.parametrize("cameras", [2, 3, 6])
def test_honest_cameras_are_hardly_ever_farther_apart_than_claimed_however_many(cameras: int) -> None:
    rng, grown = np.random.default_rng(11), 0
    for _ in range(500):
        steps = np.hypot(1e-3, 1e-3) * rng.standard_normal((cameras, 6))
        fused = fuse([seen(step, noise=1e-3, rest=1e-3) for step in steps])
        assert fused.rest is not None
        grown += bool(fused.rest[3, 3] > 1.001e-6 / cameras)
    assert grown <= 4  # of 500, each with a probability of 0.001: more than four in one of 6,000


def test_pictures_in_turn_are_not_counted_twice() -> None:
    together = fuse([seen(), seen()])
    in_turn = fuse([seen(), seen(time=0.97)])
    np.testing.assert_allclose(in_turn.measured.covariance, 2.0 * together.measured.covariance)


def test_what_turns_in_place_is_as_the_newest_image_shows_it() -> None:
    """At 1 rad/s its side, a decimetre from its middle, goes 4 mm in 40 ms."""
    before = seen(time=0.96, velocity=[0, 0, 1.0, 0, 0, 0])
    after = seen([0, 0, 0.04, 0, 0, 0], time=1.0, velocity=[0, 0, 1.0, 0, 0, 0])
    np.testing.assert_array_equal(fuse([before, after]).weights, [np.zeros((6, 6)), np.eye(6)])


@pytest.mark.parametrize(("periods", "counts"), [(1.5, True), (1.7, False)])
def test_an_image_that_comes_late_is_waited_for(periods: float, counts: bool) -> None:
    fused = fuse([seen(time=1.0 - periods / 15.0), seen()])
    assert bool(fused.weights[0].any()) == counts
