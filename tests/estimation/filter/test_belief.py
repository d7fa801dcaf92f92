"""A belief as one vector: its views, the state carried on, and what of it others see."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.filter.belief import Belief, Entry, SensorTrack
from twin_diagram.signals.layouts import NEVER


def test_views_fill_the_vector_and_do_not_overlap() -> None:
    n, p, own, sensors = 2, 3, 4, (6, 2)
    belief = Belief(n, p, own, sensors)
    N = 3 * n + p + own
    views = [belief.header, belief.torque, belief.drift, belief.regime, belief.innovation, belief.before]
    views += [belief.acceleration, belief.noise, belief.troubled, belief.steady, belief.told, belief.model]
    views += [belief.gradient, belief.freed, belief.score, belief.q, belief.v, belief.disturbance, belief.theta]
    views += [belief.own, belief.P, *belief.tracks, *belief.levels]
    shapes = [(23,), *[(n,)] * 6, (3, n), (3, 2 * n), (n,), (n,), (p,), (p,), (p,), (p, p + 1), *[(n,)] * 3, (p,)]
    shapes += [(own,), (N, N), (12 + 6,), (12 + 2,), (6,), (2,)]
    assert [view.shape for view in views] == shapes
    assert len(belief.vector) == sum(view.size for view in views) and belief.size == N
    for k, view in enumerate(views):
        view[...] = k + 1.0
    assert [int(np.sum(belief.vector == k + 1.0)) for k in range(len(views))] == [view.size for view in views]
    np.testing.assert_array_equal(
        belief.x, np.concatenate([belief.q, belief.v, belief.disturbance, belief.theta, belief.own])
    )


def test_nothing_is_known_at_first() -> None:
    belief = Belief(2, 1, 0, (3,))
    assert belief.time == NEVER and belief.header[Entry.HEARD] == NEVER and not belief.valid
    assert belief.tracks[0][SensorTrack.LAST] == NEVER and belief.tracks[0][SensorTrack.NIS_MEAN] == 1.0
    np.testing.assert_array_equal(belief.state_at(99.0), np.zeros(4))
    belief.header[Entry.TIME] = 0.0
    assert belief.valid


def test_a_state_is_carried_on_by_20_ms_at_most_and_never_back() -> None:
    belief = Belief(1, 0)
    belief.x[:2], belief.acceleration[:], belief.header[Entry.TIME] = [0.3, 2.0], 50.0, 1.0
    for t, ahead in ((0.9, 0.0), (1.0, 0.0), (1.01, 0.01), (1.0199, 0.0199), (1.02, 0.02), (3.0, 0.02)):
        expected = [0.3 + 2.0 * ahead + 25.0 * ahead**2, 2.0 + 50.0 * ahead]
        np.testing.assert_allclose(belief.state_at(t), expected, rtol=1e-12)


def test_others_see_state_and_parameters() -> None:
    belief = Belief(2, 3, 1)
    belief.P[:] = np.arange(100.0).reshape(10, 10)
    seen = [0, 1, 2, 3, 6, 7, 8]
    np.testing.assert_array_equal(belief.outside_covariance(), [[10.0 * i + j for j in seen] for i in seen])


@pytest.mark.parametrize(
    ("value", "sound"), [(9.9, True), (-9.9, True), (10.0, False), (-11.0, False), (np.nan, False)]
)
def test_a_sound_belief_is_finite_and_no_state_is_larger_than_that(value: float, sound: bool) -> None:
    belief = Belief(1, 1)
    belief.x[3] = value
    assert belief.sound(10.0) == sound
    belief.x[3], belief.P[0, 0] = 0.0, value
    assert belief.sound(10.0) == np.isfinite(value)
