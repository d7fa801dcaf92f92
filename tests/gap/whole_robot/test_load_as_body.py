"""A load is no point, and a last link that may be anything tells where it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.gap.made import ARM, effect, everywhere, record, swing
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.load_as_body import as_a_body, loose
from twin_diagram.gap.whole_robot.loads import loaded
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import OWN, equations
from twin_diagram.gap.whole_robot.unusual import terms_of, with_candidate
from twin_diagram.model.effects import Effect
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

MASS, COM, MOMENT = 2.0, (0.0, 0.0, 0.12), 0.012
WRIST = 5


def quiet(*added: Effect) -> tuple[RobotProblem, Array]:
    """An arm with friction on all joints and something more, its torques' noise 5 mN·m, everything usual free."""
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0), *added])
    log = noisy(ARM, true, 12.0)
    (made,) = log.records
    exact = true.inverse_dynamics(made.q, made.v, made.a, time=made.time)
    records = Records(ARM, (replace(made, torque=exact + 0.05 * (made.torque - exact)),))
    return settled(begun(records, equations(records)))


def load(own: float) -> list[Effect]:
    mass = effect("payload", links=["tool0"], mass=MASS, com=list(COM))
    if not own:
        return [mass]
    moments = [own, own, own, 0.0, 0.0, 0.0]
    solid = effect("inertial_parameters", links=["wrist_3_link"], mass=0.0, com=[0.0, 0.0, 0.0], inertia=moments)
    return [mass, solid]


def test_a_load_on_the_last_axis_is_told_with_its_moment_of_inertia() -> None:
    """As a point it was moved off the axis, and made lighter: 0.37 ± 0.17 kg of 2.2."""
    whole, start = quiet(*load(MOMENT))
    body = as_a_body(whole, start, terms_of(whole.sums, ARM))
    assert body is not None and body.variant == "solid"
    beside = with_candidate(replace(whole, spread=0.06), body, WRIST)
    fitted = solve(beside)
    told = fitted[beside.place(0)]
    assert told[0] == np.clip(told[0], 0.93 * MASS, 1.07 * MASS)
    np.testing.assert_allclose(told[1:4] / told[0], COM, atol=0.01)
    np.testing.assert_allclose(told[4], MOMENT, rtol=0.1)
    found = loaded(whole, start)
    assert found is not None and found.sums.further[-1].variant == "solid"


def test_a_point_stays_one_and_nothing_is_found_of_nothing() -> None:
    whole, start = quiet(*load(0.0))
    point = as_a_body(whole, start, terms_of(whole.sums, ARM))
    assert point is not None and point.variant == ""
    _, own = loose(replace(whole, spread=0.06), start, WRIST)
    assert own[0] > 0.5 * MASS
    plain, start = quiet()
    assert loaded(plain, start) is None


def gantry(folder: Path) -> Model:
    """Three rails; the last one is upright."""
    rails = (("x", "1 0 0", 55.0), ("y", "0 1 0", 22.0), ("z", "0 0 1", 9.0))
    text, parent = '<robot name="gantry"><link name="base"/>', "base"
    for name, axis, mass in rails:
        text += (
            f'<link name="{name}_link"><inertial><origin xyz="0 0 -0.1"/><mass value="{mass}"/>'
            '<inertia ixx="0.5" iyy="0.4" izz="0.6" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="3" effort="3000"/></joint>'
        )
        parent = f"{name}_link"
    (folder / "gantry.urdf").write_text(text + "</robot>")
    return Model.load(folder / "gantry.urdf")


def test_a_load_on_an_upright_rail_is_no_offset(tmp_path: Path) -> None:
    """An offset of −58.9 N and rotors that are 6 kg too heavy were said of 6 kg in a gantry's hand."""
    given = gantry(tmp_path)
    rails = [
        effect("payload", links=["z_link"], mass=6.0, com=[0.0, 0.0, -0.4]),
        effect("reflected_inertia", joints=given.joints, inertia=[30.0, 15.0, 12.0]),
        effect("viscous_friction", joints=given.joints, damping=[20.0] * 3),
    ]
    true = given.with_effects(rails)
    time, q, v, a = (x if x.ndim == 1 else x[:, :3] for x in swing(16.0))
    made = record(given, time, q, v, a)
    torque = true.inverse_dynamics(q, v, a, time=time) + 0.3 * np.random.default_rng(3).normal(size=q.shape)
    records = Records(given, (replace(made, torque=torque),))
    whole, start = settled(begun(records, equations(records)))
    found = loaded(whole, start)
    assert found is not None
    z = solve(found)
    assert z[found.place(0)][0] == pytest.approx(6.0, abs=0.3)
    assert abs(z[10 * 3 + 4 * 2 + OWN.index("bias")]) < 3.0
