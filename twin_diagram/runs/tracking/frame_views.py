"""Tells the cameras of a folder's frames apart by where they stand, and lets each go on from what it saw itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.turned_alike import turned
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, Outcome, advance
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.several_views.view_memory import (
    ViewEntry,
    ViewMemory,
    contradicted,
    entering,
    forgotten,
    left,
)
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    step: tuple[float, float] = (0.35, 0.2)
    """A camera that is led along turns and moves by less from frame to frame [rad], [m]; what jumps is another one."""

    most: int = 8
    """Cameras at most: with one more, a frame is taken for one of the camera that is nearest."""


TUNING = Tuning()


class FrameViews:
    """What each camera of a sequence remembers; with one camera, nothing but what the tracker does."""

    def __init__(self) -> None:
        """Begin with none."""
        self._views: list[ViewMemory] = []
        self._places: list[tuple[Array, Array]] = []
        self._newest: tuple[int, ViewEntry, Segments] | None = None

    def advance(self, slots: Sequence[Slot], beside: OtherMemory, segments: Segments, told: ImageSettings) -> Outcome:
        """Take a frame in: `whole_image.advance` on what its camera remembers.

        Args:
            slots: of the library's objects, as the newest frame left them.
            beside: all else.
            segments: the frame taken apart.
            told: what does not change.
        """
        beside = self._leave(slots, beside, told)
        which = self._which(segments, told)
        if len(self._views) == 1:
            entry = ViewEntry(list(slots), beside, [])
        else:
            entry = entering(self._views, which, beside, told, segments.time)
        self._newest = which, entry, segments
        return advance(entry.slots, entry.beside, segments, told, entry.elsewhere)

    def _leave(self, slots: Sequence[Slot], beside: OtherMemory, told: ImageSettings) -> OtherMemory:
        """Note what the newest frame's camera remembers; return what is common to all."""
        if self._newest is None:
            return beside
        which, entry, segments = self._newest
        self._views[which], common = left(self._views[which], entry.beside, slots, beside, segments.time)
        if len(self._views) < 2 or not told.every:
            return common
        every = [*told.library, *(told.every[one.asset] for one in beside.further)]
        for other, k in contradicted(self._views, which, segments, every):
            self._views[other] = forgotten(self._views[other], k)
        return common

    def _which(self, segments: Segments, told: ImageSettings) -> int:
        """Return the number of a frame's camera: where it stands, or where it went on to from frame to frame."""
        R, p = segments.camera.R_WC, segments.camera.p_WC
        away = [
            max(float(turned(R, other)) / TUNING.step[0], float(np.linalg.norm(p - place)) / TUNING.step[1])
            for other, place in self._places
        ]
        nearest = int(np.argmin(away)) if away else 0
        if not away or (away[nearest] > 1.0 and len(away) < TUNING.most):
            aside = ViewMemory.empty(told, 0.0)
            if away:  # of the first the tracker tells
                shift = ColourShift.told(told.aside * segments.camera.width / 640)
                aside = replace(aside, shift=shift)
            self._views.append(aside)
            self._places.append((R, p))
            return len(away)
        self._places[nearest] = R, p
        return nearest
