"""The page about an asset takes whatever the command builds from, and says beforehand what it cannot use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.assets.building.pictured import box, cameras, shots, write
from twin_diagram.logs.frames.transforms_folder import write_transforms

SCRIPT = Path(__file__).parents[2] / "sims" / "reconstruct.py"


def page(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=180)


@pytest.mark.slow
def test_nerfstudios_frames_are_shown_too(tmp_path: Path) -> None:
    taken = shots([box((0.04, 0.03, 0.05))], cameras(8, 0.02), masked=True)
    folder = write_transforms(tmp_path / "scan", taken.frames)
    done = page(folder, "--name", "box", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "page.html").is_file()


def test_a_truth_that_is_none_is_said_before_the_asset_is_built(tmp_path: Path) -> None:
    folder = write(shots([box((0.04, 0.03, 0.05))], cameras(3, 0.02)), tmp_path / "scan")
    done = page(folder, "--truth", tmp_path / "none", "--out", tmp_path / "out")
    assert done.returncode == 2 and str(tmp_path / "none") in done.stderr
    assert not (tmp_path / "out").exists()
