"""A sequence from elsewhere, with exact poses, through both commands, held to the bounds of its own tracker."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.assets.description import read_spec
from twin_diagram.cli import main

CHECKOUT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(CHECKOUT / "sims" / "benchmarks"))

from pose_truth import castle  # noqa: E402


@pytest.mark.parametrize("count", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_each_frame_of_the_castle_is_inside_its_trackers_bounds(count: int, tmp_path: Path, data_dir: Path) -> None:
    source = data_dir / "castle_sequence"
    castle.write_mesh(source, tmp_path / "castle.obj")
    castle.write_frames(source, tmp_path / "frames", count)
    library = ["--library", str(tmp_path / "library")]
    assert main(["assets", "build", str(tmp_path / "castle.obj"), "--name", "castle", *library]) == 0
    origin = np.array(read_spec(tmp_path / "library" / "castle").origin)
    castle.write_first(source, tmp_path / "first.csv", origin)
    given = ["--frames", str(tmp_path / "frames"), "--init", str(tmp_path / "first.csv")]
    assert main(["track", *library, *given, "--out", str(tmp_path / "run")]) == 0
    found = castle.score(source, tmp_path / "run" / "poses.csv", origin)
    assert found.frames == list(range(1, count + 1))
    assert found.millimetres.max() < 2.0 and found.degrees.max() < 0.4
