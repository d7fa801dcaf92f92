"""When what is held has slipped in the hand, and by how much: told once a slip. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.planning.tasks.in_hand import InHand
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand for 15 images a second."""

    slip: tuple[float, float] = (0.0873, 0.005)
    """A change of 5° [rad] or 5 mm [m] is a slip …"""

    sigmas: float = 4.0
    """… where it is so many standard deviations …"""

    images: int = 4
    """… in so many images running. It is told when it is at its end …"""

    creeping: tuple[float, float] = (0.02, 0.001)
    """… that is when an image changes it by less than this [rad], [m] …"""

    longest_slip: int = 10
    """… or after so many images."""


TUNING = Tuning()


def slipped(known: InHand) -> tuple[InHand, tuple[float, float] | None]:
    """Return what is known, and by how much it has slipped [rad], [m] where that is to be told now: once per slip.

    To be asked after each image.
    """
    moved, covariance = known.change
    since = moved - known.told
    turned, shifted = (float(np.linalg.norm(part)) for part in (since[:3], since[3:]))
    significant = _significant(since[:3], covariance[:3, :3], TUNING.slip[0])
    significant = significant or _significant(since[3:], covariance[3:, 3:], TUNING.slip[1])
    known = replace(known, away=known.away + 1 if significant else 0)
    step = moved - known.before
    rests = np.linalg.norm(step[:3]) < TUNING.creeping[0] and np.linalg.norm(step[3:]) < TUNING.creeping[1]
    if known.away < TUNING.images or not (rests or known.away >= TUNING.longest_slip):
        return known, None
    return replace(known, told=moved.copy(), away=0, slips=known.slips + 1), (turned, shifted)


def _significant(change: Array, covariance: Array, least: float) -> bool:
    """Tell whether a change (3) of a covariance (3, 3) is more than `least`, and no doubt accounts for it."""
    size = float(np.linalg.norm(change))
    return size > least and size**2 > TUNING.sigmas * float(np.sqrt(max(0.0, float(change @ covariance @ change))))


def told_of(known: InHand) -> dict[str, float | int]:
    """Return how far a thing has moved in the hand since closing, and how sure that is, for ``summary.json``."""
    moved, covariance = known.change
    told: dict[str, float | int] = {"slips": known.slips}
    for name, part, scale in (("moved_mm", slice(3, 6), 1e3), ("turned_deg", slice(0, 3), 180.0 / np.pi)):
        told[name] = round(scale * float(np.linalg.norm(moved[part])), 2)
        told[f"{name}_std"] = round(scale * float(np.sqrt(np.linalg.eigvalsh(covariance[part, part])[-1])), 2)
    return told
