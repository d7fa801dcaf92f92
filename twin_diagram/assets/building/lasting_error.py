"""Errors of depth that lie at the same place of every picture, told by what all the views together say.

A depth camera's error is in part the same in all its pictures: low waves of its matching, of its lenses. Seen from all
around, they move all walls of a thing one way. They are solved for together with the poses and with where each cell of
the mean surface lies (`lasting_equations`); so what poses or the thing's own shape explain as well stays with these.
What nothing tells apart is left to the prior: waves are a Gaussian process about zero, as strong as is likeliest; and
unless that is far likelier than none, there are none.

Stereo's error is that of the inverse of depth, whatever the depth; so this is what is corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twin_diagram.assets.building.depth_view import DepthView, Map
from twin_diagram.assets.building.lasting_equations import Sightings, alike, left_of, likeliest, problem
from twin_diagram.assets.building.view_poses import TUNING as POSES
from twin_diagram.assets.building.view_poses import AlignedViews, moved, sampled
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the search for lasting errors."""

    width: float = 640.0
    """Figures in pixels are those of images so wide [px]."""

    step: float = 12.0
    """Distance of the nodes between which an error is interpolated [px]: below the waves' σ, of 15 px."""

    rounds: int = 3
    """Joint solutions, each with cells formed anew."""

    least_views: int = 10
    """Fewer tell the error, too, but gain nothing: of eight, poses are off by more than waves do (surfaces of mug, box,
    bottle and can 0.47 mm off with and without; a box of one seed 0.80 where it was 0.75)."""

    points: float = 32000.0
    """About how many points of all views are used on the object; as many on the support, …"""

    most_points: int = 4000
    """… and of a view at most so many: more err as others do."""

    sure: float = 10.0
    """By how much the logarithm of the likelihood of waves must exceed that of none. In pictures without any it came
    out at −12 and less, with those of a D415 at 350 and more for forty views."""

    same: float = 1e-3
    """Focal lengths and principal points that differ by less are one camera's [px]."""

    least: float = 0.5
    """Least factor on depth that is believed."""


TUNING = Tuning()


@dataclass(frozen=True)
class LastingError:
    """What is to be added to the inverse of each pixel's depth.

    Attributes:
        first: (2,) row and column of the first node, in the camera's whole picture [px].
        step: distance of neighbouring nodes [px].
        values: (rows, columns) at the nodes [1/m].
        evidence: logarithm of how much likelier pictures are with it than without.
    """

    first: Array
    step: float
    values: Array
    evidence: float

    @property
    def rms(self) -> float:
        """Return the root mean square of the values [1/m]."""
        return float(np.sqrt((self.values**2).mean()))

    def over(self, view: DepthView) -> Map:
        """Return what is to be added (h, w) in a view's window [1/m]."""
        row, column = (
            (np.arange(size, dtype=np.float32) + np.float32(corner - first)) / np.float32(self.step)
            for size, corner, first in zip(view.depth.shape, view.corner, self.first, strict=True)
        )
        u, v = np.meshgrid(column, row)
        told = cv2.remap(self.values.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(told, dtype=np.float32)

    def taken_from(self, view: DepthView) -> DepthView:
        """Return the view without it. Normals are kept: waves tilt by half a degree, as noise does by more."""
        factor = np.maximum(1.0 + view.depth * self.over(view), TUNING.least)
        return replace(view, depth=(view.depth / factor).astype(np.float32))


def one_camera(views: Sequence[DepthView]) -> bool:
    """Return whether windows (of `cropped`) are of one camera's pictures: nothing lasts from one to another."""
    told = [
        (view.camera.fx, view.camera.fy, view.camera.cx + view.corner[1], view.camera.cy + view.corner[0])
        for view in views
    ]
    return bool(np.ptp(told, axis=0).max() < TUNING.same)


def lasting_error(found: AlignedViews, low: Array, high: Array, seed: int = 0) -> LastingError | None:
    """Return what all pictures have wrong at the same pixels, or None where no such thing shows.

    Args:
        found: windows of pictures, at poses that agree.
        low: (3,) least corner of the box about the object that they were aligned by [m].
        high: (3,) its greatest.
        seed: of the choice of points.
    """
    views, twists = list(found.views), found.twists
    if len(views) < TUNING.least_views or not one_camera(views):
        return None
    rng = np.random.default_rng(seed)
    points = int(np.clip(TUNING.points / len(views), POSES.points, TUNING.most_points))
    samples = [sampled(view, low, high, rng, points) for view in views]
    if not any(len(sample.points) for sample in samples):
        return None
    width = 2 * (views[0].camera.cx + views[0].corner[1])  # the principal point is about in the middle
    seen, nodes = Sightings.of(views, samples, TUNING.step * width / TUNING.width)
    prior = nodes.precision()
    values, evidence, as_one = np.zeros(nodes.size), 0.0, 0.0
    for _ in range(TUNING.rounds):
        told = problem(seen, found, views, values, rng.random(3))
        if not told.member.nnz:
            return None
        last, as_one = values, max(as_one, alike(told, nodes))
        values, steps, evidence = likeliest(told, nodes, prior, last, twists, as_one)
        as_one = alike(told, nodes, left_of(told, values - last, steps))
        views = [moved(view, one, found.centre) for view, one in zip(views, steps, strict=True)]
        twists = twists + steps
    if evidence < TUNING.sure:
        return None
    return LastingError(nodes.first, nodes.step, values.reshape(nodes.count), evidence)
