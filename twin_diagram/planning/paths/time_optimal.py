"""How fast a path can be travelled: time-optimal along straight lines with rounded corners. Pure functions.

Along a straight line the limits of the joints are one limit of speed and one of acceleration, so between two corners
the quickest profile accelerates, keeps the speed and brakes. At a corner, the speed is what lets the motion turn within
the limits of acceleration without leaving the path by more than is told (parabolic blends).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module; chosen by hand."""

    rounding: float = 0.03
    """A corner is cut off by no more than this [rad]: less than between two checked configurations."""

    tiny: float = 1e-9
    """Pieces of a path that are shorter than this are none [rad]."""


TUNING = Tuning()


@dataclass(frozen=True)
class SpeedProfile:
    """A path and when it is where; S pieces, each of which is accelerated along evenly.

    Attributes:
        times: (S + 1,) when pieces begin, and the last one ends [s].
        places: (S + 1,) length travelled then [rad].
        speeds: (S + 1,) along the path then [rad/s].
        points: (W, n) the path's corners [rad].
        lengths: (W,) travelled at these [rad].
    """

    times: Array
    places: Array
    speeds: Array
    points: Array
    lengths: Array

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    def at(self, times: Array) -> Array:
        """Return (M, n) where to be at `times` (M,) from the start on [s]; at rest at the end thereafter."""
        if len(self.points) == 1:
            return np.repeat(self.points, len(times), axis=0)
        t = np.clip(times, 0.0, self.times[-1])
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        took, gone = self.times[i + 1] - self.times[i], t - self.times[i]
        rate = np.where(took > 0.0, (self.speeds[i + 1] - self.speeds[i]) / np.where(took > 0.0, took, 1.0), 0.0)
        place = self.places[i] + self.speeds[i] * gone + rate * gone**2 / 2
        return np.stack([np.interp(place, self.lengths, column) for column in self.points.T], axis=1)


def profile(
    points: Array, velocity: Array, acceleration: Array, start: Array | None = None, gentle: float = 1.0
) -> SpeedProfile:
    """Return the quickest way along a path, to rest at its end.

    Args:
        points: (W, n) corners, straight lines between [rad].
        velocity: (n,) limits [rad/s].
        acceleration: (n,) limits [rad/s²], may be infinite.
        start: (n,) velocity at the first point, of which the part along the path counts; None: rest.
        gentle: share of the acceleration that is used to brake.
    """
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[True], lengths > TUNING.tiny])
    points, lengths = points[kept], lengths[kept[1:]]
    if len(points) == 1:
        return SpeedProfile(np.zeros(1), np.zeros(1), np.zeros(1), points, np.zeros(1))
    direction = np.diff(points, axis=0) / lengths[:, None]
    with np.errstate(divide="ignore"):
        fastest = (velocity / np.abs(direction)).min(axis=1)
        strongest = (acceleration / np.abs(direction)).min(axis=1)
    begin = 0.0 if start is None else float(np.clip(start @ direction[0], 0.0, fastest[0]))
    corners = _corner_speeds(direction, fastest, acceleration, begin)
    for i in range(len(lengths)):  # as fast as it can be reached …
        corners[i + 1] = min(corners[i + 1], np.sqrt(corners[i] ** 2 + 2 * strongest[i] * lengths[i]))
    for i in range(len(lengths) - 1, -1, -1):  # … and left again
        corners[i] = min(corners[i], np.sqrt(corners[i + 1] ** 2 + 2 * gentle * strongest[i] * lengths[i]))
    corners[0] = begin  # who is too fast already brakes harder
    return _pieces(points, lengths, fastest, strongest, corners, gentle)


def _corner_speeds(direction: Array, fastest: Array, acceleration: Array, begin: float) -> Array:
    """Return (W,) the speed at which each corner may be passed; that of the start, and rest at the end."""
    turn = np.abs(np.diff(direction, axis=0))
    result = np.concatenate([[begin], np.minimum(fastest[:-1], fastest[1:]), [0.0]])
    if len(turn):
        # A turn within T [s] takes |Δd| u / T of acceleration and leaves the corner by |Δd| u T / 8.
        with np.errstate(divide="ignore"):
            rounded = np.sqrt(8 * TUNING.rounding / (turn.max(axis=1) * (turn / acceleration).max(axis=1)))
        result[1:-1] = np.minimum(result[1:-1], rounded)
    return result


def _pieces(
    points: Array, lengths: Array, fastest: Array, strongest: Array, corners: Array, gentle: float
) -> SpeedProfile:
    """Return the profile with at most three pieces between two corners of known speed."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    times, places, speeds = [0.0], [0.0], [float(corners[0])]
    for i, length in enumerate(lengths):
        a, b, up, down = float(corners[i]), float(corners[i + 1]), float(strongest[i]), gentle * float(strongest[i])
        if a * a - b * b > 2 * down * length:
            down = (a * a - b * b) / (2 * length)
        peak = float(fastest[i])
        if np.isfinite(up):
            peak = min(peak, float(np.sqrt((2 * up * down * length + down * a * a + up * b * b) / (up + down))))
        rise, fall = (peak * peak - a * a) / (2 * up), (peak * peak - b * b) / (2 * down)
        took = ((peak - a) / up, max(length - rise - fall, 0.0) / peak, (peak - b) / down)
        times += list(times[-1] + np.cumsum(took))
        places += [ends[i] + rise, ends[i + 1] - fall, ends[i + 1]]
        speeds += [peak, peak, b]
    return SpeedProfile(np.array(times), np.array(places), np.array(speeds), points, ends)
