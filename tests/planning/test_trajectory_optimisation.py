"""The optimiser's programs against sums over the motion itself, and what the planner takes into them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.planning.collision.clearance import Contacts
from twin_diagram.planning.collision.collision_scene import Forecast, Scene, load_scene
from twin_diagram.planning.given import check_planner
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.trajectory import Trajectory
from twin_diagram.planning.mpc.trajectory_optimisation import Limits, Optimiser, OptimiserTuning
from twin_diagram.planning.paths import rrt_connect
from twin_diagram.planning.paths.route import Router
from twin_diagram.planning.paths.situation import Aim, Route, Situation
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus, Track

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
KNOTS, STEP = 8, 0.15


@pytest.fixture(scope="module")
def scene() -> Scene:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in ("can", "mug")}
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], library)


@pytest.fixture(scope="module")
def optimiser(scene: Scene) -> Optimiser:
    return Optimiser(scene.clearance, Limits(scene.lower, scene.upper, np.full(7, 1.5), np.full(7, 5.0)), KNOTS, STEP)


def tracks(*places: tuple[float, float, float]) -> Array:
    still = np.zeros(6), np.zeros((6, 6))
    return np.concatenate(
        [Track(ObjectStatus.TRACKED, 0.0, np.array([1.0, 0, 0, 0, *place]), *still).pack() for place in places]
    )


NEAR = tracks((0.5, 0.1, 0.35), (0.45, -0.2, 0.15))


def test_contacts_are_all_that_is_within_reach(scene: Scene) -> None:
    """Against the distances of everything, however far."""
    q = HOME + 0.4 * np.random.default_rng(0).standard_normal((60, 7))
    around = scene.around(Forecast.of_tracks(NEAR), np.zeros(len(q)))
    every = scene.clearance.distances(q, around, 3.0)
    for reach, own_reach in ((0.2, 0.05), (0.1, 0.15)):
        contacts = scene.clearance.contacts(q, around, reach, own_reach)
        nearest = np.full(every.shape, np.inf)
        np.minimum.at(nearest, (contacts.row, contacts.body), contacts.distance)
        within = every < np.append(np.full(every.shape[1] - 1, reach), own_reach)
        assert within[:, :-1].any(axis=0).all() and within[:, -1].any()
        assert np.array_equal(np.isfinite(nearest), within)
        np.testing.assert_allclose(nearest[within], every[within], atol=1e-12)
        again = scene.clearance.distances(q, around, reach)
        np.testing.assert_allclose(again[every < reach], every[every < reach], atol=1e-12)
        assert (again[every >= reach] >= reach).all()


@pytest.mark.parametrize("influence", [0.1, 0.25])
def test_the_planner_reacts_to_what_is_within_its_influence(
    scene: Scene, influence: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each part of the arm that comes within `influence` of a body stands in a program, and no other."""
    planner = MotionPlanner(scene, np.full(7, 2.0), scenario.Planner(influence=influence))
    planner.optimiser.tuning = replace(planner.optimiser.tuning, rows=10_000)
    found: list[tuple[Contacts, Array]] = []
    contacts = type(scene.clearance).contacts

    def told(self, q, around, *arguments):  # type: ignore[no-untyped-def]
        found.append((contacts(self, q, around, *arguments), q))
        return found[-1][0]

    monkeypatch.setattr(type(scene.clearance), "contacts", told)
    state = np.concatenate([HOME, np.zeros(7)])
    planner.tick(planner.initial(HOME), 0.0, state, NEAR, np.zeros(7))
    near, q = found[0]
    around = scene.around(Forecast.of_tracks(NEAR), planner.optimiser.samples)
    every = scene.clearance.distances(q, around, 3.0)[:, :-1]
    rows = {(int(r), int(b)) for r, b in zip(near.row, near.body, strict=True) if b < every.shape[1]}
    assert rows == {(int(r), int(b)) for r, b in zip(*np.nonzero(every < influence), strict=True)}
    assert near.distance.max() > 0.5 * influence  # half the reach would leave something out


def test_the_objective_is_the_sum_over_the_motion(optimiser: Optimiser) -> None:
    """Half the quadratic form plus the linear one, against tracking, proximity, accelerations, changes and slack."""
    rng = np.random.default_rng(1)
    t, m, n = OptimiserTuning(), len(optimiser.samples), 7
    q0, v0, a0 = HOME, 0.3 * rng.standard_normal(n), rng.standard_normal(n)
    reference, guess = HOME + 0.2 * rng.standard_normal((2, m, n))
    base = q0 + optimiser.samples[:, None] * v0 + optimiser._P0[:, None] * a0
    gradient = optimiser._gradient(base, v0 + optimiser._V0[:, None] * a0, a0, guess, reference)
    told_speed = np.gradient(reference, STEP / 2, axis=0)
    prices = optimiser._program

    def cost(x: Array) -> float:
        inner, slack = x[: (KNOTS - 2) * n].reshape(-1, n), x[(KNOTS - 2) * n :]
        accelerations = np.vstack([a0, inner, np.zeros(n)])
        plan = Trajectory(0.0, STEP, q0, v0, accelerations)
        q = plan.at(optimiser.samples)[0]
        v = plan.at(optimiser.samples - 1e-12)[1]  # beyond its end a plan rests
        weight = STEP / 2
        late = np.exp(-optimiser.samples / (t.fade * optimiser.samples[-1])) * weight
        return float(
            weight * (t.tracking * np.sum((q - reference) ** 2) + t.proximity * np.sum((q - guess) ** 2)) / 2
            + weight * t.speed * np.sum((v - told_speed) ** 2) / 2
            + STEP * t.acceleration * np.sum(inner**2) / 2
            + STEP * t.change * sum(np.sum((b - a) ** 2) for a, b in pairwise(accelerations)) / 2
            + t.slack * late @ slack
            + t.slack_square * late @ slack**2 / 2
        )

    def told_cost(x: Array) -> float:
        A, slack = x[: (KNOTS - 2) * n].reshape(-1, n), x[(KNOTS - 2) * n :]
        # The program counts slack in units in which its square costs a half.
        scaled = slack / prices.slack_scale
        loose = prices.slack_price @ scaled + scaled @ scaled / 2
        return float(np.einsum("ij,in,jn->", optimiser.price, A, A) / 2 + np.sum(gradient * A) + loose)

    points = rng.standard_normal((6, (KNOTS - 2) * n + m))
    told = [told_cost(x) for x in points]
    expected = [cost(x) for x in points]
    np.testing.assert_allclose(np.diff(told), np.diff(expected), rtol=1e-9)


def test_the_constraints_are_those_of_the_motion(optimiser: Optimiser, scene: Scene) -> None:
    """Rest at the end, limits at knots, of speed between, and distances about the guess with a slack per sample."""
    rng = np.random.default_rng(2)
    m, n = len(optimiser.samples), 7
    q0, v0, a0 = HOME, 0.2 * rng.standard_normal(n), rng.standard_normal(n)
    guess = HOME + 0.05 * rng.standard_normal((m, n))
    around = scene.around(Forecast.of_tracks(NEAR), optimiser.samples)
    contacts = scene.clearance.contacts(guess, around, 0.2, 0.05)
    margins = rng.uniform(0.02, 0.08, (m, len(scene.clearance.bodies) + 1))
    base = q0 + optimiser.samples[:, None] * v0 + optimiser._P0[:, None] * a0
    speed = v0 + optimiser._V0[:, None] * a0
    rows = optimiser._rows(base, speed, guess, contacts, margins)
    x = rng.standard_normal((KNOTS - 2, n))
    motion = Trajectory(0.0, STEP, q0, v0, np.vstack([a0, x, np.zeros(n)]))
    q = motion.at(optimiser.samples)[0]
    knots = STEP * np.arange(1, KNOTS)
    speeds, end = motion.at(optimiser.samples[:-1])[1], motion.at(np.array([motion.end - 1e-9]))[1][0]
    np.testing.assert_allclose(optimiser._V[-1] @ x + speed[-1], end, atol=1e-6)

    missing = contacts.distance - margins[contacts.row, contacts.body]
    order = np.argsort(missing, kind="stable")[:64]
    row = contacts.row[order]
    linear = missing[order] + np.einsum("mn,mn->m", contacts.gradient[order], q[row] - guess[row])
    count = len(order)
    assert count > 20
    value = rows.values(x)
    np.testing.assert_allclose((value - rows.low)[:count], linear, atol=1e-9)
    np.testing.assert_array_equal(rows.slack[:count], row)
    assert (rows.high[:count] == np.inf).all() and (rows.slack[count:] == -1).all()
    places = motion.at(knots - 1e-12)[0]
    above = np.vstack([x + 5.0, speeds + 1.5, places - optimiser.limits.lower]).ravel()
    below = np.vstack([5.0 - x, 1.5 - speeds, optimiser.limits.upper - places]).ravel()
    np.testing.assert_allclose((value - rows.low)[count:], above, atol=1e-9)
    np.testing.assert_allclose((rows.high - value)[count:], below, atol=1e-9)


def test_distances_are_linearised_where_less_is_lacking(optimiser: Optimiser, scene: Scene) -> None:
    """About the plan before, unless that lacks something and the reference lacks less than half of it."""
    m = len(optimiser.samples)
    beside, away = np.tile(HOME, (m, 1)), np.tile(HOME - [0.7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], (m, 1))
    around = scene.around(Forecast.of_tracks(tracks((0.5, 0.1, 0.35), (3.0, 3.0, 0.5))), np.zeros(m))
    bodies = scene.clearance.distances(beside, around, 0.5).shape[1]
    margins = np.full((m, bodies), 0.06)
    margins[:, -1] = 0.005
    lacking = optimiser.assess(beside, around, margins)
    assert lacking > 1e-3 > optimiser.assess(away, around, margins)
    for guess, reference, chosen in ((beside, away, away), (away, beside, away), (beside, beside, beside)):
        about, contacts, kept = optimiser._begin(guess, reference, around, margins)
        assert about is chosen and kept == pytest.approx(optimiser.assess(guess, around, margins))
        expected = optimiser._contacts(chosen, around, margins)
        np.testing.assert_array_equal(contacts.distance, expected.distance)
    # Half as good is not enough.
    between = np.where(np.arange(m)[:, None] < 0.3 * m, beside, away)
    assert 0.5 * lacking < optimiser.assess(between, around, margins) < lacking
    assert optimiser._begin(beside, between, around, margins)[0] is beside


def test_a_plan_stops_within_the_limits_and_at_rest(scene: Scene) -> None:
    planner = MotionPlanner(scene, np.full(7, 2.0), scenario.Planner())
    for speed in (0.05, 0.5, 1.2):
        v = speed * np.array([1.0, -0.5, 0.2, 0, 0, 0, 0])
        stop = planner._stop(2.0, HOME, v)
        q, speeds, _ = stop.at(np.array([2.0, stop.end - 1e-9]))
        np.testing.assert_allclose(q[0], HOME)
        np.testing.assert_allclose(speeds, [v, np.zeros(7)], atol=1e-9)
        assert np.abs(stop.accelerations).max() <= planner.limits.acceleration[0] * (1 + 1e-9)
        # No sooner than needed by more than two knots.
        moving = np.flatnonzero(np.abs(stop.accelerations[:, 0]) > 0)
        assert len(moving) <= max(2, np.ceil(speed / planner.limits.acceleration[0] / planner.params.step) + 1)


@pytest.mark.parametrize(("influence", "fine"), [(0.0599, False), (0.0601, True)])
def test_influence_is_asked_to_be_half_as_much_again_as_the_clearance(influence: float, fine: bool) -> None:
    params = scenario.Planner(clearance=0.04, influence=influence)
    if fine:
        check_planner(params)
    else:
        with pytest.raises(ScenarioError, match="influence"):
            check_planner(params)


# Routes.


def situation(scene: Scene, q: Array, here: Array, goals: Array, at_goals: Array) -> Situation:
    still = np.ones(len(scene.clearance.bodies), dtype=bool)
    still[-1] = False
    return Situation(q, Forecast.of_tracks(NEAR), goals, here, at_goals, still, 0.04, 0.01, 0.012)


def test_margins_give_way_near_a_goal_to_what_stands_still(scene: Scene) -> None:
    here, at_goal = np.array([0.3, 0.02, 0.3, 0.3]), np.array([0.023, 0.005, 0.013, 0.2])
    now = situation(scene, HOME, here, HOME[None], at_goal[None])
    np.testing.assert_allclose(now.margins(), [0.04, 0.04, 0.04, 0.012])
    np.testing.assert_allclose(now.margins(0, 0.02), [0.02, 0.01, 0.06, 0.012])
    np.testing.assert_allclose(now.margins(0, 0.0, 0.01), [0.03, 0.012, 0.04, 0.012])
    np.testing.assert_allclose(now.allowed(now.margins()), [0.04, 0.017, 0.04, 0.012])
    np.testing.assert_allclose(now.allowed(now.margins(), 0.5), [0.02, 0.017, 0.02, 0.006])


def test_routes_are_travelled_at_their_speed(scene: Scene) -> None:
    speed = np.linspace(0.5, 1.1, 7)
    router = Router(scene, speed)
    rng = np.random.default_rng(0)
    route = Route(Aim.GOAL, HOME + 0.4 * rng.standard_normal((3, 7)))
    points = np.vstack([HOME, route.points])
    took = [float((np.abs(b - a) / speed).max()) for a, b in pairwise(points)]
    assert router.travel(HOME, route).duration == pytest.approx(sum(took))
    times = np.linspace(0.0, sum(took) + 0.5, 400)
    way = router.travel(HOME, route).at(times)
    rate = np.abs(np.diff(way, axis=0)) / np.diff(times)[:, None] / speed
    assert rate.max() < 1 + 1e-6 and np.median(rate.max(axis=1)[times[1:] < sum(took)]) > 1 - 1e-6
    np.testing.assert_allclose(way[times >= sum(took)], np.broadcast_to(points[-1], way[times >= sum(took)].shape))
    np.testing.assert_allclose(router.travel(HOME, route).at(np.cumsum(took)), route.points, atol=1e-9)


def test_straight_lines_are_checked_as_densely_as_told() -> None:
    line = rrt_connect.interpolate(np.zeros(2), np.array([0.5, -1.0]), 0.3)
    np.testing.assert_allclose(line, np.arange(1, 5)[:, None] / 4 * [0.5, -1.0])
    assert rrt_connect.length(np.array([[0, 0], [1, 2.0], [1, 5]]), np.array([1, 0.5])) == pytest.approx(1 + 1.5)
    path = np.array([[0.0, 0], [0.3, 1], [0.6, 0], [1, 0]])
    np.testing.assert_array_equal(rrt_connect.prune(path, lambda q: np.ones(len(q), dtype=bool), 0.1), path[[0, 3]])
    np.testing.assert_array_equal(rrt_connect.prune(path, lambda q: np.zeros(len(q), dtype=bool), 0.1), path)
