"""The planner's memory as a vector, and the motion in it, at its edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.mpc.trajectory import Trajectory, response
from twin_diagram.planning.paths.situation import Aim, Route


@pytest.mark.parametrize(("n", "knots"), [(7, 13), (2, 4), (9, 9)])
def test_a_full_memory_is_packed_and_unpacked(n: int, knots: int) -> None:
    rng = np.random.default_rng(n)
    draw = rng.standard_normal
    memory = Memory(
        Trajectory(1.5, 0.15, draw(n), draw(n), draw((knots, n))), draw(n), draw(7), draw(n), draw((8, n)),
        Route(Aim.REFUGE, draw((12, n))), 41, 17, True, False, 2.25, draw(7), draw((5, n)),
    )  # fmt: skip
    vector = memory.pack()
    assert len(vector) == Memory.size(n, knots) == len(Memory.initial(np.zeros(n), knots, 0.1).pack())
    again = Memory.unpack(vector, n, knots, 0.15)
    np.testing.assert_array_equal(again.pack(), vector)
    for name in ("offset", "goal", "stay", "goals", "next_goal", "beyond"):
        np.testing.assert_array_equal(getattr(again, name), getattr(memory, name))
    np.testing.assert_array_equal(again.route.points, memory.route.points)
    np.testing.assert_array_equal(again.trajectory.accelerations, memory.trajectory.accelerations)
    assert (again.route.aim, again.tick, again.asked) == (Aim.REFUGE, 41, 17)
    assert (again.heard, again.braked, again.checked, again.pending) == (True, False, 2.25, None)
    assert Memory.proved_at(vector) == 2.25
    assert Memory.proved_at(replace(memory, checked=1.25).pack()) == memory.trajectory.start
    braked = Memory.unpack(replace(memory, heard=False, braked=True).pack(), n, knots, 0.15)
    assert (braked.heard, braked.braked) == (False, True)
    longer = replace(memory, route=Route(Aim.GOAL, draw((15, n))))
    np.testing.assert_array_equal(Memory.unpack(longer.pack(), n, knots, 0.15).route.points, longer.route.points[:12])


def test_a_motion_stands_still_before_and_after_and_begins_as_told() -> None:
    rng = np.random.default_rng(0)
    motion = Trajectory(2.0, 0.1, *rng.standard_normal((2, 3)), rng.standard_normal((6, 3)))
    before, begin, last, end = 1.9, 2.0, 2.4999999, 2.5
    q, v, a = motion.at(np.array([before, begin, last, end, 9.0]))
    np.testing.assert_allclose(q[:2], [motion.q0, motion.q0])
    np.testing.assert_allclose(v[:2], [np.zeros(3), motion.v0])
    np.testing.assert_allclose(a[:2], [np.zeros(3), motion.accelerations[0]])
    assert np.abs(v[2]).min() > 1e-3 and not v[3:].any() and not a[3:].any()
    for t, expected in zip(
        (before, begin, 2.234, end, 9.0), motion.at(np.array([before, begin, 2.234, end, 9.0]))[0], strict=True
    ):
        np.testing.assert_allclose(motion.position(t), expected, atol=1e-12)
    rest = Trajectory.at_rest(1.0, 0.2, 5, np.array([1, 2]))
    np.testing.assert_allclose(rest.at(np.array([0.0, 1.3, 5.0]))[0], np.tile([1.0, 2.0], (3, 1)))
    assert rest.end == pytest.approx(1.8)


def test_responses_are_integrals_of_hats() -> None:
    h, knots = 0.2, 5
    fine = np.linspace(0.0, h * (knots - 1), 4001)
    hats = np.maximum(1 - np.abs(fine[:, None] / h - np.arange(knots)), 0.0)
    step = fine[1] - fine[0]
    velocity = np.vstack([np.zeros(knots), np.cumsum((hats[1:] + hats[:-1]) / 2 * step, axis=0)])
    position = np.vstack([np.zeros(knots), np.cumsum((velocity[1:] + velocity[:-1]) / 2 * step, axis=0)])
    found = response(fine, h, knots)
    np.testing.assert_allclose(found[1], velocity, atol=1e-7)
    np.testing.assert_allclose(found[0], position, atol=1e-6)
