"""Where benchmarks look for the published data."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import real_data  # noqa: E402


def test_data_that_is_not_there_ends_a_benchmark_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(real_data, "DATA", tmp_path)
    with pytest.raises(SystemExit) as end:
        real_data.need("ycb")
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said == f"{tmp_path / 'ycb'}: no such folder; set TWIN_DIAGRAM_DATA to the folder that holds ycb\n"
    (tmp_path / "ycb").mkdir()
    assert real_data.need("ycb") == tmp_path / "ycb"
