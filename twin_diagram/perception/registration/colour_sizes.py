"""What colours say of a thing's sizes: paint that lies where the object's does is no other, larger thing's.

Where what stands beside a thing, or bears it, is not known, both have one outline, which makes the thing look larger.
Its paint does not: a print a tenth wider lies elsewhere, whatever is joined to it. Where colours speak for a name, so,
edges that lie outside of where all others have them count as something else's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.colour_kernels import sloped_colours
from twin_diagram.perception.registration.colour_shift import TUNING as SHIFTS
from twin_diagram.perception.registration.data_association import Looked
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.outline import Outline, moves
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.residual_kernels import colour_weights
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import brightness, tukey
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    joined: float = 4.6
    """An edge that lies so many deviations outside of where others have it is of something else that touches: three
    cells, where a tenth of a bottle's width makes one or two."""

    others: float = 0.25
    """Spread of the sizes that are thought of at first, as of `shape_evidence` [of 1]."""

    rounds: int = 6
    """Of choosing edges and sizes; they settle in two or three."""


TUNING = Tuning()


def colour_sizes(looked: Looked, frame: Frame, one: RegisteredPose, reach: float) -> tuple[Array, Array]:
    """Return the normal equations H (9, 9) and b (9,) of turn, shift and stretch (see `moves`), by colours alone.

    How far colours lie beside depth is not known either, and taken out of both.

    Args:
        looked: up at the pose, in fine colours.
        frame: the image.
        one: the pose.
        reach: a surface farther off is another [m].
    """
    weight = colour_weights(looked.told, looked.flags, (RESIDUALS.deepest * reach, reach))
    found = sloped_colours(frame.colours[FINE], looked.u, looked.v, weight, frame.corner_of_colours())
    gain = brightness(found, looked.colour, looked.n, weight)
    on = weight[0] > 0.0
    if not looked.coloured or not on.any():
        return np.zeros((9, 9)), np.zeros(9)
    seen = found[0][on]
    off = seen[:, :3] - np.minimum(looked.colour[0][on] * gain[0][on][:, None], 1.0)
    steep = np.maximum(np.square(seen[:, 3:]).sum(axis=1), 1e-12)
    # As in a registration: slopes that are noise's, or steeper than the model's texture makes them, tell nothing.
    own = RESIDUALS.steeper * looked.texture[0][on] * np.square(looked.z[0][on] / frame.camera.fx)
    told = np.clip(np.minimum(steep - frame.colour_slopes[FINE], own) / steep, 0.0, 1.0)
    w = weight[0][on] * told * tukey(np.linalg.norm(off, axis=1), RESIDUALS.colour_cut)
    # Colours that fit badly, as on another thing's print, err as much as they show.
    scatter = float(w @ np.square(off).mean(axis=1)) / max(float(w.sum()), 1e-12)
    w /= SHIFTS.alike * max(RESIDUALS.colour_noise**2, scatter)
    du, dv = _pixel_ways(frame, looked.r[0][on] + one.p)
    rows_u, rows_v = (moves(way, looked.r[0][on], one.R) for way in (du, dv))
    H, b = np.zeros((11, 11)), np.zeros(11)
    for i in range(3):
        by_u, by_v = seen[:, 3 + i, None], seen[:, 6 + i, None]
        J = np.hstack([by_u * rows_u + by_v * rows_v, by_u, by_v])
        H += (J * w[:, None]).T @ J
        b -= J.T @ (w * off[:, i])
    if frame.shift.certain:
        return H[:9, :9], b[:9]
    tied = np.linalg.solve(H[9:, 9:] + np.linalg.inv(frame.shift.covariance), np.c_[H[9:, :9], b[9:]])
    return H[:9, :9] - H[:9, 9:] @ tied[:, :9], b[:9] - H[:9, 9:] @ tied[:, 9]


def _pixel_ways(frame: Frame, points_W: Array) -> tuple[Array, Array]:
    """Return by how much points (N, 3) go right and down for a shift in W, each (N, 3) [px/m]."""
    camera = frame.camera
    p_C = (points_W - camera.p_WC) @ camera.R_WC
    ways = []
    for axis, focal in ((0, camera.fx), (1, camera.fy)):
        way = np.zeros((len(p_C), 3))
        way[:, axis] = focal / p_C[:, 2]
        way[:, 2] = -focal * p_C[:, axis] / p_C[:, 2] ** 2
        ways.append(way @ camera.R_WC.T)
    return ways[0], ways[1]


def own_edges(seen: Outline, H: Array, b: Array, edge: float, share: float) -> npt.NDArray[np.bool_]:
    """Return (E,) which cells of an outline are the thing's own, by where others and all else have its edges.

    However few are left: what they and all else leave open speaks for no name.

    Args:
        seen: the outline.
        H: (10, 10) what all but the outline says of its numbers, …
        b: (10,) … so that H x = b.
        edge: deviation of an edge [cells].
        share: so many cells err as one.
    """
    w = 1.0 / (edge**2 * share)
    H = H + np.diag(np.repeat([0.0, TUNING.others**-2.0, 0.0], [6, 3, 1]))
    own = ~seen.touched
    x = np.linalg.solve(H, b)
    for _ in range(TUNING.rounds):
        before, own = own, np.asarray(~seen.touched & (seen.apart - seen.J @ x <= TUNING.joined * edge))
        if (own == before).all():
            break
        J = seen.J[own]
        x = np.linalg.solve(H + w * J.T @ J, b + w * J.T @ seen.apart[own])
    return own
