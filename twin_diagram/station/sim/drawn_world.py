"""Draws the simulated world by the project's own compiled loops: on a machine without a graphics card twice as fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.geometry import LightParameter
from pydrake.math import RigidTransform

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import Lens
from twin_diagram.station.depth_units import Colour, Depth
from twin_diagram.station.sim import raster_kernels, shading_kernels
from twin_diagram.station.sim.drawn_shapes import DrawnShapes


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    samples: tuple[tuple[float, float], ...] = ((-0.125, 0.375), (0.375, 0.125), (-0.375, -0.125), (0.125, -0.375))
    """Places in a pixel, from its centre, whose colours are averaged: those of OpenGL's four samples."""

    still: float = 1e-5
    """What moves less between two pictures is drawn once [m]: a hundredth of a pixel at 1 m."""


TUNING = Tuning()


class DrawnWorld:
    """Draws shapes as Drake's VTK renderer shows them: flat light, textures between texels, edges of four samples.

    Colours differ from its by one of 255 but at edges, of shapes and on textures, and depth by nothing but at edges.
    All is computed in one thread.
    """

    def __init__(
        self,
        shapes: DrawnShapes,
        lights: Sequence[LightParameter],
        background: Sequence[float] | Array,
        near: float,
        far: float,
    ) -> None:
        """Keep what does not change.

        Args:
            shapes: what is seen.
            lights: white, from far away, in W.
            background: (r, g, b) from 0 to 1.
            near: what is nearer is not drawn [m].
            far: nor is what is farther [m].
        """
        self._shapes, self._near, self._far = shapes, near, far
        self._lights = np.array([-light.intensity * _unit(np.asarray(light.direction)) for light in lights])
        self._background = 255.0 * np.asarray(background, dtype=float)
        self._samples = np.array(TUNING.samples)
        self._scratch = np.empty(0, np.float32), np.empty(0, np.int32)
        """Overwritten by each picture."""
        self._corners = _boxes(shapes)

    def colour(self, query: Any, lens: Lens, X_WC: RigidTransform) -> Colour:
        """Return the colours (H, W, 4) that a lens without distortion at X_WC sees, of a SceneGraph's QueryObject."""
        return self.coloured(self.poses(query), lens, X_WC)

    def coloured(self, poses: tuple[Array, Array], lens: Lens, X_WC: RigidTransform) -> Colour:
        """Return what `colour` does, of frames at poses as `poses` tells them."""
        shapes, (R, p) = self._shapes, poses
        normals = raster_kernels.moved(shapes.normals, shapes.frame, R, np.zeros_like(p))
        light = raster_kernels.lit(normals, self._lights)
        points, _, who = self._draw(R, p, lens, X_WC, self._samples)
        image = np.empty((lens.height, lens.width, 4), np.uint8)
        shading_kernels.shade(
            who, points, shapes.faces, light, shapes.uv, shapes.base, shapes.texture, shapes.texels, _of(lens),
            self._background, image,
        )  # fmt: skip
        return image

    def again(self, image: Colour, before: tuple[Array, Array], query: Any, lens: Lens, X_WC: RigidTransform) -> Colour:
        """Return the colours that `colour` returns, of a world that has moved a little; only what has is drawn.

        Args:
            image: (H, W, 4) as the world was before; not changed.
            before: its frames then, as `poses` tells them.
            query: of the world now.
            lens: without distortion.
            X_WC: the camera's pose.
        """
        result = image.copy()
        now = self.poses(query)
        part = self._changed(before, now, lens, X_WC)
        if part is not None:
            rows, columns = part
            window = Lens(
                columns.stop - columns.start, rows.stop - rows.start, lens.fx, lens.fy,
                lens.cx - columns.start, lens.cy - rows.start,
            )  # fmt: skip
            result[rows, columns] = self.coloured(now, window, X_WC)
        return result

    def depth(self, query: Any, lens: Lens, X_WD: RigidTransform, least: float, most: float) -> Depth:
        """Return depth (H, W) [m] that a straight lens at X_WD sees: 0 below `least`, infinite beyond `most`."""
        _, nearest, who = self._draw(*self.poses(query), lens, X_WD, np.zeros((1, 2)))
        depth = np.float32(1.0) / nearest[0]
        depth[(who[0] < 0) | (depth > np.float32(most))] = np.inf
        depth[depth < np.float32(least)] = 0.0
        return depth

    def labels(self, query: Any, lens: Lens, X_WD: RigidTransform) -> npt.NDArray[np.int64]:
        """Return (H, W) the labels of bodies that a lens without distortion at X_WD sees, -1 where there is none."""
        who = self._draw(*self.poses(query), lens, X_WD, np.zeros((1, 2)))[2]
        return np.append(self._shapes.label, -1)[who[0]]

    def _changed(
        self, before: tuple[Array, Array], now: tuple[Array, Array], lens: Lens, X_WC: RigidTransform
    ) -> tuple[slice, slice] | None:
        """Return the rows and columns that show what has moved, before or now; None where nothing is seen to."""
        corners = np.array([self._corners @ R.transpose(0, 2, 1) + p[:, None] for R, p in (before, now)])
        moved = np.linalg.norm(corners[1] - corners[0], axis=-1).max(axis=-1) > TUNING.still
        if not moved.any():
            return None
        points = X_WC.inverse().multiply(corners[:, moved].reshape(-1, 3).T).T
        low, high = np.zeros(2), np.array([lens.width, lens.height], dtype=float)
        if points[:, 2].min() > self._near:
            places = points[:, :2] / points[:, 2:] * [lens.fx, lens.fy] + [lens.cx, lens.cy]
            low, high = np.maximum(low, places.min(axis=0) - 1.0), np.minimum(high, places.max(axis=0) + 2.0)
        (left, top), (right, bottom) = np.floor(low).astype(int), np.ceil(high).astype(int)
        return None if left >= right or top >= bottom else (slice(top, bottom), slice(left, right))

    def poses(self, query: Any) -> tuple[Array, Array]:
        """Return R_WF (B, 3, 3) and p_WF (B, 3) of all frames."""
        both = np.array([query.GetPoseInWorld(frame).GetAsMatrix34() for frame in self._shapes.frames])
        return np.ascontiguousarray(both[..., :3]), np.ascontiguousarray(both[..., 3])

    def _draw(
        self, R_WF: Array, p_WF: Array, lens: Lens, X_WC: RigidTransform, samples: Array
    ) -> tuple[Array, npt.NDArray[np.float32], npt.NDArray[np.int32]]:
        """Return corners (V, 3) in C, and of each sample (S, H, W) 1 / z and the triangle that is seen, -1 for none."""
        shapes, X_CW = self._shapes, X_WC.inverse()
        R_CW, p_CW = X_CW.rotation().matrix(), X_CW.translation()
        points = raster_kernels.moved(shapes.points, shapes.frame, R_CW @ R_WF, p_WF @ R_CW.T + p_CW)
        size = (len(samples), lens.height, lens.width)
        count = len(samples) * lens.height * lens.width
        if len(self._scratch[0]) < count:
            self._scratch = np.empty(count, np.float32), np.empty(count, np.int32)
        nearest, who = self._scratch[0][:count].reshape(size), self._scratch[1][:count].reshape(size)
        nearest.fill(1.0 / self._far)
        who.fill(-1)
        raster_kernels.draw(points, shapes.faces, shapes.closed, _of(lens), self._near, samples, nearest, who)
        return points, nearest, who


def _boxes(shapes: DrawnShapes) -> Array:
    """Return the corners (B, 8, 3) of the box about what moves with each frame, in that frame."""
    low, high = np.full((len(shapes.frames), 3), np.inf), np.full((len(shapes.frames), 3), -np.inf)
    np.minimum.at(low, shapes.frame, shapes.points)
    np.maximum.at(high, shapes.frame, shapes.points)
    upper = np.array(list(np.ndindex(2, 2, 2)), dtype=bool)
    return np.where(upper, high[:, None], low[:, None])


def _of(lens: Lens) -> Array:
    return np.array([lens.fx, lens.fy, lens.cx, lens.cy])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
