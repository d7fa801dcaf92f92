"""Looks for what the hand holds where the hand has it.

Nothing goes as fast as what an arm carries, nor turns as much: a velocity that images told is no guess of where it is
an image later. And depth may be half a frame older than colours. At 0.6 m/s that lays them 20 mm beside one another:
the can of the demonstration, found by 96 % of its shape, looked like itself to a fifth of what it did at rest. It is
not believed to be there then, but what is seen where the hand has it is no other thing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.instances import emptiness
from twin_diagram.perception.registration.point_kernels import COARSE
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import MOVING, registered_near, unmistaken
from twin_diagram.perception.registration.where_expected import TUNING as EXPECTED
from twin_diagram.perception.segmentation.segments import HeldPlaces, Segments
from twin_diagram.perception.things.clusters import Placed
from twin_diagram.signals.layouts import PoseMeasurement


def register_where_held(k: int, known: Known, slot: Slot, view: View) -> RegisteredPose | None:
    """Register object k near that of the hand's places of which the image shows most; None: not held, or not seen."""
    held = view.segments.held
    if held is None or held.asset != k:
        return None
    at = Poses(held.R, held.p)
    fits = assess(known.model, view.frame, at, view.params.model_points, COARSE, EXPECTED.rough).points
    most = int(np.argmax(fits))
    one = registered_near(known, view, held.R[most], held.p[most], MOVING, slot.alike)
    return one if one is None else unmistaken(known, view, one, slot.odds)


def where_held(
    held: HeldPlaces | None, library: Sequence[Known], measured: Sequence[PoseMeasurement]
) -> Iterator[Placed]:
    """Yield what is held and was not found at each of its places: what an image shows there is no other thing."""
    if held is not None and measured[held.asset].quality <= 0:
        for R, p in zip(held.R, held.p, strict=True):
            yield library[held.asset].model, R, p


def seen_empty(k: int, known: Known, slot: Slot, segments: Segments) -> float:
    """Return the share of object k's surface whose place is seen empty; of what the hand holds, all its places there.

    Where a hand took it from is empty, and tells nothing of where it is.
    """
    held = segments.held
    if held is None or held.asset != k:
        return emptiness(known.model, slot, segments)
    there = [replace(slot, R=R, p=p) for R, p in zip(held.R, held.p, strict=True)]
    return min(emptiness(known.model, one, segments) for one in there)
