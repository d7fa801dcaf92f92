"""Each candidate of the whole arm is its effect's own law, to the order that it says, against the model with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import (
    ARM,
    ELBOW,
    LIFT,
    PAN,
    RATE,
    WRIST,
    disagreement,
    effect,
    law,
    record,
    swing,
    swinging,
    terms_of,
    told,
    torque,
    worn,
)
from tests.gap_bench import URDF, arm
from twin_diagram.gap.candidates import (
    coupled_friction,
    encoder_offset,
    external_force,
    gravity_tilt,
    inertial_parameters,
    joint_elasticity,
    joint_spring,
    payload,
    time_delay,
    whole_arm,
)
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects.link_inertia import about_centre, about_origin
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.kinematic_tree import Kinematics
from twin_diagram.scenario import EffectSpec

Array = npt.NDArray[np.float64]

MASSES = np.array([3.7, 8.058, 2.846, 1.37, 1.3, 0.365])
"""Of the arm's links, as its maker publishes them [kg]."""


def length() -> float:
    """The arm's, along its joints' origins, and a hand's breadth [m]."""
    return float(np.sum(np.linalg.norm(ARM.tree.p_PF, axis=1))) + 0.1


def test_friction_between_neighbours_is_on_the_sum_of_their_speeds() -> None:
    terms = swinging()
    made = coupled_friction.on_joints(terms)
    assert [len(some) for some in made] == [1, 1, 1, 1, 1, 0]
    candidate = made[ELBOW][0]
    assert candidate.joints == candidate.rows == (2, 3)
    assert disagreement(terms, candidate, [1.5, 0.7]) < 0.06
    assert disagreement(terms, candidate, [1.5, 0.0]) < 1e-6
    size = np.sqrt(np.mean((candidate.columns[:, 0] * candidate.spread) ** 2, axis=0))
    np.testing.assert_allclose(size, np.min(terms.torque_size[[2, 3]]))
    assert candidate.allows(np.array([0.0, 0.0]))
    assert not candidate.allows(np.array([-1e-9, 1.0])) and not candidate.allows(np.array([1.0, -1e-9]))


def test_the_sign_of_a_sum_of_speeds_is_as_well_known_as_both() -> None:
    terms = replace(swinging(), slow=np.array([1.0, 1.0, 0.03, 0.04, 1.0, 1.0]))
    record = terms.records.records[0]
    column = coupled_friction.on_joints(terms)[ELBOW][0].columns[:, 1, 1]
    np.testing.assert_allclose(column, record.reduce(np.tanh((record.v[:, [2]] + record.v[:, [3]]) / 0.05))[:, 0])


def test_speeds_that_always_cancel_tell_of_no_friction() -> None:
    terms = swinging()
    record = terms.records.records[0]
    v = np.array(record.v)
    v[:, 3] = -v[:, 2]
    still = replace(terms, records=replace(terms.records, records=(replace(record, v=v),)))
    assert coupled_friction.on_joints(still)[ELBOW] == []


def test_an_offset_is_the_change_of_torque_with_the_angle() -> None:
    terms = swinging()
    for joint in (LIFT, WRIST - 1):
        candidate = encoder_offset.encoder_offset(terms, joint)
        assert candidate is not None and candidate.rows == tuple(range(6))
        assert disagreement(terms, candidate, [1e-3]) < 1e-2
        assert disagreement(terms, candidate, [-1e-3]) < 1e-2
    assert candidate is not None and candidate.spread == [0.1]
    assert candidate.allows(np.array([0.59])) and not candidate.allows(np.array([0.61]))
    assert candidate.allows(np.array([-0.59])) and not candidate.allows(np.array([-0.61]))
    joints = [c.joints[0] for c in encoder_offset.on_arm(terms)]
    assert joints == [1, 2, 3, 4, 5], "gravity does not know how an upright arm's base is turned"


def test_an_offset_about_half_its_size_is_right_to_third_order() -> None:
    terms = swinging()
    plain = encoder_offset.encoder_offset(terms, LIFT)
    assert plain is not None
    midway = encoder_offset.recentred(terms, plain, np.array([0.3]))
    assert midway is not None and midway.joints == (LIFT,)
    assert disagreement(terms, midway, [0.3]) < 0.2 * disagreement(terms, plain, [0.3])
    assert disagreement(terms, midway, [0.3]) < 0.01


def test_an_offset_that_makes_no_difference_is_none() -> None:
    """Of a joint about a vertical axis; below a millionth of a newton metre per radian."""
    terms = swinging()
    assert encoder_offset.encoder_offset(terms, PAN) is None
    assert all(encoder_offset.encoder_offset(terms, j) is not None for j in (LIFT, ELBOW))


def test_a_tilt_turns_gravity() -> None:
    terms = swinging()
    plain = gravity_tilt.on_arm(terms)[0]
    assert disagreement(terms, plain, [1e-3, 0.0]) < 1e-2 and disagreement(terms, plain, [0.0, -1e-3]) < 1e-2
    midway = gravity_tilt.recentred(terms, plain, np.array([0.2, -0.3]))
    assert midway is not None
    assert disagreement(terms, midway, [0.2, -0.3]) < 1e-4 < 0.1 < disagreement(terms, plain, [0.2, -0.3])
    np.testing.assert_array_equal(plain.spread, [0.15, 0.15])
    for k in range(2):
        for inside, value in ((True, 0.99), (False, 1.01)):
            assert plain.allows(value * np.eye(2)[k]) == plain.allows(-value * np.eye(2)[k]) == inside


def test_a_payload_is_a_point_where_it_is_found() -> None:
    terms = swinging()
    plain, bulky = payload.on_arm(terms)
    far = np.array([0.05, -0.1, 0.2])
    c = np.concatenate([[2.0], 2.0 * far])
    assert told(plain, c)["com"] == pytest.approx(far) and told(plain, c)["mass"] == [2.0]
    there = payload.recentred(terms, plain, c)
    assert there is not None
    assert disagreement(terms, there, list(c)) < 1e-6
    assert 1e-4 < disagreement(terms, plain, list(c)) < 0.2, "its inertia about its centre is left out"
    assert payload.recentred(terms, bulky, np.ones(10)) is None
    assert payload.recentred(terms, plain, np.zeros(4)) is None
    tensor = 2.0 * (far @ far * np.eye(3) - np.outer(far, far))
    inertia = np.array([*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])
    whole = torque(terms, bulky, np.concatenate([c, inertia]))
    np.testing.assert_allclose(whole, torque(terms, there, c), atol=1e-9)
    assert bulky.variant == "bulky" and bulky.size == 10


def test_how_much_and_how_far_a_payload_may_be() -> None:
    """0.35 of the arm's length from the link, and not behind the wrist, which is 0.1 m behind the last joint.

    1.05 of what the given model carries may be put down.
    """
    reach = 0.35 * length()
    for candidate in payload.on_arm(worn()):
        rest = np.zeros(candidate.size - 4)
        for mass in (2.0, -2.0):
            for share, inside in ((0.99, True), (1.01, False)):
                moment = np.array([0.0, 0.6, 0.8]) * reach * mass * share
                assert candidate.allows(np.concatenate([[mass], moment, rest])) == inside
            for behind, inside in ((0.099, True), (0.101, False)):
                assert candidate.allows(np.array([mass, 0.0, 0.1 * mass, -behind * mass, *rest])) == inside
        for mass, inside in ((-3.14, True), (-3.16, False)):
            assert candidate.allows(np.concatenate([[mass, 0.0, 0.0, 0.0], rest])) == inside


def test_where_the_last_joint_swings_its_link_a_payload_may_be_on_either_side(tmp_path: Path) -> None:
    """The way to the elbow lies across its axis, so that nothing tells where outward is."""
    model = Model.load(arm(tmp_path))
    still = np.zeros((500, 2))
    candidate = payload.payload(terms_of(Records(model, (record(model, np.arange(500) / RATE, still, still, still),))))
    for side in (0.2, -0.2):
        assert candidate.allows(np.array([1.0, 0.0, side, 0.0])) and candidate.allows(np.array([1.0, 0.0, 0.0, side]))
    assert candidate.admits is not None
    with np.errstate(invalid="raise"):
        assert candidate.admits(np.zeros(4)), "nothing is nowhere in particular"


def test_where_the_last_joint_is_askew_to_the_way_to_it_a_payload_may_be_on_either_side(tmp_path: Path) -> None:
    """58° tell nothing of outward: on an arm like that 1.4 kg on the side of the wrist were no payload."""
    path = tmp_path / "askew.urdf"
    path.write_text(URDF.replace('xyz="0 0 0.4"', 'xyz="0 0.042 0.068"'))
    model, still = Model.load(path), np.zeros((500, 2))
    candidate = payload.payload(terms_of(Records(model, (record(model, np.arange(500) / RATE, still, still, still),))))
    for side in (0.06, -0.06):
        assert candidate.allows(np.array([1.0, 0.0, side, 0.0]))


def test_where_the_joints_of_a_wrist_meet_a_payload_may_be_on_either_side(tmp_path: Path) -> None:
    """What is left of the way between them is rounding: it had kept a KR300's 150 kg from being named."""
    path = tmp_path / "meet.urdf"
    path.write_text(URDF.replace('xyz="0 0 0.4"', 'xyz="1e-16 1e-16 0" rpy="0 1.5707963 0"').replace("0 1 0", "1 1 0"))
    model, still = Model.load(path), np.zeros((500, 2))
    candidate = payload.payload(terms_of(Records(model, (record(model, np.arange(500) / RATE, still, still, still),))))
    for side in (np.eye(3) * 0.1).tolist() + (-np.eye(3) * 0.1).tolist():
        assert candidate.allows(np.array([1.0, *side]))


def test_sizes_that_are_thought_possible_go_with_the_arm() -> None:
    terms = swinging()
    scale = 0.3 * MASSES.max() + 0.5
    assert whole_arm.reach(terms) == pytest.approx(length())
    assert whole_arm.mass_scale(terms) == pytest.approx(scale, rel=1e-6)
    expected = [scale, *[0.1 * scale * length()] * 3, *[scale * (0.12 * length()) ** 2] * 6]
    np.testing.assert_allclose(whole_arm.inertia_spread(terms), expected, rtol=1e-6)
    np.testing.assert_array_equal(payload.payload(terms).spread, whole_arm.inertia_spread(terms)[:4])
    np.testing.assert_array_equal(payload.bulky_payload(terms).spread, whole_arm.inertia_spread(terms))
    assert whole_arm.last_body(terms) == 5


@pytest.mark.parametrize("body", [1, 5])
def test_what_may_be_wrong_with_a_link_goes_with_the_link(body: int) -> None:
    terms = swinging()
    own = ARM.tree.inertia[body]
    mass = 0.5 * own[0] + 0.02 * (0.3 * MASSES.max() + 0.5)
    gyration = float(np.sqrt(np.sum(own[4:7]) / own[0]))
    size = max(gyration, 0.05 * length())
    assert (size == gyration) == (body == 1)
    spread = whole_arm.link_spread(terms, body)
    np.testing.assert_allclose(spread, [mass, *[mass * size] * 3, *[mass * size**2] * 6], rtol=1e-6)


def test_ten_differences_of_a_link_are_its_inertia() -> None:
    terms = swinging()
    made = {c.links[0]: c for c in inertial_parameters.on_arm(terms)}
    link = ARM.tree.link[2]
    candidate = made[link]
    mass, centre, inertia = link_inertia(ARM, link)
    c = about_origin(1.2 * mass, centre + np.array([0.01, -0.02, 0.03]), 1.1 * inertia) - about_origin(
        mass, centre, inertia
    )
    assert disagreement(terms, candidate, list(c)) < 1e-6
    values = told(candidate, c)
    assert values["mass"] == pytest.approx([0.2 * mass])
    np.testing.assert_allclose(values["com"], [0.01, -0.02, 0.03], atol=1e-9)
    np.testing.assert_allclose(values["inertia"], 0.1 * inertia, atol=1e-9)
    gone = told(candidate, about_origin(-1.01 * mass, centre, -inertia))
    np.testing.assert_array_equal(gone["com"], np.zeros(3))
    assert len(gone["inertia"]) == 6
    np.testing.assert_allclose(candidate.spread, whole_arm.link_spread(terms, 2))
    assert candidate.cost == 5.0


def test_links_that_turn_about_one_axis_alone_are_rotors() -> None:
    terms = swinging()
    made = inertial_parameters.on_arm(terms)
    assert [c.links[0] for c in made] == list(ARM.tree.link[1:])
    rng = np.random.default_rng(0)
    one = np.outer(rng.normal(size=50), rng.normal(size=10)).reshape(50, 1, 10)
    assert inertial_parameters.turns_only(one)
    assert not inertial_parameters.turns_only(one + 1e-3 * rng.normal(size=one.shape))
    assert inertial_parameters.turns_only(one + 1e-7 * rng.normal(size=one.shape))


def test_what_a_link_may_become() -> None:
    """Its mass stays positive, its centre within 0.35 of the arm; the last gets no heavier: that is a payload."""
    terms = swinging()
    made = inertial_parameters.on_arm(terms)
    candidate, last = made[0], made[-1]
    own = np.array(ARM.tree.inertia[1])
    for share, inside in ((0.99, True), (1.01, False)):
        assert candidate.allows(np.concatenate([[-share * own[0]], -own[1:4], np.zeros(6)])) == inside
        far = np.array([0.35 * length() * own[0] * share, 0.0, 0.0])
        assert candidate.allows(np.concatenate([[0.0], far - own[1:4], np.zeros(6)])) == inside
    for mass in (1e-3, -1e-3):
        assert last.allows(np.array([mass, *np.zeros(9)])) == (mass < 0.0)
        assert candidate.allows(np.array([mass, *np.zeros(9)]))
    assert [bool(c.excludes) for c in made] == [c is made[-2] for c in made]
    assert made[-2].excludes == {"payload"}


def test_a_links_given_inertia_holds_what_the_model_adds_to_it() -> None:
    link, other = ARM.tree.link[2], ARM.tree.link[3]
    more = {"mass": 0.5, "com": [0.01, 0.0, 0.02], "inertia": [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]}
    heavier = ARM.with_effects(
        [
            effect("inertial_parameters", links=[link], **more),
            effect("payload", links=[ARM.last_link], mass=1.0, com=[0, 0, 0.0]),
        ]  # type: ignore[arg-type]
    )
    before, after = link_inertia(ARM, link), link_inertia(heavier, link)
    assert after[0] - before[0] == pytest.approx(0.5)
    np.testing.assert_allclose(after[1] - before[1], more["com"])
    np.testing.assert_allclose(after[2] - before[2], more["inertia"])
    for a, b in zip(link_inertia(ARM, other), link_inertia(heavier, other), strict=True):
        np.testing.assert_array_equal(a, b)
    mass, *_ = about_centre(ARM.tree.inertia[2])
    assert before[0] == pytest.approx(MASSES[2]) == pytest.approx(mass)


@pytest.mark.parametrize("about", [0.0, 0.02])
def test_a_delay_is_the_torque_of_later(about: float) -> None:
    terms = swinging()
    candidate = time_delay.delay(terms, 0.05, about)
    for t in (1e-4, about):
        if t > 0.0 and (t == about or about == 0.0):
            assert disagreement(terms, candidate, [t]) < 0.01
    again = time_delay.recentred(terms, candidate, np.array([0.02]))
    assert again is not None
    assert disagreement(terms, again, [0.02]) < 0.01
    wanted = torque(terms, time_delay.delay(terms, 0.05, 0.02), np.ones(1))
    np.testing.assert_allclose(torque(terms, again, np.ones(1)), wanted)


def test_how_long_a_delay_may_be() -> None:
    """From one sample of the coarsest log to twice the longest that is thought likely; below, it is no effect."""
    one = swinging()
    record = one.records.records[0]
    slower = replace(record, index=1, period=3.0 * record.period)
    terms = terms_of(Records(ARM, (record, slower)))
    candidate = time_delay.on_arm(terms)[0]
    for value, inside in ((0.0149, False), (0.0151, True), (0.099, True), (0.101, False)):
        assert candidate.allows(np.array([value])) == inside
    assert candidate.spread == pytest.approx([0.3 * 0.05])
    nuisance = time_delay.timing_nuisance(terms)
    assert nuisance.name == "" and nuisance.spread == pytest.approx([2.5e-4 + 0.1 * 0.015])
    assert nuisance.allows(np.array([-9.0])) and nuisance.allows(np.array([9.0]))
    np.testing.assert_array_equal(nuisance.columns, candidate.columns)


@pytest.mark.parametrize("joint", [LIFT, ELBOW])
def test_a_stiff_gear_follows_its_load(joint: int) -> None:
    """Its torque at coefficient 1/k is that of a link that is behind by load/k, in angle, speed and acceleration."""
    terms = swinging()
    candidate = joint_elasticity.on_arm(terms)[joint]
    assert candidate.joints == (joint,) and candidate.rows == tuple(range(6))
    record = terms.records.records[0]
    softness = 1e-6
    twist = softness * record.given[:, joint]
    moved = [np.array(x) for x in (record.q, record.v, record.a)]
    for signal in moved:
        signal[:, joint] -= twist
        twist = np.gradient(twist, 1.0 / RATE)
    wanted = record.reduce(ARM.inverse_dynamics(*moved) - record.given)
    found = torque(terms, candidate, np.array([softness, 0.0]))
    assert np.linalg.norm(found - wanted) < 2e-3 * np.linalg.norm(wanted)
    rotor = torque(terms, candidate, np.array([0.0, 1.0]))
    np.testing.assert_allclose(rotor[:, joint], record.reduce(record.a)[:, joint])
    assert not np.any(np.delete(rotor, joint, axis=1))
    values = told(candidate, np.array([2e-4, 0.3]))
    assert values["stiffness"] == pytest.approx([5e3]) and values["rotor_inertia"] == [0.3]
    size = np.sqrt(np.mean(record.reduce(record.a)[:, joint] ** 2))
    np.testing.assert_allclose(candidate.spread, [3e-4, terms.torque_size[joint] / size])
    for softness, inside in ((0.99e-6, False), (1.01e-6, True), (0.099, True), (0.101, False)):
        assert candidate.allows(np.array([softness, 0.0])) == inside
    assert candidate.cost == 3.0
    for rotor_inertia, inside in ((-0.524, True), (-0.526, False)):
        assert joint_elasticity.on_arm(worn())[joint].allows(np.array([1e-4, rotor_inertia])) == inside


def test_springs_in_series_are_softer_and_lose_what_both_lose() -> None:
    one = {"stiffness": [3000.0], "rotor_inertia": [0.2], "loss": [0.006]}
    two = {"stiffness": [6000.0], "rotor_inertia": [0.1], "loss": [0.003]}
    both = joint_elasticity.merge(one, two)
    assert both["stiffness"] == [pytest.approx(2000.0)] and both["rotor_inertia"] == [pytest.approx(0.3)]
    assert both["loss"] == [pytest.approx(2000.0 * (0.006 / 3000.0 + 0.003 / 6000.0))]
    assert "loss" not in joint_elasticity.merge(one, {key: two[key] for key in ("stiffness", "rotor_inertia")})
    assert "loss" not in joint_elasticity.merge({key: one[key] for key in ("stiffness", "rotor_inertia")}, two)


@pytest.mark.parametrize("body", [2, 5])
def test_a_push_is_power_over_speed(body: int) -> None:
    """The motors give what the wrench takes: Σ τ v = −(force · velocity of the link's origin + moment · turning)."""
    terms = swinging()
    forces = external_force.external_forces(terms)
    assert [c.size for c in forces] == [3, 6] * 6
    force, wrench = forces[2 * body : 2 * body + 2]
    assert force.links == wrench.links == (ARM.tree.link[body],)
    c = np.array([10.0, -20.0, 30.0, 1.0, 2.0, -3.0])
    assert disagreement(terms, wrench, list(c)) < 1e-6
    assert disagreement(terms, force, list(c[:3])) < 1e-6
    np.testing.assert_array_equal(told(force, c[:3])["wrench"], [10.0, -20.0, 30.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(told(wrench, c)["wrench"], c)
    np.testing.assert_array_equal(told(force, c[:3])["point"], [0.0, 0.0, 0.0])
    weight = 9.81 * (0.3 * MASSES.max() + 0.5)
    np.testing.assert_allclose(wrench.spread, [weight] * 3 + [0.2 * weight * length()] * 3, rtol=1e-6)
    np.testing.assert_array_equal(force.spread, wrench.spread[:3])
    for some in (force, wrench):
        assert some.allows(np.full(some.size, 1e6)) and some.allows(np.full(some.size, -1e6))


OFF = """<mujoco><worldbody><body name="base"><geom type="box" size=".05 .05 .05" mass="1"/>
<body name="upper" pos="0 0 .3"><joint name="one" axis="0 1 0" pos="0.1 0.05 -0.2"/>
<inertial pos="0 0 .2" mass="2" diaginertia=".02 .02 .01"/>
<body name="lower" pos="0 0 .4"><joint name="two" axis="0 1 0" pos="0 0 -0.1"/>
<inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .01"/></body></body></body></worldbody></mujoco>"""
"""Whose joints are not at their links' origins."""


def test_a_push_is_at_the_links_origin_wherever_its_joint_is(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(OFF)
    model = Model.load(tmp_path / "arm.xml")
    time, *motion = swing(3.0)
    records = Records(model, (record(model, time, *(x[:, :2] for x in motion)),))
    terms = terms_of(records)
    for candidate in external_force.external_forces(terms) + external_force.forces_at_centres(terms):
        c = [10.0, -20.0, 30.0, 1.0, 2.0, -3.0][: candidate.size]
        assert disagreement(terms, candidate, c) < 1e-6


def test_a_force_at_a_point_of_a_link_and_how_that_point_moves() -> None:
    terms, body, point, force = swinging(), 3, np.array([0.1, -0.2, 0.05]), np.array([10.0, -20.0, 30.0])
    wrench, R_WL = external_force.external_forces(terms)[2 * body + 1], external_force.turned(terms, body)
    there = external_force.force_at(wrench, R_WL, point)
    np.testing.assert_array_equal(told(there, force)["point"], point)
    assert disagreement(terms, there, list(force)) < 2e-3  # what is low-passed is turned as if nothing turned meanwhile
    both = external_force.with_its_point(wrench, R_WL, point, force, 0.3)
    step = np.array([0.01, 0.02, -0.03])
    moved = external_force.force_at(wrench, R_WL, point + step).columns @ force
    np.testing.assert_allclose(both.columns @ np.concatenate([force, step]), moved, atol=1e-9)
    errors = np.arange(1.0, 7.0)
    wider = external_force.placed(there, errors).parameters(force, np.diag([4.0, 1.0, 1.0]))
    np.testing.assert_allclose(wider["wrench"][1], [2.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(wider["point"][1], errors[3:])


def test_a_payload_is_put_down_as_it_was_picked_up() -> None:
    here = {"mass": [2.0], "com": [0.1, 0.0, 0.0]}
    less = {"mass": [-0.5], "com": [0.0, 0.2, 0.0]}
    left = payload.merge(here, less)
    assert left is not None and left["mass"] == [1.5]
    np.testing.assert_allclose(left["com"], (2.0 * np.array([0.1, 0, 0]) - 0.5 * np.array([0, 0.2, 0])) / 1.5)
    assert payload.merge(here, here) is None and payload.merge(here, {"mass": [0.0], "com": [0.0] * 3}) is None
    for lost, mass in ((-2.0, 0.0), (-2.09, 0.0), (-2.0 + 5e-10, 5e-10)):
        gone = payload.merge(here, {"mass": [lost], "com": [0.1, 0.0, 0.0]})
        assert gone is not None and gone["com"] == [0.0, 0.0, 0.0] and gone["mass"] == [pytest.approx(mass, abs=1e-12)]
    assert payload.merge(here, {"mass": [-2.11], "com": [0.1, 0.0, 0.0]}) is None
    for lost, kept in ((-1.91, True), (-1.89, False)):
        little = payload.merge(here, {"mass": [lost], "com": [0.3, 0.0, 0.0]})
        assert little is not None and (little["com"] == [0.1, 0.0, 0.0]) == kept


def carried(mass: float, com: float = 0.0, link: str = "hand", onset: float | None = None) -> EffectSpec:
    return EffectSpec("payload", [], [link], {"mass": [mass], "com": [com, 0.0, 0.0]}, onset=onset)


def test_the_lightest_payload_that_is_enough_is_put_down() -> None:
    specs = [carried(5.0, 0.1), carried(1.0, 0.2), carried(2.0, 0.3)]

    def masses(lost: float, there: list[EffectSpec] = specs) -> list[float]:
        left = payload.put_down(there, carried(-lost, 0.3))
        return sorted(round(spec.parameters["mass"][0], 9) for spec in left)

    assert masses(2.0) == [1.0, 5.0]
    assert masses(0.4) == [0.6, 2.0, 5.0]
    assert masses(2.09) == [1.0, 5.0], "a twentieth more is noise"
    assert masses(2.11) == [1.0, 2.0, 2.89]
    assert masses(6.0) == [2.0], "of all together"
    all_of_them = payload.put_down(specs, carried(-6.0, 0.1))
    com = (8.0 * (0.5 + 0.2 + 0.6) / 8.0 - 6.0 * 0.1) / 2.0
    assert all_of_them[0].parameters["com"][0] == pytest.approx(com)
    assert masses(9.0) == [-9.0, 1.0, 2.0, 5.0], "more than there is"
    elsewhere = [carried(2.0, link="other"), carried(2.0, onset=1.0)]
    assert masses(2.0, elsewhere) == [-2.0, 2.0, 2.0]
    assert masses(2.0, [EffectSpec("payload", [], [], {"mass": [2.0], "com": [0.0] * 3})]) == []
    assert masses(1.0, []) == [-1.0]


def test_torque_per_inertial_parameter_is_in_the_links_own_frame() -> None:
    """A mass of one unit at the link's origin, whichever frame the body's own is."""
    terms: Terms = swinging()
    for body in (2, 5):
        per_mass = whole_arm.in_link_frame(terms, body)[..., 0]
        link = ARM.tree.link[body]
        if link == ARM.last_link:
            candidate = payload.payload(terms)
            np.testing.assert_allclose(candidate.columns[..., 0], per_mass)
            wanted = law(terms, candidate, {"mass": np.array([1.0]), "com": np.zeros(3)})
            np.testing.assert_allclose(per_mass, wanted, atol=1e-9)
    motion = Kinematics.of(ARM.tree, terms.records.records[0].q.T)
    assert motion.p.shape[1] == 6


def test_a_payload_about_a_centre_is_right_to_first_order_in_mass_and_moment() -> None:
    """Looked for in turns, mass and centre then settle as Newton's steps do."""
    terms = swinging()
    mass, far = 2.0, np.array([0.05, -0.1, 0.2])
    there = payload.payload_about(terms, far)
    c = np.concatenate([[mass], mass * far])
    assert disagreement(terms, there, list(c)) < 1e-6
    for step in 1e-3 * np.eye(4):
        ahead, behind = (law(terms, there, told(there, x)) for x in (c + step, c - step))
        np.testing.assert_allclose(2.0 * torque(terms, there, step), ahead - behind, atol=1e-6 * np.max(np.abs(ahead)))


@pytest.mark.parametrize("known", [False, True])
def test_laws_are_of_the_positions_behind_encoders_whose_offset_is_known(known: bool) -> None:
    off = effect("encoder_offset", ARM.joints, offset=[0.05, -0.05, 0.05, -0.05, 0.05, -0.05])
    model = ARM.with_effects([off] if known else [])
    terms = terms_of(Records(model, (record(model, *swing(2.0)),)))
    (spring, *_) = joint_spring.on_joints(terms)[ELBOW]
    (tilt,) = gravity_tilt.on_arm(terms)
    push = external_force.external_forces(terms)[-1]
    moment = [0.02, 0.01, 0.05]
    load = payload.payload(terms, np.array(moment))
    assert disagreement(terms, spring, [20.0, -5.0]) < 1e-9
    assert disagreement(terms, tilt, [0.01, -0.01]) < 0.02  # to first order
    assert disagreement(terms, push, [10.0, 0.0, 0.0, 0.0, 1.0, 0.0]) < 1e-9
    assert disagreement(terms, load, [1.0, *moment]) < 1e-9
