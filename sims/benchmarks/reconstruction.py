"""How exact, how full and how fast objects are built from noisy pictures: prints a table, worst cell last.

`python sims/benchmarks/reconstruction.py [--views 40 8] [--noise 0 0.0015] [--objects mug …] [--first 0] [--seeds 1]
[--rings 25 50]`. Pictures are cast from `rendered_views`; told poses are 2 mm and 0.2° off. The truth is in the scorer
alone: what was built is laid on it rigidly, since an asset's frame is its own. Volume and what is told of its error are
`asset.yaml`'s; after them, the mesh's. Surface seen counts that two pictures or more see, within 75° of incidence.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from rendered_views import Picture, TrueObject, load, pictures, write_scene
from scipy.spatial import cKDTree

from twin_diagram.assets.building.from_frames import build_from_frames
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.mesh import read_obj
from twin_diagram.native import import_open3d
from twin_diagram.runtime.threads import one_thread
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

OBJECTS = ("cracker_box", "mug", "bottle", "can")
"""Of `models/objects`; a path of a glTF file may be given, too."""


FAR_OFF = 0.004
"""Distance from which a point of what was built is none of the object's, or one of the object's is lost [m]."""
TABLE_AT = 0.008
"""Height below which the former is what is left of the table [m]."""


class Surface:
    """Triangles that are asked for nearest points and shadows."""

    def __init__(self, vertices: Array, faces: Array) -> None:
        o3d = import_open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32)))

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Return the nearest points (N, 3) and the normals of their triangles."""
        found = self._scene.compute_closest_points(self._tensor(points.astype(np.float32)))
        return found["points"].numpy().astype(float), found["primitive_normals"].numpy().astype(float)

    def shows(self, shots: list[Picture], points: Array, normals: Array) -> Array:
        """Return how many pictures see each point."""
        count = np.zeros(len(points))
        for shot in shots:
            c = shot.true
            away = points - c.p_WC
            reach = np.linalg.norm(away, axis=1)
            rays = np.concatenate([np.broadcast_to(c.p_WC, points.shape), away], axis=1).astype(np.float32)
            hit = self._scene.cast_rays(self._tensor(rays))["t_hit"].numpy()
            facing = -(away * normals).sum(axis=1) / reach
            u, v, _ = c.project(points)
            inside = (u > 0) & (v > 0) & (u < c.width - 1) & (v < c.height - 1)
            count += (hit > 1 - 0.001 / reach) & (facing > np.cos(np.radians(75))) & inside
        return count


def spread(vertices: Array, faces: Array, count: int, seed: int) -> tuple[Array, Array]:
    """Return points even over a surface, and normals."""
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    area = np.linalg.norm(flat, axis=1)
    k = rng.choice(len(faces), count, p=area / area.sum())
    s, t = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return a[k] * (1 - s) + b[k] * s * (1 - t) + c[k] * s * t, flat[k] / np.maximum(area[k], 1e-20)[:, None]


def laid_on(points: Array, true: Surface, about: Array, rounds: int = 40) -> tuple[Array, Array]:
    """Return the rotation and shift about a point that lay points on a surface, by point-to-plane steps."""
    R, t = np.eye(3), np.zeros(3)
    for _ in range(rounds):
        now = (points - about) @ R.T + about + t
        near, normal = true.nearest(now)
        e = ((now - near) * normal).sum(axis=1)
        J = np.hstack([np.cross(now - about, normal), normal])
        w = (1 + (e / max(0.0005, np.median(np.abs(e)))) ** 2) ** -2.0
        x = -np.linalg.solve((J * w[:, None]).T @ J + 1e-9 * np.eye(6), J.T @ (w * e))
        turn = rotations.matrix(rotations.exp(x[:3]))
        R, t = turn @ R, turn @ t + x[3:]
    return R, t


def capped(faces: Array) -> Array:
    """Return faces (F, 3) with a fan over each hole: a part that ends within another one is often open there."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both = {(int(a), int(b)) for a, b in edges}
    onward = {b: a for a, b in both if (b, a) not in both}
    fans = []
    while onward:
        first, at = next(iter(onward.items()))
        loop = [first]
        while at != first and at in onward:
            loop.append(at)
            at = onward.pop(at)
        onward.pop(first)
        fans += [[loop[0], loop[k], loop[k + 1]] for k in range(1, len(loop) - 1)]
    return np.concatenate([faces, np.array(fans, dtype=faces.dtype).reshape(-1, 3)])


def true_volume(item: TrueObject, step: float = 0.0006) -> float:
    """Return what an object's outlines hold [m³], by counting crossings; parts that overlap count once."""
    _, first, place = np.unique(np.round(item.vertices, 6), axis=0, return_index=True, return_inverse=True)
    o3d = import_open3d()
    inside = None
    low, high = item.vertices.min(axis=0), item.vertices.max(axis=0)
    grid = np.stack(np.meshgrid(*(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))), axis=-1)
    for part in item.parts():
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        own = first[place.reshape(-1)][item.faces[part]]  # places, whatever the texture's seams
        faces = capped(own[(own != np.roll(own, 1, axis=1)).all(axis=1)])
        scene.add_triangles(o3d.core.Tensor(item.vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
        full = scene.compute_occupancy(o3d.core.Tensor(grid.reshape(-1, 3).astype(np.float32)), nsamples=3).numpy() > 0
        inside = full if inside is None else inside | full
    return float(np.count_nonzero(inside)) * step**3


def with_others(item: TrueObject, others: list[TrueObject]) -> Surface:
    """Return the surface of a thing and of what stands beside it, and hides some of it."""
    every = [item, *others]
    first = np.cumsum([0, *(len(one.vertices) for one in every)])
    faces = [one.faces + start for one, start in zip(every, first, strict=False)]
    return Surface(np.concatenate([one.vertices for one in every]), np.concatenate(faces))


def score(
    item: TrueObject, shots: list[Picture], vertices: Array, faces: Array, others: list[TrueObject] | None = None
) -> dict[str, float]:
    """Return distances both ways [mm] on what is seen, what is left of the table and lost of the thing, volume.

    `others` stand beside it: what they hide in a picture is not seen there.
    """
    true = Surface(item.vertices, item.faces)
    points, normals = spread(item.vertices, item.faces, 20000, 0)
    seen = with_others(item, others or []).shows(shots, points, normals) >= 2
    built, _ = spread(vertices, faces, 20000, 1)
    R, t = laid_on(built[::4], true, item.vertices.mean(axis=0))
    about = item.vertices.mean(axis=0)
    built, vertices = ((x - about) @ R.T + about + t for x in (built, vertices))
    there = np.linalg.norm(Surface(vertices, faces).nearest(points[seen])[0] - points[seen], axis=1) * 1000
    back = np.linalg.norm(true.nearest(built)[0] - built, axis=1) * 1000
    back = back[seen[cKDTree(points).query(built)[1]]]
    off = np.linalg.norm(true.nearest(built)[0] - built, axis=1)
    low = built[:, 2] < item.vertices[:, 2].min() + TABLE_AT
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c)) / 6
    return {
        "to built": there.mean(),
        "p95": float(np.quantile(there, 0.95)),
        "to truth": back.mean(),
        "p95 back": float(np.quantile(back, 0.95)),
        "table left %": 100 * float((low & (off > FAR_OFF)).mean()),
        "lost %": 100 * float((there > 1000 * FAR_OFF).mean()),
        "volume %": 100 * (volume / true_volume(item) - 1),
    }


@one_thread()
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--objects", nargs="+", default=list(OBJECTS))
    parser.add_argument("--views", nargs="+", type=int, default=[40, 8])
    parser.add_argument("--noise", nargs="+", type=float, default=[0.0015], help="RMS at 1 m [m]")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--rings", nargs="+", type=float, default=[], help="elevations [deg], instead of a spiral")
    parser.add_argument("--masks", action="store_true")
    told = parser.parse_args()
    print("object            views noise seed | s (cpu) to built   p95 to truth   p95 volume %  told mesh % unseen")
    for name in told.objects:
        folder = models_dir() / "objects" / name
        item = load(folder if folder.is_dir() else Path(name))
        for views in told.views:
            for noise in told.noise:
                for seed in range(told.first, told.first + told.seeds):
                    shots = pictures(item, views, noise, seed=seed, elevations=told.rings)
                    with tempfile.TemporaryDirectory() as aside:
                        scene = write_scene(Path(aside) / "scene", shots, told.masks)
                        start = time.process_time()
                        built = build_from_frames(scene, "built", Path(aside) / "library", density=500.0)
                        taken = time.process_time() - start
                        mesh, spec = read_obj(built.folder / "visual.obj"), read_spec(built.folder)
                        vertices = mesh.vertices + np.array(spec.origin)
                        found, true = score(item, shots, vertices, mesh.faces), true_volume(item)
                        volume, std = ((x or np.nan) / true * 100 for x in (spec.volume, spec.volume_std))
                        print(
                            f"{item.name:17} {views:5} {noise:5g} {seed:4} | {taken:7.1f} {found['to built']:8.3f} "
                            f"{found['p95']:5.2f} {found['to truth']:8.3f} {found['p95 back']:5.2f} "
                            f"{volume - 100:+8.2f} {std:5.1f} {found['volume %']:+6.1f} {spec.unseen:6.2f}",
                            flush=True,
                        )


if __name__ == "__main__":
    main()
