"""Asks an image for the names of what is followed, what other objects surely show set apart.

Where two things touch, segments are cut some pixels beside the edge: what one shows there would count as the other's,
which would be too large for what it is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from twin_diagram.perception.registration.naming import TUNING as NAMING
from twin_diagram.perception.registration.naming_evidence import TUNING as EVIDENCE
from twin_diagram.perception.registration.naming_evidence import naming
from twin_diagram.perception.registration.registration import RegisteredPose, claimed
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import TUNING as EXPECTED


def set_apart(
    library: Sequence[Known], slots: Sequence[Slot], found: Mapping[int, RegisteredPose], view: View, but: int = -1
) -> View:
    """Return a view in which points at the surface of each object whose name is sure are a segment of their own.

    Args:
        library: the known objects.
        slots: one per object.
        found: those that were found in the image, by number.
        view: the image.
        but: this one stays as it is.
    """
    sure = [k for k in found if k != but and slots[k].named.odds >= NAMING.enough]
    if not sure:
        return view
    segments = view.segments
    labels, count = segments.labels.copy(), segments.count
    for k in sure:
        at = claimed(library[k].model, segments, found[k].R, found[k].p, EXPECTED.owned)
        labels[at], count = count, count + 1
    return replace(view, segments=replace(segments, labels=labels, count=count))


def asked(
    library: Sequence[Known], slots: Sequence[Slot], tracked: Mapping[int, RegisteredPose], view: View
) -> dict[int, RegisteredPose]:
    """Return the objects that were followed, of which the one whose name is least settled was asked for it again."""
    open_ = [k for k, one in tracked.items() if not slots[k].named.settled and one.visible_share >= EVIDENCE.shown]
    if not open_:
        return dict(tracked)
    k = min(open_, key=lambda k: (slots[k].named.looks, slots[k].named.asked, k))
    apart = set_apart(library, slots, tracked, view, but=k)
    return {**tracked, k: replace(tracked[k], named=slots[k].named.after(naming(library[k], apart, tracked[k])))}
