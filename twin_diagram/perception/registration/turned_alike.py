"""Weighs a pose against turns of it that leave the shape alike, and remembers how sure it is from image to image.

A bottle's front and back are told apart where a label shows; from its narrow side perhaps not. What one image tells,
it tells again in the next, errors included: odds do not add up over images. An image that tells counts from then on,
and images that contradict it take it back bit by bit; images that hardly tell count by their mean. None tells more than
what it shows differs from turn to turn; see `told_apart`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.alternatives import compare
from twin_diagram.perception.registration.colour_votes import colour_costs
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.registration import RegisteredPose, claimed
from twin_diagram.perception.registration.sunk import sunk_costs
from twin_diagram.perception.registration.told_apart import most_told
from twin_diagram.perception.registration.view import View
from twin_diagram.signals.arrays import Array

Again = Callable[[Array, Array], RegisteredPose | None]
"""Registers the object anew from R (3, 3), p (3,)."""


@dataclass(frozen=True)
class Tuning:
    """Constants, set on `sims/benchmarks/followed_scenes.py`, seeds 0 to 12."""

    certain: float = 0.93
    """Where so much of what fits in shape fits in colour, what was sure before stays so: half of what is right."""

    speaks: float = 0.3
    """Where of no pose more than this share of what fits in shape fits in colour, too, camera or light are others; …"""

    unsaid: float = 1.75
    """… then odds are no shorter than this [nat], 0.62: nothing speaks for another pose either."""

    tells: float = 3.0
    """An image by which a pose is likelier by this tells [nat]: so far all 1,733 of them were right, and 89 % of those
    with 2 to 3; by less, no more than two of three, whatever was said."""

    says: float = 2.0
    """Odds below `tells` fall so much faster than what is told, down to even ones."""

    newest: float = 0.2
    """Share of the newest image in the mean of what images hardly tell."""

    points: int = 150
    """Model points by whose colours a pose is compared with those that it may be mistaken for."""

    rivals: int = 2
    """So many of those are registered and compared."""

    doubted: float = 1.0
    """Small turns are, where their colours are likelier by this as they are laid [nat]."""

    other: float = 0.6
    """A turn by more is another pose [rad]; by less, registration may be off."""

    clear: float = 20.0
    """What is less likely by this as it is laid is not registered [nat]: registered, it comes nearer, by 10 at most."""

    same: float = 0.12
    """What registration brings back to within this is the same pose [rad]."""

    around: float = 0.02
    """Points this near to an object's surface weigh its poses against one another [m]."""

    most: float = 6.0
    """No odds are longer [nat], so that half a dozen images can contradict them."""

    enough: float = 5.0
    """Odds as long need no further rivals registered [nat]: two images told, and each rival costs a registration."""

    most_of_one: float = 3.5
    """No image makes odds longer by more [nat], 0.97: the first after a search may show a pose that is still off."""

    back: float = 0.25
    """Share of what an image says against a pose by which its odds fall."""

    wrong: float = 1.0
    """A pose gives way where odds are as long against it [nat]."""


TUNING = Tuning()


def weighed(model: ModelCloud, view: View, one: RegisteredPose, before: float, again: Again) -> RegisteredPose:
    """Return a pose, or the one that it was mistaken for, with the odds that it is right among its turns.

    Args:
        model: the object.
        view: the image.
        one: the pose.
        before: logarithm of the odds as they were before this image.
        again: registers the object from elsewhere.
    """
    if not len(model.mistaken) or not model.coloured:
        return unweighed(model, one)
    if before >= TUNING.enough and one.quality >= TUNING.certain * one.shape:
        return replace(one, odds=before)
    R = np.concatenate([one.R[None], one.R @ model.mistaken])
    laid = Poses(R, model.kept_in_place(one.R, one.p, R))
    cost = colour_costs(model, view.frame, laid, TUNING.points)
    against = cost - cost[0]
    far = turned(R, one.R) > TUNING.other
    worth = _worth(R, against, far, before < TUNING.enough)
    if before >= TUNING.most and not worth and against[far].min(initial=np.inf) >= 0.0:
        return replace(one, odds=before)  # no image makes them longer, and this one says nothing against it
    most = _most(model, view, laid, against, far, worth)
    found = [(again(laid.R[k], laid.p[k]), most[k]) for k in worth]
    against = np.clip(against, -most, most)
    against[worth] = np.inf
    # A rival that is not registered by bad luck is as likely as the image can tell.
    told = float(np.minimum(against, most)[far].min(initial=np.inf))
    kept = [(x, bound) for x, bound in found if x is not None and turned(x.R, one.R) > TUNING.same]
    others = [replace(x, named=one.named, by_shape=one.by_shape) for x, _ in kept]
    if max(x.quality / max(x.shape, 1e-9) for x in (one, *others)) < TUNING.speaks:
        return replace(one, odds=max(before, TUNING.unsaid))
    if others:
        worse = _worse(model, view, one, others, np.array([bound for _, bound in kept]))
        best = int(np.argmin(worse))
        far_off = np.array([turned(x.R, one.R) > TUNING.other for x in others])
        if worse[best] < -TUNING.wrong and not far_off[best]:
            return replace(others[best], odds=before)
        told = min(told, float(worse[far_off].min(initial=np.inf)))
        odds = after_image(before, told)
        # Odds fall by turns that were not registered, too: those may be likelier as they are laid alone.
        if odds <= -TUNING.wrong and far_off[best] and worse[best] < 0.0:
            return replace(others[best], odds=min(-odds, TUNING.most))
    return replace(one, odds=after_image(before, told))


def unweighed(model: ModelCloud, one: RegisteredPose) -> RegisteredPose:
    """Return a pose with its odds before any image has told: even where it may be mistaken.

    Of what has no colours no image will tell: then each of its turns is as likely.
    """
    if not len(model.mistaken):
        return replace(one, odds=TUNING.most)
    return replace(one, odds=0.0 if model.coloured else -float(np.log(len(model.mistaken))))


def after_image(before: float, told: float) -> float:
    """Return the logarithm of a pose's odds after an image by which it is likelier than its rivals by so much [nat]."""
    if told >= TUNING.tells:
        return min(max(told, before), max(before, 0.0) + TUNING.most_of_one, TUNING.most)
    if before < TUNING.tells:
        return before + TUNING.newest * (max(told, -TUNING.most) - before)
    return before + TUNING.back * min(told, 0.0)


def odds_kept(odds: float, R: Array, other: Array) -> float:
    """Return the odds of a pose turned as R (3, 3), of what was found anew as `other` (3, 3): even another way."""
    return odds if turned(other, R) <= TUNING.other else 0.0


def probability(odds: float) -> float:
    """Return the probability that a pose of such odds is right: what images hardly tell counts as even."""
    if 0.0 < odds < TUNING.tells:
        odds = max(0.0, TUNING.tells - TUNING.says * (TUNING.tells - odds))
    return float(1.0 / (1.0 + np.exp(-odds)))


def turned(R: Array, other: Array) -> Array:
    """Return the angle [rad] between rotations (..., 3, 3) and another."""
    cosine = 0.5 * (np.einsum("...ij,ij->...", R, other) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _worth(R: Array, against: Array, far: npt.NDArray[np.bool_], unsure: bool) -> list[int]:
    """Return the numbers of the rivals that are worth registering: what looks likelier, and the likeliest other way."""
    order = [int(k) for k in np.argsort(against, kind="stable") if k]
    chosen = [k for k in order if against[k] < -TUNING.doubted][: TUNING.rivals]
    for k in order:
        fresh = all(turned(R[k], R[j]) > TUNING.other for j in chosen)
        if unsure and far[k] and fresh and against[k] < TUNING.clear and len(chosen) < TUNING.rivals:
            chosen.append(k)
    return chosen


def _most(
    model: ModelCloud, view: View, laid: Poses, against: Array, far: npt.NDArray[np.bool_], worth: Sequence[int]
) -> Array:
    """Return (B,) what the image can tell of the first of poses and those that are likely; of others, anything.

    Those are what is `worth` registering and is another way round, and the likeliest that is not registered.
    """
    left = np.where(far, against, np.inf)
    left[list(worth)] = np.inf
    asked = [k for k in {*worth, int(np.argmin(left))} if far[k]]
    most = np.full(len(laid.p), np.inf)
    if asked:
        most[asked] = most_told(model, view.frame, laid[np.array([0, *asked])], TUNING.points)[1:]
    return most


def _worse(model: ModelCloud, view: View, one: RegisteredPose, others: Sequence[RegisteredPose], most: Array) -> Array:
    """Return (K,) how much less likely than a registered pose others are, by shape, colours and the table [nat].

    Shape and colours say no more than `most` (K,).
    """
    poses = Poses(np.stack([x.R for x in (one, *others)]), np.stack([x.p for x in (one, *others)]))
    own = claimed(model, view.segments, one.R, one.p, TUNING.around)
    whole = compare(model, view.frame, poses, view.segments.points_W[own], FINE)
    whole += colour_costs(model, view.frame, poses, view.params.model_points)
    sunk = sunk_costs(model.points, poses, view.segments.planes)
    return np.asarray(np.clip(whole[1:] - whole[0], -most, most) + sunk[1:] - sunk[0])
