"""Registers an object near where it is expected, told apart from what its shape may be mistaken for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram import scenario
from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.alternatives import compare, votes, weak_directions
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_votes import colour_costs
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.past_tears import followed_past_tears
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.recognition import looks_like_itself
from twin_diagram.perception.registration.registration import RegisteredPose, claimed, information, label_of, register
from twin_diagram.perception.registration.rotation import log
from twin_diagram.perception.registration.slots import Slot, predict
from twin_diagram.perception.registration.standing import standing
from twin_diagram.perception.registration.torn_depth import in_place
from twin_diagram.perception.registration.turned_alike import weighed
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of following, chosen by hand for images at 15 Hz of objects that people and arms move.

    `sims/closed_loop.py --seeds 20` and `sims/benchmarks/followed_scenes.py` show what is lost, and errors.
    """

    least_visible: float = 0.12
    """An object of which less can be seen counts as hidden."""

    least_points: int = 30
    """A registration on fewer model points is a guess."""

    largest_step: tuple[float, ...] = (0.7, 0.08)
    """From one image to the next no object turns or moves farther than this [rad], [m]."""

    stays: tuple[float, ...] = (0.2, 0.02)
    """Within this of where it is expected, an object is believed by its shape alone [rad], [m]."""

    thin: int = 120
    """Image points that pull on an object that is followed."""

    owned: float = 0.012
    """Points this near to an object's surface are its own [m]."""

    rough: float = 0.01
    """Slack of surfaces at a pose that is a guess [m]: a third of a step at half a metre a second."""

    moves: tuple[float, float] = (0.2, 0.03)
    """How far off the next pose of an object that moves is where it is expected, RMS [rad], [m]."""

    jumps: float = 2.0
    """What turned by more of those deviations, about an axis of which its shape tells least, is held against what did
    not."""

    turned: float = 0.07
    """A smaller turn from image to image is found again from either side [rad]."""

    coloured: float = 0.8
    """Where less than this share of what fits in shape fits in colour, too, it may have turned."""

    turning: float = 0.8
    """Share of a turn, in units that weigh alike, in a direction that counts as one."""

    turned_by: tuple[float, ...] = (-0.4, -0.2, 0.2, 0.4)
    """Then turns by so much are tried [rad]: registration finds back from about 0.12."""

    around: float = 0.02
    """Points this near to an object's surface weigh its poses against one another [m]."""

    floats: float = 0.03
    """What is this far above the table is in the air [m], carried by something."""

    half: float = 0.5
    """Of what is seen to a smaller share, too little is known of its edges."""

    beyond: float = 0.03
    """Around an object in the air, so far from its surface [m], …"""

    alone: float = 0.65
    """… at least this share of its segment's points is its own: a hand hides one of its sides."""

    alone_anew: float = 0.88
    """The same of what is found anew: of those found right three quarters had 0.97 and more, of sides of boxes found on
    forearms three quarters less than 0.91 (`sims/benchmarks/followed_scenes.py`, seeds 4, 21, 24, 25)."""


TUNING = Tuning()


MOVING: Final = information(*TUNING.moves)
"""How well the next pose of an object that moves is known."""
RESTING: Final = information(0.03, 0.005)
"""And of one that stands still. Nearly hidden, it is held where it was; in the open, the image has far more to say."""
AS_TURNED: Final = information(0.03, TUNING.moves[1])
"""And of one whose turn is held against another."""


def register_where_expected(known: Known, slot: Slot, view: View) -> RegisteredPose | None:
    """Register an object near where it is expected; None where it is not to be seen there.

    What moves goes on, stops, or stops turning. Where the shape fits and the colours do not, it may have turned about
    an axis that the shape does not tell: then turns about it are registered, too. The image tells the likeliest.
    """
    time = view.segments.time
    R, p = predict(slot, time)
    if not np.any(slot.velocity):
        best = registered_near(known, view, R, p, RESTING, slot.alike, rests=True)
    elif _turns(slot, time):
        places = (R, p), (slot.R, slot.p), (slot.R, p)
        found = [registered_near(known, view, *at, MOVING, slot.alike) for at in places]
        best = likeliest(known, view, [one for one in found if one is not None])
    else:
        best = _goes_on_or_stops(known, slot, view, R, p)
    if best is None:
        return None
    if best.quality < TUNING.coloured * best.shape:
        turned = [registered_near(known, view, *at, MOVING) for at in turns(known, view, best)]
        best = likeliest(known, view, [best, *(one for one in turned if one is not None)])
    return best if best is None else unmistaken(known, view, turned_back(known, slot, view, best), slot.odds)


def _goes_on_or_stops(known: Known, slot: Slot, view: View, R: Array, p: Array) -> RegisteredPose | None:
    """Register an object where it is expected (R, p), or where it was: first at that of which the image shows more."""
    starts = Poses(np.stack([R, slot.R]), np.stack([p, slot.p]))
    fits = assess(known.model, view.frame, starts, view.params.model_points, COARSE, TUNING.rough).points
    for k in np.argsort(-fits, kind="stable"):
        result = registered_near(known, view, starts.R[k], starts.p[k], MOVING, slot.alike)
        if result is not None:
            return result
    return None


def turned_back(known: Known, slot: Slot, view: View, one: RegisteredPose) -> RegisteredPose:
    """Return a pose, or the one without its turn about the axis that its shape tells least of, whichever is likelier.

    Of a can that is half hidden colours leave several turns about its axis nearly alike, and registration may slip
    from one to the next. The image tells, and how far things turn from image to image.
    """
    expected = np.stack([predict(slot, view.segments.time)[0], slot.R])
    steps = log(one.R @ expected.transpose(0, 2, 1))
    large = TUNING.jumps * TUNING.moves[0]
    if np.linalg.norm(steps, axis=1).min() < large or (way := weak_turn(known, view, one)) is None:
        return one
    axis = way[:3] / np.linalg.norm(way[:3])
    by = min(steps @ axis, key=abs)
    if abs(by) < large:
        return one
    R, p = _turned_by(one, way, np.array([-by]))[0]
    back = registered_near(known, view, R, p, AS_TURNED, slot.alike)
    if back is None:
        return one
    own = claimed(known.model, view.segments, one.R, one.p, TUNING.around)
    both = Poses(np.stack([one.R, back.R]), np.stack([one.p, back.p]))
    cost = compare(known.model, view.frame, both, view.segments.points_W[own], FINE)
    cost += colour_costs(known.model, view.frame, both, view.params.model_points)
    left = by + float(log((back.R @ one.R.T)[None])[0] @ axis)
    cost += 0.5 * np.square(np.array([by, left]) / TUNING.moves[0])
    return back if cost[1] < cost[0] else one


def turns(known: Known, view: View, one: RegisteredPose) -> list[tuple[Array, Array]]:
    """Return poses turned to both sides about the axis, through the object's middle, that its shape tells least of."""
    way = weak_turn(known, view, one)
    return [] if way is None else _turned_by(one, way, np.array(TUNING.turned_by))


def weak_turn(known: Known, view: View, one: RegisteredPose) -> Array | None:
    """Return the motion (6,) [units of `alternatives`], mostly a turn, that its shape tells least of, if any."""
    pose = Poses(one.R[None], one.p[None])
    looked = look(known.model, view.frame, pose, view.params.model_points, FINE)
    for way, _ in weak_directions(looked, view.frame, votes(looked, view.frame, known.model.spacing), 0.0):
        if np.linalg.norm(way[:3]) > TUNING.turning:
            return way
    return None


def _turned_by(one: RegisteredPose, way: Array, angles: Array) -> list[tuple[Array, Array]]:
    """Return a pose turned by angles (K,) [rad] along a motion (6,)."""
    steps = angles[:, None] * (way / np.linalg.norm(way[:3]))
    # Units of turns and shifts differ; see `alternatives`.
    steps[:, 3:] *= ALTERNATIVES.unit[1] / ALTERNATIVES.unit[0]
    R, p = np.repeat(one.R[None], len(steps), axis=0), np.repeat(one.p[None], len(steps), axis=0)
    moved = Poses(R, p).moved(steps)
    return list(zip(moved.R, moved.p, strict=True))


def likeliest(known: Known, view: View, results: Sequence[RegisteredPose]) -> RegisteredPose | None:
    """Return which of registered poses the image says is the likeliest; None of none."""
    if len(results) < 2:
        return results[0] if results else None
    segments = view.segments
    own = claimed(known.model, segments, results[0].R, results[0].p, TUNING.around)
    poses = Poses(np.stack([one.R for one in results]), np.stack([one.p for one in results]))
    cost = compare(known.model, view.frame, poses, segments.points_W[own], FINE)
    return results[int(np.argmin(cost))]


def unmistaken(known: Known, view: View, one: RegisteredPose, before: float = 0.0) -> RegisteredPose:
    """Return a pose, or the one that it was mistaken for, with its odds among its turns; see `turned_alike.weighed`."""
    return weighed(known.model, view, one, before, lambda R, p: registered_near(known, view, R, p, MOVING))


def _turns(slot: Slot, time: float) -> bool:
    """Return whether an object is expected to have turned by more than registration finds back."""
    return float(np.linalg.norm(slot.velocity[:3])) * (time - slot.seen) > TUNING.turned


def registered_near(
    known: Known, view: View, R: Array, p: Array, prior: Array, usual: float = 0.0, *, rests: bool = False
) -> RegisteredPose | None:
    """Register an object from a guess; None where what comes of it is not believable."""
    thin = view.segments.points_W[claimed(known.model, view.segments, R, p, view.params.reach, TUNING.thin)]
    result = register(known.model, view.frame, R, p, view.params, prior=prior, points_W=thin, rests=rests)
    if rests and not (in_place(result.shape, result.quality) or floats(known, view, result)):
        result = followed_past_tears(known.model, view, result, Poses(R[None], p[None]), thin, prior)
    return result if believable(result, view.params, R, p) and stands_out(known, view, result, usual) else None


def stands_out(known: Known, view: View, one: RegisteredPose, usual: float, *, anew: bool = False) -> bool:
    """Return whether what is seen at a pose ends where the object does; what stands on the table may touch its likes.

    In the air, a box's side fits anywhere on a forearm: what is found `anew` there has to be apart from all else.
    """
    segments = view.segments
    if not floats(known, view, one) or one.visible_share < TUNING.half:
        return True
    if not looks_like_itself(one, usual):
        return False
    near = claimed(known.model, segments, one.R, one.p, TUNING.beyond)
    own = claimed(known.model, segments, one.R, one.p, TUNING.owned)
    if not len(own):
        return True
    label = label_of(segments, own)
    mine = np.count_nonzero(segments.labels[own] == label)
    alone = TUNING.alone_anew if anew else TUNING.alone
    return bool(mine >= alone * np.count_nonzero(segments.labels[near] == label))


def held_by_planes(
    library: Sequence[Known], slots: Sequence[Slot], view: View, found: Mapping[int, RegisteredPose]
) -> dict[int, RegisteredPose]:
    """Return poses found, by object, with what they tell of those that stand, where they did not move just now."""
    still = {k: library[k].feet for k in found if not np.any(slots[k].velocity)}
    return {
        k: standing(still[k], library[k].model.asset.symmetric_axis == "z", one, view.segments) if still.get(k) else one
        for k, one in found.items()
    }


def floats(known: Known, view: View, one: RegisteredPose) -> bool:
    """Return whether an object is in the air."""
    table = view.frame.table
    up = np.array([-table[0], -table[1], 1.0])
    return float((known.model.points @ (up @ one.R)).min() + up @ one.p - table[2]) >= TUNING.floats


def believable(result: RegisteredPose, params: scenario.Registration, R: Array, p: Array) -> bool:
    """Return whether a registration is the object, near where it must be, and not a guess from a few pixels.

    Where the shape is there, as it should be, colours that are not (a dim light, a camera of colours a few pixels
    aside) do not matter; what is elsewhere must look like the object.
    """
    shift = float(np.linalg.norm(result.p - p))
    turn = float(np.linalg.norm(log((result.R @ R.T)[None])))
    stays = shift <= TUNING.stays[1] and turn <= TUNING.stays[0]
    fits = max(result.quality, result.shape if stays else 0.0)
    return bool(
        fits >= params.minimum_quality
        and result.visible_share >= TUNING.least_visible
        and result.points >= TUNING.least_points
        and shift <= TUNING.largest_step[1]
        and turn <= TUNING.largest_step[0]
    )
