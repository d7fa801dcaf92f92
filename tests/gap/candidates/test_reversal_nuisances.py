"""What every hypothesis may have about a turn: torque that comes earlier or unevenly, of the size of dry friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ELBOW, RATE, swinging
from twin_diagram.gap.candidates.reversal_nuisances import nuisances
from twin_diagram.gap.residuals.regressors import Terms


def turning(count: int, level: float = 2.0) -> tuple[Terms, list[int]]:
    """An elbow that turns so often, at 1 rad/s either way, and has so much dry friction."""
    terms = swinging()
    record = terms.records.records[0]
    v, given = np.array(record.v), np.array(record.given)
    at = [100 * (k + 1) for k in range(count)]
    v[:, ELBOW] = 1.0
    for k in at:
        v[k:, ELBOW] *= -1.0
        v[k : k + 5, ELBOW] = 0.0
        v[k - 5 : k, ELBOW] = 0.0
    given[:, ELBOW] += level
    record = replace(record, v=v)
    records = replace(terms.records, records=(record,))
    return replace(terms, records=records, load=(given,), moved=(record.passed,)), at


def test_shapes_stand_against_the_motion_before_a_turn() -> None:
    terms, at = turning(4)
    (candidate,) = nuisances(terms)
    assert candidate.joints == candidate.rows == (ELBOW,) and candidate.name == ""
    shapes = np.zeros((len(terms.records.records[0].time), 2))
    before = 1.0
    for k in at:
        shapes[k - 5 : k + 5, 0] = -before
        shapes[k - 5 : k, 1], shapes[k : k + 5, 1] = -before, before
        before = -before
    wanted = terms.records.records[0].reduce(shapes)
    np.testing.assert_allclose(candidate.columns[:, 0], wanted, atol=1e-12)
    np.testing.assert_allclose(candidate.spread, [2.0, 2.0])
    assert candidate.allows(np.full(2, 1e9)) and candidate.allows(np.full(2, -1e9))
    assert RATE * 0.08 > 10.0, "turns are brief"


@pytest.mark.parametrize(("turns", "level", "there"), [(3, 2.0, 0), (4, 2.0, 1), (9, 2.0, 1), (9, 0.0, 0)])
def test_joints_that_hardly_turn_or_have_no_dry_friction_need_none(turns: int, level: float, there: int) -> None:
    assert len(nuisances(turning(turns, level)[0])) == there
