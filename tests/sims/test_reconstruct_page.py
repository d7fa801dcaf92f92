"""The page about an asset takes whatever the command builds from, and says beforehand what it cannot use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.assets.building.pictured import box, cameras, shots, write
from twin_diagram.logs.frames.transforms_folder import write_transforms

SIMS = Path(__file__).resolve().parents[2] / "sims"
SCRIPT = SIMS / "reconstruct.py"
sys.path[:0] = [str(SIMS)]

from asset_pictures.built_asset import finer  # noqa: E402


def test_large_triangles_are_drawn_in_all_their_colours() -> None:
    """A can of long triangles was drawn in stripes: each has one colour."""
    corners = np.array(
        [[[0, 0, 0], [0.08, 0, 0], [0, 0.02, 0]], [[0, 0, 0], [0.001, 0, 0], [0, 0.001, 0]]], dtype=float
    )
    parts, uv = finer(corners, corners[..., :2] * 10, 0.003)
    assert np.linalg.norm(parts - np.roll(parts, 1, axis=1), axis=2).max() <= 0.003
    np.testing.assert_allclose(uv, parts[..., :2] * 10, atol=1e-12)
    area = np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(0.0008 + 5e-7)


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
