"""What one image says of a thing's name, by its colours and by its shape.

Things of nearly an object's shape pass for it where neither its colours nor the share of its surface that fits can
tell: a grey can, a box a tenth longer. See `shape_evidence`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.perception.registration.colour_contrast import coloured_alike, painted_alike
from twin_diagram.perception.registration.colour_margin import turn_speaks
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import TUNING as NAMING
from twin_diagram.perception.registration.naming import Naming
from twin_diagram.perception.registration.outline import outline, own_points
from twin_diagram.perception.registration.registration import RegisteredPose, claimed
from twin_diagram.perception.registration.settling import settle
from twin_diagram.perception.registration.shape_evidence import ShapeEvidence, shape_evidence
from twin_diagram.perception.registration.torn_depth import past_what_is_torn
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import TUNING as EXPECTED
from twin_diagram.perception.registration.where_expected import floats


@dataclass(frozen=True)
class Tuning:
    """Constants, set on 8 rendered sequences before a D435: 78 poses that were right, and stretched things."""

    even: float = 2.65
    """Shape's odds from which a thing is the object as often as not [nat]: stretched things had up to 2.4, what was
    right and passed `passes` 2.9 and more."""

    each: float = 1.5
    """Odds of the name for each nat more or less: models err, too."""

    most: tuple[float, float] = (-5.0, 4.0)
    """No shape says more [nat]."""

    fails: float = -2.0
    """Nor more than this, if it does not pass and colours say nothing."""

    least: tuple[float, float] = (0.95, 0.92)
    """It passes with such shares of surface in place, and of the thing's image near the surface, …"""

    largest: tuple[float, float, float] = (0.10, 0.12, 1.35)
    """… and no more than such shares outside of the model's outline, and missed in it, and such an excess of depth's
    errors."""

    alike: tuple[float, float] = (0.45, 0.75)
    """Where it looks like itself to so large a share of what fits in shape, and so large a share of that fits in
    colour, colours begin to speak for it, …"""

    colours: tuple[float, float] = (20.0, 3.0)
    """… by so much for each of 1 more, and no more than that [nat]. They never speak against it: it may be painted."""

    silent: tuple[float, float] = (-0.5, 1.0)
    """Where shape says nothing, the odds start from there: of coloured objects, and of those without colours [nat]."""

    edge: float = 1.5
    """In the air, an outline is in place within so many cells, …"""

    ends: tuple[float, float] = (0.35, 0.5)
    """… and colours speak where such a share of it is: not at all with less, fully with more. What forearms held had
    0.51 to 1, patches of forearms that passed for a box or a can by their own paint or a neighbour's 0.04 to 0.38, but
    for one of 30 cells with 0.57 (`sims/benchmarks/followed_scenes.py`, seeds 12, 100403, 100404)."""

    never: float = -2.5
    """What has shorter odds is not taken for the object at all [nat]."""

    shown: float = 0.5
    """What is seen to a smaller share is asked for its name again."""

    thin: int = 150
    """Points of a thing that weigh its poses."""


TUNING = Tuning()


def with_name(known: Known, view: View, one: RegisteredPose) -> RegisteredPose:
    """Return a find with its name, settled where its shape denies that it is the object.

    Of what is half hidden, a search may be half a centimetre off along what depth leaves open: shape then tells of
    another size.

    Args:
        known: what it was found as.
        view: the image.
        one: the find.
    """
    told = naming(known, view, one)
    past = past_what_is_torn(known.model, view, one.R, one.p) if is_another(told) else view
    if is_another(told) and told_by_colours(known, past, one) > 0.0:
        own = claimed(known.model, past.segments, one.R, one.p, EXPECTED.owned)
        points = past.segments.points_W[own[:: max(1, len(own) // TUNING.thin)]]
        one = settle(known.model, past.frame, [one], points, view.params).registration
        told = naming(known, view, one)
    return replace(one, named=told, by_shape=False)


def naming(known: Known, view: View, one: RegisteredPose) -> Naming:
    """Return what an image says of a registered thing's name.

    Args:
        known: what it is named.
        view: the image.
        one: the pose.
    """
    model = known.model
    view = past_what_is_torn(model, view, one.R, one.p)
    colours = told_by_colours(known, view, one)
    evidence = None
    if floats(known, view, one):  # What carries it hides a part of its outline, and it stands on nothing.
        colours *= min(ends_alike(model, view, one), coloured_alike(model, view.frame, one)) if colours > 0.0 else 0.0
    else:
        evidence = shape_evidence(model, view.frame, view.segments, one, min(colours / TUNING.colours[1], 1.0))
    if evidence is None:
        return Naming(colours + TUNING.silent[0 if model.coloured else 1])
    shape = TUNING.each * (evidence.odds - TUNING.even)
    if colours == 0.0 and not passes(evidence, one.shape):
        shape = min(shape, TUNING.fails)
    odds = colours + float(np.clip(shape, *TUNING.most))
    return Naming(min(odds, NAMING.certain), int(one.visible_share >= TUNING.shown))


def colours_speak(known: Known, one: RegisteredPose) -> float:
    """Return by how much colours speak for a registered thing's name [nat]; 0: not at all."""
    if not known.model.coloured:
        return 0.0
    shape = max(one.shape, 1e-9)
    more = min(one.likeness / shape - TUNING.alike[0], one.quality / shape - TUNING.alike[1])
    return float(np.clip(TUNING.colours[0] * more, 0.0, TUNING.colours[1]))


def told_by_colours(known: Known, view: View, one: RegisteredPose) -> float:
    """Return by how much colours speak for a thing's name: as many fit, or they fit this way round alone [nat].

    What fits on a plain thing, where the object has paint, says nothing.
    """
    spoken = colours_speak(known, one)
    if spoken > 0.0:
        spoken *= painted_alike(known.model, view.frame, one)
    if spoken >= TUNING.colours[1] or not view.params.told_by_shape:
        return spoken
    return max(spoken, turn_speaks(known.model, view.frame, one))


def ends_alike(model: ModelCloud, view: View, one: RegisteredPose) -> float:
    """Return from 0 to 1 whether a thing in the air ends where the object does, but for what something holds of it.

    A box's side fits anywhere on a forearm, and with a neighbour's paint its colours do: but there the forearm goes on.
    """
    own = own_points(model, view.segments, one)[1]
    seen = outline(model, view.frame, view.segments, one, own)
    if seen is None:
        return 1.0
    low, high = TUNING.ends
    return float(np.clip((seen.in_place(TUNING.edge) - low) / (high - low), 0.0, 1.0))


def passes(evidence: ShapeEvidence, shape: float) -> bool:
    """Return whether a thing shows nothing that stretching does not explain; `shape`: the share that is in place."""
    return (
        shape >= TUNING.least[0]
        and evidence.explained >= TUNING.least[1]
        and evidence.outside <= TUNING.largest[0]
        and evidence.missed <= TUNING.largest[1]
        and evidence.excess <= TUNING.largest[2]
    )


def is_another(one: Naming | None) -> bool:
    """Return whether a thing is not taken for what it is named at all; None: nobody asked."""
    return one is not None and one.looks > 0 and one.odds < TUNING.never


def name_believed(known: Known, view: View, one: RegisteredPose, ask: bool) -> bool:
    """Return whether a find is believed to be what it was asked for as.

    Args:
        known: that.
        view: the image.
        one: the find, named.
        ask: of what colours do not speak for shape is asked, beside all other objects.
    """
    looked = one.named is not None and one.named.looks > 0
    if ask and looked and known.model.coloured and told_by_colours(known, view, one) <= 0.0:
        return False
    return not is_another(one.named)
