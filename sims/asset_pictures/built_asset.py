"""What is shown of an asset: its views, its cloud before and after denoising, its mesh, its pieces, and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from asset_pictures import drawing
from asset_pictures.page import Row
from twin_diagram.assets import Asset
from twin_diagram.assets.building.depth_view import view_points
from twin_diagram.assets.building.reconstruct import looked_over, object_points
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.mesh import bilinear, read_obj, read_png
from twin_diagram.logs.frames import FrameFolder
from twin_diagram.logs.frames.transforms_folder import TransformsFolder
from twin_diagram.signals.arrays import Array

Part = tuple[str, Sequence[str], Row]


def views_part(frames: FrameFolder | TransformsFolder, most: int = 12) -> Part:
    """Return some of the pictures with their masks."""
    chosen = np.unique(np.linspace(0, len(frames) - 1, most).round().astype(int))
    read = [frames.read(int(k)) for k in chosen]
    row = [(f"frame {f.number}", drawing.view_picture(f.rgb, f.mask)) for f in read if f.rgb is not None]
    said = "masks are outlined" if frames.has_masks else "no masks were given: the object is what stands out"
    return f"{len(frames)} views", [f"{len(row)} of them; {said}."], row


def cloud_part(frames: FrameFolder | TransformsFolder, where: str) -> Part:
    """Return the scene's cloud, and what is left of it as the object's."""
    views = [looked_over(frames.read(k)) for k in range(len(frames))]
    kept, plane = object_points(views, where, 0)
    middle, reach = (kept.min(axis=0) + kept.max(axis=0)) / 2, float(np.linalg.norm(np.ptp(kept, axis=0))) / 2
    scene = np.concatenate([view_points(view, 1, None)[0] for view in views])
    scene = scene[(np.abs(scene - middle) < 1.6 * reach).all(axis=1)]
    own = kept if plane is None else kept[kept @ plane[:3] - plane[3] > 1e-6]
    row = [
        ("all that was seen there", drawing.cloud_picture(scene, _by_height(scene), middle, 1.6 * reach)),
        ("denoised: the object's", drawing.cloud_picture(own, _by_height(own), middle, 1.6 * reach)),
    ]
    return "The cloud", [f"{len(scene)} points, {len(own)} of them the object's."], row


def _by_height(points: Array) -> Array:
    share = (points[:, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-9)
    return np.asarray(np.stack([60 + 160 * share, 110 + 60 * share, 220 - 150 * share], axis=1).astype(np.uint8))


def extent(asset: Asset) -> Array:
    """Return the edges of the box that holds an asset's surface [m]."""
    return np.asarray(np.ptp(read_obj(asset.folder / "visual.obj").vertices, axis=0))


def finer(corners: Array, uv: Array, longest: float) -> tuple[Array, Array]:
    """Return triangles (F, 3, 3) and their uv (F, 3, 2), quartered until no edge is longer: each has one colour."""
    both = np.concatenate([corners, uv], axis=2)
    while (
        long := np.linalg.norm((both - np.roll(both, 1, axis=1))[..., :3], axis=2).max(axis=1, initial=0.0) > longest
    ).any():
        a, b, c = np.moveaxis(both[long], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [np.stack(one, axis=1) for one in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        both = np.concatenate([both[~long], *parts])
    return both[..., :3], both[..., 3:]


def asset_row(asset: Asset, called: str, reach: float) -> Row:
    """Return an asset's mesh from two sides, and its pieces."""
    mesh, texture = read_obj(asset.folder / "visual.obj"), read_png(asset.folder / "visual.png")
    corners, uv = finer(mesh.vertices[mesh.faces], mesh.uv[mesh.faces], reach / 25)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    colours = 255.0 * bilinear(texture, uv.mean(axis=1))
    plain = np.full_like(colours, 205.0)
    return [
        (f"{called}: in its colours", drawing.mesh_picture(corners, colours, middle, reach)),
        (f"{called}: its shape", drawing.mesh_picture(corners, plain, middle, reach, -60, 50)),
        (f"{called}: {len(asset.convex_pieces)} pieces", drawing.pieces_picture(asset.convex_pieces, middle, reach)),
    ]


def asset_parts(folder: Path, truth: Path | None, said: Sequence[str]) -> list[Part]:
    """Return what was built, and beside it what it should be, where that is known as an asset."""
    asset, spec = Asset.load(folder), read_spec(folder)
    edges = extent(asset)
    reach = 0.55 * float(np.linalg.norm(edges))
    lines = [" × ".join(f"{1000 * x:.1f}" for x in edges) + f" mm, {1e6 * (spec.volume or 0):.1f} cm³, "
             f"{100 * (spec.unseen or 0):.0f} % of the surface was never seen.", *said]  # fmt: skip
    parts: list[Part] = [("Mesh and convex pieces", lines, asset_row(asset, "built", reach))]
    if truth is not None:
        true = Asset.load(truth)
        lines = [" × ".join(f"{1000 * x:.1f}" for x in extent(true)) + " mm."]
        parts.append(("The truth", lines, asset_row(true, "true", reach)))
    return parts
