"""Follows things that are painted otherwise than their assets, by the command `track`, beside strangers.

    python sims/benchmarks/painted_otherwise.py --first 0 --count 8
    python sims/benchmarks/painted_otherwise.py --first 100000 --count 4 --without-rgb

Five things stand before a D435 for 12 frames at 15 Hz: two to four of them grey, of one other colour or with inverted
colours, the rest as their assets. Two strangers are things of the library, stretched by 10 to 15 % along each axis,
grey or painted as it. Where shape cannot part the two cans, neither is counted. Printed: poses within 5 mm and 5° up to
symmetry, named ones, truth among hypotheses, and claims of what is not there. Seeds from 100000 are held back. Needs
the YCB meshes.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from pose_truth import raycast, spoil  # noqa: E402
from pose_truth.things import GREY, ROUND, YCB, Thing, thing  # noqa: E402
from real_data import DATA, need  # noqa: E402
from rendered_views import Picture, write_scene  # noqa: E402
from scene_truth import library  # noqa: E402
from scene_truth.film import _seen  # noqa: E402
from scene_truth.script import CELLS, _stood  # noqa: E402

from twin_diagram.assets.mesh import Mesh  # noqa: E402
from twin_diagram.logs.frames.view_camera import ViewCamera  # noqa: E402
from twin_diagram.perception.registration.model_cloud import alike_turns  # noqa: E402
from twin_diagram.runs.tracking.track_frames import track_frames  # noqa: E402
from twin_diagram.signals import rotations  # noqa: E402

Array = npt.NDArray[np.float64]
KINDS = [*YCB, "mug", "can"]
CANS = ("can", "005_tomato_soup_can")
FRAMES = 12
OPEN, NEAR, SAME = 0.3, 0.05, np.radians(12.0)
"""Share of a thing that is seen where it counts; where a claim is of it [m]; a hypothesis is the truth within this."""


@dataclass(frozen=True)
class Actor:
    """A thing where it stands: its kind (`?` before a stranger's), how it is painted, and its mesh's pose."""

    one: Thing
    R: Array
    p: Array
    name: str
    how: str


def painted(one: Thing, how: str, rng: np.random.Generator) -> Thing:
    """Return a thing grey, of one colour, or with colours inverted and exchanged; `told`: as it is."""
    texture = one.texture
    if how == "grey":
        texture = np.full_like(texture, GREY)
    elif how == "flat":
        texture = np.broadcast_to(rng.integers(30, 230, 3).astype(np.uint8), texture.shape).copy()
    elif how == "inverse":
        texture = np.ascontiguousarray(255 - texture[..., rng.permutation(3)])
    return replace(one, texture=texture)


def stretched(one: Thing, by: Array) -> Thing:
    """Return a thing stretched by factors (3,) along its mesh's axes."""
    mesh, asset = one.mesh, one.asset
    pieces = tuple(piece * by for piece in asset.convex_pieces)
    other = replace(asset, points_O=asset.points_O * by, size=asset.size * by, convex_pieces=pieces)
    return replace(one, mesh=Mesh(mesh.vertices * by, mesh.normals, mesh.uv, mesh.faces), asset=other)


def cast(seed: int, rng: np.random.Generator) -> list[Actor]:
    """Draw five things and two strangers; of odd seeds none is the can that is nearly the soup can."""
    pool = KINDS if seed % 2 == 0 else KINDS[:-1]
    kinds = [str(kind) for kind in rng.permutation(pool)[:5]]
    hows = ["grey", "grey", rng.choice(["grey", "flat", "inverse"]), "told", rng.choice(["flat", "told"])]
    cells = rng.permutation(12)
    actors = []
    for j, (kind, how) in enumerate(zip(kinds, hows, strict=True)):
        one = painted(thing(kind, DATA), how, rng)
        actors.append(Actor(one, *_stood(one, CELLS[cells[j]], rng), kind, str(how)))
    for j in range(2):
        kind = str(rng.choice(pool))
        by = 1 + rng.uniform(0.10, 0.15, 3) * rng.choice([-1, 1], 3)
        if kind in CANS:
            by[1] = by[0]
        how = str(rng.choice(["grey", "told"]))
        one = painted(stretched(thing(kind, DATA), by), how, rng)
        actors.append(Actor(one, *_stood(one, CELLS[cells[5 + j]], rng), f"?{kind}", how))
    return actors


def filmed(folder: Path, actors: list[Actor], rng: np.random.Generator) -> Array:
    """Write frames into a folder; return (FRAMES, A) the share of each that is seen."""
    azimuth, elevation = rng.uniform(-2.2, -0.9), np.radians(rng.uniform(35, 60))
    distance, sweep = float(rng.uniform(0.8, 1.15)), rng.choice([0.0, 0.3])
    waves = spoil.field((480, 640), 15.0, rng)
    shots, seen = [], []
    for frame in range(FRAMES):
        at = azimuth + sweep * frame / FRAMES
        away = np.array([np.cos(at) * np.cos(elevation), np.sin(at) * np.cos(elevation), np.sin(elevation)])
        camera = raycast.look_at(distance * away, np.array([0, 0, 0.03]), focal=560.0)
        taken = raycast.take(camera, [(one.one, one.R, one.p) for one in actors])
        size = (camera.width, camera.height, camera.focal, camera.focal, *camera.centre)
        view = ViewCamera(*size, camera.R_WC, camera.p_WC)
        depth, rgb = spoil.spoiled(taken, "d435", rng, waves)
        shots.append(Picture(view, view, depth, rgb, taken.label == 0))
        seen.append([_seen(camera, taken, j, one.one, one.R, one.p) for j, one in enumerate(actors)])
    write_scene(folder, shots, with_masks=False)
    (folder / "times.json").write_text(json.dumps([round(k / 15, 6) for k in range(FRAMES)]))
    return np.array(seen)


def symmetries(kind: str) -> Array:
    """Return turns (T, 3, 3) that leave a thing's shape alike, none first."""
    from scipy.spatial import cKDTree

    points = thing(kind, DATA).asset.points_O
    most = 0.003 + 0.08 * np.linalg.norm(points, axis=1).max()
    return np.concatenate([np.eye(3)[None], alike_turns(points, cKDTree(points), float(most), None)])


def off(R: Array, truth: Array, kind: str, turns: Array | None = None) -> float:
    """Return the angle between two turns [rad], up to a round thing's axis and to `turns`."""
    if kind in ROUND:
        angle = float(np.arccos(np.clip(R[:, 2] @ truth[:, 2], -1, 1)))
        return angle if turns is None else min(angle, np.pi - angle)
    ways = np.eye(3)[None] if turns is None else turns
    cosine = 0.5 * (np.einsum("ij,ik,tkj->t", R, truth, ways) - 1.0)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).min())


def counted(
    row: dict, actors: list[Actor], seen: Array, origins: dict[str, Array], without_rgb: bool, both_cans: bool
) -> Counter[str]:
    """Count what a line of `objects.jsonl` claims; `seen` (A,) the share of each actor in its frame."""
    count: Counter[str] = Counter()
    claims = [one for one in row["objects"] if one["asset"] and one["status"] not in ("lost", "gone", "unseen")]
    for one in claims:
        one["R"] = rotations.matrix(np.array(one["q_WO"]))
        one["at"] = np.array(one["p_WO"]) - one["R"] @ origins.get(one["asset"], np.zeros(3))
    for j, actor in enumerate(actors):
        if actor.name.startswith("?"):
            continue
        told = actor.how == "told" and not without_rgb
        away = [
            (float(np.linalg.norm(one["at"] - actor.p)), k)
            for k, one in enumerate(claims)
            if one["asset"] == actor.name
        ]
        distance, k = min(away, default=(np.inf, -1))
        one = claims.pop(k) if distance < NEAR else None
        if (both_cans and actor.name in CANS and not told) or seen[j] < OPEN:
            continue
        group = "as told" if told else "otherwise"
        count[group] += 1
        if one is None:
            continue
        right = distance < 0.005 and off(one["R"], actor.R, actor.name, symmetries(actor.name)) < np.radians(5.0)
        ways = [rotations.matrix(np.array(way["q_WO"])) for way in one["hypotheses"]]
        count[f"{group}, right"] += right
        count[f"{group}, named"] += 1
        count[f"{group}, named >= 0.5"] += one["named"] >= 0.5
        count[f"{group}, truth among hypotheses"] += any(off(R, actor.R, actor.name) < SAME for R in ways)
    count["not there"] += len(claims)
    count["not there, >= 0.5"] += sum(one["probability"] >= 0.5 for one in claims)
    count["not there, named >= 0.5"] += sum(one["named"] >= 0.5 for one in claims)
    return count


def main() -> None:
    """Film, follow and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="first seed; from 100000 on they are held back")
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--without-rgb", action="store_true", help="the frames have no colours")
    parser.add_argument("--out", type=Path, default=Path("out/painted_otherwise"), help="keeps the assets")
    args = parser.parse_args()
    need("ycb")
    whole: Counter[str] = Counter()
    for seed in range(args.first, args.first + args.count):
        rng = np.random.default_rng([seed, 777])
        actors, both = cast(seed, rng), seed % 2 == 0
        with tempfile.TemporaryDirectory() as aside:
            known, frames, found = (Path(aside) / name for name in ("library", "frames", "found"))
            origins = library.built(known, args.out / "assets", KINDS if both else KINDS[:-1], DATA)
            seen = filmed(frames, actors, rng)
            if args.without_rgb:
                shutil.rmtree(frames / "rgb")
            track_frames(known, frames, found, say=lambda text: None)
            lines = (found / "objects.jsonl").read_text().splitlines()
        for row, shares in zip(map(json.loads, lines), seen, strict=True):
            whole += counted(row, actors, shares, origins, args.without_rgb, both)
        print(f"seed {seed}", file=sys.stderr, flush=True)
    for name in sorted(whole):
        print(f"{name}: {whole[name]}")


if __name__ == "__main__":
    main()
