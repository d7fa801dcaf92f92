"""Weighs poses by how deep they lie in the plane that things stand on: nothing is inside of a table.

What is below a table's top is hidden whatever the pose, so that the image itself says little of it. A carton turned
upside down about its middle, where its roof is narrower than its foot, is such a pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    sigma: float = 0.005
    """Deviation of the depth of an object's lowest point in a plane [m]: a third of `buried`, by which table's height
    and object's may be wrong together."""

    most: float = 0.03
    """Deeper than this it costs no more [m]: then the object stands on another plane than the one that is seen."""


TUNING = Tuning()


def sunk_costs(points: Array, poses: Poses, planes: Sequence[Plane]) -> Array:
    """Return (B,) negative log-likelihoods of poses by how deep they lie in the plane that things stand on [nat].

    Args:
        points: (M, 3) of the object's surface, in O.
        poses: B of them, of one object.
        planes: that are seen; those of things themselves do not count.
    """
    bare = [plane for plane in planes if plane.part < 0]
    if not bare:
        return np.zeros(len(poses.p))
    plane = min(bare, key=lambda plane: abs(float(plane.height(poses.p[0]))))
    lowest = (points @ (plane.normal @ poses.R).T).min(axis=0) + plane.height(poses.p)
    return np.asarray(0.5 * np.square(np.clip(-lowest, 0.0, TUNING.most) / TUNING.sigma))
