"""What one image makes of all that is known: a function of vectors and segments alone, to be worked out anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, advance
from twin_diagram.perception.segmentation.segmentation_system import DeliveredImage, ImageParting
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ImageQuestion:
    """An image, and what was known before it.

    Attributes:
        memory: (K · SLOT_SIZE) of the library's objects.
        beside: a packed `OtherMemory`.
        image: taken apart, or as it was delivered.
    """

    memory: Array
    beside: Array
    image: Segments | DeliveredImage


@dataclass(frozen=True)
class ImageAnswer:
    """What is known after it.

    Attributes:
        memory, beside: as in `ImageQuestion`.
        poses: (K · MEASUREMENT_SIZE) of the library's objects.
        told: further instances, unknown things, and how many of each were turned away, one after another.
    """

    memory: Array
    beside: Array
    poses: Array
    told: Array


class ImageLook:
    """Takes images in."""

    def __init__(self, settings: ImageSettings, parting: ImageParting | None = None) -> None:
        """Keep what does not change, and what takes images apart that are asked about as they were delivered."""
        self.settings, self._parting = settings, parting

    def answer(self, question: ImageQuestion, added: tuple[Known, ...] = ()) -> ImageAnswer:
        """Return what is known after an image.

        Args:
            question: the image, and what was known before it.
            added: assets that came after the settings were made.
        """
        segments = question.image
        if isinstance(segments, DeliveredImage):
            assert self._parting is not None
            segments = self._parting.apart(segments)
        told = replace(self.settings, added=added) if added else self.settings
        slots = [Slot.unpack(part) for part in question.memory.reshape(-1, SLOT_SIZE)]
        found = advance(slots, OtherMemory.unpack(question.beside, told), segments, told)
        return ImageAnswer(
            np.concatenate([slot.pack() for slot in found.slots] or [np.zeros(0)]),
            found.beside.pack(),
            np.concatenate([pose.pack() for pose in found.poses] or [np.zeros(0)]),
            np.concatenate([found.further, found.things, np.array(found.beside.turned_away, dtype=float)]),
        )
