"""Each effect's law against the formula of its docstring, on joints of an arm that has no others."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.errors import ModelError
from twin_diagram.model import effects
from twin_diagram.model.effects.actuation import ActuatorFault, TorqueConstant
from twin_diagram.model.effects.elasticity import YieldingGear
from twin_diagram.model.effects.friction import CoulombFriction, smooth_sign
from twin_diagram.model.effects.inertia import point_mass, point_mass_jacobian
from twin_diagram.model.effects.link_inertia import about_centre, about_origin, spatial_inertia
from twin_diagram.model.effects.parameter import Parameter, ParameterKind
from twin_diagram.model.effects.parameter_vector import vector, with_values, with_vector
from twin_diagram.model.effects.stated import stated_effects
from twin_diagram.model.effects.timing import ALWAYS, Interval, at, in_run, settled, told
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.scenario import EffectSpec

JOINTS = ("a", "b", "c")
ARM: Any = SimpleNamespace(joints=JOINTS)
RNG = np.random.default_rng(0)
Q, V, A, TAU = RNG.standard_normal((4, 50, 3))


def made(name: str, joints: list[str], **parameters: list[float]) -> Any:
    return effects.make(EffectSpec(name, joints, [], parameters))


def torque(effect: Any, tau: np.ndarray = TAU) -> np.ndarray:
    return np.asarray(effect.torque(ARM, Q, V, A, tau))


def test_a_smooth_sign_has_three_quarters_at_five_milliradians_per_second() -> None:
    np.testing.assert_allclose(smooth_sign(np.array([0.005, -0.005])), [0.7616, -0.7616], atol=1e-4)
    np.testing.assert_allclose(smooth_sign(np.array([-1.0, 0.0, 1.0])), [-1, 0, 1])


def test_friction_against_its_formulas() -> None:
    sign = np.sign(V[:, 1:]) * np.tanh(np.abs(V[:, 1:]) / 0.005)
    np.testing.assert_allclose(torque(made("viscous_friction", ["c", "b"], damping=[2.0, 3.0])), V * [0, 3, 2])
    one = made("coulomb_friction", ["b", "c"], torque=[2.0, 0.5])
    np.testing.assert_allclose(torque(one)[:, 1:], [2.0, 0.5] * sign)
    assert not torque(one)[:, 0].any()
    two = made("coulomb_friction", ["b", "c"], torque_positive=[2.0, 1.0], torque_negative=[0.5, 3.0])
    np.testing.assert_allclose(torque(two)[:, 1:], np.where(V[:, 1:] > 0, [2.0, 1.0], [0.5, 3.0]) * sign)
    forward, backward = two.friction_level(ARM, Q, V, TAU)
    np.testing.assert_allclose(forward, np.tile([0, 2.0, 1.0], (50, 1)))
    np.testing.assert_allclose(backward, np.tile([0, 0.5, 3.0], (50, 1)))
    stribeck = made(
        "stribeck_friction", ["b", "c"], coulomb=[1.0, 2.0], static=[3.0, 1.0], stribeck_velocity=[0.5, 0.9]
    )
    level = np.array([1.0, 2.0]) + [2.0, -1.0] * np.exp(-((V[:, 1:] / [0.5, 0.9]) ** 2))
    np.testing.assert_allclose(torque(stribeck)[:, 1:], level * sign)
    for bound in stribeck.friction_level(ARM, Q, V, TAU):
        np.testing.assert_allclose(bound[:, 1:], level)
        assert not bound[:, 0].any()
    loaded = made("load_dependent_friction", ["b", "c"], coefficient=[0.2, 0.5])
    np.testing.assert_allclose(torque(loaded)[:, 1:], [0.2, 0.5] * np.abs(TAU[:, 1:]) * sign)
    # A motor gives T ± c |T| where T is passed on.
    forward, backward = loaded.friction_level(ARM, Q, V, TAU)
    for k, c in ((1, 0.2), (2, 0.5)):
        for row in range(50):
            for friction, direction in ((forward[row, k], 1.0), (backward[row, k], -1.0)):
                passed = TAU[row, k] - direction * friction
                assert friction == pytest.approx(c * abs(passed))


def test_friction_that_is_even_is_the_same_whatever_the_motion() -> None:
    """What goes by `Effect.even` works it out once."""
    figures: dict[str, dict[str, list[float]]] = {
        "coulomb_friction": {"torque": [2.0]},
        "stribeck_friction": {"coulomb": [1.0], "static": [3.0], "stribeck_velocity": [0.5]},
        "load_dependent_friction": {"coefficient": [0.2]},
    }
    for name, parameters in figures.items():
        effect = made(name, ["b"], **parameters)
        bounds = effect.friction_level(ARM, Q, V, TAU)
        assert effect.even == all(np.ptp(bound, axis=0).max() == 0.0 for bound in bounds), name


def test_coupled_friction_is_on_the_sum_of_speeds() -> None:
    effect = made("coupled_friction", ["a", "c"], damping=[2.0], torque=[3.0])
    total = V[:, 0] + V[:, 2]
    expected = 2.0 * total + 3.0 * np.tanh(total / 0.005)
    np.testing.assert_allclose(torque(effect), np.stack([expected, 0 * expected, expected], axis=1))
    np.testing.assert_allclose(effect.dry_torque(ARM, V)[:, 2], 3.0 * np.tanh(total / 0.005))
    np.testing.assert_array_equal(effect.direction(ARM), [1, 0, 1])
    for joints in (["a"], []):
        with pytest.raises(ModelError, match="two or more"):
            made("coupled_friction", joints, torque=[1.0])


def test_what_becomes_of_the_logged_torque() -> None:
    gain = made("torque_constant", ["c", "a"], gain=[0.5, 2.0])
    np.testing.assert_allclose(gain.applied(JOINTS, TAU), TAU * [2.0, 1.0, 0.5])
    np.testing.assert_allclose(gain.logged(JOINTS, TAU), TAU / [2.0, 1.0, 0.5])
    dead = made("actuator_fault", ["b"], gain=[0.0])
    np.testing.assert_allclose(dead.logged(JOINTS, TAU)[:, 1], TAU[:, 1] * 100)
    weak = made("actuator_fault", ["b"], gain=[0.011])
    np.testing.assert_allclose(weak.logged(JOINTS, TAU)[:, 1], TAU[:, 1] / 0.011)
    for value, loses in ((0.199, True), (0.201, False)):
        assert made("actuator_fault", ["b", "c"], gain=[1.0, value]).loses == loses
        assert not made("torque_constant", ["b"], gain=[value]).loses
    assert ActuatorFault.kinds["gain"].upper == 1.0 and not TorqueConstant.kinds["gain"].lower > 0.01
    bias = made("torque_bias", ["b"], torque=[0.7])
    np.testing.assert_allclose(bias.applied(JOINTS, TAU) - TAU, np.tile([0, 0.7, 0], (50, 1)))
    np.testing.assert_allclose(bias.logged(JOINTS, bias.applied(JOINTS, TAU)), TAU)
    bound = made("torque_saturation", ["b"], limit=[0.4])
    assert bound.loses
    np.testing.assert_allclose(bound.limits(JOINTS), [np.inf, 0.4, np.inf])
    expected = TAU.copy()
    expected[:, 1] = np.clip(TAU[:, 1], -0.4, 0.4)
    np.testing.assert_allclose(bound.applied(JOINTS, TAU), expected)
    assert made("time_delay", [], delay=[0.03]).delay == 0.03
    with pytest.raises(ModelError, match="name none"):
        made("time_delay", ["a"], delay=[0.03])


@pytest.mark.parametrize(
    ("name", "key", "bound", "beyond"),
    [
        ("torque_constant", "gain", 0.01, 0.0099), ("torque_constant", "gain", 10.0, 10.01),
        ("actuator_fault", "gain", 1.0, 1.01), ("time_delay", "delay", 1.0, 1.01),
        ("load_dependent_friction", "coefficient", 0.95, 0.951), ("backlash", "gap", 0.5, 0.51),
        ("joint_elasticity", "stiffness", 1e-3, 0.9e-3), ("joint_elasticity", "stiffness", 1e9, 1.1e9),
        ("stribeck_friction", "stribeck_velocity", 1e-4, 0.9e-4),
        ("stribeck_friction", "stribeck_velocity", 100.0, 101.0), ("torque_ripple", "cycles", 1e5, 1.1e5),
        ("encoder_offset", "offset", np.pi, 3.2), ("encoder_offset", "offset", -np.pi, -3.2),
        ("gravity_tilt", "roll", np.pi, 3.2), ("gravity_tilt", "roll", -np.pi, -3.2),
        ("gravity_tilt", "pitch", np.pi, 3.2), ("gravity_tilt", "pitch", -np.pi, -3.2),
        ("joint_elasticity", "loss", 0.1, 0.11),
    ],
)  # fmt: skip
def test_values_are_refused_beyond_their_bounds(name: str, key: str, bound: float, beyond: float) -> None:
    rest: dict[str, dict[str, list[float]]] = {
        "stribeck_friction": {"coulomb": [1.0], "static": [1.0]},
        "torque_ripple": {"amplitude": [1.0], "phase": [0.0]},
        "gravity_tilt": {"roll": [0.0], "pitch": [0.0]},
        "joint_elasticity": {"stiffness": [1.0]},
    }
    joints = [] if name in ("time_delay", "gravity_tilt") else ["a"]
    assert made(name, joints, **{**rest.get(name, {}), key: [bound]}).value(key)[0] == bound
    with pytest.raises(ModelError, match="not within"):
        made(name, joints, **{**rest.get(name, {}), key: [beyond]})


def test_springs_ripple_readings_and_gears() -> None:
    spring = made("joint_spring", ["b", "c"], stiffness=[20.0, 5.0], rest_angle=[0.1, -0.2])
    np.testing.assert_allclose(torque(spring), (Q - [0, 0.1, -0.2]) * [0, 20.0, 5.0])
    ripple = made("torque_ripple", ["c"], amplitude=[2.0], cycles=[7.0], phase=[0.4])
    np.testing.assert_allclose(torque(ripple)[:, 2], 2.0 * np.sin(7.0 * Q[:, 2] + 0.4))
    offset = made("encoder_offset", ["b"], offset=[0.3])
    np.testing.assert_allclose(offset.measured_position(JOINTS, Q) - Q, np.tile([0, 0.3, 0], (50, 1)))
    np.testing.assert_allclose(offset.true_position(JOINTS, offset.measured_position(JOINTS, Q)), Q)
    rotor = made("reflected_inertia", ["a"], inertia=[0.4])
    np.testing.assert_allclose(torque(rotor), A * [0.4, 0, 0])
    gear = made("joint_elasticity", ["b", "c"], stiffness=[100.0, 50.0], rotor_inertia=[0.2, 0.3])
    assert isinstance(gear, YieldingGear)
    np.testing.assert_allclose(torque(gear), A * [0, 0.2, 0.3])
    assert gear.change(ARM).rotor == {"b": 0.2, "c": 0.3}
    # The usual loss is 5 % of critical at 100 rad/s: loss × ω / 2.
    assert gear.gears()["c"].stiffness == 50.0 and gear.gears()["b"].loss * 100.0 / 2.0 == pytest.approx(0.05)
    play = made("backlash", ["c"], gap=[0.02])
    assert play.gears()["c"].gap == 0.02 and math.isinf(play.gears()["c"].stiffness) and not torque(play).any()


def test_a_curve_bends_within_half_a_piece_beyond_its_ends() -> None:
    angles, torques = [0.0, 0.2, 0.6, 0.8], [0.0, 3.0, 4.0, 9.0]
    spring = made("joint_spring", ["b"], curve=[*angles, *torques])
    assert isinstance(spring, JointSpring)
    law = spring.curve()
    np.testing.assert_allclose(law(np.array(angles)), torques)
    from scipy.interpolate import PchipInterpolator

    inside, mean = PchipInterpolator(angles, torques), np.polyfit(angles, torques, 1)[0]
    reach = 0.5 * 0.8 / 3
    for end, sign in ((0.0, -1.0), (0.8, 1.0)):
        bend = inside.derivative()(end) - mean
        for far in (0.05, 0.3, 2.0):
            expected = inside(end) + sign * (mean * far + bend * reach * (1 - np.exp(-far / reach)))
            assert law(np.array(end + sign * far)) == pytest.approx(float(expected))
    np.testing.assert_allclose(torque(spring)[:, 1], law(Q[:, 1]))
    assert not torque(spring)[:, [0, 2]].any()
    for curve in ([0.0, 1.0, 2.0], [0.0, 1.0], [0.0, 0.0, 1.0, 2.0]):
        with pytest.raises(ModelError, match="rising angles"):
            made("joint_spring", ["b"], curve=curve)
    made("joint_spring", ["b"], curve=[0.0, 1.0, 2.0, 1.0])


def test_a_curve_is_made_once_for_all_that_ask_for_its_torque() -> None:
    numbers = [0.0, 0.2, 0.6, 0.0, 3.0, 4.0]
    one, same, other = (made("joint_spring", ["b"], curve=c) for c in (numbers, numbers, [*numbers[:5], 5.0]))
    assert isinstance(one, JointSpring) and isinstance(same, JointSpring) and isinstance(other, JointSpring)
    assert one.curve() is same.curve()
    assert float(other.curve()(np.array(0.6))) == pytest.approx(5.0)


def test_inertia_is_that_of_points() -> None:
    """Moments by sums over points, centres moved by Steiner's theorem, slopes by differences."""
    points, masses = RNG.standard_normal((5, 3)), RNG.uniform(0.5, 2.0, 5)
    total = sum(point_mass(m, p) for m, p in zip(masses, points, strict=True))
    x, y, z = points.T
    expected = [masses.sum(), *(masses @ points), masses @ (y * y + z * z), masses @ (x * x + z * z),
                masses @ (x * x + y * y), -masses @ (x * y), -masses @ (x * z), -masses @ (y * z)]  # fmt: skip
    np.testing.assert_allclose(total, expected)
    mass, centre, inner = about_centre(np.asarray(total))
    np.testing.assert_allclose(centre, masses @ points / masses.sum())
    own = sum(point_mass(m, p - centre) for m, p in zip(masses, points, strict=True))
    np.testing.assert_allclose(inner, np.asarray(own)[4:], atol=1e-12)
    np.testing.assert_allclose(about_origin(mass, centre, inner), total)
    assert about_centre(np.zeros(10))[1].tolist() == [0, 0, 0]
    theta = np.array([1.3, 0.2, -0.5, 0.7])
    slopes = [(point_mass(up[0], up[1:]) - point_mass(down[0], down[1:])) / 2e-6
              for up, down in ((theta + 1e-6 * e, theta - 1e-6 * e) for e in np.eye(4))]  # fmt: skip
    np.testing.assert_allclose(point_mass_jacobian(1.3, theta[1:]), np.array(slopes).T, atol=1e-8)
    for sign in (1.0, -1.0):
        body = spatial_inertia(np.asarray(total), sign)
        assert body.get_mass() == pytest.approx(sign * mass)
        np.testing.assert_allclose(body.get_com(), centre)
        tensor = body.CalcRotationalInertia().CopyToFullMatrix3()
        np.testing.assert_allclose(np.diag(tensor), sign * np.asarray(expected[4:7]))
        np.testing.assert_allclose(tensor[0, 1], sign * expected[7])


def test_intervals_hold_from_their_onset_to_before_their_end() -> None:
    time = np.array([0.0, 1.0, 1.5, 2.0, 3.0])
    assert Interval(1.0, 2.0).active(time).tolist() == [False, True, True, False, False]
    assert Interval(onset=1.0).active(time).tolist() == [False, True, True, True, True]
    assert Interval(end=2.0).active(time).tolist() == [True, True, True, False, False]
    assert ALWAYS.active(time).all() and not ALWAYS.timed and Interval(onset=1.0).timed and Interval(end=1.0).timed


def test_what_other_runs_make_of_an_onset_or_an_end() -> None:
    began, ended, both = Interval(1.0, log="x"), Interval(end=2.0, log="x"), Interval(1.0, 2.0, "x")
    assert began.in_run("x") is began and Interval(1.0).in_run("y") == Interval(1.0)
    assert began.in_run("y") == ALWAYS and ended.in_run("y") is None and both.in_run("y") is None
    for moment, starts, stops in (
        (3.0, Interval(3.0, log="y"), Interval(end=3.0, log="y")),
        (-math.inf, ALWAYS, None),
        (math.inf, None, ALWAYS),
    ):
        assert Interval(1.0, log="x", elsewhere={"y": moment}).in_run("y") == starts
        assert Interval(end=1.0, log="x", elsewhere={"y": moment}).in_run("y") == stops
    effect = at(made("torque_bias", ["a"], torque=[1.0]), began)
    assert in_run(effect, "x") is effect
    later = in_run(effect, "y")
    assert later is not None and later.when == ALWAYS and effect.when is began
    gone = at(effect, ended)
    assert in_run(gone, "y") is None
    assert [each.when for each in settled([effect, gone, at(effect, ALWAYS)], ["z"])] == [ALWAYS, ALWAYS]
    assert [each.when for each in settled([effect, gone], ["x"])] == [began, ended]
    assert dict(told(told(effect, {"y": 1.0}), {"z": 2.0}).when.elsewhere) == {"y": 1.0, "z": 2.0}


def test_specifications_of_times_are_checked() -> None:
    def timed(**times: Any) -> Any:
        return effects.make(EffectSpec("torque_bias", ["a"], [], {"torque": [1.0]}, **times))

    assert timed(onset=1.0, end=1.1).when == Interval(1.0, 1.1)
    assert timed(log="x", elsewhere={"y": math.inf}).when.elsewhere == {"y": math.inf}
    for bad in ({"onset": 1.0, "end": 1.0}, {"onset": 2.0, "end": 1.0}, {"onset": math.inf}, {"end": math.nan}):
        with pytest.raises(ModelError, match=r"onset|end"):
            timed(**bad)
    with pytest.raises(ModelError, match="time in y is not a number"):
        timed(elsewhere={"y": math.nan})


def test_parameters_keep_bounds_units_and_what_is_frozen() -> None:
    kind = ParameterKind("N·m", lower=0.0, upper=5.0, lessens=True)
    value = Parameter.of(kind, [2.0, -1.0], "here")
    np.testing.assert_array_equal(value.lower, [0.0, -1.0])
    np.testing.assert_array_equal(value.upper, [5.0, 5.0])
    assert value.unit == "N·m" and not value.frozen and not value.value.flags.writeable
    with pytest.raises(ModelError, match=r"here: \[5.1\]"):
        Parameter.of(kind, [5.1], "here")
    assert (kind.unit_on(False), kind.unit_on(True)) == ("N·m", "N")
    assert kind.unit_anywhere == "N·m (N where the joint is prismatic)"
    phase = ParameterKind("rad", prismatic_unit="rad")
    assert phase.unit_on(True) == "rad" == phase.unit_anywhere
    two = made("joint_spring", ["b", "c"], stiffness=[20.0, 5.0], rest_angle=[0.1, -0.2])
    np.testing.assert_array_equal(vector(two), [20.0, 5.0, 0.1, -0.2])
    moved = with_vector(two, np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(moved.value("rest_angle"), [3.0, 4.0])
    from dataclasses import replace

    frozen = with_values(two, {})
    frozen.parameters["stiffness"] = replace(frozen.parameters["stiffness"], frozen=True)
    np.testing.assert_array_equal(vector(frozen), [0.1, -0.2])
    np.testing.assert_array_equal(with_vector(frozen, np.array([9.0, 8.0])).value("rest_angle"), [9.0, 8.0])
    np.testing.assert_array_equal(with_vector(frozen, np.array([9.0, 8.0])).value("stiffness"), [20.0, 5.0])
    with pytest.raises(ModelError):
        with_values(two, {"stiffness": [-1.0, 1.0]})
    assert with_values(two, {"stiffness": [-1.0, 1.0]}, check=False).value("stiffness")[0] == -1.0
    told_of = two.on_arm(["c", "x"])
    assert told_of.prismatic == {"c"} and told_of.on_arm(["c"]) is told_of
    assert (told_of.unit("rest_angle", "c"), told_of.unit("rest_angle", "b")) == ("m", "rad")


def test_what_a_description_states_is_given() -> None:
    stated = SimpleNamespace(friction={"a": 1.0, "c": 2.0}, springs={"b": (3.0, 0.5)})
    friction, spring = stated_effects(SimpleNamespace(stated=stated))  # type: ignore[arg-type]
    assert isinstance(friction, CoulombFriction) and friction.joints == ("a", "c") and friction.given and spring.given
    np.testing.assert_array_equal(friction.value("torque"), [1.0, 2.0])
    assert (spring.value("stiffness").tolist(), spring.value("rest_angle").tolist()) == ([3.0], [0.5])
