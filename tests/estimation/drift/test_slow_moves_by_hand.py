"""What `breakaway` remembers and says, joint by joint in plain numbers: as its docstring has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from twin_diagram.estimation.drift import breakaway
from twin_diagram.signals.arrays import Array

CREEPS, FLOOR, SIGMA = 0.25, 0.5, 3.0


@dataclass
class Plain:
    """One joint: five messages of forgetting and of motion, 0.3 mrad of way, 20 lessons, near is half a threshold."""

    begin: float = 0.0
    run: int = 0
    low: float = 0.0
    count: float = 0.0
    mean: float = 0.0
    square: float = 0.0
    jumps: float = 0.0
    lessons: int = 0

    def take(self, q: float, v: float, rho: float, slow: bool, calm: bool, jump: float) -> tuple[float, float]:
        way = 0 if abs(v) <= CREEPS else (1 if v > 0.0 else -1)
        if way != 0 and self.run * way > 0:
            self.run += way
            self.low += (rho - self.low) / 5.0
            self.jumps = 0.64 * self.jumps + 0.04 * jump**2
        else:
            self.begin, self.run, self.low, self.jumps = q, way, rho, jump**2
        if not slow or abs(self.run) < 5 or (q - self.begin) * way < 3e-4:
            return 0.0, 0.0
        beyond = self.low * way - self.mean
        usual, allowed = (np.sqrt(max(self.square, FLOOR**2 + more)) for more in (0.0, self.jumps))
        widened = SIGMA * (1.0 + 2.0 / np.sqrt(max(self.count / 5.0, 1.0)))
        found = max(beyond, 0.0) / (widened * allowed)
        known = self.count >= 20
        if calm and (not known or beyond / (widened * usual) < 0.5):
            self.lessons += 1
            self.count = min(self.count + 1.0, 20_000.0)
            share = 1.0 / self.count
            self.mean += share * beyond
            self.square = (1.0 - share) * (self.square + share * beyond**2)
        return (found if known else 0.0), beyond * way


def grid(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Speeds that now and then are just those of a joint that creeps, positions that now and then come just so far."""
    sign = np.sign(np.sin(np.arange(count)[:, None] / np.array([7.0, 11.0, 17.0])))
    v = sign * rng.choice([0.0, CREEPS, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5], (count, 3))
    q = np.cumsum(np.sign(v) * rng.choice([3e-5, 6e-5], (count, 3)), axis=0)
    return q, v, rng.normal(0.3, 0.7, (count, 3)) * sign


@pytest.mark.parametrize(("seed", "before"), [(0, 0.0), (1, 18.0), (2, 19_990.0)])
def test_is_what_each_joint_alone_would_say(seed: int, before: float) -> None:
    rng = np.random.default_rng([1301, seed])
    q, v, rho = grid(rng, 900)
    rho[600:] *= 3.0
    memory = np.zeros((breakaway.SIZE, 3))
    memory[3], memory[5] = before, 0.4 * (before > 0.0)
    joints = [Plain(count=before, square=0.4 * (before > 0.0)) for _ in range(3)]
    told, expected = [], []
    for k in range(len(q)):
        slow, calm = rng.random(3) < 0.9, k < 600 or bool(rng.random() < 0.5)
        jump = np.where(rng.random(3) < 0.1, 3.0 * rng.random(3), 0.0)
        found, gained = breakaway.slow_moves(
            memory, q[k], v[k], rho[k], CREEPS, slow, np.full(3, FLOOR), SIGMA, bool(calm), jump
        )
        plain = [
            joint.take(q[k, i], v[k, i], rho[k, i], bool(slow[i]), calm, jump[i]) for i, joint in enumerate(joints)
        ]
        expected.append(plain)
        told.append(np.transpose([found, np.where(found > 0.0, gained, 0.0)]))
    said, expected_said = np.array(told), np.array(expected)
    np.testing.assert_allclose(said[..., 0], expected_said[..., 0], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        said[..., 1], np.where(expected_said[..., 0] > 0.0, expected_said[..., 1], 0.0), rtol=1e-8, atol=1e-12
    )
    state = np.array([[j.begin, j.run, j.low, j.count, j.mean, j.square, j.jumps] for j in joints]).T
    np.testing.assert_allclose(memory, state, rtol=1e-8, atol=1e-12)
    assert np.sum(said[..., 0] > 0.0) > 50 and said.max() > 1.0 and all(joint.lessons > 12 for joint in joints)


def test_a_joint_is_tested_just_where_it_has_come_far_enough() -> None:
    for way, tested in ((2.99e-4, False), (3.01e-4, True)):
        memory = np.zeros((breakaway.SIZE, 1))
        memory[3], memory[5] = 1000.0, 0.01
        for k in range(5):
            found, _ = breakaway.slow_moves(
                memory,
                np.array([way * k / 4.0]),
                np.array([0.3]),
                np.array([9.0]),
                CREEPS,
                np.array([True]),
                np.array([FLOOR]),
                SIGMA,
                False,
            )
        assert (found[0] > 0.0) == tested


def test_lessons_end_where_a_statistic_comes_near() -> None:
    """Half a threshold is the border: 20 lessons of 0 ± floor, then just below and just above it."""
    limit = SIGMA * FLOOR * (1.0 + 2.0 / np.sqrt(1000.0 / 5.0))
    for share, learnt in ((0.495, True), (0.505, False)):
        memory = np.zeros((breakaway.SIZE, 1))
        memory[:, 0] = [-1.0, 5.0, share * limit, 1000.0, 0.0, 0.0, 0.0]
        breakaway.slow_moves(
            memory,
            np.zeros(1),
            np.array([0.3]),
            np.array([share * limit]),
            CREEPS,
            np.array([True]),
            np.array([FLOOR]),
            SIGMA,
            True,
        )
        assert (memory[3, 0] > 1000.0) == learnt
