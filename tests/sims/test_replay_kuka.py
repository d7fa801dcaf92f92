"""The measured runs of the KR300: what is left of the torque is what was worked out independently."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from twin_diagram.errors import TwinError
from twin_diagram.logs import read_log
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual_rms

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def script() -> ModuleType:
    sys.path.insert(0, str(CHECKOUT / "sims"))
    return importlib.import_module("kuka_kr300.runs")


@pytest.mark.parametrize("run", [pytest.param("A", marks=pytest.mark.long), pytest.param("B", marks=pytest.mark.slow)])
def test_residual_torque(script: ModuleType, data_dir: Path, run: str) -> None:
    """Within 10 % is asked; both ways come within 2 %."""
    found = script.residuals(run, data_dir / "kuka_kr300")
    for way in ("direct", "filtered"):
        np.testing.assert_allclose(found[way], script.EXPECTED[run], rtol=0.02)


def test_rotors_matter(script: ModuleType, data_dir: Path) -> None:
    """Without the rotors the first joint's figure is off, so the test above holds them too."""
    folder = data_dir / "kuka_kr300"
    log = read_log(folder / "trajectory_A.csv")
    plain = torque_residual_rms(Model.load(folder / "kr300.urdf"), log) / script.GEAR_RATIO
    assert plain[0] > 1.05 * script.EXPECTED["A"][0]


@pytest.mark.slow
def test_filter_follows_the_run(script: ModuleType, data_dir: Path) -> None:
    folder = data_dir / "kuka_kr300"
    log = read_log(folder / "trajectory_B.csv")
    seen = script.through_the_filter(script.kuka(folder), folder / "trajectory_B.csv")
    assert len(seen) > 0.98 * len(log)
    actual = np.stack([np.interp(seen.time, log.time, q) for q in log.position.T], axis=1)
    assert np.max(np.abs(seen.position - actual)[50:]) < 2e-3


def test_missing_data_is_said(script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_DIAGRAM_DATA", str(tmp_path))
    with pytest.raises(TwinError, match="set TWIN_DIAGRAM_DATA"):
        script.data_folder()
