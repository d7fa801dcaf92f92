"""Which of the wanted objects is which segment, and where: by colour first, then by search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.registration.colour_margin import turn_speaks
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import TUNING as GLOBAL_SEARCH
from twin_diagram.perception.registration.global_search import Found, search
from twin_diagram.perception.registration.hues import alike, hues
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.past_tears import search_past_tears
from twin_diagram.perception.registration.registration import RegisteredPose, claimed
from twin_diagram.perception.registration.search_aloft import afloat, anyhow, hangs
from twin_diagram.perception.registration.turns_about import turned_about
from twin_diagram.perception.registration.view import View
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Aloft:
    """An object that is looked for in the air.

    Attributes:
        R, p: (3, 3), (3,) X_WO when it was seen last [m].
        usual: how much it looked like itself; 0: not known.
        near: how far from there it can be by now [m]; any way if nobody has seen it.
        just_lost: it was there a moment ago: then less is accepted.
    """

    R: Array
    p: Array
    usual: float
    near: float
    just_lost: bool = False

    def may_be(self, one: RegisteredPose) -> bool:
        """Return whether a pose can be where it has got to, and looks like it."""
        return self.reaches(one) and looks_like_itself(one, self.usual)

    def reaches(self, one: RegisteredPose) -> bool:
        """Return whether it can have got to a pose by now."""
        return float(np.linalg.norm(one.p - self.p)) <= self.near


@dataclass(frozen=True)
class Tuning:
    """Constants of recognition, chosen by hand.

    `sims/closed_loop.py --seeds 20` shows their effect: an object that is mistaken for another misses its truth by far.
    """

    accept: float = 0.6
    """Least score of an object that is recognised."""

    turned: float = 0.75
    """Where colours speak for the way round that it was found, a score as much lower is accepted: half hidden cups
    before a D435 had 0.47 to 0.56, a can 1.7 m off 0.55. Wrong ones as low had no such colours, …"""

    own: float = 0.85
    """… if what is seen there is mostly its own."""

    bare: float = 0.8
    """The same of one without colours, of which nothing but its shape tells: boxes seen from one side have 0.7 where
    they are other boxes. It is told by comparison: nothing is taken before all was tried."""

    aloft: float = 0.6
    """What looks less like itself than others do, before this camera and in this light, is accepted with a score as
    much lower where it was a moment ago, down to this share: half hidden cups before a D435 had 0.55 …"""

    alone: float = 0.8
    """… if so much of it is to be seen and what is seen there is its own: of a can on a forearm it is 0.55."""

    coloured: float = 0.6
    """What looks like itself to a smaller share of what is usual is another thing: where 0.7 to 0.8 of what fits in
    shape was usual, others did to 0.2 to 0.41 (`sims/benchmarks/followed_scenes.py`, seeds 0 to 7 and 11)."""

    usual: float = 0.75
    """What is usual where nobody has seen it."""


TUNING = Tuning()


def looks_like_itself(one: RegisteredPose, usual: float) -> bool:
    """Return whether colours speak for an object as they `usual`ly do; what that is may not be known (0)."""
    return one.likeness >= TUNING.coloured * usual * one.shape


def recognise(
    wanted: Mapping[int, ModelCloud],
    orientations: Mapping[int, Sequence[tuple[Array, float]]],
    segments: Segments,
    frame: Frame,
    free: npt.NDArray[np.bool_],
    params: scenario.Registration,
    smallest: int,
    floating: Mapping[int, Aloft] | None = None,
    rivals: Sequence[tuple[ModelCloud, Sequence[tuple[Array, float]]]] = (),
    least: float = 0.0,
) -> dict[int, Found]:
    """Find wanted objects in what no tracked object explains.

    Args:
        wanted: models by the object's number.
        orientations: resting orientations to try, by the object's number; none: the object is not looked for.
        segments: the image taken apart.
        frame: the same image.
        free: (N,) the segments' points that no object explains.
        params: tuning.
        smallest: points that a segment must have left.
        floating: of objects that are looked for in the air instead, what is known of them, by the object's number.
        rivals: models of which there may be one more, and how they rest: what has no colours, is none of these.
        least: a segment is given up where nothing laid in it has such a `coarse_score`.

    Returns:
        What was found, by the object's number; each segment's points go to one object alone.
    """
    free, view = free.copy(), View(segments, frame, params, smallest)
    found, tried = dict[int, Found](), dict[tuple[int, int], Found]()
    for k, model in wanted.items():
        sure = GLOBAL_SEARCH.sure if model.coloured else np.inf
        members = {s: np.flatnonzero(free & (segments.labels == s)) for s in range(segments.count)}
        likeness = {s: alike(model.hues, hues(segments.colours[i])) for s, i in members.items() if len(i) >= smallest}
        known, ways = (floating or {}).get(k), list(orientations.get(k, ()))
        for s in sorted(likeness, key=lambda s: -likeness[s]):
            result = _searched(model, view, segments.points_W[members[s]], known, ways, least)
            if result is not None:
                tried[k, s] = result
                if result.score >= sure:
                    break
        best = max((result for (j, _), result in tried.items() if j == k), key=lambda r: r.score, default=None)
        if best is not None and best.score >= sure:
            found[k] = best
            free[_owned(model, segments, best)] = False
    # The rest in the order of their scores, each only where its segment is still there.
    for (k, s), result in sorted(tried.items(), key=lambda item: -item[1].score):
        accept = TUNING.accept if wanted[k].coloured else TUNING.bare
        if k in found or result.score < accept * _discount((floating or {}).get(k), result, wanted[k], frame, params):
            continue
        own_points = _owned(wanted[k], segments, result)
        if int(free[own_points].sum()) >= max(smallest // 2, len(own_points) // 2):
            points = segments.points_W[free & (segments.labels == s)]
            others = [one for (j, at), one in tried.items() if at == s and j != k]
            if not wanted[k].coloured and _outdone(result, others, rivals, frame, points, params):
                continue  # one more of what is elsewhere, too
            found[k] = result
            free[own_points] = False
    return found


def _searched(
    model: ModelCloud,
    view: View,
    points_W: Array,
    known: Aloft | None,
    ways: list[tuple[Array, float]],
    least: float,
) -> Found | None:
    """Look for an object among a segment's points (N, 3), in the air where it is `known` to have been, or hangs."""
    frame, params = view.frame, view.params
    if known is None:
        result = search(model, frame, points_W, ways, params, least)
        if result is not None and result.score < TUNING.accept and model.coloured:
            result = turned_about(model, frame, result, points_W, params)
        if result is not None and result.score < TUNING.accept:
            result = search_past_tears(model, view, points_W, ways, result)
        # Turned anyhow, a shape without colours fits too much: a part of a castle passed for a second one.
        if not (ways and model.coloured and hangs(frame, points_W)):
            return result
        if result is not None and result.score >= GLOBAL_SEARCH.sure:
            return result
        other = anyhow(model, frame, points_W, params)
        return max((one for one in (result, other) if one is not None), key=lambda one: one.likeness, default=None)
    result = afloat(model, frame, points_W, known.R, params)
    return result if result is not None and known.may_be(result.registration) else None


def _outdone(
    one: Found,
    others: Sequence[Found],
    rivals: Sequence[tuple[ModelCloud, Sequence[tuple[Array, float]]]],
    frame: Frame,
    points_W: Array,
    params: scenario.Registration,
) -> bool:
    """Return whether another object explains a segment's points (N, 3) better, or one more of the `rivals` does."""
    tried = (search(model, frame, points_W, list(ways), params) for model, ways in rivals)
    return any(other is not None and other.score > one.score for other in (*others, *tried))


def _discount(
    known: Aloft | None, found: Found, model: ModelCloud, frame: Frame, params: scenario.Registration
) -> float:
    """Return by which share less is accepted of what usually looks as much less like itself, and was there just now.

    On a table, of what looks like itself one way round alone.
    """
    if known is None and params.told_by_shape and TUNING.accept * TUNING.turned <= found.score < TUNING.accept:
        mostly = found.score >= TUNING.own * found.registration.quality
        return TUNING.turned if mostly and turn_speaks(model, frame, found.registration) > 0.0 else 1.0
    if (
        known is None
        or not known.just_lost
        or known.usual <= 0.0
        or found.score < TUNING.alone * found.registration.quality
    ):
        return 1.0
    return float(np.clip(known.usual / TUNING.usual, TUNING.aloft, 1.0))


def _owned(model: ModelCloud, segments: Segments, found: Found) -> npt.NDArray[np.int64]:
    return claimed(model, segments, found.registration.R, found.registration.p, 0.012)
