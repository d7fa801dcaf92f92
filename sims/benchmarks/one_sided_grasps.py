"""Counts how many grasps that are proposed on what one camera sees of a thing hold on the whole of it.

    python sims/benchmarks/one_sided_grasps.py --views 6
    python sims/benchmarks/one_sided_grasps.py --views 6 --hidden --mesh a.obj b.obj

Each thing stands on a table and is seen from 0.9 m, 25 to 55° above it, with depth off by 0.7 mm; with `--hidden` a
post stands before a part of it. A grasp holds where the whole surface says so, collisions included. For each thing:
views in which the first grasp holds, mean share of ten that do, views without any grasp, processor time.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram import TwinError
from twin_diagram.native import import_open3d
from twin_diagram.planning.grasps import PANDA_HAND, Wanted, propose, rank, read_known

Array = npt.NDArray[np.float64]

THINGS = ("can", "gelatin_box", "bottle", "mug", "sugar_box")
"""Of those that come along, what the Panda's hand can take."""
AWAY = 0.9
"""From the camera [m]."""
ELEVATION = (25.0, 55.0)
"""Of the camera [°]."""
NOISE = 0.0007
"""Of depth [m]."""
POST = (0.06, 0.06, 0.2)
"""What stands before a thing with `--hidden` [m]."""


@dataclass(frozen=True)
class Shown:
    """What one camera sees: points (N, 3) of the thing in random order, normals, those of what hides it, the camera."""

    points: Array
    normals: Array
    others: Array
    eye: Array


def look(triangles: Array, rng: np.random.Generator, hidden: bool) -> Shown:
    """Return what a camera sees of a surface (F, 3, 3) from a side that is drawn."""
    corners = triangles.reshape(-1, 3)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    turn, lift = rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(*ELEVATION))
    ahead, aside = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    eye = middle + AWAY * (np.cos(lift) * ahead + np.sin(lift) * np.array([0.0, 0.0, 1.0]))
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(o3d.core.Tensor(corners.astype(np.float32)), o3d.core.Tensor(faces))
    if hidden:
        post = o3d.geometry.TriangleMesh.create_box(*POST)
        at = middle + 0.15 * ahead + rng.choice([-1.0, 1.0]) * rng.uniform(0.04, 0.07) * aside
        post.translate(np.array([at[0], at[1], corners[:, 2].min()]) - np.array([POST[0] / 2, POST[1] / 2, 0.0]))
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(post))
    rays = scene.create_rays_pinhole(fov_deg=56, center=middle, eye=eye, up=[0, 0, 1], width_px=320, height_px=240)
    hits = {name: value.numpy() for name, value in scene.cast_rays(rays).items()}
    ray = rays.numpy().astype(float)
    places = ray[..., :3] + hits["t_hit"][..., None] * ray[..., 3:]
    mine = hits["geometry_ids"] == 0
    points, normals = places[mine], hits["primitive_normals"][mine].astype(float)
    normals *= np.sign(np.einsum("ni,ni->n", normals, eye - points))[:, None]
    order = rng.permutation(len(points))
    points = points + rng.normal(0.0, NOISE, points.shape)
    return Shown(points[order], normals[order], places[hits["geometry_ids"] == 1], eye)


def tried(name: str, views: int, seed: int, hidden: bool) -> dict[str, Any]:
    """Return the counts of one thing."""
    known = read_known(name)
    assert known.triangles is not None
    low = float(known.triangles[..., 2].min())
    whole = known.target(table=True)
    first, shares, empty, took = 0, [], 0, 0.0
    for view in range(views):
        shown = look(known.triangles, np.random.default_rng([seed, view]), hidden)
        begun = time.process_time()
        found = propose(
            shown.points, shown.normals, PANDA_HAND, viewpoint=shown.eye, table=np.array([0.0, 0.0, 1.0, low]),
            surroundings=shown.others if len(shown.others) else None,
        )  # fmt: skip
        took += time.process_time() - begun
        if not len(found):
            empty += 1
            continue
        held = rank(found, whole, PANDA_HAND, Wanted(len(found), triangles=known.triangles))
        good = [bool((np.abs(held.poses - pose).max(axis=1, initial=0.0) < 1e-9).any()) for pose in found.poses]
        first += good[0]
        shares.append(np.mean(good))
    return {"first": first, "share": float(np.sum(shares)) / views, "empty": empty, "ms": 1e3 * took / views}


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--mesh", nargs="+", default=[f"objects/{name}" for name in THINGS], help="assets or meshes [m]"
    )
    parser.add_argument("--views", type=int, default=6, help="of each (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the views (default: %(default)s)")
    parser.add_argument("--hidden", action="store_true", help="a post stands before a part of each")
    arguments = parser.parse_args()
    try:
        every = []
        for name in arguments.mesh:
            row = tried(name, arguments.views, arguments.seed, arguments.hidden)
            every.append(row)
            told = f"first holds {row['first']} of {arguments.views}, of ten {100 * row['share']:3.0f} %"
            print(f"{Path(name).stem:16s} {told}, none {row['empty']}, {row['ms']:.0f} ms", flush=True)
        first, views = sum(row["first"] for row in every), arguments.views * len(every)
        share = 100 * np.mean([row["share"] for row in every])
        print(f"all: first holds {first} of {views} ({100 * first / views:.0f} %), of ten {share:.0f} %")
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
