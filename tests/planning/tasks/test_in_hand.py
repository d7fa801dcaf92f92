"""Where a thing lies in the hand: what slips is found again by as much, and what does not slip does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.planning.tasks.carried import DOWN, EXACT, PERIOD, SHEET, Carry
from twin_diagram.planning.tasks.in_hand import TUNING, HeldImage, InHand, after_image, closed_on
from twin_diagram.planning.tasks.slips import TUNING as SLIPS
from twin_diagram.planning.tasks.slips import slipped, told_of
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import pose_shifts
from twin_diagram.signals.pose_vectors import compose, errors

QUIET = Carry(noise=(0.002, 0.0002), waves=(0.001, 0.0001), late=0.0, camera=EXACT)
"""Seen by a camera that is where it is said to be, with little noise."""
DOWNWARD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.01)
"""A slip of 10 mm along the fingers."""
SWING = (0.0, 0.2, 0.0, 0.006, 0.0, 0.004)
"""A swing of 11° about the axis along which the fingers close."""


@pytest.mark.parametrize("slip", [DOWNWARD, SWING])
def test_a_slip_is_found_again_by_as_much(slip: tuple[float, ...]) -> None:
    carry = replace(QUIET, slip=slip)
    known, told = carry.watched()
    moved, _ = known.change
    np.testing.assert_allclose(moved[:3], slip[:3], atol=0.004)
    np.testing.assert_allclose(moved[3:], slip[3:], atol=0.0006)
    off, angle = errors(carry.lies(3.0), known.X_TO)
    assert off < 0.0006 and angle < 0.004
    assert len(told) == known.slips == 1, "once per slip"
    assert told[0][0] == pytest.approx(np.linalg.norm(slip[:3]), abs=0.006)
    assert told[0][1] == pytest.approx(np.linalg.norm(slip[3:]), abs=0.001)


def test_before_a_real_camera_at_full_speed_it_is_found_by_millimetres() -> None:
    off, told = [], 0
    for seed in range(12):
        carry = Carry(seed=seed, slip=DOWNWARD)
        known, ones = carry.watched()
        off.append(known.X_TO[4:] - carry.lies(3.0)[4:])
        told += len(ones) == 1 and abs(ones[0][1] - 0.01) < 0.005
    assert told >= 11, "a slip of 10 mm is told in most carries"
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 0.0035 and np.abs(off).max() < 0.01


def test_nothing_slips_because_depth_is_late_and_the_camera_is_off() -> None:
    """Half a frame late at 0.5 m/s is 17 mm; a camera turned by half a degree shifts what goes 0.6 m by 5 mm."""
    squares = []
    for seed in range(20):
        known, told = Carry(seed=seed, camera=SHEET).watched()
        assert not told and known.slips == 0, seed
        moved, covariance = known.change
        squares.append(moved @ np.linalg.solve(covariance, moved))
    assert np.mean(squares) < 9.0, "what is told of its uncertainty is no less than it is: 6 would be just so"


def test_the_errors_of_the_camera_are_told_from_a_slip() -> None:
    with_: list[float] = []
    without: list[float] = []
    for seed in range(6):
        carry = replace(QUIET, seed=seed, camera=SHEET)
        for told_of_camera, into in ((True, with_), (False, without)):
            into.append(float(np.linalg.norm(carry.watched(told_of_camera)[0].change[0][3:])))
    assert np.mean(with_) < 0.5 * np.mean(without), (np.mean(with_), np.mean(without))


def _at_rest(known: InHand, k: int, by: Array, sure: float = 1e-6, symmetric: bool = False) -> InHand:
    """Return what is known after the k-th image of a hand at rest that shows the thing aside `by` (6)."""
    X_WT, X_TO = Carry().tool(0.0), known.closed
    aside = np.array([*rotations.multiply(rotations.exp(by[:3]), X_TO[:4]), *(X_TO[4:] + by[3:])])
    shown = HeldImage(k * PERIOD, compose(X_WT, aside), sure * np.eye(6), X_WT, np.zeros(6))
    return after_image(known, shown, None, symmetric)


def _held() -> InHand:
    return closed_on(np.array([*DOWN, 0.0, 0.0, 0.02]), 1e-6 * np.eye(6), Carry().tool(0.0), None, 0.0)


def test_one_odd_image_is_no_slip_and_three_are() -> None:
    odd = np.array([0.0, 0.0, 0.0, 0.03, 0.0, 0.0])
    known = _held()
    for k in range(1, 9):
        known = _at_rest(known, k, np.zeros(6))
    before = known.X_TO
    once = _at_rest(known, 9, odd)
    np.testing.assert_array_equal(once.X_TO, before)
    for k in range(10, 12):
        once = _at_rest(once, k, odd)
    assert errors(once.X_TO, before)[0] == pytest.approx(0.03, abs=0.002)
    back = _at_rest(known, 9, odd)
    for k in range(10, 16):
        back = _at_rest(back, k, np.zeros(6))
    assert errors(back.X_TO, before)[0] < 0.001


def test_an_image_counts_once() -> None:
    known = _at_rest(_held(), 3, np.array([0.0, 0.0, 0.0, 0.001, 0.0, 0.0]))
    assert _at_rest(known, 3, np.zeros(6)) is known and _at_rest(known, 2, np.zeros(6)) is known


def test_what_looks_the_same_all_around_has_not_turned() -> None:
    about_z = rotations.matrix(DOWN) @ np.array([0.0, 0.0, 1.0]) * 0.6
    known = other = _held()
    for k in range(1, 12):
        known = _at_rest(known, k, np.concatenate([about_z, np.zeros(3)]), symmetric=True)
        other = _at_rest(other, k, np.concatenate([about_z, np.zeros(3)]))
    assert errors(known.X_TO, known.closed)[1] < 1e-6 < 0.5 < errors(other.X_TO, other.closed)[1]


def test_creep_below_a_slip_is_followed_and_not_told() -> None:
    known, told = _held(), []
    for k in range(1, 60):
        known = _at_rest(known, k, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.001 * k * PERIOD]), sure=1e-7)
        known, one = slipped(known)
        told += [one] if one else []
    assert known.change[0][5] == pytest.approx(0.0039, abs=0.0006) and not told


def test_what_slips_twice_is_told_twice_and_the_sum_is_kept() -> None:
    known, told, by = _held(), [], np.zeros(6)
    for k in range(1, 60):
        by[5] = 0.008 * ((k > 20) + (k > 40))
        known = _at_rest(known, k, by)
        known, one = slipped(known)
        told += [one] if one else []
    assert [entry[1] for entry in told] == pytest.approx([0.008, 0.008], abs=0.001)
    said = told_of(known)
    assert said["slips"] == 2 and said["moved_mm"] == pytest.approx(16.0, abs=1.0)
    assert 0.0 < said["moved_mm_std"] < 1.0 and said["turned_deg"] < 0.2


def test_a_long_slip_is_told_before_its_end() -> None:
    known, told = _held(), 0
    for k in range(1, 40):
        known = _at_rest(known, k, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.003 * k]))
        known, one = slipped(known)
        told += one is not None
    assert 2 <= told <= 40 / SLIPS.longest_slip + 1


def test_fingers_tell_where_the_middle_is() -> None:
    wide = np.diag([1e-4] * 3 + [1e-4, 1e-4, 1e-4])
    known = closed_on(np.array([*DOWN, 0.0, 0.0, 0.02]), wide, Carry().tool(0.0), None, 0.0)
    sd = np.sqrt(np.diagonal(known.pose_covariance)[3:])
    assert sd[1] == pytest.approx(TUNING.centred, rel=0.01) and sd[[0, 2]].min() > 0.01


def test_it_is_a_vector_and_back() -> None:
    known, _ = replace(QUIET, slip=DOWNWARD).watched()
    np.testing.assert_array_equal(InHand.unpack(known.pack()).pack(), known.pack())
    for name, value in vars(known).items():
        np.testing.assert_array_equal(getattr(InHand.unpack(known.pack()), name), value)


def test_a_calibration_that_is_told_better_meanwhile_is_no_move_in_the_hand() -> None:
    """What is taken out of the images from then on was in where it was told to lie at closing."""
    X_WT, X_TO, better = Carry().tool(0.0), np.array([*DOWN, 0.0, 0.0, 0.02]), np.zeros(10)
    better[3:6] = 0.004
    eye = replace(Carry().eye(), covariance=1e-8 * np.eye(10))
    known = closed_on(X_TO, 1e-6 * np.eye(6), X_WT, eye, 0.0)
    (shift,) = pose_shifts(((compose(X_WT, X_TO)[4:] - eye.p_WC) @ eye.R_WC)[None], eye.R_WC, *eye.focal)
    X_WO = compose(X_WT, X_TO) - np.concatenate([np.zeros(4), (shift @ better)[3:]])
    for k in range(1, 12):
        shown = HeldImage(k * PERIOD, X_WO, 1e-6 * np.eye(6), X_WT, np.zeros(6))
        known = after_image(known, shown, replace(eye, errors=better))
    assert np.linalg.norm((shift @ better)[3:]) > 0.004
    np.testing.assert_allclose(known.change[0], 0.0, atol=2e-5)


def test_what_lies_within_its_doubt_is_no_slip() -> None:
    for sigma, slips in ((0.0015, False), (0.0003, True)):
        known, told = _held(), 0
        for _ in range(11):
            mean, P = known.mean.copy(), known.covariance.copy()
            mean[11], P[6:12, 6:12] = 0.0055, sigma**2 * np.eye(6)  # 5.5 mm: more than a slip's least
            known, one = slipped(replace(known, mean=mean, covariance=P, before=mean[6:12]))
            told += one is not None
        assert bool(told) == slips


def test_what_a_turning_hand_holds_beside_its_axis_lies_where_it_did() -> None:
    """Shown 30 ms late at 1.5 rad/s, 0.15 m beside the axis: 7 mm and 2.6° behind, and it has not moved in the hand."""

    def tool(time: float) -> Array:
        return np.array([*rotations.multiply(rotations.exp(np.array([0.0, 0.0, 1.5 * time])), DOWN), 0.5, 0.0, 0.2])

    X_TO, turning = np.array([*DOWN, 0.15, 0.0, 0.02]), np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    known = closed_on(X_TO, 1e-6 * np.eye(6), tool(0.0), None, 0.0)
    for k in range(1, 5):
        late = compose(tool(k * PERIOD - 0.03), X_TO)
        known = after_image(known, HeldImage(k * PERIOD, late, 1e-6 * np.eye(6), tool(k * PERIOD), turning), None)
    off, angle = errors(known.X_TO, X_TO)
    assert off < 0.001 and angle < 0.02
