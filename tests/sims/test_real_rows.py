"""The references that `gap` is held against on measured logs: told the structure, they find what is there."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.gap.made import ARM, swing

SIMS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
if str(SIMS) not in sys.path:
    sys.path.insert(0, str(SIMS))

from real_references import least_squares, rows, table  # noqa: E402
from real_references.regression import Equations  # noqa: E402

LINK = np.array([3.0, 0.3, -0.2, 0.6, 0.5, 0.4, 0.3, 0.02, -0.03, 0.04])
"""Mass, mass times centre, inertia about the origin."""


def made(noise: float, seed: int = 3) -> tuple[Equations, np.ndarray]:
    """Equations of one joint of one link, random in all columns, and the parameters that they hold."""
    rng = np.random.default_rng(seed)
    truth = np.concatenate(
        [least_squares.from_log_cholesky(least_squares.log_cholesky(LINK) + 0.1), [2.0, 1.5, -0.7, 0.4]]
    )
    columns = rng.normal(size=(1, 4000, 14))
    torque = columns @ truth + noise * rng.normal(size=(1, 4000))
    return Equations(columns, torque, LINK, np.zeros((1, 4000)), 1200.0), truth


def test_a_link_has_coordinates_and_comes_back_from_them() -> None:
    found = least_squares.from_log_cholesky(least_squares.log_cholesky(LINK))
    np.testing.assert_allclose(found, LINK, atol=1e-12)
    slope = least_squares.jacobian(least_squares.log_cholesky(LINK))
    moved = least_squares.from_log_cholesky(least_squares.log_cholesky(LINK) + 1e-4 * np.ones(10))
    np.testing.assert_allclose(moved - LINK, slope @ (1e-4 * np.ones(10)), atol=1e-6)


@pytest.mark.parametrize("estimator", [least_squares.classical, least_squares.physical])
def test_both_find_links_and_friction(estimator) -> None:
    equations, truth = made(0.01)
    np.testing.assert_allclose(estimator(equations), truth, atol=0.01)
    assert equations.left(estimator(equations))[0] == pytest.approx(0.01, rel=0.05)


def test_the_physical_one_has_no_negative_friction() -> None:
    equations, truth = made(0.01)
    less = truth.copy()
    less[10] = -2.0
    against = Equations(equations.columns, equations.columns @ less, LINK, equations.stated, equations.seconds)
    assert least_squares.classical(against)[10] == pytest.approx(-2.0, abs=0.01)
    assert 0.0 <= least_squares.physical(against)[10] < 0.01


def test_logs_are_cut_by_time_since_their_begin(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time,x\n" + "".join(f"{5.0 + k},{k}\n" for k in range(10)))
    part = rows.cut(log, (2.0, 4.0), tmp_path / "part.csv").read_text().splitlines()
    assert part == ["time,x", "7.0,2", "8.0,3", "9.0,4"]
    assert rows.cut(log, rows.WHOLE, tmp_path / "other.csv") == log


def test_short_rows_are_run_where_they_are_asked_for() -> None:
    assert list(rows.chosen(None)) == list(rows.ROWS) and list(rows.chosen(None, short=True)) == list(rows.SHORT_ROWS)
    assert [row.name for row in rows.chosen(["lwr4", "lwr4-1-8"])] == ["lwr4", "lwr4-1-8"]


def test_the_table_says_ratios() -> None:
    found = {"description": np.array([2.0, 4.0]), "physical": np.array([1.0, 1.0])}
    gap = {
        "verdict": "named",
        "remainder": True,
        "effects": [{"name": "payload", "joints": [], "links": ["hand"]}],
        "gap": {"torque_rms": {"holdout": {"after": {"a": 1.0, "b": 2.0}}}},
        "processor": 3.0,
    }
    said = table.text(rows.ROWS[1], found, gap)
    assert "gap / physical      1.00   2.00  mean 1.50, most 2.00" in said
    assert "gap / description   0.50   0.50  mean 0.50, most 0.50" in said
    assert "named with remainder: payload(1)" in said


def test_two_corrected_models_are_as_far_apart_as_their_torques(tmp_path: Path) -> None:
    time, q, v, a = swing(4.0)
    torque = ARM.inverse_dynamics(q, v, a) + 0.3
    header = ",".join(["time", *(f"{s}.{j}" for s in ("position_measured", "torque_measured") for j in ARM.joints)])
    log = tmp_path / "log.csv"
    np.savetxt(log, np.column_stack([time, q, torque]), "%.9g", ",", header=header, comments="")
    described = Path(__file__).resolve().parents[2] / "models" / "arms" / "ur5e.urdf"
    heavier = described.read_text(encoding="utf-8").replace('<mass value="', '<mass value="1')
    (tmp_path / "heavier.urdf").write_text(heavier, encoding="utf-8")
    apart, left = table.agreement(described, described, log)
    assert np.all(apart == 0.0)
    np.testing.assert_allclose(left, 0.3, atol=0.1)
    apart, least = table.agreement(described, tmp_path / "heavier.urdf", log)
    assert np.all(apart[:-1] > 1.0) and apart[-1] < 1e-9  # nothing turns on the last joint but about its own axis
    np.testing.assert_allclose(least, left)
    assert table.agreement_text(tmp_path) == ""  # no run was done before
