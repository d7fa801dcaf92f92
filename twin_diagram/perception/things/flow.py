"""How fast a thing goes, from how its surface has shifted since an image before: pure functions.

Places on what an earlier image showed are laid on what the newest one shows, by point-to-plane registration (Chen and
Medioni 1991) of a shift and a turn, with Tukey's weights. What comes into view meanwhile at the image's border, or goes
behind an arm, has no say, as it would have in where a thing's edges and its middle are. A surface tells nothing of how
it slides along itself: how sure the shift is along each direction is told with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things import flow_kernels
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout
from twin_diagram.signals.layouts import NEVER


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    ages: tuple[float, float] = (0.15, 0.5)
    """Shown by an image that is so old at most, the oldest such: two images at 15 Hz. Where none is, by the newest, if
    it is no older than this [s]. The velocity found is that of the time between."""

    points: int = 500
    """Of the newest image so many at most are met: on a thing of 20 cm they are a centimetre apart."""

    apart: float = 30.0
    """Two places whose depth errs independently are on this many pixels of their own: a disc of 3 pixels' radius, as
    real depth images are correlated over 2.5."""

    reach: tuple[float, ...] = (0.08, 0.04, 0.04, 0.02, 0.02, 0.02)
    """A place meets what is nearest within this [m], round after round; begun where it rests, where it goes as before,
    and where the middle of what is seen has gone, for it finds but what is nearer than faces are long."""

    alike: float = 0.8
    """Normals that meet are no more than 37° apart: else an edge would meet the other side. A D435's err by 10 to 20°
    at 1 m."""

    flat: tuple[int, float] = (2, 0.9)
    """A place counts whose neighbours, so many pixels of the grid off on all four sides, are the thing's own, and face
    as it does to this cosine: where faces meet, or one ends, normals lie between, and a slide along them shows as a
    shift …"""

    fewest_flat: int = 12
    """… unless fewer than these are left, on thin things and far ones: then all count."""

    slant: float = 0.035
    """Normals err by so much [rad], so that this share of how far a surface has slid shows as a shift: 2°, as the
    places of a flat face in simulated images do."""

    tukey: float = 4.685
    """Residuals count down to nothing at so many standard deviations: 95 % efficient on normal ones."""

    spins: float = 1.5
    """Nothing turns faster, as a standard deviation [rad/s]; one that does is told less surely."""

    fewest: int = 6
    """Places must meet something: as many as there are unknowns."""


TUNING = Tuning()

PLACES: Final = 48
"""Places of an image at the most."""
VIEWS: Final = 2
"""Images that are kept."""
_VIEW: Final = 1 + PLACES * 6
"""Time, then places and their normals; zeros where there is none."""
FLOW_SIZE: Final = VIEWS * _VIEW
"""Numbers of `VIEWS` images: what `flow` remembers of a thing."""


@dataclass(frozen=True)
class Flow:
    """What the surface tells of a thing's velocity.

    Attributes:
        velocity: (3,) of its middle, in W [m/s].
        information: (3, 3) of that, in W [s²/m²]; next to nothing along what the surface slides along.
    """

    velocity: Array
    information: Array


def no_views() -> Array:
    """Return (VIEWS, _VIEW) before any image."""
    views = np.zeros((VIEWS, _VIEW))
    views[:, 0] = NEVER
    return views


def with_view(views: Array, own: npt.NDArray[np.int64], segments: Segments) -> Array:
    """Return the views (VIEWS, _VIEW), oldest first, with one more, of a thing that the segments' points `own` show."""
    places = min(PLACES, max(2 * TUNING.fewest, int(len(own) * segments.stride**2 / TUNING.apart)), len(own))
    flat = own[_flat(own, segments)]
    flat = flat if len(flat) >= TUNING.fewest_flat else own
    chosen = flat[np.linspace(0, len(flat) - 1, min(places, len(flat))).round().astype(int)]
    view = np.zeros(_VIEW)
    view[0] = segments.time
    view[1 : 1 + 6 * len(chosen)] = np.hstack([segments.points_W[chosen], segments.normals_W[chosen]]).ravel()
    return np.concatenate([views[1:], view[None]])


def flow_since(views: Array, own: npt.NDArray[np.int64], segments: Segments, before: Array) -> Flow | None:
    """Return how a thing has gone since an image before; None where none, or too little of it, is there to compare.

    Args:
        views: (VIEWS, _VIEW) of images before.
        own: the thing's points among the segments' of the newest image.
        segments: of that.
        before: (3,) velocity that it was taken to have [m/s].
    """
    ages = np.where(views[:, 0] >= 0.0, segments.time - views[:, 0], np.inf)
    fit = np.flatnonzero(ages <= TUNING.ages[0])
    k = int(fit[0]) if len(fit) else int(np.argmin(ages))
    age = float(ages[k])
    if not 0.0 < age <= TUNING.ages[1]:
        return None
    rows = views[k, 1:].reshape(PLACES, 6)
    rows = rows[rows[:, 3:].any(axis=1)]
    thin = own[:: max(1, -(-len(own) // TUNING.points))]
    places, normals = one_layout(rows[:, :3]), one_layout(rows[:, 3:])
    seen = _Seen(places, normals, segments.points_W[thin], segments.normals_W[thin], age)
    noise = _noise(seen.places, segments)
    starts = [age * before]
    for start in (seen.points.mean(axis=0) - seen.places.mean(axis=0), np.zeros(3)):
        if all(np.linalg.norm(start - other) > TUNING.reach[-1] for other in starts):
            starts.append(start)
    laid = [one for one in (_laid(seen, start, noise) for start in starts) if one is not None]
    return min(laid, key=lambda one: one[0])[1] if laid else None


class _Seen(NamedTuple):
    """Places (S, 3) of an image before, and the newest one's points (N, 3), both with normals, `age` [s] apart."""

    places: Array
    normals: Array
    points: Array
    facing: Array
    age: float


def _laid(seen: _Seen, start: Array, noise: float) -> tuple[float, Flow] | None:
    """Return what is left where places are laid on points from a shift on (3), and what that tells; None: they miss.

    Left is the sum of squares, none larger than the last round's reach, in those; what meets nothing counts as one.
    """
    age, reach = seen.age, np.array(TUNING.reach)
    still = 1.0 / (TUNING.spins * age) ** 2
    left, shift, known = flow_kernels.laid(
        *seen[:4], start, reach, TUNING.alike, noise, TUNING.slant, TUNING.tukey, still, TUNING.fewest
    )
    return (left, Flow(shift / age, known * age**2)) if np.isfinite(left) else None


def _flat(own: npt.NDArray[np.int64], segments: Segments) -> npt.NDArray[np.bool_]:
    """Return (K,) which of the segments' points `own` lie on one face with what is around them."""
    r, least = TUNING.flat
    cells, normals = segments.cells[own], one_layout(segments.normals_W)
    return flow_kernels.on_one_face(
        own, cells, normals, segments.label_image.shape[1], segments.label_image.size, r, least
    )


def _noise(places: Array, segments: Segments) -> float:
    """Return the standard deviation of how far two images show a place of a surface apart [m]."""
    camera = segments.camera
    z = float(np.median((places - camera.p_WC) @ camera.R_WC[:, 2]))
    return float(np.sqrt(2.0) * camera.depth_noise(np.array(z)))
