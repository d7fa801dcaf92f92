"""Torques measured behind the gears: no rotor of the arm's own shows in them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.made import ARM, everywhere, record, swing, terms_of
from twin_diagram.errors import ModelError
from twin_diagram.gap.naming import all_candidates
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.explain import begun
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel

BEHIND = Model.load(ArmModel(model="arms/ur5e.urdf", tool_frame=""), torque_side="link")
IIWA = ArmModel(model="arms/iiwa7.urdf", tool_frame="")


def test_the_descriptions_rotors_are_left_out() -> None:
    motor, link = (Model.load(IIWA, torque_side=side) for side in ("motor", "link"))
    assert np.all(motor.tree.rotor > 0.0)
    np.testing.assert_array_equal(link.tree.rotor, 0.0)
    q, v, a = np.full((1, 7), 0.3), np.full((1, 7), 0.2), np.arange(7.0)[None]
    apart = motor.inverse_dynamics(q, v, a) - link.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(apart, motor.tree.rotor * a, atol=1e-9)
    np.testing.assert_array_equal(link.with_effects(()).tree.rotor, 0.0)


def test_a_side_that_is_none_is_refused() -> None:
    with pytest.raises(ModelError, match="torque side 'wrist': it is one of motor, link"):
        Model.load(ArmModel(model="arms/ur5e.urdf"), torque_side="wrist")


def test_no_rotor_is_a_candidate_behind_the_gears() -> None:
    for model, there in ((ARM, True), (BEHIND, False)):
        records = problem_records(model)
        problem = begun(records, equations(records))
        assert np.all(problem.own_free[:, :3]) and np.all(problem.own_free[:, 3] == there)
        names = {candidate.name for candidate in all_candidates(terms_of(records))}
        assert ("reflected_inertia" in names) == there
        assert "viscous_friction" in names


def problem_records(model: Model) -> Records:
    return Records(model, (record(model, *swing(3.0)),))


def test_what_effects_add_stays() -> None:
    added = BEHIND.with_effects([everywhere("reflected_inertia", inertia=0.5)])
    np.testing.assert_allclose(added.tree.rotor, 0.5)
