"""A joint that moves and rests by turns: what holds it while it rests tells Stribeck's law from Coulomb's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap_bench import arm
from twin_diagram.gap.naming import name
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.signals.stretches import stretches

Array = npt.NDArray[np.float64]

PERIOD = 0.004
LEVEL = 2.0
"""Of sliding friction [N·m]."""

NOISE = 0.4


def moves(rng: np.random.Generator, samples: int, rests: tuple[float, float], every: int, power: int) -> Array:
    """(N,) speed of short moves to and fro, with rests of some length [s] after every so many of them [rad/s]."""
    parts: list[Array] = []
    sign = 1.0
    while sum(len(part) for part in parts) < samples:
        move, rest = rng.uniform(0.5, 0.9), rng.uniform(*rests) * (len(parts) // 2 % every == 0)
        top = rng.uniform(0.5, 1.0)
        parts += [
            sign * top * np.sin(np.linspace(0.0, np.pi, int(move / PERIOD))) ** power,
            np.zeros(int(rest / PERIOD)),
        ]
        sign = -sign
    return np.concatenate(parts)[:samples]


def log_of(
    model: Model,
    static: float,
    slow: float,
    seed: int,
    rests: tuple[float, float] = (0.15, 0.35),
    every: int = 1,
    power: int = 2,
) -> Log:
    """16 s in which the shoulder has friction that rises by a factor below a speed, and rests hold as much at most."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 16.0, PERIOD)
    v = np.stack([moves(rng, len(time), rests, every, power) for _ in model.joints], axis=1)
    q: Array = np.array([0.4, -0.6]) + PERIOD * np.cumsum(v, axis=0)
    tau = model.inverse_dynamics(q, v, np.gradient(v, PERIOD, axis=0))
    speed = v[:, 0]
    friction = LEVEL * np.sign(speed) * (1.0 + (static - 1.0) * np.exp(-((speed / slow) ** 2)))
    for first, last in stretches(np.abs(speed) < 1e-6):
        friction[first:last] = rng.choice([-1.0, 1.0]) * LEVEL * static * rng.uniform(0.65, 1.0)
    tau += NOISE * rng.normal(size=q.shape)
    tau[:, 0] += friction
    seen: Array = q + 2e-6 * rng.normal(size=q.shape)
    return Log(time, model.joints, seen, torque=tau)


@pytest.mark.parametrize(
    ("static", "slow", "law"),
    [(1.8, 0.04, "stribeck_friction"), (1.8, 0.02, "stribeck_friction"), (1.0, 0.04, "coulomb_friction")],
    ids=["hardly a dip", "no dip to be seen", "holds no more"],
)
@pytest.mark.slow
def test_what_holds_a_joint_counts_where_the_dip_tells_next_to_nothing(
    tmp_path: Path, static: float, slow: float, law: str
) -> None:
    """Whichever of the two laws the samples that slide happen to favour by a hair."""
    model = Model.load(arm(tmp_path))
    (finding,) = name(model, [log_of(model, static, slow, seed=1)]).findings
    assert (finding.name, finding.joints) == (law, ("shoulder",))
    if static > 1.0:
        assert finding.confidence > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("static", "law"), [(2.2, "stribeck_friction"), (1.0, "coulomb_friction")])
def test_a_few_holds_too_short_to_be_seen_by_themselves_count_where_they_exceed_what_coulombs_law_could_hold(
    tmp_path: Path, static: float, law: str
) -> None:
    """Every seventh turn holds for less than a tenth of a second, which the low-pass leaves nowhere pure."""
    model = Model.load(arm(tmp_path))
    (finding,) = name(model, [log_of(model, static, 0.02, seed=1, rests=(0.07, 0.09), every=7, power=1)]).findings
    assert (finding.name, finding.joints) == (law, ("shoulder",))
