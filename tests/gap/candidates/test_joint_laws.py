"""Each candidate on a joint is its effect's own law: torque by torque, against the model with that effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import (
    ARM,
    ELBOW,
    LIFT,
    PAN,
    WRIST,
    disagreement,
    record,
    sized,
    swinging,
    terms_of,
    told,
    worn,
)
from twin_diagram.gap.candidates import (
    coulomb_friction,
    joint_spring,
    load_dependent_friction,
    reflected_inertia,
    stribeck_friction,
    torque_bias,
    torque_constant,
    torque_ripple,
    viscous_friction,
)
from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import below_zero, single, those_there
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms

Array = npt.NDArray[np.float64]

Make = Callable[[Terms], list[list[Candidate]]]

PLAIN: list[tuple[Make, int, list[float], float]] = [
    (viscous_friction.on_joints, 0, [2.5], 1e-6),
    (reflected_inertia.on_joints, 0, [0.7], 1e-6),
    (torque_bias.on_joints, 0, [1.7], 1e-6),
    (torque_constant.on_joints, 0, [0.25], 1e-6),
    (torque_constant.on_joints, 0, [-0.25], 1e-6),
    (joint_spring.on_joints, 0, [30.0, 4.0], 1e-6),
    (coulomb_friction.on_joints, 0, [3.0], 0.06),
    (coulomb_friction.on_joints, 1, [3.0, 1.0], 0.06),
    (load_dependent_friction.on_joints, 0, [0.2], 0.05),
    (stribeck_friction.on_joints, 3, [2.0, 1.5], 0.09),
    (stribeck_friction.on_joints, 6, [1.0, 4.0], 0.09),
]


@pytest.mark.parametrize(("make", "which", "coefficients", "off"), PLAIN)
@pytest.mark.parametrize("joint", [LIFT, ELBOW])
def test_columns_are_the_torque_of_the_law(
    make: Make, which: int, coefficients: list[float], off: float, joint: int
) -> None:
    terms = swinging()
    candidate = make(terms)[joint][which]
    assert candidate.joints == candidate.rows == (joint,) and candidate.links == ()
    assert disagreement(terms, candidate, coefficients) < off
    np.testing.assert_allclose(sized(terms, candidate), 1.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "which", "fits", "fails"),
    [
        (viscous_friction.on_joints, 0, [-2.09], [-2.11]),
        (coulomb_friction.on_joints, 0, [-4.19], [-4.21]),
        (coulomb_friction.on_joints, 1, [-4.19, -4.19], [0.0, -4.21]),
        (coulomb_friction.on_joints, 1, [9.0, -4.19], [-4.21, 0.0]),
        (load_dependent_friction.on_joints, 0, [-0.104], [-0.106]),
        (load_dependent_friction.on_joints, 0, [0.89], [0.91]),
        (reflected_inertia.on_joints, 0, [-0.524], [-0.526]),
        (joint_spring.on_joints, 0, [-20.9, -90.0], [-21.1, 0.0]),
        (torque_constant.on_joints, 0, [-0.74], [-0.76]),
        (torque_constant.on_joints, 0, [3.99], [4.01]),
        (stribeck_friction.on_joints, 3, [-3.99, 1.0], [-4.01, 1.0]),
        (stribeck_friction.on_joints, 3, [1.0, 0.01], [1.0, -0.01]),
    ],
)
def test_no_more_is_taken_away_than_the_given_model_has(
    make: Make, which: int, fits: list[float], fails: list[float]
) -> None:
    """By a twentieth, so that noise may take it across zero."""
    candidate = make(worn())[PAN][which]
    assert candidate.allows(np.array(fits)) and not candidate.allows(np.array(fails))


@pytest.mark.parametrize("make", [viscous_friction.on_joints, coulomb_friction.on_joints, reflected_inertia.on_joints])
def test_what_the_given_model_lacks_cannot_be_negative(make: Make) -> None:
    candidate = make(swinging())[PAN][0]
    assert candidate.allows(np.array([0.0])) and not candidate.allows(np.array([-1e-6]))


def test_a_constant_torque_may_have_either_sign() -> None:
    candidate = torque_bias.on_joints(swinging())[WRIST][0]
    assert candidate.allows(np.array([-1e3])) and candidate.allows(np.array([1e3]))
    assert told(candidate, np.array([1.5]))["torque"] == pytest.approx([-1.5]), "logged = needed − bias"


def test_what_a_present_dip_has_may_be_taken_off() -> None:
    terms = worn()
    names = terms.present.names
    assert "stribeck_friction" not in names and "coulomb_friction" in names
    assert below_zero(2.0) == pytest.approx(-2.1)


def test_columns_that_vanish_make_no_candidate() -> None:
    terms = swinging()
    there, nothing = np.ones(len(terms.records.residual)), np.zeros(len(terms.records.residual))
    made = [
        single(terms, "torque_bias", 1, columns, linear("torque"), [0.0] * len(columns))
        for columns in ([there], [nothing], [there, nothing], [there, 2e-12 * there], [there, 0.6e-12 * there])
    ]
    assert [some is not None for some in made] == [True, False, False, True, False]
    assert len(those_there(made)) == 2
    assert made[0] is not None and np.all(made[0].upper == np.inf) and made[0].columns.shape[1:] == (1, 1)


def test_a_spring_rests_where_its_torque_is_none() -> None:
    terms = swinging()
    straight = joint_spring.on_joints(terms)[ELBOW][0]
    middle = straight.shape["middle"]
    assert middle == pytest.approx(float(np.mean(terms.records.reduce(lambda r: r.q)[:, ELBOW])))
    values = told(straight, np.array([10.0, 2.0]))
    assert values["rest_angle"] == pytest.approx([middle - 0.2]) and values["stiffness"] == pytest.approx([10.0])


@pytest.mark.parametrize(("angle", "curves"), [(0.12, 0), (0.15, 1), (0.3, 2), (0.5, 3)])
def test_no_curve_bends_within_the_way_over_which_dry_friction_builds_up(angle: float, curves: int) -> None:
    """One took the place of a wrist's damping (305001): of 86 mrad, where friction builds up over 5."""
    (whole,) = swinging().records.records
    share = angle / float(np.ptp(whole.q[:, PAN]))
    smaller = record(ARM, whole.time, *(x * share for x in (whole.q, whole.v, whole.a)))
    straight, *more = joint_spring.on_joints(terms_of(Records(ARM, (smaller,))))[PAN]
    assert straight.variant == "" and [c.variant for c in more] == ["curve"] * curves


@pytest.mark.parametrize(("which", "pieces"), [(1, 3), (2, 6), (3, 10)])
def test_curves_follow_any_smooth_function_of_the_angle(which: int, pieces: int) -> None:
    terms = swinging()
    curve = joint_spring.on_joints(terms)[PAN][which]
    assert curve.variant == "curve" and curve.shape["pieces"] == pieces and curve.size == pieces + 3
    assert curve.cost == 1.0
    q = terms.records.records[0].q[:, PAN]
    low, high = q.min(), q.max()
    wanted = terms.records.reduce(lambda r: np.cos(4.0 * r.q[:, [PAN]]))[:, 0]
    c, *_ = np.linalg.lstsq(curve.columns[:, 0], wanted, rcond=None)
    assert np.max(np.abs(curve.columns[:, 0] @ c - wanted)) < 0.02
    angles, torques = np.split(told(curve, c)["curve"], 2)
    assert len(angles) == 2 * pieces + 1
    np.testing.assert_allclose([angles[0], angles[-1]], [low, high])
    np.testing.assert_allclose(torques[1:-1], np.cos(4.0 * angles[1:-1]), atol=0.05)
    assert disagreement(terms, curve, list(c)) < 0.05
    assert curve.allows(c) and curve.allows(-c)


@pytest.mark.parametrize("count", [40.0, 101.5])
def test_a_ripple_is_a_sine_of_the_angle(count: float) -> None:
    terms = swinging()
    candidate = torque_ripple.ripple(terms, PAN, count)
    assert candidate is not None
    assert disagreement(terms, candidate, [0.6, -0.8]) < 1e-6
    values = told(candidate, np.array([0.6, -0.8]))
    assert values["amplitude"] == pytest.approx([1.0]) and values["cycles"] == [count]
    assert values["phase"] == pytest.approx([np.arctan2(-0.8, 0.6)])
    np.testing.assert_allclose(sized(terms, candidate), 1.0, rtol=1e-9)
    assert candidate.allows(np.array([-5.0, -5.0]))
    again = torque_ripple.rebuilt(terms, candidate, "cycles", count + 1.0)
    assert again is not None and again.shape["cycles"] == count + 1.0


def test_ripple_counts_are_as_close_as_the_range_tells_them_apart() -> None:
    """Nearly half of 2π over the range; the price is the logarithm of how many there are."""
    terms = swinging()
    record = terms.records.records[0]
    travelled = float(np.ptp(record.q[:, PAN]))
    step = 0.4 * 2.0 * np.pi / travelled
    assert torque_ripple.count_step(terms, PAN) == pytest.approx(step)
    counts = torque_ripple.ripple_counts(terms, PAN)
    np.testing.assert_allclose(np.diff(counts), step)
    assert counts[0] == pytest.approx(max(4.0, 3.75 * step))
    most = 2.0 * np.pi * record.band / float(np.median(np.abs(record.v[:, PAN])))
    assert most - step <= counts[-1] < most < 320.0
    slow = terms_with(terms, v=0.01 * record.v)
    assert 320.0 - step <= torque_ripple.ripple_counts(slow, PAN)[-1] < 320.0
    candidate = torque_ripple.ripple(terms, PAN, 50.0)
    assert candidate is not None
    assert candidate.cost == pytest.approx(np.log(0.4 * len(counts)))
    ((key, low, high),) = torque_ripple.shapes(terms, candidate)
    assert key == "cycles" and low == pytest.approx(1.0 - step / 50.0) and high == pytest.approx(1.0 + step / 50.0)
    few = torque_ripple.ripple(terms, PAN, counts[0])
    assert few is not None and torque_ripple.shapes(terms, few)[0][1:] == pytest.approx(
        (1.0 - min(0.3, step / counts[0]), 1.0 + min(0.3, step / counts[0]))
    )
    lowest = counts[0]
    assert torque_ripple.ripple(terms, PAN, 0.59 * lowest) is None
    assert torque_ripple.ripple(terms, PAN, 0.61 * lowest) is not None
    wide = terms_with(terms, q=record.q * 20.0)
    assert torque_ripple.ripple_counts(wide, PAN)[0] == 4.0
    for share, there in ((0.24 / travelled, False), (0.26 / travelled, True)):
        still = terms_with(terms, q=record.q * share, v=record.v * share)
        assert bool(len(torque_ripple.ripple_counts(still, PAN))) == there, "a step above 10 is 0.25 rad of range"


def terms_with(terms: Terms, **changed: Array) -> Terms:
    record = replace(terms.records.records[0], **changed)  # type: ignore[arg-type]
    return replace(terms, records=replace(terms.records, records=(record,)))


def test_ripples_of_one_joint_are_two_beyond_two_counts() -> None:
    terms = swinging()
    made = {count: torque_ripple.ripple(terms, PAN, count) for count in (40.0, 41.95, 42.05, 37.95)}
    one = made[40.0]
    assert one is not None
    apart = [torque_ripple.apart(one, other) for other in made.values() if other is not None]
    assert apart == [False, False, True, True]


def test_a_dip_near_rest_has_its_price() -> None:
    """Down to 0.03 rad/s the price of eight speeds; at 0.014, ten nats more; below, none is thought of."""
    terms = swinging()
    costs = {}
    for speed in (0.0139, 0.0141, np.sqrt(0.014 * 0.03), 0.031, 0.2):
        made = stribeck_friction.stribeck(terms, PAN, float(speed))
        costs[round(float(speed), 4)] = None if made is None else made.cost - np.log(4.0)
    assert costs[0.0139] is None
    assert costs[0.0141] == pytest.approx(9.9, abs=0.1)
    assert costs[0.0205] == pytest.approx(5.0, abs=0.01)
    assert costs[0.031] == costs[0.2] == pytest.approx(0.0)
    speeds = [c.shape["stribeck_velocity"] for c in stribeck_friction.on_joints(terms)[PAN]]
    np.testing.assert_allclose(np.diff(np.log(speeds)), np.log(0.5 / 0.016) / 7.0)
    assert speeds[0] == pytest.approx(0.016) and len(speeds) == 8
    values = told(stribeck_friction.on_joints(terms)[PAN][0], np.array([2.0, 0.5]))
    assert values["coulomb"] == [2.0] and values["static"] == [2.5]
    candidate = stribeck_friction.on_joints(terms)[PAN][2]
    assert stribeck_friction.shapes(terms, candidate) == [("stribeck_velocity", 0.55, 1.8)]
    again = stribeck_friction.rebuilt(terms, candidate, "stribeck_velocity", 0.07)
    assert again is not None and again.shape["stribeck_velocity"] == 0.07 and again.joints == (PAN,)


@pytest.mark.parametrize(("speed", "one"), [(0.119, True), (0.121, False), (0.081, True), (0.079, False)])
def test_two_dips_at_much_the_same_speed_are_one(speed: float, one: bool) -> None:
    here = {"coulomb": [1.0], "static": [2.0], "stribeck_velocity": [speed]}
    more = {"coulomb": [0.5], "static": [0.25], "stribeck_velocity": [0.1]}
    merged = stribeck_friction.merge(here, more)
    assert (merged is not None) == one
    if merged is not None:
        assert merged == {"coulomb": [1.5], "static": [2.25], "stribeck_velocity": [speed]}


def test_two_springs_are_one_about_the_rest_of_both() -> None:
    one, two = {"stiffness": [30.0], "rest_angle": [0.4]}, {"stiffness": [10.0], "rest_angle": [-0.8]}
    assert joint_spring.merge(one, two) == {"stiffness": [40.0], "rest_angle": [pytest.approx(0.1)]}
    q = 0.7
    assert 40.0 * (q - 0.1) == pytest.approx(30.0 * (q - 0.4) + 10.0 * (q + 0.8))
    none = joint_spring.merge(one, {"stiffness": [-30.0], "rest_angle": [0.4]})
    assert none == {"stiffness": [0.0], "rest_angle": [0.0]}
    little = joint_spring.merge({"stiffness": [1.5e-9], "rest_angle": [2.0]}, {"stiffness": [0.0], "rest_angle": [0.0]})
    assert little is not None and little["rest_angle"] == [pytest.approx(2.0)]
    less = joint_spring.merge({"stiffness": [0.7e-9], "rest_angle": [2.0]}, {"stiffness": [0.0], "rest_angle": [0.0]})
    assert less is not None and less["rest_angle"] == [0.0]
    assert joint_spring.merge({"curve": [0.0, 1.0]}, {"curve": [0.0, 1.0]}) is None


@pytest.mark.parametrize(
    ("lost", "level"), [(-1.0, 3.0), (-4.0, 0.0), (-3.82, 0.0), (-4.18, 0.0), (-3.78, 0.22), (-4.22, -0.22)]
)
def test_wear_is_taken_off_both_levels_of_a_dip(lost: float, level: float) -> None:
    """A loss of a twentieth more or less than the level leaves nothing."""
    here = {"coulomb": [4.0], "static": [6.0], "stribeck_velocity": [0.1]}
    left = coulomb_friction.worn(here, {"torque": [lost]})
    assert left is not None
    assert left["coulomb"] == [pytest.approx(level)] and left["static"] == [pytest.approx(6.0 + lost)]
    assert left["stribeck_velocity"] == [0.1]
    assert coulomb_friction.worn(here, {"torque_positive": [lost], "torque_negative": [lost]}) is None


def test_every_joint_has_a_candidate_of_each_plain_law() -> None:
    terms = swinging()
    for make, *_ in PLAIN:
        made = make(terms)
        assert [candidates[0].joints[0] for candidates in made] == list(range(len(ARM.joints)))
