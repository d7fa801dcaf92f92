"""Arms that lack everything at once: how far what is unusual stands out is counted in what the log's noise does."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "sims" / "benchmarks"))

from gap_truth import cases
from gap_truth.hidden import Hidden
from whole_robots.scoring import right
from whole_robots.separation import BAND, whitened


def test_whitened_noise_has_a_variance_of_one_whatever_its_colour() -> None:
    rng = np.random.default_rng(3)
    chain = cases.draw_arm(rng)
    period, count, still = 0.002, 20000, np.zeros(chain.n)
    noise = cases.Noise(np.full(chain.n, 0.3), np.linspace(0.0, 2.0, chain.n), np.linspace(4.0, 40.0, chain.n), 0.0)
    robot = SimpleNamespace(
        period=period,
        noise=noise,
        control=SimpleNamespace(resolution=still),
        fit=SimpleNamespace(q=np.zeros((2, chain.n)), v=np.zeros((2, chain.n))),
        truth=SimpleNamespace(real=chain),
    )
    drawn = np.stack([noise.draw(count, period, rng).T for _ in range(8)])
    white = whitened(drawn, cast(Any, robot)).reshape(8, chain.n, -1)
    assert white.shape[2] == 2 * (int(BAND * count * period) + 1)
    np.testing.assert_allclose(np.mean(white**2, axis=(0, 2)), 1.0, rtol=0.08)


@pytest.mark.parametrize(
    ("link", "point", "moment", "found"),
    [
        ("link_6", [0.0, 0.0, 0.0], 0.0, True),
        ("link_5", [0.0, 0.0, 0.0], 0.0, True),
        ("link_5", [0.0, 0.0, 0.0], 0.1, False),
        ("link_5", [0.0, 0.0, 0.02], 0.0, False),
        ("link_4", [0.0, 0.0, 0.0], 0.0, False),
        ("link_7", [0.0, 0.0, 0.0], 0.0, False),
    ],
)
def test_a_push_at_an_origin_that_two_links_share_is_told_of_either(
    link: str, point: list[float], moment: float, found: bool
) -> None:
    """A Panda's links 5 and 6 have one origin, so no log tells which of them is pushed there."""
    arms = {chain.kind: chain for chain in (cases.draw_arm(np.random.default_rng(k)) for k in range(40))}
    thing = Hidden("external_force", (), 5, {"wrench": [-2.7, 3.0, 6.8, 0.0, 0.0, 0.0]})
    truth = SimpleNamespace(described=arms["panda"], as_described=False, unusual=[thing])
    wrench = {"value": [-2.8, 3.0, 6.6, moment, 0.0, 0.0], "std": [0.2] * 6, "unit": "N, N·m"}
    where = {"value": point, "std": [0.001] * 3, "unit": "m"}
    effect = {
        "name": "external_force",
        "joints": [],
        "links": [link],
        "parameters": {"wrench": wrench, "point": where},
    }
    assert right(effect, cast(Any, SimpleNamespace(truth=truth))) == found
