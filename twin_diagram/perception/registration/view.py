"""What is followed and searched for, and in what: a known object, ready to be found, and one image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from twin_diagram import scenario
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.resting import resting
from twin_diagram.perception.registration.standing import Footing, footings
from twin_diagram.perception.registration.without_colours import without_colours
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Known:
    """An object of the library, ready to be found.

    Attributes:
        model: its cloud.
        upright, fallen: orientations R_WO in which it rests on a level plane, and how high O is above it [m].
        feet: faces on which it rests.
    """

    model: ModelCloud
    upright: list[tuple[Array, float]]
    fallen: list[tuple[Array, float]]
    feet: Sequence[Footing] = ()

    @staticmethod
    def of(model: ModelCloud) -> Known:
        """Return a model with the ways in which it rests."""
        orientations = resting(model.asset)
        return Known(model, orientations[:1], orientations[1:], footings(model.asset))

    @cached_property
    def bare(self) -> Known:
        """The same without its colours."""
        return Known.of(without_colours(self.model)) if self.model.coloured else self


@dataclass(frozen=True)
class View:
    """One image and what it is searched with.

    Attributes:
        segments: the image taken apart.
        frame: the same image, ready for registration.
        params: tuning.
        smallest: points that make an object.
    """

    segments: Segments
    frame: Frame
    params: scenario.Registration
    smallest: int
