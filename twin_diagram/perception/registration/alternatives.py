"""What else an image allows: poses along the directions that depth leaves open, weighed against one another.

Point-to-plane distances say nothing of slides along a face or turns about an axis; what bounds them are edges: points
of the model beyond the image's edge find nothing, points of the image beyond the model's edge belong to nothing. Both
are counted at poses along each weak direction, as a log-likelihood in which points that err alike share one vote. The
best of them is taken, the spread of the weights is the claim along that direction, and what stands apart is a
hypothesis of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.assets import symmetry
from twin_diagram.perception.depth_noise import TUNING as DEPTH
from twin_diagram.perception.registration.assessment import TUNING as ASSESSMENT
from twin_diagram.perception.registration.claims import colours_alike
from twin_diagram.perception.registration.cloud_kernels import mean_costs
from twin_diagram.perception.registration.data_association import Looked, Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import brightness, colour_terms, depth_pairs
from twin_diagram.perception.registration.rotation import log
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants, set on trials below number 100 000 of `sims/benchmarks/registration_peers.py`."""

    unit: tuple[float, float] = (0.15, 0.02)
    """Turns [rad] and shifts [m] that weigh alike."""

    weak: float = 0.1
    """A direction is weak where depth alone leaves a deviation of so many units."""

    steps: tuple[float, ...] = (0.06, 0.12, 0.2, 0.35, 0.6, 1.0, 1.6)
    """Poses lie so far along a direction, both ways [units]."""

    turns: tuple[float, ...] = (2.5, 3.5, 4.6, 6.0, 7.5, 9.0, 11.0, 13.0, 15.0, 17.0, 19.0, 20.9)
    """And so far where it is a turn: up to half a one."""

    open: float = 0.4
    """A turn of which so many units are left open is tried all round; what colours tell is weighed from here."""

    better: float = 2.0
    """A pose likelier by this is gone to, and registered anew [nat]."""

    rounds: int = 2
    """How often at most."""

    reach: float = 0.007
    """Pairs farther apart are cut, as in the last steps of registration [m]."""

    points: int = 150
    """Model points that are looked up, and image points that are explained."""

    cut: float = 3.0
    """A deviation larger than this is another thing's: it costs no more."""

    placed: float = 4.5
    """A model point is in place within so many deviations."""

    unexplained: float = 0.02
    """An image point farther from the model belongs to something else [m]."""

    hidden: float = 0.15
    """Cost of a point that something else hides, beside 4.5 of one that is not where it should be."""

    edge: float = 0.002
    """Deviation of an edge [m]."""

    colour: float = 0.12
    """Deviation of a colour [of 1]."""

    unpainted: float = 1.2
    """Square of that of a point whose colour no picture showed, at least: what one that is right is off in the mean
    (half-hidden ketchup bottle, D435, training seed 101000); what others of the first pose are, if that is more, …"""

    known: float = 0.3
    """… and these are more than this share of what is in place."""

    fewest: float = 4.0
    """So many points share one vote at least: a cloud leaves out what lies between its points, and so do few pixels."""

    yaws: int = 12
    """Poses about the vertical that one found without a prediction is compared with, itself included."""

    rivals: int = 2
    """So many of the turned poses are registered and compared."""

    likely: float = 0.01
    """What is less probable is no hypothesis."""

    apart: tuple[float, float] = (0.12, 0.008)
    """Hypotheses differ by this [rad], [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class PoseHypothesis:
    """A pose that the image allows, and how probable it is."""

    R: Array
    p: Array
    covariance: Array
    probability: float


def share_of_first(hypotheses: Sequence[PoseHypothesis], symmetries: tuple[tuple[int, int], ...]) -> float:
    """Return how probable the first of poses is, with those that a thing's symmetries make the same.

    Args:
        hypotheses: whose probabilities sum to 1.
        symmetries: of the thing; see `assets.symmetry.parsed`.
    """
    return float(np.array([one.probability for one in hypotheses])[_as_first(hypotheses, symmetries)].sum())


def each_once(
    hypotheses: Sequence[PoseHypothesis], symmetries: tuple[tuple[int, int], ...]
) -> tuple[PoseHypothesis, ...]:
    """Return poses in their order, without those that a thing's symmetries make the same as one before them.

    That one is as probable as all of them together. Without symmetries all are kept.
    """
    if not symmetries:
        return tuple(hypotheses)
    left, kept = list(hypotheses), []
    while left:
        same = _as_first(left, symmetries)
        kept.append(replace(left[0], probability=share_of_first(left, symmetries)))
        left = [one for one, is_same in zip(left, same, strict=True) if not is_same]
    return tuple(kept)


def _as_first(hypotheses: Sequence[PoseHypothesis], symmetries: tuple[tuple[int, int], ...]) -> npt.NDArray[np.bool_]:
    """Return (N,) which poses a thing's symmetries make the same as the first, itself among them."""
    first = hypotheses[0]
    turned = symmetry.apart(first.R, np.stack([one.R for one in hypotheses]), symmetries)
    moved = np.linalg.norm(np.stack([one.p for one in hypotheses]) - first.p, axis=1)
    same = (turned < TUNING.apart[0]) & (moved < TUNING.apart[1])
    same[0] = True
    return np.asarray(same)


def votes(looked: Looked, frame: Frame, spacing: float) -> float:
    """Return how many model points share one vote: those whose depth errs as one, and no fewer than `fewest`."""
    noise = frame.camera.depth_noise
    if noise.correlated + noise.lasting <= 0.0:
        return TUNING.fewest
    z = float(np.median(looked.z[0]))
    patch = 4.0 * np.pi * (DEPTH.patch * frame.camera.width / DEPTH.width) ** 2
    points = max(1.0, float(looked.counted[0].sum()))
    area = float((looked.facing[0].clip(0.0) * looked.counted[0]).sum()) * (spacing * frame.camera.fx / z) ** 2
    return max(TUNING.fewest, patch * points / max(area, 1.0))


def in_place(looked: Looked, frame: Frame) -> npt.NDArray[np.bool_]:
    """Return (B, P) whether the image shows a model point where it is, as closely as depth can tell."""
    sigma = np.hypot(frame.camera.depth_noise(looked.z) * looked.facing.clip(0.3), RESIDUALS.model_noise)
    on = looked.near & (np.abs(looked.deeper) < ASSESSMENT.same_surface)
    return np.asarray(on & (np.abs(looked.distance) < TUNING.placed * sigma))


def colours_missed(looked: Looked, frame: Frame, weight: Array, level: int) -> tuple[Array, Array]:
    """Return (B, P, 3) by what colours miss the model's, and those (B, P, 3) in the light fitted where `weight` is.

    Nothing is missed of a model without colours.
    """
    if not looked.coloured:
        return np.zeros(looked.colour.shape), looked.colour
    found = frame.plain_colour_at(looked.u, looked.v, level)
    gain = brightness(found, looked.colour, looked.n, weight * looked.painted)[..., None]
    lit = np.minimum(looked.colour * gain, 1.0)
    return np.asarray((found - lit) / np.maximum(gain, 0.2)), np.asarray(lit)


def colours_off(looked: Looked, frame: Frame, weight: Array, level: int) -> Array:
    """Return (B, P) how far colours are from the model's in the light that is fitted where `weight` (B, P) is not 0."""
    missed, _ = colours_missed(looked, frame, weight, level)
    return np.asarray(np.sqrt(np.einsum("bpi,bpi->bp", missed, missed)))


def costs(model: ModelCloud, frame: Frame, poses: Poses, points_W: Array, looked: Looked, level: int = COARSE) -> Array:
    """Return (B,) the negative log-likelihood of an image at poses, each point a vote.

    Args:
        model: the object.
        frame: the image.
        poses: B of them.
        points_W: (N, 3) the image's points that should be the object's.
        looked: up at the poses on colours of that level.
        level: of colours.
    """
    # How well each fits is the image's points' to say: those are the same at all poses, the model's are not.
    placed = in_place(looked, frame)
    colour = np.minimum(colours_off(looked, frame, looked.facing * placed, level) / TUNING.colour, TUNING.cut)
    each = np.where(placed, 0.25 * np.where(looked.painted, colour**2, _unpainted(looked, placed, colour)), 0.0)
    hidden = looked.seen & ~placed & (looked.deeper < 0) & ~looked.buried
    behind = looked.seen & ~placed & ~hidden
    each = each + 0.5 * TUNING.cut**2 * behind + TUNING.hidden * hidden
    shown = (looked.facing * looked.counted).clip(0.0)
    total = (each * shown).sum(axis=1) / np.maximum(shown.sum(axis=1), 1e-9) * looked.counted.sum(axis=1)
    return np.asarray(total + _unexplained(model, frame, poses, points_W) * looked.counted.sum(axis=1))


def _unpainted(looked: Looked, placed: npt.NDArray[np.bool_], colour: Array) -> float:
    """Return the square of how far colours that no picture showed count as off: as others of the first pose are.

    Args:
        looked: up at poses.
        placed: (B, P) which points are in place.
        colour: (B, P) by how many deviations colours are off.
    """
    if not looked.coloured or looked.painted[0].all():
        return TUNING.unpainted
    shown = looked.facing[0].clip(0.0) * placed[0]
    known = shown * looked.painted[0]
    if known.sum() <= TUNING.known * shown.sum():
        return TUNING.unpainted
    return max(TUNING.unpainted, float(known @ colour[0] ** 2 / known.sum()))


def _unexplained(model: ModelCloud, frame: Frame, poses: Poses, points_W: Array) -> Array:
    """Return (B,) the mean cost of the image's points: how far they are from the model, for its spacing."""
    z = (points_W - frame.camera.p_WC) @ frame.camera.R_WC[:, 2]
    sigma = np.hypot(frame.camera.depth_noise(z), RESIDUALS.model_noise)
    cuts = (TUNING.unexplained, 0.5 * model.spacing, TUNING.edge, TUNING.cut)
    R, p = one_layout(poses.R), one_layout(poses.p)
    return mean_costs(one_layout(points_W), R, p, sigma, model.cloud, cuts)


def weak_directions(looked: Looked, frame: Frame, votes_each: float, colour_share: float) -> list[tuple[Array, float]]:
    """Return directions (6,) [units of `Tuning.unit`] that depth and colour leave open, with the deviation left."""
    J, w, _ = depth_pairs(looked, frame, TUNING.reach)
    scale = np.repeat(TUNING.unit, 3)
    both = scale[:, None] * scale
    H = (J[0] * w[0][:, None]).T @ J[0] / votes_each * both
    Hc = np.zeros((6, 6))
    if colour_share > 0.0 and looked.coloured:
        colours = colour_terms(looked, frame, FINE, TUNING.reach, colour_share).without_shift(frame.shift)
        Hc = colours.H[0] / colours_alike(colour_share) * both
    values, ways = np.linalg.eigh(H + Hc)
    deviation = 1.0 / np.sqrt(np.maximum(values, 1e-6))
    found = []
    for k in range(3):
        way = ways[:, k]
        # What colours tell, a registration has seen more finely than is weighed here.
        most = TUNING.open if way @ Hc @ way > 0.5 * values[k] else TUNING.weak
        if deviation[k] > most:
            found.append((way, float(deviation[k])))
    return found


@dataclass(frozen=True)
class Profile:
    """Poses along weak directions.

    Attributes:
        poses: B of them, the first is where it began.
        cost: (B,) negative log-likelihoods.
        along: (B,) which direction; -1: none.
        offset: (B,) how far [units].
        directions: (6,) each, in radians and metres per unit.
    """

    poses: Poses
    cost: Array
    along: Array
    offset: Array
    directions: list[Array]


def profile(
    model: ModelCloud, frame: Frame, pose: Poses, points_W: Array, fine: Looked, colour_share: float
) -> Profile:
    """Weigh poses along the weak directions of one that was registered, `fine` being looked up there."""
    share = votes(fine, frame, model.spacing)
    scale = np.repeat(TUNING.unit, 3)
    steps, along, offset, directions = [np.zeros(6)], [-1], [0.0], []
    for k, (way, deviation) in enumerate(weak_directions(fine, frame, share, colour_share)):
        far = TUNING.steps
        if np.linalg.norm(way[:3]) > 0.9 and deviation > TUNING.open:
            far = far + TUNING.turns
        directions.append(way * scale)
        for s in (*(-x for x in reversed(far)), *far):
            steps.append(s * way * scale)
            along.append(k)
            offset.append(s)
    count = len(steps)
    poses = Poses(np.repeat(pose.R, count, axis=0), np.repeat(pose.p, count, axis=0)).moved(np.array(steps))
    cost = compare(model, frame, poses, points_W)
    return Profile(poses, cost, np.array(along), np.array(offset), directions)


def weights(cost: Array, offset: Array) -> Array:
    """Return (K,) probabilities of offsets, in order, each standing for the cell half way to its neighbours."""
    edges = np.concatenate([offset[:1], 0.5 * (offset[1:] + offset[:-1]), offset[-1:]])
    w = np.exp(-np.clip(cost - cost.min(), 0.0, 50.0)) * np.diff(edges)
    return np.asarray(w / w.sum())


def settled(found: Profile) -> tuple[Array, Array]:
    """Return the step (6,) to the mean of a profile, and the covariance (6, 6) of what lies along it."""
    step, spread = np.zeros(6), np.zeros((6, 6))
    for k, way in enumerate(found.directions):
        on = (found.along == k) | (found.along == -1)
        order = np.argsort(found.offset[on])
        offset, cost = found.offset[on][order], found.cost[on][order]
        w = weights(cost, offset)
        mean = float(w @ offset)
        step += mean * way
        spread += float(w @ (offset - mean) ** 2) * np.outer(way, way)
    return step, spread


def compare(model: ModelCloud, frame: Frame, poses: Poses, points_W: Array, level: int = COARSE) -> Array:
    """Return (B,) negative log-likelihoods of poses, up to what all share, points that err alike with one vote.

    Of poses that were registered, fine colours tell more: coarse ones forgive what lies a centimetre aside.
    """
    looked = look(model, frame, poses, TUNING.points, level)
    thin = points_W[:: max(1, len(points_W) // TUNING.points)]
    return costs(model, frame, poses, thin, looked, level) / votes(looked, frame, model.spacing)


def distinct(found: Profile, centre: Poses, narrow: Array, wide: Array) -> tuple[PoseHypothesis, ...]:
    """Return the centre of a profile and its poses that are likely and apart from one another, the likeliest first.

    Args:
        found: the profile.
        centre: of all of it; it stands for what is near.
        narrow: (6, 6) covariance of a registered pose.
        wide: (6, 6) covariance with what lies along the profile.
    """
    between = narrow + np.diag(np.square(np.repeat(TUNING.apart, 3) / 2.0))
    poses = Poses(np.concatenate([centre.R, found.poses.R[1:]]), np.concatenate([centre.p, found.poses.p[1:]]))
    ratio, likely = beside_centre(found, np.array([k == 0 or not _apart(poses, k, 0) for k in range(len(found.cost))]))
    chosen, mass = [0], [1.0]
    for number in np.argsort(-ratio[1:], kind="stable") + 1:
        k = int(number)
        near = [j for j, one in enumerate(chosen) if not _apart(poses, k, one)]
        if near:
            mass[near[0]] += float(ratio[k])
        elif likely[k]:
            chosen.append(k)
            mass.append(float(ratio[k]))
    whole = sum(mass)
    order = [0, *sorted(range(1, len(chosen)), key=lambda j: -mass[j])]
    return tuple(
        PoseHypothesis(poses.R[chosen[j]], poses.p[chosen[j]], between if j else wide, mass[j] / whole) for j in order
    )


def beside_centre(found: Profile, near: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return (K,) how much likelier each pose of a profile is than its centre and what is near it, and what counts.

    What is left open along one direction says nothing of another: a pose off along one of them is as probable as what
    is near the centre along all others. Each direction has a say of its own, so, and the widest does not drown.

    Args:
        found: the profile.
        near: (K,) which poses the centre stands for; their ratio is 0, as it is counted already.
    """
    ratio, likely = np.zeros(len(found.cost)), np.zeros(len(found.cost), dtype=bool)
    for k in range(len(found.directions)):
        on = np.flatnonzero((found.along == k) | (found.along == -1))
        on = on[np.argsort(found.offset[on])]
        share = weights(found.cost[on], found.offset[on])
        ratio[on] = np.where(near[on], 0.0, share / max(float(share[near[on]].sum()), 1e-6))
        likely[on] = share > TUNING.likely
    return ratio, likely


def _apart(poses: Poses, first: int, second: int) -> bool:
    turn = np.linalg.norm(log((poses.R[first] @ poses.R[second].T)[None]))
    return bool(turn > TUNING.apart[0] or np.linalg.norm(poses.p[first] - poses.p[second]) > TUNING.apart[1])


def widened(covariance: Array, spread: Array) -> Array:
    """Return a covariance (6, 6) that claims along each direction of `spread` (6, 6) no less than that does."""
    values, ways = np.linalg.eigh(spread)
    result = covariance.copy()
    for value, way in zip(values, ways.T, strict=True):
        if value > 0.0:
            already = 1.0 / float(way @ np.linalg.solve(result, way))
            result += max(0.0, value - already) * np.outer(way, way)
    return np.asarray(0.5 * (result + result.T))
