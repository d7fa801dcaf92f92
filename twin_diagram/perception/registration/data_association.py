"""What the image shows in the places where the model's visible points should be, for one pose or for many at once.

Projective data association: each visible point of the model is paired with what stands at its pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.rotation import components_last, dot, exp
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of what counts as a pair, chosen by hand.

    `sims/closed_loop.py --seeds 20` shows their effect.
    """

    table_thickness: float = 0.006
    """A point of the image this near to the table's top is the table's, unless the model point itself is as low [m]."""

    least_cosine: float = 0.5
    """Between the normals of a model point and of what is seen in its place."""


TUNING = Tuning()

FINE, COARSE = 0, 1
"""Scales of colour; indices of `Frame.colours` and `ModelCloud.colours`."""


@dataclass(frozen=True)
class Poses:
    """B poses X_WO: `R` (B, 3, 3), `p` (B, 3)."""

    R: Array
    p: Array

    def __getitem__(self, index: npt.NDArray[np.int64] | slice) -> Poses:
        """Return a selection."""
        return Poses(self.R[index], self.p[index])

    def moved(self, step: Array) -> Poses:
        """Return the poses turned and shifted by `step` (B, 6)."""
        return Poses(exp(step[:, :3]) @ self.R, self.p + step[:, 3:])


@dataclass(frozen=True)
class Looked:
    """What an image shows where the model's visible points should be; all arrays (B, P, …).

    Attributes:
        r: points relative to the object's origin, axes of W.
        n: normals in W.
        facing: cosine between normal and line of sight.
        colour: the model's.
        u: pixel coordinates.
        v: pixel coordinates.
        z: depth of the model points [m].
        distance: n · (y - x), seen point to model surface [m].
        deeper: seen depth minus the model point's [m].
        seen: there is depth, and it is not the robot's.
        near: seen, and not the table below or behind the model point.
        matched: near, and what is seen does not face another way: the floor of a mug is not its rim.
        robot: the pixel shows the robot.
        counted: not a repetition.
        texture: squared slope of the model's colours [1/m²].
    """

    r: Array
    n: Array
    facing: Array
    colour: Array
    u: Array
    v: Array
    z: Array
    distance: Array
    deeper: Array
    seen: npt.NDArray[np.bool_]
    near: npt.NDArray[np.bool_]
    matched: npt.NDArray[np.bool_]
    robot: npt.NDArray[np.bool_]
    counted: npt.NDArray[np.bool_]
    texture: Array


def look(model: ModelCloud, frame: Frame, poses: Poses, count: int, level: int) -> Looked:
    """Look the visible points of the model, at most `count` each, up in the image."""
    camera = frame.camera
    towards = ((camera.p_WC - poses.p)[:, None] @ poses.R)[:, 0]
    view = np.argmax(towards @ model.directions.T, axis=1)
    index = model.views[view, :count]
    counted = np.arange(index.shape[1]) < model.view_counts[view][:, None]
    told = model.rows[:, index]
    r, n = ((poses.R @ part.transpose(1, 0, 2)).transpose(0, 2, 1) for part in (told[:3], told[3:6]))
    x = r + poses.p[:, None]
    u, v, z = camera.project(x)
    depth, y, there = frame.depth_at(u, v)
    sight = camera.p_WC - x
    facing = dot(n, sight) / np.sqrt(dot(sight, sight))
    robot = frame.robot_at(u, v)
    distance = dot(n, y - x)
    a, b, c = frame.table
    up = np.array([-a, -b, 1.0])
    on_table = np.abs(y @ up - c) < TUNING.table_thickness
    above = x @ up > 2.0 * TUNING.table_thickness + c
    seen = there & ~robot & counted & (facing > 0.1)
    near = seen & ~(on_table & above)
    normal = frame.normal_at(u, v)
    matched = near & ((dot(n, normal) > TUNING.least_cosine) | (dot(normal, normal) == 0.0))
    return Looked(
        r=r,
        n=n,
        facing=facing,
        colour=components_last(told[7 + 3 * level : 10 + 3 * level]),
        u=u,
        v=v,
        z=z,
        distance=distance,
        deeper=depth - z,
        seen=seen,
        near=near,
        matched=matched,
        robot=robot & counted,
        counted=counted,
        texture=told[6],
    )
