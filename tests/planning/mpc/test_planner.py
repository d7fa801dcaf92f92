"""What a tick hands to the router and to the optimiser, against the rules told in words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import Forecast, Scene, load_scene
from twin_diagram.planning.mpc.margins import as_near_as, at_samples
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import FRESH, Memory
from twin_diagram.planning.mpc.trajectory_optimisation import Optimum, PlanProblem
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.planning.paths.guide import Answer, Question
from twin_diagram.planning.paths.searching import Searcher
from twin_diagram.planning.paths.situation import Aim, Route, Situation
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus, Track

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.16])
NONE = np.zeros(7)
PARAMS = scenario.Planner()


def track(velocity: float = 0.0, place: tuple[float, float, float] = (0.5, 0.1, 0.3)) -> Array:
    status = ObjectStatus.MOVING if velocity else ObjectStatus.TRACKED
    pose, speed = np.array([1.0, 0, 0, 0, *place]), np.array([0, 0, 0, velocity, 0, 0])
    return np.asarray(Track(status, 0.0, pose, speed, np.zeros((6, 6))).pack())


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], {"can": Asset.load(models_dir() / "objects" / "can")})


class Spied:
    """A planner whose router answers what it is told and whose optimiser leaves the plan before."""

    def __init__(self, scene: Scene, monkeypatch: pytest.MonkeyPatch, params: scenario.Planner = PARAMS) -> None:
        self.planner = MotionPlanner(scene, np.array([2.0, 2, 2, 2, np.inf, 2, 2]), params)
        self.route, self.wants = Route.none(7), False
        self.situation: Any = None
        self.answers: list[Answer | None] = []
        self.questions: list[Question] = []
        self.decided, self.works, self.fresh = 0, True, False
        self.asked: dict[str, Any] = {}

        def decide(route: Route, now: Situation, rng: Any, *, fresh: bool) -> tuple[Route, bool]:
            self.situation, self.fresh = now, fresh
            self.decided += 1
            return self.route, self.wants

        class Told(Searcher):
            def ask(_, question: Question) -> None:
                self.questions.append(question)

            def answer(_, question: Question) -> Answer | None:
                assert question is self.questions[-1]
                return self.answers.pop(0)

            def works(_) -> bool:
                return self.works

        def solve(problem: PlanProblem, guess: Array) -> Optimum:
            self.asked = {**problem._asdict(), "guess": guess}
            return Optimum(problem.fallback, 0.0, True)

        self.planner.searcher = Told()
        monkeypatch.setattr(self.planner.router, "decide", decide)
        monkeypatch.setattr(self.planner.optimiser, "solve", solve)

    def tick(
        self, memory: Memory, now: float, q: Array = HOME, v: Array = NONE, goal: Array = NONE, tracks: Any = None
    ):  # type: ignore[no-untyped-def]
        return self.planner.tick(memory, now, np.concatenate([q, v]), track() if tracks is None else tracks, goal)


@pytest.fixture
def spied(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Spied:
    return Spied(scene, monkeypatch)


@pytest.fixture
def at_home(spied: Spied) -> Memory:
    memory, _ = spied.tick(spied.planner.initial(HOME), 0.0)
    return memory  # type: ignore[no-any-return]


def test_limits_are_shares_of_the_arms(spied: Spied) -> None:
    share = PARAMS.velocity_share
    np.testing.assert_allclose(spied.planner.limits.velocity, share * np.array([2, 2, 2, 2, np.pi, 2, 2]))
    np.testing.assert_allclose(spied.planner.limits.acceleration, spied.planner.limits.velocity / 0.1)
    np.testing.assert_allclose(spied.planner.guide.settings.acceleration, 0.95 * spied.planner.limits.acceleration)
    np.testing.assert_allclose(spied.planner.router.speed, 0.95 * spied.planner.limits.velocity)


@pytest.mark.parametrize("influence", [0.07, 0.2])
def test_the_influence_is_the_optimisers_reach(scene: Scene, influence: float) -> None:
    planner = MotionPlanner(scene, np.full(7, 2.0), replace(PARAMS, influence=influence, clearance=0.04))
    assert planner.optimiser.tuning.reach == influence


@pytest.mark.parametrize("velocity", [0.0, 0.1])
def test_margins_grow_with_time_and_with_what_is_left_of_the_way(
    spied: Spied, at_home: Memory, velocity: float
) -> None:
    goals = HOME + np.array([[0.9, 0, 0, 0, 0, 0, 0], [0.6, 0, 0, 0, 0, 0, 0]])
    memory = replace(at_home, goals=goals, goal=GOAL, route=Route(Aim.GOAL, goals[:1]))
    spied.route = Route(Aim.GOAL, goals[1:])
    spied.tick(memory, 0.1, goal=GOAL, tracks=track(velocity))
    samples = spied.planner.optimiser.samples
    # A trapezoid of speed, at 0.95 of what joint 1 may do, braked on with six tenths of that.
    speed, harder = 0.95 * spied.planner.limits.velocity[0], 0.95 * spied.planner.limits.acceleration[0]
    ramp, braking = speed / harder, speed / (0.6 * harder)
    arrival = 0.6 / (0.95 * PARAMS.velocity_share * 2.0) + ramp / 2 + braking / 2
    clearance, at_goal = PARAMS.clearance, spied.situation.at_goals[1]
    np.testing.assert_array_equal(spied.situation.still, [True, velocity == 0.0])
    assert spied.situation.least == pytest.approx(0.25 * clearance)
    expected = np.empty((len(samples), 3))
    for row, t in enumerate(samples):
        most = clearance + 0.02 * min(t, 1.0)
        way = 0.1 * max(arrival - 0.15 - t, 0.0)
        near = np.clip(at_goal[:2] - 0.003 + way, 0.25 * clearance, most)
        expected[row] = [near[0], most if velocity else near[1], 0.01]
    np.testing.assert_allclose(spied.asked["margins"], expected)
    # What is followed is a tenth of a second ahead.
    ahead = samples + 0.1
    late = arrival - ahead
    up, down = speed * (ahead - ramp / 2), 0.6 - 0.6 * harder * np.maximum(late, 0.0) ** 2 / 2
    expected_way = np.where(late < braking, down, up)
    expected_way[ahead < ramp] = harder * ahead[ahead < ramp] ** 2 / 2
    np.testing.assert_allclose(spied.asked["reference"][:, 0], HOME[0] + expected_way, atol=1e-9)


def test_what_is_nearly_at_its_goal_may_be_as_near_to_things_as_there(spied: Spied) -> None:
    """A motion that runs past its end by millimetres is not pushed away from there."""
    samples = spied.planner.optimiser.samples
    far = np.array([1.0, 1.0])
    at_goal = np.array([[0.02, 1.0]])
    still = np.array([True])
    now = Situation(HOME, Forecast.of_tracks(track()), HOME[None], far, at_goal, still, 0.06, 0.01, 0.005)
    for duration in (0.0, 0.14, 0.4):
        left = np.maximum(duration - 0.15 - samples, 0.0)
        expected = np.stack([0.02 - 0.003 + 0.1 * left, np.full(len(samples), 0.005)], axis=1)
        np.testing.assert_allclose(at_samples(now, spied.planner.optimiser.samples, duration), expected)


def test_what_rests_beside_the_hand_is_left_gently_and_what_moves_is_not(spied: Spied) -> None:
    """A hand that is 2 cm from a thing, on its way to where there is none, is not pushed aside at once."""
    samples = spied.planner.optimiser.samples
    here, at_goal = np.array([0.02, 1.0, 0.005, 1.0]), np.full((1, 4), 1.0)
    full = 0.06 + 0.02 * np.minimum(samples, 1.0)
    for still in (True, False):
        now = Situation(
            HOME,
            Forecast.of_tracks(track()),
            HOME[None],
            here,
            at_goal,
            np.array([still, True, True]),
            0.06,
            0.01,
            0.004,
        )
        told = at_samples(now, spied.planner.optimiser.samples, 0.4)
        gentle = np.minimum(0.02 - 0.003 + 0.1 * samples, full)
        np.testing.assert_allclose(told[:, 0], gentle if still else full)
        np.testing.assert_allclose(told[:, 1], full)
        np.testing.assert_allclose(told[:, 2], np.minimum(0.01 + 0.1 * samples, full))  # the least is always wanted
        np.testing.assert_allclose(told[:, 3], 0.004)


def test_what_overlaps_at_rest_is_left_from_where_it_is_on(spied: Spied) -> None:
    """An arm that is 5 cm inside of something does not leap out of it."""
    samples = spied.planner.optimiser.samples
    here, still = np.array([-0.05, 1.0, 1.0]), np.array([True, True])
    now = Situation(HOME, Forecast.of_tracks(track()), HOME[None], here, np.ones((1, 3)), still, 0.06, 0.01, 0.004)
    full = 0.06 + 0.02 * np.minimum(samples, 1.0)
    np.testing.assert_allclose(
        at_samples(now, spied.planner.optimiser.samples, 0.4)[:, 0], np.minimum(-0.05 + 0.1 * samples, full)
    )


def test_what_rests_may_be_as_near_as_to_the_line_that_was_found_free(scene: Scene) -> None:
    """3 mm nearer, to be exact, but never nearer than the least; what moves keeps its distance."""
    planner = MotionPlanner(scene, np.full(7, 2.0), PARAMS)
    way = np.tile(HOME, (len(planner.optimiser.samples), 1))
    X = scene.chain.tool(scene.chain.place(HOME[None]))[0]
    for moves in (False, True):
        forecast = Forecast.of_tracks(track(0.1 if moves else 0.0, place=(X[0, 3] + 0.1, X[1, 3], X[2, 3])))
        around = scene.around(forecast, planner.optimiser.samples)
        now = planner.guide.margins_at(HOME, forecast, HOME[None])
        near = scene.clearance.distances(way, around, 1.0, own=False)
        margins = np.full(near.shape, 0.3)
        told = as_near_as(near, margins, now)
        least = 0.25 * PARAMS.clearance
        gentle = np.minimum(0.3, np.maximum(near[:, 1] - 0.003, least))
        np.testing.assert_allclose(told[:, 1], 0.3 if moves else gentle)
        assert moves or (gentle < 0.2).all()
        np.testing.assert_array_equal(told[:, -1], margins[:, -1])
        np.testing.assert_array_equal(margins, 0.3)


def test_what_a_line_leaves_may_stay_as_near_as_it_is(scene: Scene) -> None:
    """The line is ahead of the arm, which need not be jerked aside to be as far off as the line is by then."""
    planner = MotionPlanner(scene, np.full(7, 2.0), PARAMS)
    way = HOME + np.linspace(0.1, 0.5, len(planner.optimiser.samples))[:, None] * [0, -1, 0, 0, 0, 0, 0]
    X = scene.chain.tool(scene.chain.place(HOME[None]))[0]
    forecast = Forecast.of_tracks(track(place=(X[0, 3] + 0.1, X[1, 3], X[2, 3])))
    around = scene.around(forecast, planner.optimiser.samples)
    now = planner.guide.margins_at(HOME, forecast, HOME[None])
    near = scene.clearance.distances(way, around, 1.0, own=False)
    assert (near[:, 1] > now.here[1] + 0.003).all() and (np.diff(near[:, 1]) > 0).all()
    margins = np.full(near.shape, 0.3)
    ahead, behind = (as_near_as(near, margins, now, lagging=lagging) for lagging in (False, True))
    np.testing.assert_allclose(ahead[:, 1], np.minimum(0.3, near[:, 1] - 0.003))
    np.testing.assert_allclose(behind[:, 1], now.here[1] - 0.003)
    np.testing.assert_array_equal(behind[:, -1], 0.3)


def test_a_hand_goes_straight_up_beside_what_stands_close(scene: Scene) -> None:
    planner = MotionPlanner(scene, np.full(7, 2.0), PARAMS)
    X = scene.chain.tool(scene.chain.place(HOME[None]))[0]
    beside = track(place=(X[0, 3] + 0.08, X[1, 3] + 0.09, X[2, 3] - 0.05))
    near = scene.clearance.distances(HOME[None], scene.around(Forecast.of_tracks(beside), np.zeros(1)), 1.0)[0, 1]
    assert 0.02 < near < PARAMS.clearance, "nearer than is kept on a way"
    goal = np.concatenate([rotations.from_matrix(X[:3, :3]), X[:3, 3] + [0.0, 0.0, 0.08]])
    memory, _ = planner.tick(planner.initial(HOME), 0.0, np.concatenate([HOME, NONE]), beside, NONE)
    now, places = 0.0, []
    for _ in range(60):
        now += 1.0 / PARAMS.rate
        q, v, _ = (part[0] for part in memory.trajectory.at(np.array([now])))
        memory, _ = planner.tick(memory, now, np.concatenate([q, v]), beside, goal)
        places.append(scene.chain.tool(scene.chain.place(q[None]))[0, :3, 3])
    gone = np.array(places) - X[:3, 3]
    assert gone[-1, 2] > 0.075 and np.linalg.norm(gone[:, :2], axis=1).max() < 0.005


def test_without_a_goal_six_tenths_of_the_clearance_are_always_wanted(spied: Spied, at_home: Memory) -> None:
    spied.tick(at_home, 0.1)
    assert spied.situation.least == pytest.approx(0.6 * PARAMS.clearance)
    assert spied.situation.own == pytest.approx(0.01)


def test_distances_are_told_apart_up_to_what_is_spared(spied: Spied, scene: Scene) -> None:
    """Up to the clearance, 2 cm that a route spares or a plan keeps for surprises, and a centimetre."""
    rng = np.random.default_rng(0)
    q = HOME + 0.4 * rng.standard_normal((300, 7))
    forecast = Forecast.of_tracks(track())
    exact = scene.clearance.distances(q, scene.around(forecast, np.zeros(300)), 3.0)
    found = spied.planner.guide.situation(q[0], forecast, q[1:])
    every = np.vstack([found.here, found.at_goals])
    within = exact < PARAMS.clearance + 0.03
    assert (within & (exact > PARAMS.clearance))[:, :2].any()
    np.testing.assert_allclose(every[within], exact[within])
    assert (every[~within] >= PARAMS.clearance + 0.03).all()


def test_nowhere_to_go_means_coming_to_rest_in_half_a_second(spied: Spied, at_home: Memory) -> None:
    v = np.array([0.4, 0, 0, -0.2, 0, 0, 0])
    memory = replace(at_home, trajectory=replace(at_home.trajectory, v0=v))
    spied.tick(memory, 0.0, v=v)
    np.testing.assert_allclose(spied.asked["reference"], np.tile(HOME + 0.25 * v, (len(spied.asked["reference"]), 1)))
    np.testing.assert_allclose(spied.asked["v0"], v)
    # The same for a goal that is taken away.
    memory = replace(memory, goal=GOAL)
    memory, _ = spied.tick(memory, 0.0, v=v)
    for where in (memory.stay, memory.goals[0]):
        np.testing.assert_allclose(where, HOME + 0.25 * v)
    assert not memory.goal.any() and len(memory.goals) == 1


def test_a_plan_that_is_kept_as_the_best_counts_as_made_now_and_one_kept_for_want_of_any_does_not(
    spied: Spied, at_home: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Five ticks in a row found nothing better, and the monitor braked for a planner that hangs.
    memory = at_home
    for now in (0.02, 0.04, 0.06):
        memory, _ = spied.tick(memory, now)
        assert memory.trajectory.start == at_home.trajectory.start
        assert Memory.proved_at(memory.pack()) == now
    monkeypatch.setattr(spied.planner.optimiser, "solve", lambda *given: Optimum(at_home.trajectory, 0.0, solved=False))
    failed, _ = spied.tick(memory, 0.08)
    assert Memory.proved_at(failed.pack()) == 0.06
    held = spied.planner.hold(failed, 0.1, HOME)
    assert Memory.proved_at(held.pack()) == 0.1


def test_the_plan_starts_anew_where_the_arm_is_a_quarter_radian_off(spied: Spied, at_home: Memory) -> None:
    offset = np.array([0, 0.01, 0, 0, 0, 0, 0.0])
    for joint in (1, 3):
        for off, anew in ((0.249, False), (0.251, True)):
            q = HOME - offset - off * np.eye(7)[joint]
            memory, report = spied.tick(replace(at_home, offset=offset), 0.1, q=q, v=np.full(7, 0.3))
            assert report.reanchored == anew
            if anew:
                np.testing.assert_allclose(spied.asked["q0"], q)
                np.testing.assert_allclose(spied.asked["v0"], 0.3)
                assert not memory.offset.any()
            else:
                np.testing.assert_allclose(spied.asked["q0"], HOME - memory.offset)
    fast = np.full(7, 9.0)
    spied.tick(at_home, 0.1, q=HOME + 0.5, v=-fast)
    np.testing.assert_allclose(spied.asked["v0"], -spied.planner.limits.velocity)


def test_the_first_message_is_where_the_arm_begins_and_stays(spied: Spied) -> None:
    first = spied.planner.initial(HOME)
    assert first.trajectory.start == NEVER
    memory, report = spied.tick(first, 3.0, q=HOME + 0.01, v=np.full(7, 0.1))
    assert report.reanchored and memory.trajectory.start == 3.0 and memory.tick == 1
    np.testing.assert_allclose(memory.stay, HOME + 0.01)
    np.testing.assert_allclose(spied.asked["v0"], 0.0)
    memory, report = spied.tick(first, 3.0, q=HOME * np.nan)
    assert not report.reanchored and memory.trajectory.start == 3.0
    np.testing.assert_allclose(spied.asked["q0"], HOME)


@pytest.mark.parametrize("rate", [50.0, 1.0])
def test_plans_start_where_the_arm_is_but_for_what_it_lags_behind(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, rate: float
) -> None:
    """Within a tenth of a second beyond 0.1 s of its speed and 0.02 rad; the rest in 0.7 s, while it is slow."""
    spied = Spied(scene, monkeypatch, replace(PARAMS, rate=rate))
    memory, _ = spied.tick(spied.planner.initial(HOME), 0.0)
    known = np.full(7, 0.004)
    quick, slowly = min(1.0, 1.0 / (0.1 * rate)), min(1.0, 1.0 / (0.7 * rate))
    for behind in (0.02, 0.09, -0.12):
        for speed, slow in ((0.09, True), (0.11, False), (0.5, False)):
            v = np.array([0, 0, -speed, 0, 0, 0, 0])
            lead = behind - known
            for commanded, measured in ((NONE, v), (v, NONE)):
                start = replace(memory, offset=known, trajectory=replace(memory.trajectory, v0=commanded))
                after, _ = spied.tick(start, 0.0, q=HOME - behind, v=measured)
                lag = 0.02 + 0.1 * np.abs(commanded)
                beyond = np.sign(lead) * np.maximum(np.abs(lead) - lag, 0.0)
                expected = known + quick * beyond + slow * slowly * (lead - beyond)
                np.testing.assert_allclose(after.offset, expected, atol=1e-12)
                np.testing.assert_allclose(spied.asked["q0"], HOME - after.offset)
                np.testing.assert_allclose(spied.asked["v0"], commanded)  # commands go on as they were
    for sign in (1.0, -1.0):  # no more than 0.2 rad
        after, _ = spied.tick(replace(memory, offset=sign * np.full(7, 0.1999)), 0.0, q=HOME - sign * 0.24)
        np.testing.assert_allclose(after.offset, sign * 0.2)
    after, _ = spied.tick(replace(memory, offset=known), 0.0, q=HOME * np.nan)
    np.testing.assert_array_equal(after.offset, known)


def test_plans_are_made_where_the_arm_is_and_kept_as_commands(spied: Spied, at_home: Memory) -> None:
    offset = np.linspace(-0.03, 0.03, 7)
    memory = replace(at_home, offset=offset)
    memory, _ = spied.tick(memory, 0.1, q=HOME - offset)
    np.testing.assert_allclose(spied.asked["fallback"].q0, HOME - offset)
    np.testing.assert_allclose(spied.asked["guess"], np.tile(HOME - offset, (len(spied.asked["guess"]), 1)))
    np.testing.assert_allclose(memory.trajectory.q0, HOME)
    # The last plan is what distances are linearised about, at the samples from now on.
    a = np.zeros_like(at_home.trajectory.accelerations)
    a[1] = 0.3
    a[2] = -0.3
    moving = replace(at_home, trajectory=replace(at_home.trajectory, accelerations=a))
    spied.tick(moving, 0.07)
    q, _, _ = moving.trajectory.at(0.07 + spied.planner.optimiser.samples)
    np.testing.assert_allclose(spied.asked["guess"] - spied.asked["guess"][-1], q - q[-1], atol=1e-9)


NOWHERE = np.zeros((0, 7))


def test_an_answer_counts_at_its_latency_and_a_vain_search_is_repeated(spied: Spied, at_home: Memory) -> None:
    """At 15 Hz: asked at tick 1, answered 0.2 s later, asked again 0.2 s after that."""
    spied.wants = True
    goals = HOME + np.linspace(0.2, 0.6, 2)[:, None]
    spied.answers = [Answer(goals, NOWHERE), Answer(goals, np.stack([HOME + 0.01, HOME]))]
    memory, asked, pending = at_home, [], []
    for k in range(11):
        memory, _ = spied.tick(memory, 0.1 + k / 15)
        asked.append(len(spied.questions))
        pending.append(memory.pending is not None)
    assert asked == [1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2] and [len(q.seed) for q in spied.questions] == [3, 3]
    assert pending == [True] * 3 + [False] * 3 + [True] * 3 + [False] * 2
    assert spied.questions[0].seed != spied.questions[1].seed
    np.testing.assert_array_equal(memory.goals, goals)
    np.testing.assert_array_equal(spied.questions[0].q, HOME)
    assert not spied.questions[0].more_goals and spied.questions[0].hand == b""


def test_a_way_that_was_found_is_taken_unless_the_present_one_is_good(spied: Spied, at_home: Memory) -> None:
    found, other = np.stack([HOME + 0.02, HOME + 0.05]), HOME[None] + 0.04
    for present, taken in ((Route.none(7), found), (Route(Aim.GOAL, other), other)):
        spied.answers, spied.wants, spied.route = [Answer(found[-1:], found)], True, present
        spied.questions.clear()
        memory = replace(at_home, route=present, asked=FRESH)
        memory, _ = spied.tick(memory, 0.1)
        for k in range(2):
            memory, _ = spied.tick(memory, 0.2 + k / 15)
        heard = spied.planner._heard(replace(memory, tick=memory.asked + 3), HOME, Forecast.of_tracks(track()))
        np.testing.assert_array_equal(heard.route.points, taken)
        assert heard.heard and heard.pending is None


def test_where_the_search_has_failed_the_arm_brakes_until_it_works_again(spied: Spied, at_home: Memory) -> None:
    spied.wants, spied.answers, spied.works = True, [None], False
    memory = at_home
    for k in range(5):
        memory, _ = spied.tick(memory, 0.1 + k / 15)
    assert memory.braked and memory.route.aim is Aim.NOTHING
    spied.route = Route(Aim.GOAL, HOME[None] + 0.3)
    v = np.array([0.4, 0, 0, -0.2, 0, 0, 0])
    memory, _ = spied.tick(replace(memory, trajectory=replace(memory.trajectory, start=1.0, v0=v)), 1.0, v=v, goal=GOAL)
    assert memory.route.aim is Aim.NOTHING and len(spied.questions) == 1
    np.testing.assert_allclose(spied.asked["reference"], np.tile(HOME + 0.25 * v, (len(spied.asked["reference"]), 1)))
    spied.works = True
    memory, _ = spied.tick(memory, 1.0 + 1 / 15, goal=GOAL)
    # It goes on along what needs no search, and asks anew without waiting.
    assert not memory.braked and memory.route.aim is Aim.GOAL and len(spied.questions) == 2
    assert memory.pending is spied.questions[-1]


def test_routes_are_decided_upon_fifteen_times_a_second_and_where_something_is_new(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    spied = Spied(scene, monkeypatch, replace(PARAMS, rate=50.0))
    memory, decided = spied.planner.initial(HOME), []
    for k in range(10):
        memory, _ = spied.tick(memory, k / 50, goal=GOAL if k > 4 else NONE)
        decided.append(spied.decided)
    assert decided == [1, 1, 1, 2, 2, 3, 4, 4, 4, 5]
    # There is a goal now and no way: somebody is to look for one, and for other joint goals.
    assert len(spied.questions) == 1 and spied.questions[0].more_goals


def test_joint_goals_near_by_are_found_at_once_and_others_by_a_search(
    spied: Spied, at_home: Memory, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    drawn = HOME + 0.8 * rng.standard_normal((14, 7))
    drawn[:, 1] += 0.8  # some of them in the table
    starts: list[int] = []

    def solve(*arguments: Any) -> Array:
        starts.append(arguments[-1].starts if arguments[-1] else 96)
        return drawn

    monkeypatch.setattr(inverse_kinematics, "solve", solve)
    spied.route = Route(Aim.GOAL, np.tile(HOME, (15, 1)))
    memory = at_home
    for _ in range(40):
        memory, _ = spied.tick(memory, 0.1, goal=GOAL)
    assert starts == [12] and len(memory.route.points) == 12 and not spied.questions
    distance = scene.clearance.distances(drawn, scene.around(Forecast.of_tracks(track()), np.zeros(14)), 3.0)
    clear = (distance >= [0.25 * PARAMS.clearance, 0.25 * PARAMS.clearance, 0.01]).all(axis=1)
    assert 2 < clear.sum() < 12
    np.testing.assert_array_equal(memory.goals, np.vstack([drawn[clear], drawn[~clear]])[:8])
    memory, _ = spied.tick(memory, 0.1, goal=GOAL + [0, 0, 0, 0, 0.01, 0, 0])
    assert starts == [12, 12]
    # A goal without a rotation, or one that is not finite, is none.
    for nothing in (0.49 * GOAL, np.full(7, np.nan)):
        after, _ = spied.tick(memory, 0.1, goal=nothing)
        assert not after.goal.any() and len(after.goals) == 1


def test_a_short_move_is_straight_in_space_where_nothing_is_in_the_way(scene: Scene) -> None:
    planner = MotionPlanner(scene, np.full(7, 2.0), PARAMS)
    aside = track(place=(0.3, 0.6, 0.06))
    at_rest = np.concatenate([HOME, NONE])
    begin, _ = planner.tick(planner.initial(HOME), 0.0, at_rest, aside, NONE)
    X = scene.chain.tool(scene.chain.place(HOME[None]))[0]

    def towards(down: float, tracks: Array) -> tuple[Route, Array]:
        goal = np.concatenate([rotations.from_matrix(X[:3, :3]), X[:3, 3] - [0.0, 0.0, down]])
        memory, _ = planner.tick(begin, 0.1, at_rest, tracks, goal)
        return memory.route, memory.goals

    route, goals = towards(0.08, aside)
    assert route.aim is Aim.LINE
    np.testing.assert_array_equal(goals[0], route.points[-1])
    reached = scene.chain.tool(scene.chain.place(route.points))[:, :3, 3]
    below = np.array([0.02, 0.04, 0.06, 0.08])[:, None]
    np.testing.assert_allclose(reached, X[:3, 3] - below * [0.0, 0.0, 1.0], atol=1e-4)
    assert towards(0.2, aside)[0].aim is Aim.GOAL
    in_the_way = track(place=(X[0, 3], X[1, 3], X[2, 3] - 0.07))
    assert towards(0.14, aside)[0].aim is Aim.LINE
    assert towards(0.14, in_the_way)[0].aim is not Aim.LINE


def test_a_goal_that_seems_out_of_reach_is_looked_at_again_after_two_seconds(
    spied: Spied, at_home: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inverse_kinematics, "solve", lambda *arguments: NOWHERE)
    spied.answers = [Answer(NOWHERE, NOWHERE)] * 3
    memory, asked = at_home, []
    for k in range(70):
        before = len(spied.questions)
        memory, _ = spied.tick(memory, k / 15, goal=GOAL)
        asked += [k] * (len(spied.questions) - before)
    assert asked == [0, 33, 66] and memory.heard


def test_a_stop_takes_as_long_as_the_limit_allows_or_two_knots(spied: Spied) -> None:
    knots, h = PARAMS.knots, PARAMS.step
    for speed in (0.01, 0.4, 0.9, 50.0):
        stop = spied.planner._stop(1.0, HOME, np.array([speed, 0, 0, 0, 0, 0, -0.5 * speed]))
        count = int(np.count_nonzero(stop.accelerations[:, 0]))
        np.testing.assert_allclose(stop.at(np.array([stop.end - 1e-9]))[1], 0.0, atol=1e-6)
        enough = [c for c in range(2, knots) if speed / (h * (c - 0.5)) <= spied.planner.limits.acceleration[0]]
        assert count >= (enough[0] if enough else knots - 1)
        assert count <= (enough[0] + 1 if enough else knots - 1)
