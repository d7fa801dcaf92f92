"""Ray-cast RGB-D images of boxes and upright cylinders on a table: exact truth, and no renderer needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.asset import Asset
from twin_diagram.assets.texture import patches
from twin_diagram.perception.pinhole import Pinhole

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Thing:
    """An object in the picture: its asset, the seed of its texture, and its pose."""

    asset: Asset
    seed: int
    R: Array
    p: Array


def yawed(angle: float) -> Array:
    """Rotation about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def camera(width: int = 640, height: int = 480, focal: float = 600.0) -> Pinhole:
    """The usual camera opposite the arm."""
    eye, target = np.array([1.4, 0.0, 0.85]), np.array([0.45, 0.0, 0.05])
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return Pinhole(width, height, focal, np.column_stack([x, np.cross(z, x), z]), eye)


def box_hit(origin: Array, rays: Array, half: Array) -> tuple[Array, Array]:
    """Ray parameter (inf where missed) and outward normal, for a box about the origin."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (-half - origin) / rays, (half - origin) / rays
    near, far = np.minimum(a, b), np.maximum(a, b)
    axis = np.argmax(near, axis=-1)
    t = np.take_along_axis(near, axis[..., None], -1)[..., 0]
    hit = (t <= far.min(axis=-1)) & (t > 0)
    normal = np.zeros_like(rays)
    np.put_along_axis(normal, axis[..., None], -np.sign(np.take_along_axis(rays, axis[..., None], -1)), -1)
    return np.where(hit, t, np.inf), normal


def cylinder_hit(origin: Array, rays: Array, radius: float, half: float) -> tuple[Array, Array]:
    """The same for an upright cylinder about the origin, seen from outside."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (rays[..., :2] ** 2).sum(-1)
        b = (rays[..., :2] * origin[:2]).sum(-1)
        root = b**2 - a * ((origin[:2] ** 2).sum() - radius**2)
        side = (-b - np.sqrt(root)) / a
        at = origin + side[..., None] * rays
        side = np.where((root > 0) & (np.abs(at[..., 2]) <= half) & (side > 0), side, np.inf)
        lid = (half - origin[2]) / rays[..., 2]
        on = origin + lid[..., None] * rays
        lid = np.where(((on[..., :2] ** 2).sum(-1) <= radius**2) & (lid > 0), lid, np.inf)
        normal = np.concatenate([at[..., :2] / radius, np.zeros((*side.shape, 1))], axis=-1)
    top = lid < side
    normal[top] = [0.0, 0.0, 1.0]
    return np.minimum(side, lid), normal


def region(view: Pinhole, centre: Array, R: Array, half: Array) -> tuple[slice, slice]:
    """Rows and columns of the picture beyond which nothing of a box shows; all where it is beside the camera."""
    corners = centre + (np.indices((2, 2, 2)).reshape(3, -1).T * 2 - 1) * half @ R.T
    u, v, depth = view.project(corners)
    if depth.min() < 0.05 or view.optics.distortion:
        return slice(None), slice(None)
    return tuple(slice(max(int(at.min()) - 2, 0), max(int(at.max()) + 3, 0)) for at in (v, u))


def picture(
    view: Pinhole,
    things: list[Thing],
    rng: np.random.Generator | None = None,
    light: tuple[float, float, float] = (0.3, -0.2, 0.7),
    balls: list[tuple[Array, float]] | None = None,
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32], npt.NDArray[np.int64]]:
    """RGB (H, W, 3), depth (H, W) [m] and whose pixel it is: a thing's number, -1 table, -2 a ball, -3 nothing.

    With `rng`: depth noise 0.8 mm·z², steps of 0.25 mm, half of the pixels at edges lost, colour noise 2 of 255.
    `balls` (centre, radius) are grey and hide what is behind them.
    """
    rays = view.rays()
    with np.errstate(divide="ignore"):
        depth = np.where(rays[..., 2] < 0, -view.p_WC[2] / rays[..., 2], np.inf)
    owner = np.where(depth < 3.0, -1, -3)
    rgb = np.full((*depth.shape, 3), 0.4)
    normal = np.broadcast_to([0.0, 0.0, 1.0], rays.shape).copy()
    direction = np.asarray(light)
    for k, thing in enumerate(things):
        half = thing.asset.size / 2
        rows, columns = at = region(view, thing.p, thing.R, half)
        # Whole rows are turned, so that no last bit depends on what is looked at.
        origin, local = (view.p_WC - thing.p) @ thing.R, (rays[rows] @ thing.R)[:, columns]
        if len(thing.asset.convex_pieces[0]) == 8:
            t, n = box_hit(origin, local, half)
        else:
            t, n = cylinder_hit(origin, local, float(half[0]), float(half[2]))
        new = t < depth[at]
        depth[at][new], owner[at][new] = t[new], k
        normal[at][new] = n[new] @ thing.R.T
        # The corners fix the extent over which the texture is laid out.
        corners = np.array([-half, half])
        points = np.concatenate([corners, origin + t[new][:, None] * local[new]])
        rgb[at][new] = patches(points, thing.seed)[2:]
    shade = 0.35 + np.maximum(normal @ direction, 0.0)
    rgb *= shade[..., None]
    squares = rays[..., 0] ** 2 + rays[..., 1] ** 2 + rays[..., 2] ** 2
    for centre, radius in balls or []:
        rows, columns = at = region(view, centre, np.eye(3), np.full(3, radius))
        offset = view.p_WC - centre
        a = squares[at]
        b = (rays[rows] @ offset)[:, columns]
        root = b**2 - a * (offset @ offset - radius**2)
        with np.errstate(invalid="ignore"):
            t = np.where(root > 0, (-b - np.sqrt(root)) / a, np.inf)
        new = t < depth[at]
        depth[at][new], owner[at][new], rgb[at][new] = t[new], -2, 0.7
    depth = np.where(depth < 3.0, depth, 0.0)
    if rng is not None:
        spoilt = depth + 0.0008 * depth**2 * rng.standard_normal(depth.shape)
        edge = np.zeros(depth.shape, dtype=bool)
        for axis in (0, 1):
            for way in (-1, 1):
                edge |= np.abs(np.roll(depth, way, axis) - depth) > 0.02
        lost = (edge & (rng.random(depth.shape) < 0.5)) | (depth == 0)
        depth = np.where(lost, 0.0, np.round(spoilt / 0.00025) * 0.00025)
        rgb += 2.0 / 255.0 * rng.standard_normal(rgb.shape)
    np.clip(rgb, 0.0, 1.0, out=rgb)
    return np.round(rgb * 255, out=rgb).astype(np.uint8), depth.astype(np.float32), owner
