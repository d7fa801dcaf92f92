"""What views' poses may do together is told, and how far told poses are off is taken from how far they were moved."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.assets.building.poses_together import all_together

VIEWS = 12
PRIOR = np.repeat([0.0035, 0.003], 3) ** -2.0


def told(off: float, sure: float = 1e-5) -> tuple[np.ndarray, np.ndarray]:
    """Covariance where views tell each other's shifts to `sure` [m], but not a step of all; poses are `off` priors off.

    Also the step that none tells: all views by as much, along their own third axis.
    """
    rng = np.random.default_rng(3)
    away = np.tile([0.0, 0, 0, 0, 0, 1.0], VIEWS) / np.sqrt(VIEWS)
    seen = (np.eye(6 * VIEWS) - np.outer(away, away)) / sure**2
    moves = off * rng.standard_normal(6 * VIEWS) * np.tile(PRIOR**-0.5, VIEWS)
    moves -= away * (away @ moves)  # what nothing tells, no step takes away
    return all_together(seen, PRIOR, moves.reshape(VIEWS, 6)), away


@pytest.mark.parametrize("off", [0.1, 1.0, 2.0])
def test_a_step_of_all_is_known_as_well_as_poses_were_told(off: float) -> None:
    covariance, away = told(off)
    assert np.sqrt(away @ covariance @ away) == pytest.approx(off * 0.003, rel=0.2)
    aside = np.zeros(6 * VIEWS)
    aside[[5, 11]] = np.sqrt(0.5), -np.sqrt(0.5)  # one view's against another's, which pictures tell
    assert np.sqrt(aside @ covariance @ aside) == pytest.approx(1e-5, rel=0.05)


def test_what_views_tell_nothing_of_is_as_it_was_told() -> None:
    n = 6 * VIEWS
    covariance = all_together(np.zeros((n, n)), PRIOR, np.zeros((VIEWS, 6)))
    np.testing.assert_allclose(np.diag(covariance), np.tile(1.0 / PRIOR, VIEWS))


def test_a_scale_of_depth_is_left_out_and_taken_into_account() -> None:
    prior = np.append(PRIOR, 0.05**-2.0)
    seen = np.zeros((14, 14))
    seen[5, 5] = seen[6, 6] = seen[5, 6] = 1e12  # a shift along the ray passes for a scale
    seen[6, 5] = seen[5, 6]
    covariance = all_together(seen, prior, np.zeros((2, 7)))
    assert covariance.shape == (12, 12)
    assert np.sqrt(covariance[5, 5]) == pytest.approx(0.003, rel=0.02)
    assert np.sqrt(covariance[11, 11]) == pytest.approx(0.003)
