"""What is believed of an object that frames do not show."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.perception.registration.alternatives import PoseHypothesis, each_once, share_of_first
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.settling import SettledPose
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.runs.tracking.individual import Individual, expected
from twin_diagram.scene import object_filter, object_update
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, PoseMeasurement

SETTINGS = object_filter.FilterSettings.of(scenario.SceneUpdater())
FRAME = 1 / 15


def _turn(angle: float) -> Array:
    return rotations.exp(np.array([0.0, 0.0, angle]))


def _watched(angles: list[float], deviation: float) -> tuple[Array, Slot]:
    """Return the filter and the slot of an object at the origin that frames showed turned by angles about z."""
    filter_ = object_filter.initial_filters(1)[0]
    covariance = np.diag([1e-4, 1e-4, deviation**2, 1e-6, 1e-6, 1e-6])
    slot = Slot()
    for k, angle in enumerate(angles):
        pose = np.concatenate([_turn(angle), np.zeros(3)])
        filter_ = object_update.update(filter_, PoseMeasurement(1.0, k * FRAME, pose, covariance), k * FRAME, SETTINGS)
        slot = Slot(True, rotations.matrix(_turn(angle)[None])[0], np.zeros(3), seen=k * FRAME)
    return filter_, slot


def _asked(filter_: Array, slot: Slot, now: float) -> tuple[Array, Array]:
    belief = object_filter.propagate(filter_[None], now, SETTINGS)
    shown = expected(slot, filter_, belief.poses[0], belief.covariances[0, :6, :6], now)
    return shown.R, shown.p


def test_what_rests_is_where_its_images_average() -> None:
    filter_, slot = _watched([0.02, -0.02] * 10, 0.02)
    R, _ = _asked(filter_, slot, 21 * FRAME)
    assert abs(rotations.log(rotations.from_matrix(R))[2]) < 0.01


def test_the_first_pose_that_images_took_back_does_not_return_when_nothing_is_seen() -> None:
    """Claimed to 0.6 rad, a pose 1.7 rad off is within the filter's gate, which goes on with the mean of both."""
    filter_, slot = _watched([1.7] * 6 + [0.0] * 3, 0.6)
    belief = object_filter.propagate(filter_[None], 10 * FRAME, SETTINGS).poses[0]
    assert abs(rotations.log(belief[:4])[2]) > 0.6
    R, _ = _asked(filter_, slot, 10 * FRAME)
    assert abs(rotations.log(rotations.from_matrix(R))[2]) < 1e-9


@pytest.mark.parametrize("fits", [0.6, 0.77, 0.85, 0.9, 1.0])
def test_what_is_hidden_is_believed_as_it_was_when_it_was_seen(fits: float) -> None:
    """What fitted badly was believed three times as much a frame later, for being hidden."""
    one = Individual(0, 0, object_filter.initial_filters(1)[0])
    seen = one.believed(True, fits, 1.0, FRAME)
    hidden = one.believed(False, 0.0, 0.0, 1e-9)
    assert hidden == pytest.approx(seen, rel=1e-6)


@pytest.mark.long
def test_what_moves_goes_on_for_a_while_only() -> None:
    filter_, _ = _watched([0.0], 0.02)
    filter_[object_filter.FilterLayout.MODE] = object_filter.Mode.MOVING
    slot = Slot(True, np.eye(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0]), seen=0.0)
    assert _asked(filter_, slot, 0.2)[1][0] == pytest.approx(0.1)
    assert _asked(filter_, slot, 5.0)[1][0] == pytest.approx(0.15)


def test_where_another_camera_showed_it_to_go_it_is() -> None:
    filter_, _ = _watched([0.0], 0.02)
    slot = Slot(True, np.eye(3), np.array([0.3, 0.0, 0.0]), np.full(6, 0.5), seen=NEVER)
    assert _asked(filter_, slot, 1.0)[1] == pytest.approx([0.3, 0.0, 0.0])


def test_what_was_carried_is_doubted_sooner_and_forgotten() -> None:
    def after(aloft: bool, shape: float, whole: float, frames: int) -> float:
        one = Individual(0, 0, object_filter.initial_filters(1)[0])
        one.believed(True, 0.98, 1.0, FRAME)
        return [one.believed(False, shape, whole, FRAME, aloft) for _ in range(frames)][-1]

    assert after(True, 0.5, 0.8, 1) < 0.5 < after(False, 0.5, 0.8, 1)
    assert after(True, 0.0, 0.0, 15) < 0.75 < 0.95 < after(False, 0.0, 0.0, 15)


def test_what_was_on_its_way_is_not_where_it_was_expected_for_long() -> None:
    """A can that left the picture at 1 m/s was told 0.1 to 0.5 m behind itself, as likely as not for seconds."""

    def after(fits: float, speed: float, frames: int) -> float:
        one = Individual(0, 0, object_filter.initial_filters(1)[0])
        one.believed(True, fits, 1.0, FRAME)
        return [one.believed(False, 0.0, 0.0, FRAME, True, speed) for _ in range(frames)][-1]

    assert after(0.86, 0.6, 1) < 0.5 < after(0.86, 0.0, 1)
    assert after(1.0, 0.6, 1) > 0.5 > after(1.0, 0.6, 2)
    assert after(1.0, 0.05, 3) > 0.5
    assert after(1.0, 0.05, 15) < 0.2 < 0.5 < after(1.0, 0.0, 15)


def test_a_rival_that_a_frame_tells_of_too_counts_once() -> None:
    half = rotations.matrix(_turn(np.pi))
    one = RegisteredPose(np.eye(3), np.zeros(3), np.eye(6), 1.0, 1.0, 1.0, 100.0)
    first, other = (PoseHypothesis(R, np.zeros(3), np.eye(6), share) for R, share in ((np.eye(3), 0.8), (half, 0.2)))
    individual = Individual(0, 0, object_filter.initial_filters(1)[0], rivals=((half, np.zeros(3), 1.0),))
    told = individual.with_rivals(SettledPose(one, (first, other), False), 0.7)
    assert [h.probability for h in told] == pytest.approx([0.7, 0.3])
    assert share_of_first(told, ()) == pytest.approx(0.7)
    assert share_of_first(told, ((2, 2),)) == pytest.approx(1.0)


def test_turns_of_a_round_thing_are_one_pose() -> None:
    """A bowl was told with thirty hypotheses, of which 26 were turns about its axis: the pose itself had 0.01."""
    shares = [0.1, 0.3, 0.2, 0.25, 0.15]
    poses = [(0.0, 0.0), (1.0, 0.0), (2.5, 0.001), (0.7, 0.02), (-2.0, 0.021)]
    hypotheses = [
        PoseHypothesis(rotations.matrix(_turn(angle)), np.array([shift, 0.0, 0.0]), np.eye(6), share)
        for (angle, shift), share in zip(poses, shares, strict=True)
    ]
    told = each_once(hypotheses, ((2, 0),))
    assert [one.probability for one in told] == pytest.approx([0.6, 0.4])
    assert told[0].R is hypotheses[0].R and told[1].p is hypotheses[3].p
    assert [one.probability for one in each_once(hypotheses, ())] == shares
    assert each_once((), ()) == ()
