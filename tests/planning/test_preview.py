"""Where the arm will be a second from now: by the plan or by its speed, and how sure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram.model.model import Model
from twin_diagram.planning.preview import AHEAD, RATE, REMEMBERED, SETS_OFF, Foresight, Preview
from twin_diagram.signals.arrays import Array

HOME = np.array([0.0, 0.1, 0.0, -2.0, 0.0, 2.1, 0.8])
Motion = Callable[[float], Array]


@pytest.fixture(scope="module")
def panda() -> Model:
    return Model.load("arms/panda.urdf")


class Told(LeafSystem):
    """What a function of time says."""

    def __init__(self, size: int, says: Motion) -> None:
        super().__init__()
        self._says = says
        self.DeclareVectorOutputPort("told", size, self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._says(context.get_time()))


def wave(t: float) -> Array:
    """To and fro by 0.4 rad every three seconds: at the speed of now it would be elsewhere a second later."""
    return HOME + 0.4 * np.sin(2 * np.pi * t / 3.0) * np.eye(7)[0]


def state(q: Motion) -> Motion:
    return lambda t: np.concatenate([q(t), (q(t + 1e-6) - q(t - 1e-6)) / 2e-6])


def built(panda: Model, q: Motion, planned: Motion | None, P: Array | None = None) -> tuple[Diagram, Preview]:
    builder = DiagramBuilder()
    P = np.zeros((16, 16)) if P is None else P
    preview = builder.AddSystem(Preview(panda, P.size))
    arm = builder.AddSystem(Told(14, state(q)))
    builder.Connect(arm.get_output_port(), preview.GetInputPort("arm_state"))
    covariance = builder.AddSystem(ConstantVectorSource(P.ravel()))
    builder.Connect(covariance.get_output_port(), preview.GetInputPort("covariance"))
    if planned is not None:
        plan = builder.AddSystem(Told(7, planned))
        builder.Connect(plan.get_output_port(), preview.GetInputPort("position_planned"))
    return builder.Build(), preview


def seen(preview: Preview, root: Context) -> tuple[Array, Array]:
    own = preview.GetMyContextFromRoot(root)
    position, covariance = (
        cast(Array, np.array(preview.GetOutputPort(name).Eval(own)))
        for name in ("position_previewed", "preview_covariance")
    )
    return position, covariance.reshape(7, 7)


def run(diagram: Diagram, until: float) -> Context:
    simulator = Simulator(diagram)
    simulator.Initialize()
    simulator.AdvanceTo(until)
    return cast(Context, simulator.get_context())


def test_a_plan_that_is_kept_is_believed_and_is_sure(panda: Model) -> None:
    P = np.zeros((16, 16))
    P[:7, :7] = 1e-8 * np.eye(7)
    diagram, preview = built(panda, wave, lambda t: wave(t + AHEAD), P)
    root = run(diagram, 4.0)
    position, covariance = seen(preview, root)
    np.testing.assert_allclose(position, wave(5.0), atol=1e-12)
    np.testing.assert_allclose(covariance, P[:7, :7], atol=1e-15)  # what the filter is not sure of, and no more


def test_a_plan_that_is_off_by_as_much_each_time_says_so(panda: Model) -> None:
    off = np.array([0.0, 0.01, 0.0, -0.02, 0.0, 0.0, 0.0])
    diagram, preview = built(panda, wave, lambda t: wave(t + AHEAD) + off)
    _, covariance = seen(preview, run(diagram, 6.0))
    assert np.trace(covariance) == pytest.approx(off @ off)
    seconds = 5.0 - 0.5  # of errors, most of them on the way
    along = off @ covariance @ off / (off @ off) / np.trace(covariance)
    assert along == pytest.approx((seconds + 1.0) / (seconds + 7.0), abs=0.06)  # the rest is even: so few tell little


def test_an_arm_that_something_else_moves_goes_on_at_its_speed(panda: Model) -> None:
    """A replayed log follows no plan of ours, which stays where it is."""

    def on(t: float) -> Array:
        return HOME + 0.05 * t * np.eye(7)[0]

    diagram, preview = built(panda, on, on)  # the plan: to stay
    position, covariance = seen(preview, run(diagram, 3.0))
    np.testing.assert_allclose(position, on(4.0), atol=1e-9)
    assert np.abs(covariance).max() < 1e-15
    diagram, preview = built(panda, on, None)
    np.testing.assert_allclose(seen(preview, run(diagram, 3.0))[0], on(4.0), atol=1e-9)


def test_a_plan_is_followed_unless_the_speed_clearly_foretells_more() -> None:
    """After one way that was foreseen wrongly, previews went past a goal by 0.37 m that the plan led to."""
    for plan, better in ((0.9, 0), (9.9, 0), (10.1, 1)):
        squares = np.zeros((2, 2, 1, 1))
        squares[1, :, 0, 0] = plan, 1.0
        assert replace(Foresight.begin(1), counts=np.array([3.0, 7.0]), squares=squares).better == better
    assert Foresight.begin(1).better == 0


def test_before_the_first_comes_due_the_whole_way_may_be_wrong(panda: Model) -> None:
    diagram, preview = built(panda, wave, lambda t: wave(t + AHEAD))
    position, covariance = seen(preview, run(diagram, 0.5))
    way = position - wave(0.5)
    np.testing.assert_allclose(covariance, way @ way / 7 * np.eye(7), atol=1e-12)


def test_joints_that_would_pass_their_ends_stop_there(panda: Model) -> None:
    diagram, preview = built(panda, lambda t: HOME + 1.5 * t * np.eye(7)[0], None)
    root = run(diagram, 1.9)
    preview_position, _ = seen(preview, root)
    assert preview_position[0] == pytest.approx(panda.upper[0])


def test_nothing_is_learned_before_the_arm_speaks_or_of_what_is_not_finite() -> None:
    after = Foresight.begin(7).learned(HOME, np.stack([HOME, HOME]))
    assert not after.counts.any() and np.isfinite(after.waiting[-1]).all()
    for _ in range(15):
        after = after.learned(HOME, np.full((2, 7), np.nan))
    assert after.counts.sum() == 1  # the first one came due; those that are not finite never do
    assert after.learned(HOME, np.stack([HOME, HOME])).counts.sum() == 1
    packed = after.pack()
    np.testing.assert_array_equal(Foresight.unpack(packed, 7).pack(), packed)


def test_old_errors_fade() -> None:
    kept, count = Foresight.begin(1), round(REMEMBERED * RATE)
    for _ in range(round(AHEAD * RATE) + count):
        kept = kept.learned(np.ones(1), np.zeros((2, 1)))
    assert kept.squares[0, 0, 0, 0] == pytest.approx(1.0)
    for _ in range(count):
        kept = kept.learned(np.zeros(1), np.zeros((2, 1)))
    assert kept.squares[0, 0, 0, 0] == pytest.approx(np.exp(-1.0), rel=0.02)


def test_what_is_asked_right_after_a_preview_was_kept_is_of_the_same_kind() -> None:
    """A drawing falls on the tick that keeps a preview: a plan that had not moved since passed for one that rests."""
    kept, k = Foresight.begin(1), 0
    for k in range(40):
        kept = kept.learned(np.full(1, 0.1 * k), np.full((2, 1), 0.1 * (k + 15) + 0.01))
    resting, going = kept.squares[:, 0, 0, 0]
    assert going == pytest.approx(1e-4) and resting in (0.0, pytest.approx(1e-4))
    q, now = np.full(1, 0.1 * k), kept.waiting[-1]
    assert kept.goes_on(now, back=2)
    assert kept.square(now, q)[0, 0] == pytest.approx(going)
    halfway = replace(kept, squares=kept.squares * np.array([4.0, 1.0])[:, None, None, None])
    assert halfway.square(now, q)[0, 0] == pytest.approx(going)


def test_what_a_plan_says_on_its_way_is_surer_than_that_it_will_rest(panda: Model) -> None:
    """An arm that sets off again and again: that it rests is often wrong, where it goes to never is."""

    def steps(t: float) -> Array:
        return HOME + 0.2 * np.clip(t % 8.0 - 2.0, 0.0, 3.0) * np.eye(7)[0]

    def planned(t: float) -> Array:  # a plan knows of a way once it is begun
        return steps(t + AHEAD) if 2.0 <= t % 8.0 < 5.0 else steps(t)

    diagram, preview = built(panda, steps, planned)
    simulator = Simulator(diagram)
    simulator.Initialize()
    simulator.AdvanceTo(17.0)
    resting = seen(preview, simulator.get_context())[1][0, 0]
    simulator.AdvanceTo(19.0)
    going = seen(preview, simulator.get_context())[1][0, 0]
    assert resting > 4.0 * going


def test_an_arm_that_rests_may_be_told_to_go() -> None:
    """What was right while it rested says nothing of when a step begins; on its way it is as sure as it was."""
    reach, still = np.array([0.6, 1.2]), np.zeros((2, 2))
    kept = Foresight.begin(2)
    first = kept.learned(np.zeros(2), still).square(still, np.zeros(2), reach)
    assert np.trace(first) == pytest.approx(SETS_OFF**2 * reach @ reach)
    seconds = 3
    for _ in range(round((AHEAD + seconds) * RATE)):
        kept = kept.learned(np.zeros(2), still)
    later = kept.square(still, np.zeros(2), reach)
    assert np.trace(later) == pytest.approx(np.trace(first) / (1 + seconds))
    assert not kept.square(still, np.zeros(2)).any(), "nobody tells it to go"
    going = np.ones((2, 2))
    np.testing.assert_array_equal(kept.square(going, np.zeros(2), reach), kept.square(going, np.zeros(2)))


def test_two_contexts_do_not_meet_and_angles_count_anew_in_one(panda: Model) -> None:
    off = 0.05 * np.eye(7)[1]
    diagram, preview = built(panda, wave, lambda t: wave(t + AHEAD))
    one, two = (run(diagram, 2.0) for _ in range(2))
    np.testing.assert_array_equal(seen(preview, one)[1], seen(preview, two)[1])
    preview.recount(preview.GetMyMutableContextFromRoot(one), off)
    kept = [preview._kept(preview.GetMyContextFromRoot(each)).waiting for each in (one, two)]
    np.testing.assert_allclose(kept[0] - kept[1], np.broadcast_to(off, kept[0].shape), atol=1e-12)
