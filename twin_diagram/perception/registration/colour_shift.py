"""Learns how far colours lie beside depth, which all objects of all images share, while objects are registered.

Colour and depth cameras are aligned to a few pixels. Where shape leaves a direction open, as along a box half hidden,
colours decide, and a registration that took them to lie on depth would be off by those pixels: 8 mm a metre away. The
shift s is therefore a further unknown of each registration, held by what is known of it: eliminating it (Schur's
complement) leaves to the pose what colours say whatever the shift, and to the shift what they say whatever the pose.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array

COLOUR_SHIFT_SIZE: Final = 6
"""Numbers of a packed `ColourShift`."""


@dataclass(frozen=True)
class Tuning:
    """Constants of learning, set on `real_camera`, seeds 1 to 3."""

    alike: float = 20.0
    """Evidence counts so many times less than as of independent pixels: neighbouring colours err alike, and depth's
    errors last. As much more counts beside it, in a registration, what is known of the shift."""

    walk: float = 0.05
    """What it may change by from image to image [px]: mounts warm up."""

    floor: float = 0.3
    """It is never known better [px]: colours are blurred where depth's edges are."""

    unsettled: float = 4.0
    """Variance of a shift that has just changed, for the square of its change."""

    step: float = 2.0
    """Largest change in one image [px]: farther off, colours' slopes do not tell."""


TUNING = Tuning()


@dataclass(frozen=True)
class ShiftEvidence:
    """What one registration says of the shift, whatever the pose: information (2, 2) [1/px²], gradient (2,) [1/px]."""

    information: Array
    gradient: Array


@dataclass(frozen=True)
class ColourShift:
    """Where a point seen by depth at pixel (u, v) has its colour: at (u, v) + mean.

    Attributes:
        mean: (2,) [px].
        covariance: (2, 2) [px²]; zeros: colours lie on depth, and nothing is learnt.
    """

    mean: Array
    covariance: Array

    @staticmethod
    def told(std: float) -> ColourShift:
        """Return what a data sheet tells: none, give or take `std` [px] in each direction."""
        return ColourShift(np.zeros(2), std**2 * np.eye(2))

    @property
    def certain(self) -> bool:
        """Whether there is nothing to learn."""
        return not self.covariance.any()

    @cached_property
    def information(self) -> Array:
        """(2, 2) [1/px²] beside a registration's colours, each of which counts `alike` times; where it is not certain.

        As it is, a hundred pixels outweigh what is told: the shift was free, and a bottle slid by a centimetre.
        """
        return np.asarray(TUNING.alike * np.linalg.inv(self.covariance))

    def pack(self) -> Array:
        """Return it as a vector (COLOUR_SHIFT_SIZE,)."""
        return np.concatenate([self.mean, self.covariance.ravel()])

    @staticmethod
    def unpack(vector: Array) -> ColourShift:
        """Return the inverse of `pack`."""
        return ColourShift(np.array(vector[:2]), np.array(vector[2:6]).reshape(2, 2))


ALIGNED: Final = ColourShift.told(0.0)
"""Colours lie on depth."""


def learnt(shift: ColourShift, evidence: Iterable[ShiftEvidence]) -> ColourShift:
    """Return the shift after an image.

    Args:
        shift: before it.
        evidence: of the image's registrations, each linearised at `shift.mean`.
    """
    if shift.certain:
        return shift
    information = np.linalg.inv(shift.covariance + TUNING.walk**2 * np.eye(2))
    gradient = np.zeros(2)
    for one in evidence:
        information = information + one.information / TUNING.alike
        gradient = gradient + one.gradient / TUNING.alike
    covariance = np.linalg.inv(information)
    step = covariance @ gradient
    step *= min(1.0, TUNING.step / max(float(np.linalg.norm(step)), 1e-12))
    values, ways = np.linalg.eigh(0.5 * (covariance + covariance.T))
    known = (ways * np.maximum(values, TUNING.floor**2)) @ ways.T
    # Slopes are those of the colours nearby: as long as it goes on changing it is not known better than it changes.
    return ColourShift(shift.mean + step, known + TUNING.unsettled * np.outer(step, step))
