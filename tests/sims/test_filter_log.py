"""The filter over a measured log, by the script that shows it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.estimation_bench import JOINTS, Recording, World, simulate
from twin_diagram.logs import Log, read_log, write_log

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "sims"))

import filter_log

WORLD = World(mass=1.1, seed=1031, period=4.0)


@pytest.fixture(scope="module")
def run() -> Recording:
    return simulate(WORLD, 6.0)


@pytest.mark.long
@pytest.mark.parametrize("velocities", [True, False])
def test_payload_of_a_recorded_run(
    run: Recording, velocities: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Log(run.time, JOINTS, run.q, velocity=run.v if velocities else None, torque=run.tau)
    write_log(log, tmp_path / "run.csv")
    learn = ["payload", "coulomb_friction", "viscous_friction"]
    files = ["--log", str(tmp_path / "run.csv"), "--out", str(tmp_path / "states.csv")]
    assert filter_log.main(["--model", "arms/panda_hand.urdf", *files, "--learn", *learn]) == 0
    lines = dict(line.split(" ", 1) for line in capsys.readouterr().out.splitlines())
    assert len(lines) == 4 + 7 + 7
    value, _, rest = lines["payload.mass"].removeprefix("[kg] ").partition(" ± ")
    assert float(value) == pytest.approx(WORLD.mass, abs=0.1) and rest.endswith("settled")
    states = read_log(tmp_path / "states.csv")
    assert states.velocity is not None
    np.testing.assert_allclose(states.position[100:], run.q_true[100:], atol=2e-4)
    assert np.sqrt(np.mean((states.velocity[100:] - run.v_true[100:]) ** 2)) < 0.02


def test_bad_input_is_one_line(run: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = Log(run.time[:50], JOINTS, run.q[:50], torque=run.tau[:50])
    write_log(log, tmp_path / "run.csv")
    for arguments in (
        ["--model", "arms/panda_hand.urdf", "--log", str(tmp_path / "none.csv")],
        ["--model", "arms/ur5e.urdf", "--log", str(tmp_path / "run.csv")],
        ["--model", "arms/panda_hand.urdf", "--log", str(tmp_path / "run.csv"), "--learn", "magic"],
    ):
        assert filter_log.main(arguments) == 2
        err = capsys.readouterr().err
        assert err.startswith("error: ") and err.count("\n") == 1
