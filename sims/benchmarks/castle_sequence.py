"""Tracks ViSP's simulated castle through its 40 frames by the two commands, and prints each frame's error.

    python sims/benchmarks/castle_sequence.py

The pose in the first frame is given. The tracker that the sequence was made for keeps all inside 2 mm and 0.4°.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from pose_truth import castle  # noqa: E402
from real_data import need  # noqa: E402

from twin_diagram.assets.description import read_spec  # noqa: E402
from twin_diagram.cli import main as twin_diagram  # noqa: E402


def main() -> int:
    """Track and print; 1 where a frame is outside."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    data = need("castle_sequence")
    with tempfile.TemporaryDirectory() as place:
        out = Path(place)
        castle.write_mesh(data, out / "castle.obj")
        castle.write_frames(data, out / "frames")
        library = ["--library", str(out / "library")]
        assert twin_diagram(["assets", "build", str(out / "castle.obj"), "--name", "castle", *library]) == 0
        origin = np.array(read_spec(out / "library" / "castle").origin)
        castle.write_first(data, out / "first.csv", origin)
        given = ["--frames", str(out / "frames"), "--init", str(out / "first.csv"), "--out", str(out / "run")]
        begin = time.process_time()
        assert twin_diagram(["track", *library, *given]) == 0
        spent = time.process_time() - begin
        found = castle.score(data, out / "run" / "poses.csv", origin)
    for frame, apart, turned in zip(found.frames, found.millimetres, found.degrees, strict=True):
        print(f"{frame:3d} {apart:6.2f} mm {turned:6.2f}°")
    inside = (found.millimetres < 2.0) & (found.degrees < 0.4)
    print(
        f"{len(found.frames)} of 40 frames, {inside.sum()} inside 2 mm / 0.4°, worst {found.millimetres.max():.2f} mm"
        f" {found.degrees.max():.2f}°, {1e3 * spent / 40:.0f} ms a frame with reading and labelling"
    )
    return 0 if inside.sum() == 40 else 1


if __name__ == "__main__":
    raise SystemExit(main())
