"""Motions that are looked for: slopes, limits, grip, surroundings."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from tests.estimation.weighing.conftest import POSTURE
from twin_diagram.estimation.weighing import (
    Excitation,
    ExcitationPlan,
    Grip,
    MotionLimits,
    Shape,
    WeighingError,
    crlb,
    feed_forward,
    optimise_excitation,
)
from twin_diagram.estimation.weighing.carried_motion import CarriedMotion
from twin_diagram.estimation.weighing.excitation import _improved, _share_within, _stricter
from twin_diagram.estimation.weighing.excitation_cost import ExcitationCost
from twin_diagram.estimation.weighing.harmonics import Harmonics
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.model import Model

SHORT = ExcitationPlan(period=4.0, harmonics=5, starts=1, steps=6)
SHORTEST = ExcitationPlan(period=4.0, harmonics=4, starts=1, steps=2)


@pytest.fixture(scope="module")
def carried(iiwa: Model, X_TO: RigidTransform, off_centre: np.ndarray) -> CarriedMotion:
    return CarriedMotion(iiwa, Held.in_tool(iiwa, X_TO), off_centre, X_TO.inverse(), POSTURE)


def test_the_hand_gives_what_joints_feel(carried: CarriedMotion, iiwa: Model, plain: Excitation) -> None:
    q, v, a = plain.sampled(5.0)[1]
    asked = carried.asked(q, v, a)
    by_object = asked.Y @ carried.parameters
    np.testing.assert_allclose(asked.torque, iiwa.inverse_dynamics(q, v, a) + by_object, atol=1e-9)
    for k in range(0, len(q), 7):  # virtual work: Jᵀ of the wrench at the tool, where G is
        R = iiwa.tool_pose(q[k]).rotation().matrix()
        force, moment = R @ asked.wrench[k, :3], R @ asked.wrench[k, 3:]
        J = iiwa.tool_jacobian(q[k])
        np.testing.assert_allclose(J[:3].T @ moment + J[3:].T @ force, by_object[k], atol=1e-8)


def test_at_rest_the_hand_carries_the_weight(carried: CarriedMotion) -> None:
    zero = np.zeros((1, 7))
    wrench = carried.asked(POSTURE[None], zero, zero).wrench[0]
    assert np.linalg.norm(wrench[:3]) == pytest.approx(0.8 * 9.81, rel=1e-3)


def test_slopes(carried: CarriedMotion, plain: Excitation) -> None:
    q, v, a = plain.sampled(1.0)[1]
    _, slopes = carried.with_slopes(q, v, a)
    step = 1e-4
    for k, (dq, dv, da) in {2: (1, 0, 0), 8: (0, 1, 0), 20: (0, 0, 1)}.items():
        e = step * np.eye(7)[k % 7]
        plus, minus = (carried.asked(q + s * dq * e, v + s * dv * e, a + s * da * e) for s in (1, -1))
        for name in ("Y", "torque", "wrench"):
            numeric = (getattr(plus, name) - getattr(minus, name)) / (2 * step)
            np.testing.assert_allclose(getattr(slopes, name)[k], numeric, atol=2e-4)


def test_the_slope_of_the_cost_with_every_limit_passed(carried: CarriedMotion, iiwa: Model) -> None:
    limits = MotionLimits.of(iiwa)
    tight = replace(limits.near(POSTURE, 0.3), acceleration=0.5 * limits.acceleration, torque=0.5 * limits.torque)
    cost = ExcitationCost.of(carried, tight, Grip(15.0), Harmonics(4.0, 5))
    x = cost.drawn(np.random.default_rng(0))
    x[7:] *= 2.0
    use = cost.use(x, cost.time)
    assert min(use.values()) > 1.0, use
    value, slope = cost.value_and_slope(x, 0.1)
    for k in (0, 3, 5, 6, 9, 20, 33, 50):
        e = 1e-5 * np.eye(len(x))[k]
        numeric = (cost.value_and_slope(x + e, 0.1)[0] - cost.value_and_slope(x - e, 0.1)[0]) / 2e-5
        assert slope[k] == pytest.approx(numeric, rel=1e-3, abs=1e-4), k
    assert cost.value_and_slope(x, 0.2)[0] > value


def test_what_is_told_is_what_the_bound_says(carried: CarriedMotion, iiwa: Model, X_TO: RigidTransform) -> None:
    cost = ExcitationCost.of(carried, MotionLimits.of(iiwa), None, Harmonics(10.0, 15))
    x = cost.drawn(np.random.default_rng(1))
    q, v, a = cost.motion(x, np.arange(1000) / 100.0)
    bound = crlb(iiwa, X_TO, carried.parameters, (q, v, a), 0.05)
    errors = np.concatenate([[bound.mass / 0.001], bound.centre / 0.0005, bound.moments / 0.12])
    told = np.exp(cost.value_and_slope(x, 0.0)[0])
    assert told == pytest.approx(np.sum(errors**4) ** 0.25, rel=0.1)  # dry friction is wider in the cost


def test_it_is_much_better_than_its_start_and_meets_the_targets(
    excitation: Excitation, iiwa: Model, X_TO: RigidTransform, box: Shape
) -> None:
    assert excitation.bound is not None
    assert excitation.bound.mass < 0.001
    assert np.all(excitation.bound.centre < 0.0005)
    assert np.all(excitation.bound.moments < 0.18)
    again = crlb(iiwa, X_TO, box.even(0.5), excitation.sampled(100.0)[1], 0.05)
    np.testing.assert_allclose(again.moments, excitation.bound.moments)


def test_every_limit_is_kept_at_all_times(
    excitation: Excitation, iiwa: Model, X_TO: RigidTransform, box: Shape
) -> None:
    q, v, a = excitation.sampled(500.0)[1]
    limits = MotionLimits.of(iiwa)
    held = Held.in_tool(iiwa, X_TO)
    torque = iiwa.inverse_dynamics(q, v, a) + held.regressor(iiwa, q, v, a) @ box.even(0.5)
    for value, bound in ((v, limits.velocity), (a, limits.acceleration), (torque, limits.torque)):
        assert np.max(np.abs(value) / bound) < 1.003
    assert np.all(q > limits.lower - 1e-3)
    assert np.all(q < limits.upper + 1e-3)
    # All of the limit that binds is made use of, not 95 % of it, as is aimed at between samples.
    assert 0.995 <= max(excitation.use.values()) <= 1.0


def test_it_rests_at_both_ends_and_outside(excitation: Excitation) -> None:
    q, v, a = excitation.at(np.array([-1.0, 0.0, 10.0, 11.0]))
    np.testing.assert_allclose(q, np.tile(excitation.posture, (4, 1)), atol=1e-9)
    np.testing.assert_allclose(v, 0.0, atol=1e-9)
    np.testing.assert_allclose(a, 0.0, atol=1e-8)


@pytest.mark.long
def test_a_weaker_grip_moves_it_less(iiwa: Model, X_TO: RigidTransform, box: Shape) -> None:
    heavy = box.even(1.5)
    held = Held.in_tool(iiwa, X_TO)
    grip = Grip(30.0)
    found = optimise_excitation(iiwa, X_TO, heavy, POSTURE, grip=grip, plan=SHORT)
    q, v, a = found.sampled(200.0)[1]
    carried = CarriedMotion(iiwa, held, heavy, X_TO.inverse(), POSTURE)
    assert grip.use(carried.asked(q, v, a).wrench).max() <= 1.003
    with pytest.raises(WeighingError, match="limit of grip: at rest it takes"):
        optimise_excitation(iiwa, X_TO, heavy, POSTURE, grip=Grip(5.0), plan=SHORT)


def test_where_limits_leave_little_of_a_motion_one_is_found_of_which_they_leave_more(
    carried: CarriedMotion, iiwa: Model
) -> None:
    """A grip that carries the weight and little more: the first search counts too little what goes beyond it."""
    grip = Grip(75.0, 0.3, 0.011, 0.009, share=1.2)
    limits = MotionLimits.of(iiwa).near(POSTURE, np.full(7, np.pi))
    cost = ExcitationCost.of(carried, limits, grip, Harmonics(5.0, 4))
    x = cost.drawn(np.random.default_rng(2))
    share = _share_within(cost, x)
    assert share < 0.6
    better = _stricter(cost, x)
    kept = [cost.scaled(y, s) for y, s in ((x, share), (better, _share_within(cost, better)))]
    assert max(cost.use(kept[1], np.arange(0.0, 5.0, 0.01)).values()) <= 1.0
    told = [cost.value_and_slope(y, 0.0)[0] for y in kept]  # logarithms of standard errors
    assert told[1] < told[0] - np.log(2.0)


def test_what_asks_too_much_between_samples_is_mended_there_and_not_made_small(iiwa: Model) -> None:
    """Grips carry most of their share at rest: 2 % too much for a moment took two thirds of a motion away."""
    X_TO, even = RigidTransform(np.array([0.0, 0.0, 0.02])), Shape.box(np.array([0.06, 0.09, 0.175])).even(1.0)
    carried = CarriedMotion(iiwa, Held.in_tool(iiwa, X_TO), even, X_TO.inverse(), POSTURE)
    rest = carried.asked(POSTURE[None], np.zeros((1, 7)), np.zeros((1, 7))).wrench
    grip = Grip(60.0, 0.3, 0.02, 0.03)
    grip = replace(grip, share=1.1 * grip.share * float(grip.use(rest)[0]))
    cost = ExcitationCost.of(carried, MotionLimits.of(iiwa).near(POSTURE, 0.6), grip, Harmonics(4.0, 6))
    x = _improved(cost, cost.drawn(np.random.default_rng(0)), 25, 3.0)[1]
    x = _improved(cost, x, 10, 30.0)[1]
    asked = cost.use(x, np.arange(0.0, 4.0, 0.01))["grip"]
    cost = replace(cost, grip=replace(grip, share=grip.share * asked / 1.02))
    assert _share_within(cost, x) < 0.5
    mended = _stricter(cost, x)
    assert _share_within(cost, mended) > 0.95
    told = [cost.value_and_slope(y, 0.0)[0] for y in (x, mended)]  # logarithms of standard errors
    assert told[1] < told[0] + np.log(1.25)


def test_the_grips_forces_are_told_at_its_own_centre(iiwa: Model, box: Shape) -> None:
    """A box held at its middle, 2 cm behind the tool's origin, does not turn between the pads when at rest."""
    X_TO = RigidTransform(RotationMatrix(), [0.0, 0.0, -0.02])
    heavy = box.even(1.5)
    for centre, holds in (((0.0, 0.0, -0.02), True), ((0.2, 0.0, -0.02), False)):
        carried = CarriedMotion(
            iiwa, Held.in_tool(iiwa, X_TO), heavy, X_TO.inverse() @ RigidTransform(np.array(centre)), POSTURE
        )
        at_rest = carried.asked(POSTURE[None][:, carried.held.rows], *2 * [np.zeros((1, len(carried.held.rows)))])
        assert (Grip(25.0).use(at_rest.wrench)[0] <= 1.0) == holds
    grip = Grip(25.0, centre=(0.0, 0.0, -0.02))
    assert optimise_excitation(iiwa, X_TO, heavy, POSTURE, grip=grip, plan=SHORT).use["grip"] <= 1.0


def test_it_stays_clear_of_what_a_predicate_tells(iiwa: Model, X_TO: RigidTransform, box: Shape) -> None:
    def clear(q: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(q[:, 5] - POSTURE[5]) < 0.4)

    found = optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, clear=clear, plan=SHORTEST)
    assert np.all(clear(found.sampled(300.0)[1][0]))
    free = optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, plan=SHORTEST)
    assert not np.all(clear(free.sampled(300.0)[1][0]))
    with pytest.raises(WeighingError, match="no motion about this posture is clear"):
        optimise_excitation(
            iiwa, X_TO, box.even(0.5), POSTURE, clear=lambda q: np.abs(q - POSTURE).max(axis=1) < 1e-6, plan=SHORTEST
        )


def test_the_slope_of_what_is_missing_of_room(carried: CarriedMotion, iiwa: Model) -> None:
    def room(q: np.ndarray) -> np.ndarray:
        off = q - POSTURE
        return np.column_stack(
            [0.05 - 0.1 * off[:, 3] ** 2 - 0.05 * off[:, 5] * off[:, 1], 0.02 * np.cos(2.0 * off[:, 6])]
        )

    limits = MotionLimits.of(iiwa).near(POSTURE, np.full(7, np.pi))
    cost, free = (ExcitationCost.of(carried, limits, None, Harmonics(4.0, 5), one) for one in (room, None))
    x = cost.drawn(np.random.default_rng(0))
    value, slope = cost.value_and_slope(x, 0.1)
    assert value > free.value_and_slope(x, 0.1)[0]
    for k in (1, 3, 5, 6, 10, 12, 19, 20, 50):
        e = 1e-5 * np.eye(len(x))[k]
        numeric = (cost.value_and_slope(x + e, 0.1)[0] - cost.value_and_slope(x - e, 0.1)[0]) / 2e-5
        assert slope[k] == pytest.approx(numeric, rel=2e-3, abs=1e-3), k


@pytest.mark.long
def test_where_room_is_told_only_what_comes_near_is_narrowed(iiwa: Model, X_TO: RigidTransform, box: Shape) -> None:
    """Two joints of the arm are barred; where nobody told by how much, all were narrowed, the wrist's too."""

    def room(q: np.ndarray) -> np.ndarray:
        return np.asarray(0.2 * (0.3 - np.abs(q[:, [1, 3]] - POSTURE[[1, 3]])))

    def clear(q: np.ndarray) -> np.ndarray:
        return np.asarray((room(q) >= 0.0).all(axis=1))

    plan = ExcitationPlan(period=4.0, harmonics=6, starts=1, steps=20)
    narrowed = optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, clear=clear, plan=plan)
    found = optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, clear=clear, plan=plan, room=room)
    q = [one.sampled(200.0)[1][0] for one in (narrowed, found)]
    assert clear(found.sampled(100.0)[1][0]).all() and max(found.use.values()) <= 1.0
    assert np.ptp(q[1][:, 4:], axis=0).sum() > 1.5 * np.ptp(q[0][:, 4:], axis=0).sum()
    assert narrowed.bound is not None and found.bound is not None
    assert found.bound.moments.max() < 0.8 * narrowed.bound.moments.max()


def test_a_motion_that_comes_a_little_too_near_is_scaled_down_a_little(
    iiwa: Model, X_TO: RigidTransform, box: Shape
) -> None:
    free = optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, plan=SHORTEST)
    most = np.abs(free.sampled(100.0)[1][0] - free.posture).max(axis=0)

    def clear(q: np.ndarray) -> np.ndarray:
        return np.asarray((np.abs(q - free.posture) <= 0.9 * most).all(axis=1))

    start = np.abs(POSTURE - free.posture) <= 0.9 * most
    assert start.all()
    found = optimise_excitation(iiwa, X_TO, box.even(0.5), POSTURE, clear=clear, plan=SHORTEST)
    assert clear(found.sampled(100.0)[1][0]).all()
    np.testing.assert_allclose(found.scale / free.scale, 0.9, atol=0.005)
    np.testing.assert_allclose(found.posture, free.posture)


def test_what_cannot_be_is_refused(iiwa: Model, X_TO: RigidTransform, box: Shape) -> None:
    body = box.even(0.5)
    with pytest.raises(WeighingError, match="7 finite numbers"):
        optimise_excitation(iiwa, X_TO, body, POSTURE[:6], plan=SHORT)
    with pytest.raises(WeighingError, match="iiwa_joint_2 outside"):
        optimise_excitation(iiwa, X_TO, body, POSTURE + [0, 3, 0, 0, 0, 0, 0], plan=SHORT)
    with pytest.raises(WeighingError, match="not clear"):
        optimise_excitation(iiwa, X_TO, body, POSTURE, clear=lambda q: np.zeros(len(q), dtype=bool), plan=SHORT)
    with pytest.raises(WeighingError, match="not those of a body"):
        optimise_excitation(iiwa, X_TO, np.zeros(10), POSTURE, plan=SHORT)
    with pytest.raises(WeighingError, match="harmonics must be at least 3"):
        ExcitationPlan(harmonics=2)
    with pytest.raises(WeighingError, match="period must be positive"):
        ExcitationPlan(period=-1.0)


def test_limits_of_a_description(iiwa: Model) -> None:
    limits = MotionLimits.of(iiwa)
    np.testing.assert_allclose(limits.velocity, 0.9 * iiwa.velocity_limit)
    np.testing.assert_allclose(limits.torque, 0.9 * iiwa.effort_limit)
    np.testing.assert_allclose(limits.acceleration[-1], 22.0, rtol=0.01)
    np.testing.assert_allclose(limits.upper - iiwa.upper, -0.05)
    np.testing.assert_allclose(limits.lower - iiwa.lower, 0.05)
    near = limits.near(POSTURE, 0.1)
    np.testing.assert_allclose(near.upper - near.lower, 0.2)
    np.testing.assert_allclose(MotionLimits.of(iiwa, np.full(7, 5.0)).acceleration, 5.0)


def test_a_joint_without_ends_may_stand_anywhere(iiwa: Model, X_TO: RigidTransform, box: Shape) -> None:
    """A continuous wrist turned by more than half a turn; its limits were those of a turn about zero."""
    last = np.arange(7) == 6
    limits = MotionLimits.of(iiwa)
    free = replace(limits, lower=np.where(last, -np.inf, limits.lower), upper=np.where(last, np.inf, limits.upper))
    told = SimpleNamespace(
        joints=iiwa.joints,
        lower=np.where(last, -np.inf, iiwa.lower),
        upper=np.where(last, np.inf, iiwa.upper),
        velocity_limit=iiwa.velocity_limit,
        effort_limit=iiwa.effort_limit,
    )
    for name in ("lower", "upper"):
        np.testing.assert_array_equal(getattr(MotionLimits.of(told), name), getattr(free, name))  # type: ignore[arg-type]
    plan = ExcitationPlan(period=2.0, harmonics=3, starts=1, trial_steps=1, steps=2)
    posture = np.where(last, 4.0, POSTURE)
    motion = optimise_excitation(iiwa, X_TO, box.even(0.5), posture, free, plan=plan)
    assert np.abs(motion.sampled(50.0)[1][0][:, 6] - 4.0).max() < np.pi


def test_feed_forward_is_what_a_motion_takes_beyond_holding_the_arm(
    iiwa: Model, X_TO: RigidTransform, off_centre: np.ndarray, plain: Excitation
) -> None:
    q, v, a = plain.sampled(10.0)[1]
    torque = feed_forward(iiwa, X_TO, off_centre, (q, v, a))
    whole = CarriedMotion(iiwa, Held.in_tool(iiwa, X_TO), off_centre, X_TO.inverse(), POSTURE).asked(q, v, a).torque
    holding = iiwa.inverse_dynamics(q, 0 * v, 0 * a)
    np.testing.assert_allclose(torque + holding, whole, atol=1e-9)
    np.testing.assert_allclose(feed_forward(iiwa, X_TO, np.zeros(10), (q, 0 * v, 0 * a)), 0.0, atol=1e-9)
