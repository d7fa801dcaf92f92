"""Several instances of one asset: who is who among those that look alike, and slots for more than one of each.

The first instance of each of the library's objects has a slot of its own; further ones share a pool of slots. Who is
tracked keeps its identity by continuity. Of those that were lost, alikes that are found again are told apart by where
they were: the nearest is the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from twin_diagram import scenario
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.height import as_tall, seen_tall
from twin_diagram.perception.registration.hues import alike, hues
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming_evidence import is_another, naming
from twin_diagram.perception.registration.recognition import TUNING as RECOGNITION
from twin_diagram.perception.registration.recognition import looks_like_itself, recognise
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot
from twin_diagram.perception.registration.slots import TUNING as SLOTS
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.seen_through import seen_through
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, PoseMeasurement


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    same_place: float = 0.5
    """Two alikes whose origins are nearer than this share of their radius are one, seen twice."""

    looked_up: int = 60
    """Points of an object's surface that are looked up to see whether its place is empty."""

    open_share: float = 0.3
    """This share of them must be in the open …"""

    empty: float = 0.7
    """… and the camera see through this share of those."""

    sure: float = 0.6
    """Least quality and score of a further instance: an unknown thing must not be taken for one."""

    again: float = 10.0
    """A thing that is like nothing in the library is compared anew after this long [s]."""


TUNING = Tuning()

INSTANCE_SIZE: Final = 4 + SLOT_SIZE
"""A packed `Instance`."""


@dataclass(frozen=True)
class Instance:
    """A slot for a further instance.

    Attributes:
        identity: from 1, never given again; 0: the slot is free.
        asset: number in the library.
        gone_since: since when its place is seen empty [s]; `NEVER` while it is not.
        slot: what tracking remembers of it.
        own: the first of an asset that came later: it keeps its slot, as the library's first ones do.
    """

    identity: int = 0
    asset: int = 0
    gone_since: float = NEVER
    slot: Slot = field(default_factory=Slot)
    own: bool = False

    def pack(self) -> Array:
        """Return it as a vector of `INSTANCE_SIZE`."""
        head = [float(self.identity), float(self.asset), self.gone_since, float(self.own)]
        return np.concatenate([head, self.slot.pack()])

    @staticmethod
    def unpack(vector: Array) -> Instance:
        """Return the inverse of `pack`."""
        return Instance(
            int(vector[0]), int(vector[1]), float(vector[2]), Slot.unpack(vector[4:]), bool(vector[3] > 0.5)
        )


def settled(
    assets: Sequence[int],
    radii: Sequence[float],
    before: Sequence[Slot],
    after: Sequence[Slot],
    measured: Sequence[PoseMeasurement],
) -> tuple[list[Slot], list[PoseMeasurement]]:
    """Settle who is who after an image: no two alikes in one place, and who is found again is who was nearest.

    Args:
        assets: what each slot holds, a number in the library.
        radii: of the assets, by that number [m].
        before: slots before the image.
        after: slots after tracking.
        measured: what tracking found.
    """
    after, measured = list(after), list(measured)
    for asset in sorted(set(assets)):
        alikes = [k for k, one in enumerate(assets) if one == asset]
        if len(alikes) < 2:
            continue
        _part(alikes, TUNING.same_place * radii[asset], before, after, measured)
        _regive(alikes, before, after, measured)
    return after, measured


def _part(
    alikes: Sequence[int], least: float, before: Sequence[Slot], after: list[Slot], measured: list[PoseMeasurement]
) -> None:
    """Leave one of those alikes that were found in one place: the one that was there before."""
    for a in alikes:
        for b in alikes:
            both = measured[a].quality > 0 and measured[b].quality > 0
            if b <= a or not both or np.linalg.norm(after[a].p - after[b].p) >= least:
                continue
            stray = max((a, b), key=lambda k: (_away(before[k], after[k]), k))
            waits = replace(before[stray], next_search=measured[stray].time)
            after[stray] = waits
            measured[stray] = replace(measured[stray], quality=0.0)


def _away(before: Slot, after: Slot) -> float:
    return float(np.linalg.norm(after.p - before.p)) if before.known else np.inf


def _regive(alikes: Sequence[int], before: Sequence[Slot], after: list[Slot], measured: list[PoseMeasurement]) -> None:
    """Give poses found anew to those lost alikes that were nearest to them."""
    lost = [k for k in alikes if before[k].known and measured[k].time - before[k].seen > SLOTS.coast]
    found = [k for k in lost if measured[k].quality > 0]
    if not found or len(lost) < 2:
        return
    cost = np.array([[float(np.linalg.norm(after[j].p - before[k].p)) for j in found] for k in lost])
    rows, columns = linear_sum_assignment(cost)
    given = {lost[r]: found[c] for r, c in zip(rows, columns, strict=True)}
    slots, poses = {k: after[k] for k in found}, {k: measured[k] for k in found}
    for k in found:
        after[k], measured[k] = before[k], replace(measured[k], quality=0.0)
    for k, j in given.items():
        after[k], measured[k] = slots[j], poses[j]


def emptiness(model: ModelCloud, slot: Slot, segments: Segments) -> float:
    """Return the share of an object's camera-facing surface whose place the camera sees through; 0: it may be there."""
    towards = (segments.camera.p_WC - slot.p) @ slot.R
    view = int(np.argmax(model.directions @ towards))
    index = model.views[view][: min(TUNING.looked_up, int(model.view_counts[view]))]
    look = seen_through(model.points[index] @ slot.R.T + slot.p, segments)
    open_ = look.there + look.empty
    return look.empty if open_ >= TUNING.open_share and look.empty >= TUNING.empty * open_ else 0.0


def taken(model: ModelCloud, slot: Slot, segments: Segments) -> bool:
    """Return whether something took an object: its place is seen empty."""
    return slot.known and emptiness(model, slot, segments) > 0.0


def recognised(
    library: Mapping[int, Known],
    of: npt.NDArray[np.int64],
    searches: int,
    segments: Segments,
    params: scenario.Registration,
    smallest: int,
    usual: Mapping[int, float],
    frame: Frame,
) -> tuple[int, RegisteredPose | None, int]:
    """Compare a thing with one of the library's objects: those that lie as tall as it is first, then by their colours.

    It takes as long as tracking everything, so there is one comparison in an image.

    Args:
        library: the known objects by number.
        of: indices of the segments' points that show the thing.
        searches: how many were compared with it before.
        segments: the image taken apart.
        params: tuning.
        smallest: points that make an object.
        usual: how much objects look like themselves (0: not known), by number; of what is not among them the first is
            looked for elsewhere.
        frame: the image ready for registration.

    Returns:
        Which object it is and where (None: it is not that one), and how many were compared by now; -1: all were.
    """
    mask = np.zeros(len(segments.labels), dtype=bool)
    mask[of] = True
    own = hues(segments.colours[of])
    colours = {k: -alike(one.model.hues, own) for k, one in library.items()}
    tall = seen_tall(segments.points_W[of], segments.table)
    ways: list[tuple[bool, int, float, int]] = []
    for k, one in library.items():
        for how, rests in enumerate((one.upright, one.fallen)):
            ways.append((not as_tall(one.model, rests, tall), how, colours[k], k))
    done = searches
    for _, how, _, k in sorted(ways)[searches:]:
        done += 1
        orientations = (library[k].upright, library[k].fallen)[how]
        if k not in usual or not orientations:
            continue
        found = recognise({k: library[k].model}, {k: orientations}, segments, frame, mask, params, smallest).get(k)
        fits = 0.0 if found is None else max(found.registration.quality, found.registration.shape)
        if (
            found is not None
            and min(found.score, fits) >= TUNING.sure
            and looks_like_itself(found.registration, usual[k] or RECOGNITION.usual)
        ):
            view = View(segments, frame, params, smallest)
            named = naming(library[k], view, found.registration)
            if not is_another(named):
                return k, replace(found.registration, named=named), 0
        break
    return -1, None, done if done < len(ways) else -1
