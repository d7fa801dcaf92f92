"""What each step of Stage I is worth: views, mask expansion, denoising, tall and weakly supported things, predictions.

    python sims/benchmarks/ablations.py --out out/ablations
    python sims/benchmarks/ablations.py --rows views --views 5 10
    python sims/benchmarks/ablations.py --rows predictions --seeds 0 1 2

SyncTwin's Figures 5, 6 and 9. Pictures are cast with a D415's noise, poses 2 mm / 0.2° off; masks are the true ones.
Prints a table and writes `OUT/page.html`, with a picture of each result beside the truth. Seconds are of processor
time, the scale's error is that of predictions by their cube; a row that the same code left in `OUT/rows.jsonl` is not
built again.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import trimesh

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parent), str(SIMS.parents[1])]

import result_lines  # noqa: E402
from asset_pictures import drawing  # noqa: E402
from asset_pictures.page import write_page  # noqa: E402
from reconstruction import score  # noqa: E402
from rendered_views import Picture, TrueObject, cube, load, pictures, write_predictions, write_scene  # noqa: E402

from twin_diagram.assets.building import build_from_frames, build_from_predictions, reconstruct  # noqa: E402
from twin_diagram.assets.description import read_spec  # noqa: E402
from twin_diagram.assets.mesh import read_obj  # noqa: E402
from twin_diagram.errors import TwinError  # noqa: E402
from twin_diagram.runtime.threads import one_thread  # noqa: E402
from twin_diagram.scenario.resources import models_dir  # noqa: E402

EDGE, UNIT = 0.05, 0.41
"""Of the green cube [m], and of the predictions."""
COLUMNS = ("to built", "p95", "to truth", "p95 back", "table left %", "lost %", "volume %")


def _made(name: str, mesh: trimesh.Trimesh) -> TrueObject:
    vertices = np.asarray(mesh.vertices) - [0, 0, float(mesh.bounds[0, 2])]
    grey = np.full((8, 8, 3), 150, np.uint8)
    return TrueObject(name, vertices, np.asarray(mesh.faces), np.zeros((len(vertices), 2)), grey)


def _round(name: str, outline: list[list[float]]) -> TrueObject:
    return _made(name, trimesh.creation.revolve(np.array(outline), sections=64))


THINGS: dict[str, Callable[[], TrueObject]] = {
    "mug": lambda: load(models_dir() / "objects" / "mug"),
    "box": lambda: load(models_dir() / "objects" / "cracker_box"),
    "tall rod": lambda: _round("rod", [[0, 0], [0.02, 0], [0.02, 0.4], [0, 0.4]]),
    "ball": lambda: _made("ball", trimesh.creation.icosphere(4, 0.04)),
    "mushroom": lambda: _round("mushroom", [[0, 0], [0.012, 0], [0.012, 0.07], [0.05, 0.07], [0.05, 0.09], [0, 0.09]]),
}
"""A mug, a box, and what is tall or stands on little."""


@dataclass(frozen=True)
class Row:
    """One thing to be built: how many views, and what is left out."""

    group: str
    thing: str
    views: int
    without: str = ""
    predicted: bool = False
    seed: int = 0

    @property
    def label(self) -> str:
        """What the table calls it."""
        extra = f", no {self.without}" if self.without else ", predictions" if self.predicted else ""
        return f"{self.thing}, {self.views} views{extra}" + (f", seed {self.seed}" if self.seed else "")

    def beside(self) -> list[TrueObject]:
        """Return what stands beside the thing: the cube that tells the scale of predictions."""
        return [cube(EDGE, (0.11, 0.02))] if self.predicted else []


def rows(groups: list[str], views: list[int], seeds: list[int]) -> Iterator[Row]:
    """Yield what is to be built, for each seed of the pictures."""
    every = [Row("views", thing, count) for thing in ("mug", "box") for count in views]
    for thing in ("mug", "tall rod", "ball", "mushroom"):
        every += [Row("steps", thing, 10, without) for without in ("", "expansion", "denoising")]
    every += [Row("predictions", thing, count, predicted=True) for thing in ("box", "mug") for count in (5, 10)]
    yield from (replace(row, seed=seed) for seed in seeds for row in every if row.group in groups)


def build(row: Row, item: TrueObject, out: Path) -> tuple[list[Picture], Path, float, float]:
    """Build one row's asset.

    Returns its pictures, its folder, the seconds that it took, and by what share the scale found is off; NaN of frames.
    """
    distance = 0.6 if item.vertices[:, 2].max() < 0.3 else 0.9
    shots = pictures(item, row.views, seed=row.seed, distance=distance, others=row.beside())
    name = row.label.replace(", ", "-").replace(" ", "_")
    begin, scale = time.process_time(), float("nan")
    said: list[str] = []
    with ExitStack() as changes:
        if row.without == "expansion":
            changes.enter_context(patch.object(reconstruct, "grown", lambda mask, pixels=0: mask))
        if row.without == "denoising":
            changes.enter_context(patch.object(reconstruct, "find_plane", lambda *a, **k: None))
        if row.predicted:
            out.mkdir(parents=True, exist_ok=True)
            file = write_predictions(out / f"{name}.npz", shots, UNIT, row.seed)
            built = build_from_predictions(file, name, out / "library", EDGE, replace_it=True, say=said.append)
            scale = float(said[0].removeprefix("scale: ").split()[0]) / UNIT - 1
        else:
            scene = write_scene(out / "scenes" / name, shots)
            built = build_from_frames(scene, name, out / "library", density=500.0, replace_it=True)
    return shots, built.folder, time.process_time() - begin, scale


def run(row: Row, out: Path) -> dict[str, float | str]:
    """Build and score one row."""
    item = THINGS[row.thing]()
    try:
        shots, folder, seconds, scale = build(row, item, out)
    except TwinError as error:
        return {"label": row.label, "refused": str(error)}
    mesh, spec = read_obj(folder / "visual.obj"), read_spec(folder)
    found = score(item, shots, mesh.vertices + np.array(spec.origin), mesh.faces, row.beside())
    return {"label": row.label, "folder": folder.name, "s": seconds, "scale %": 100 * scale, **found}


def told(result: dict[str, float | str]) -> str:
    """Return a row of the table."""
    if "refused" in result:
        return f"{result['label']:34} refused: {result['refused']}"
    return f"{result['label']:34} {float(result['s']):6.1f} {float(result['scale %']):+7.2f} " + " ".join(
        f"{float(result[key]):{max(7, len(key))}.2f}" for key in COLUMNS
    )


def picture(folder: Path, item: TrueObject) -> list[tuple[str, drawing.Picture]]:
    """Return what was built beside the truth, in grey."""
    mesh = read_obj(folder / "visual.obj")
    row = []
    for called, vertices, faces in (("built", mesh.vertices, mesh.faces), ("true", item.vertices, item.faces)):
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        reach = 0.55 * float(np.linalg.norm(np.ptp(item.vertices, axis=0)))
        grey = np.full((len(faces), 3), 205.0)
        row.append((called, drawing.mesh_picture(vertices[faces], grey, middle, reach, -60, 40)))
    return row


@one_thread()
def main() -> None:
    """Print the table and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    groups = ["views", "steps", "predictions"]
    parser.add_argument("--rows", nargs="+", choices=groups, default=groups)
    parser.add_argument("--views", nargs="+", type=int, default=[5, 10, 20, 40, 60])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--out", type=Path, default=Path("out/ablations"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "rows.jsonl"
    done = {r["label"]: r for r in result_lines.read(file)}
    print(f"{'':34} {'s':>6} {'scale %':>7} " + " ".join(f"{key:>7}" for key in COLUMNS))
    parts = []
    for row in rows(args.rows, args.views, args.seeds):
        if row.label not in done:
            done[row.label] = run(row, args.out)
            result_lines.append(file, done[row.label])
        result = done[row.label]
        print(told(result), flush=True)
        shown = picture(args.out / "library" / str(result["folder"]), THINGS[row.thing]()) if "folder" in result else []
        parts.append((row.label, [told(result)], shown))
    print(f"see {write_page(args.out / 'page.html', 'What each step of Stage I is worth', parts)}")


if __name__ == "__main__":
    main()
