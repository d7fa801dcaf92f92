"""Real Kinect images of a table (mOSD): the table is found, things are parted, published labels score both.

    python sims/benchmarks/kinect_tabletop.py --out out/kinect_tabletop

Needs the data of `kinect_tabletop` (`$TWIN_DIAGRAM_DATA`, or `../shared/data`). Constants were tuned on `learn` alone.
A thing that touches no other counts as apart. Writes `page.html` with each thing below 0.85.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from real_data import need
from tabletop.kinect import Scene, touching
from tabletop.page import write_page

from twin_diagram.scenario import Perception

PARAMS = Perception(workspace=[[-1.5, -1.5, -0.02], [1.5, 1.5, 0.6]])


def main() -> None:
    """Print each scene's scores and the means; write the failures as pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/kinect_tabletop"))
    args = parser.parse_args()
    files = sorted(need("kinect_tabletop").glob("*/*.pcd"))
    all_, apart, failures = [], [], []
    print(f"{'scene':12s} {'table off [mm]':>14s} {'mean IoU':>8s}  each thing (* touches another)")
    for file in files:
        scene = Scene.read(file)
        found = scene.segmented(PARAMS)
        scores = scene.scores(found)
        near = touching(scene)
        all_ += scores.values()
        apart += [score for thing, score in scores.items() if thing not in near]
        each = "  ".join(f"{thing}: {score:.2f}{'*' if thing in near else ''}" for thing, score in scores.items())
        print(f"{file.stem:12s} {1e3 * scene.table_off():14.1f} {np.mean(list(scores.values())):8.3f}  {each}")
        failures += [(scene, found, thing, score) for thing, score in scores.items() if score < 0.85]
    print(f"mean IoU: things apart {np.mean(apart):.3f} ({len(apart)}), all {np.mean(all_):.3f} ({len(all_)})")
    print(f"wrote {write_page(args.out, failures)} with {len(failures)} failures")


if __name__ == "__main__":
    main()
