"""Friction on most joints of an arm: none of its probabilities contradict each other, and all joints may have it."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.search.test_evidence import candidate
from twin_diagram.gap.naming import decided, name
from twin_diagram.gap.residuals import whitening
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.greedy_search import search
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec

Array = npt.NDArray[np.float64]
ROWS, JOINTS = 600, 7


def found(weak: float, seed: int) -> tuple[int, ...]:
    """Joints on which viscous friction is named, where five of seven have plenty of it.

    Args:
        weak: on the other two, in standard errors.
        seed: of noise and motion.
    """
    rng = np.random.default_rng(seed)
    speed = rng.normal(size=(ROWS, JOINTS))
    names = ("viscous_friction", "coulomb_friction", "torque_constant")
    offered = [
        candidate(n, j, speed[:, j] if n == names[0] else rng.normal(size=ROWS)) for n in names for j in range(7)
    ]
    sizes = np.full(JOINTS, 0.6)
    noise = rng.normal(size=(ROWS, JOINTS))
    for j in (2, 5):  # exactly so many: what chance adds is taken off
        sizes[j] = weak / np.sqrt(ROWS)
        noise[:, j] -= speed[:, j] * (speed[:, j] @ noise[:, j]) / (speed[:, j] @ speed[:, j])
    white = whitening.Whitener(np.ones((JOINTS, 1)), np.ones(JOINTS), (ROWS,))
    bench = Bench(speed * sizes + noise, white, offered, [])
    fit = decided(bench, cast(Any, None), search(bench, PRIOR_COSTS.least))
    assert {bench.candidates[k].name for k in fit.members} == {"viscous_friction"}
    return tuple(sorted(bench.candidates[k].joints[0] for k in fit.members))


@pytest.mark.parametrize("seed", range(3))
def test_a_weak_joint_is_named_where_most_others_have_it(seed: int) -> None:
    assert found(4.2, seed) == tuple(range(JOINTS))  # joint by joint, it took 5 standard errors


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_no_joint_more(seed: int) -> None:
    assert found(2.0, seed) == (0, 1, 3, 4, 6)


@pytest.mark.slow
def test_an_own_log_of_a_noisy_arm() -> None:
    """What was named with 12 % stood beside an alternative of 48 %; dry friction was 8 standard errors high."""
    given = Model.load(ArmModel(model="arms/panda.urdf", tool_frame=""))
    rng, joints, effort = np.random.default_rng(4), list(given.joints), given.effort_limit
    dry = [1, 3, 5]
    damping = 0.006 * effort * rng.uniform(0.3, 1.5, 7)
    level = 0.02 * effort[dry] * rng.uniform(0.5, 1.5, 3)
    effects = [
        EffectSpec("viscous_friction", joints, [], {"damping": damping.tolist()}),
        EffectSpec("coulomb_friction", [joints[j] for j in dry], [], {"torque": level.tolist()}),
    ]
    truth = Model.load(ArmModel(model="arms/panda.urdf", tool_frame="", effects=effects))
    time = np.arange(2500) / 250.0
    q, v, a = np.tile([0.0, -0.5, 0.0, -1.9, 0.0, 1.7, 0.6], (2500, 1)), np.zeros((2500, 7)), np.zeros((2500, 7))
    for frequency in (0.1, 0.2, 0.3, 0.5, 0.7):
        w = 2.0 * np.pi * frequency
        size, phase = 0.09 * rng.normal(size=7) / frequency**0.5, rng.uniform(0.0, 6.28, 7)
        angle = w * time[:, None] + phase
        q, v, a = q + size * np.sin(angle), v + size * w * np.cos(angle), a - size * w**2 * np.sin(angle)
    tau = truth.inverse_dynamics(q, v, a) + 0.02 * effort * rng.normal(size=q.shape)
    verdict = name(given, [Log(time, tuple(joints), q, torque=tau)])
    for finding in verdict.findings:
        others = [other.probability for other in finding.alternatives]
        assert max(others, default=0.0) <= finding.confidence and finding.confidence + sum(others) <= 1.0 + 1e-9
        if finding.name == "coulomb_friction":
            told = cast(dict[str, Any], finding.parameters["torque"])
            assert set(told) == {joints[j] for j in dry}
            for j, true in zip(dry, level, strict=True):
                assert abs(told[joints[j]].value - true) < 6.0 * told[joints[j]].std
