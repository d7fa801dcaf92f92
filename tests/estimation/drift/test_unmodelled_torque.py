"""The momentum observer on a gantry of two slides, whose ρ fits on a line, against plain numbers joint by joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from tests.estimation.small_arms import constant_friction, gantry
from twin_diagram.estimation.drift.momentum_observer import TorqueTest
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

SIGMA, DT = 4.0, 0.005
MASSES = np.array([5.0, 2.0])
DAMPING = np.array([0.7, 0.3])
UP, DOWN = np.array([2.0, 0.5]), np.array([1.0, 0.8])
NAMES = ["payload", "viscous_friction", "coulomb_friction", "torque_bias", "torque_constant"]
THETA = np.array([1.5, 0.0, 0.0, 0.0, 0.4, -0.1, 0.3, -0.2, 0.25, -0.15, 0.06, -0.04])
"""A payload of 1.5 kg; then two each of damping, dry friction, bias and torque constant."""
TUNING = Filter(parameters=NAMES)


def arm() -> ArmTerms:
    return gantry(laws=constant_friction(*UP, backward=tuple(DOWN)), damping=tuple(DAMPING))


@dataclass
class Plain:
    """One joint and what it remembers: 100 lessons for each direction, eight messages of sliding, λ of 0.85."""

    index: int
    low: float = 0.0
    run: int = 0
    past: tuple[float, float] = (0.0, 0.0)
    last: float = 0.0
    jumps: float = 0.0

    def __post_init__(self) -> None:
        self.count, self.mean, self.square = np.zeros(2), np.zeros(2), np.zeros(2)

    def rho(self, q: float, v: float, tau: float, dt: float) -> tuple[float, float]:
        i, middle = self.index, 0.5 * (v + self.past[1])
        levels = UP[i] + THETA[6 + i], DOWN[i] + THETA[6 + i]
        friction = levels[0] if middle > 0.0 else -levels[1]
        needed = (MASSES[i] + 1.5) * (v - self.past[1]) / dt + (DAMPING[i] + THETA[4 + i]) * middle + friction
        return needed - tau - THETA[8 + i] - THETA[10 + i] * tau, 0.5 * sum(levels)

    def take(self, q: float, v: float, tau: float, dt: float, learning: bool) -> tuple[float, float] | None:
        """Statistic and torque gained; None where the joint does not slide."""
        rho, level = self.rho(q, v, tau, dt)
        self.past = (q, v)
        way = 0 if abs(v) <= 0.01 else (1 if v > 0.0 else -1)
        self.run = self.run + way if way and self.run * way > 0 else way
        share = 1.0 if abs(self.run) <= 1 else 0.15
        self.low += share * (rho - self.low)
        self.jumps = (1.0 - share) ** 2 * self.jumps + share**2 * (tau - self.last) ** 2 / 12.0
        self.last = tau
        if abs(self.run) < 8:
            return None
        side = int(self.run < 0)
        beyond = self.low - self.mean[side]
        floor = (0.04 * level) ** 2 + (0.3 * 0.3) ** 2 + 0.1**2
        usual, allowed = (np.sqrt(max(self.square[side], floor + more)) for more in (0.0, self.jumps))
        widened = SIGMA * (1.0 + 2.0 / np.sqrt(max(0.15 * self.count[side], 1.0)))
        found, known = abs(beyond) / (widened * allowed), self.count[side] >= 100
        if learning and (not known or abs(beyond) / (widened * usual) < 0.5):
            self.count[side] = min(self.count[side] + 1.0, 60_000.0)
            share = 1.0 / self.count[side]
            self.mean[side] += share * beyond
            self.square[side] = (1.0 - share) * (self.square[side] + share * beyond**2)
        return (found if known else 0.0), beyond


def motion(count: int) -> tuple[Array, Array]:
    """Times and states of slides that go to and fro, rest now and then, and are never slow but while they turn."""
    t = 1.0 + DT * np.arange(1, count + 1)
    angle = np.outer(t, [1.9, 2.7]) + [0.3, 1.0]
    q, v = 0.4 * np.sin(angle) / [1.9, 2.7], 0.4 * np.cos(angle)
    return t, np.hstack([q, v])


@pytest.mark.parametrize("before", [0.0, 59_900.0])
def test_is_what_each_slide_alone_would_say(before: float) -> None:
    terms = arm()
    test = TorqueTest(terms, ParameterSet(terms, TUNING), TUNING, SIGMA)
    vector, joints = np.zeros(test.size), [Plain(0), Plain(1)]
    counts = vector[1 + 8 : 1 + 12].reshape(2, 2)
    counts[:] = before
    for one in joints:
        one.count[:] = before
    rng = np.random.default_rng(1305)
    t, x = motion(1000)
    said, plain = [], []
    for k in range(len(t)):
        tau = rng.normal(0.0, 1.0, 2) + [0.5, -0.3] * np.sign(x[k, 2:])
        tau[1] += 24.0 * (k > 850)
        learning = k < 700 or k % 3 == 0
        dt = t[k] - (t[k - 1] if k else 0.0)
        found, joint, gained = test.follow(vector, x[k], THETA, tau, float(t[k]), learning, True)
        if k == 0:
            for i, one in enumerate(joints):
                one.past, one.last = (x[k, i], x[k, 2 + i]), tau[i]
            assert (found, joint, gained) == (0.0, -1, 0.0)
            continue
        each = [one.take(x[k, i], x[k, 2 + i], tau[i], dt, learning) for i, one in enumerate(joints)]
        if any(one is None for one in each):
            continue  # a slide that creeps is the business of `breakaway`
        best = int(np.argmax([one[0] for one in each if one is not None]))
        statistic, torque = each[best] or (0.0, 0.0)
        said.append((found, joint, gained))
        plain.append((statistic, best, torque) if statistic > 0.0 else (0.0, -1, 0.0))
    np.testing.assert_allclose(said, plain, rtol=1e-7, atol=1e-9)
    found = np.array(said)[:, 0]
    assert np.sum(found > 0.0) > 150 and found.max() > 1.0


def test_slides_are_those_faster_than_five_deviations_of_what_speeds_are_heard_through() -> None:
    for std, speed, slides in (
        (1e-3, 0.0076, True),
        (1e-3, 0.0074, False),
        (0.01, 0.0501, True),
        (0.01, 0.0499, False),
    ):
        terms, tuning = gantry(), Filter(parameters=[], velocity_std=std)
        test = TorqueTest(terms, ParameterSet(terms, tuning), tuning, SIGMA)
        vector = np.zeros(test.size)
        for k in range(300):
            x = np.array([speed * DT * k, 0.0, speed, 0.0])
            test.follow(vector, x, np.zeros(0), np.zeros(2), 1.0 + DT * k, True, True)
        assert (vector[1 + 8] > 0.0) == slides
        assert vector[1 + 9] == 0.0


def test_joints_move_that_are_faster_than_two_deviations_or_the_filter_s_excitation() -> None:
    """Slower ones rest, and nothing is remembered of their way."""
    for std, speed, moves in ((1e-3, 0.0029, False), (1e-3, 0.0031, True), (4e-3, 0.0079, False), (4e-3, 0.0081, True)):
        terms, tuning = gantry(), Filter(parameters=[], velocity_std=std)
        test = TorqueTest(terms, ParameterSet(terms, tuning), tuning, SIGMA)
        vector = np.zeros(test.size)
        for k in range(4):
            test.follow(vector, np.array([0.0, 0.0, speed, 0.0]), np.zeros(0), np.zeros(2), 1.0 + DT * k, True, True)
        assert (vector[1 + 20 + 2] > 0.0) == moves


@pytest.mark.parametrize(("gap", "joins"), [(0.249, True), (0.251, False), (1e-7, False), (-0.1, False)])
def test_messages_join_up_within_a_quarter_of_a_second(gap: float, joins: bool) -> None:
    terms, tuning = gantry(), Filter(parameters=[])
    test = TorqueTest(terms, ParameterSet(terms, tuning), tuning, SIGMA)
    vector = np.zeros(test.size)
    t = 1.0
    for k in range(6):
        t += gap if k == 5 else DT
        test.follow(vector, np.array([0.0, 0.0, 0.5, -0.5]), np.zeros(0), np.zeros(2), t, True, True)
    run = vector[1 + 6 : 1 + 8]
    np.testing.assert_array_equal(run, [5.0, -5.0] if joins else [0.0, 0.0])
    assert vector[0] == t
    np.testing.assert_array_equal(vector[1:5], [0.0, 0.0, 0.5, -0.5])


def test_effects_of_the_model_count() -> None:
    """A smooth load is needed of the motor; of what is measured only a part is applied; no ρ counts beyond 1e6."""
    laws = Laws(
        load=lambda q, v, tau: 3.0 * q + 0.5 * v + 0.1 * tau,
        dry=lambda q, v, tau: (np.full(2, 0.5), np.full(2, 0.25)),
        applied=lambda tau: 0.9 * tau,
        true_position=lambda q: q + 0.2,
    )
    terms, tuning = gantry(laws=laws), Filter(parameters=[])
    test = TorqueTest(terms, ParameterSet(terms, tuning), tuning, SIGMA)
    before, after, tau = np.array([0.1, 0.3, 0.5, -0.6]), np.array([0.2, 0.1, 0.7, -0.4]), np.array([2.0, -3.0])
    rho, level = test._unmodelled(before, after, np.zeros(0), tau, DT)
    q, v = np.array([0.15, 0.2]) + 0.2, np.array([0.6, -0.5])
    needed = MASSES * np.array([0.2, 0.2]) / DT + [0.5, -0.25] + 3.0 * q + 0.5 * v + 0.1 * tau
    np.testing.assert_allclose(rho, needed - 0.9 * tau)
    np.testing.assert_allclose(level, 0.375)
    for push in (3e6, -3e6):
        rho, _ = test._unmodelled(before, after, np.zeros(0), np.full(2, push), DT)
        np.testing.assert_array_equal(rho, -np.sign(push) * 1e6)
    standing, _ = test._unmodelled(np.zeros(4), np.zeros(4), np.zeros(0), np.zeros(2), DT)
    np.testing.assert_allclose(standing, 3.0 * 0.2 - 0.25)  # at no speed at all friction is taken for that backwards


def test_nobody_knows_when_between_two_messages_a_torque_jumped() -> None:
    """A drive of ± 40 N that has always switched just after a message, and now switches just before one.

    What is logged is the force at the message. A force that is lacking is noticed as before.
    """
    terms, tuning, force = gantry(), Filter(parameters=[]), 40.0
    test = TorqueTest(terms, ParameterSet(terms, tuning), tuning, SIGMA)
    vector, x, tau = np.zeros(test.size), np.array([0.0, 0.0, 3.0, 1.0]), np.array([force, 0.0])
    rng = np.random.default_rng(1309)

    def drive(count: int, late: bool, lacking: float = 0.0) -> list[tuple[float, int, float]]:
        said = []
        for k in range(count):
            asked = np.array([force if k // 40 % 2 else -force, 0.0])
            given = (tau if late else asked) - [lacking, 0.0]
            before = x.copy()
            x[2:] += given / MASSES * DT
            x[:2] += 0.5 * (before[2:] + x[2:]) * DT
            tau[:] = asked
            seen.append(1.0 + DT * len(seen))
            logged = tau + 0.05 * rng.standard_normal(2)
            said.append(test.follow(vector, x, np.zeros(0), logged, seen[-1], True, True))
        return said

    seen: list[float] = []
    assert max(found for found, _, _ in drive(400, late=False)) < 1.0
    assert 0.4 < max(found for found, _, _ in drive(160, late=True)) < 1.0
    assert vector[1 + 16 : 1 + 20].max() < 0.2 * (0.09**2 + 0.1**2)  # variances: jumps were no lesson
    drive(120, late=False)
    weak = drive(12, late=False, lacking=3.0)
    assert weak[-1][0] > 1.0
    assert weak[-1][1] == 0
    assert weak[-1][2] == pytest.approx(-3.0 * (1.0 - 0.85**12), abs=0.2)
