"""Grasps of an object for a gripper: proposed, and ranked; learned proposers plug in between.

Example:
    >>> from twin_diagram.planning.grasps import PANDA_HAND, propose
    >>> grasps = propose(points, normals, PANDA_HAND, count=10, seed=0)  # doctest: +SKIP
    >>> grasps.poses[0], grasps.score[0]  # X_OG of the best; or grasps.why_empty()  # doctest: +SKIP
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from twin_diagram.planning.grasps import cost
from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.hidden_sides import with_hidden_sides
from twin_diagram.planning.grasps.judging import REASONS, Judged, judge, success_over_poses
from twin_diagram.planning.grasps.judging import TUNING as JUDGING
from twin_diagram.planning.grasps.search import grid, refine, stacked, taken
from twin_diagram.planning.grasps.slab import Flags
from twin_diagram.planning.grasps.surface_frames import Indices
from twin_diagram.planning.grasps.target import GraspError, GraspTarget, target_of
from twin_diagram.planning.grasps.triangles import LaidOut, laid_out, meets_triangles, surface_cloud
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

Reachable = Callable[[Array], bool]
"""Whether an arm can go through poses X_WG (S, 7) of its tool frame: the whole approach, the grasp last."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    apart: float = 0.010
    """Grasps whose middles are nearer than this and whose axes agree are one [m]: a pad's half."""

    turned: float = 15.0
    """Axes that differ by less agree [deg]."""

    attempts: int = 4
    """Times that points are sampled anew, at the most, while grasps lack: rims and handles are little of a surface.
    Every other time at edges, of what is seen whole."""

    looked_closer: float = 1.4
    """Of each grasp that is asked for, so many candidates are compared with the mesh at once: few of them cut it."""

    looked_closer_uncertain: float = 3.0
    """The same where samples of the object's pose may put them into another order."""

    batches: int = 10
    """Of so many, one after another while grasps lack, at the most."""

    fine_points: int = 20000
    """Of a mesh's cloud that chosen poses are judged on again: 2 mm apart on a mug."""

    samples: int = 24
    """Samples of the object's pose."""

    approach_poses: int = 6
    """At which the approach is asked for."""


TUNING = Tuning()


@dataclass(frozen=True)
class Grasps:
    """Grasps of one object, the best first.

    Attributes:
        poses: (m, 7) X_OG of the gripper's tool frame as (qw, qx, qy, qz, px, py, pz): z along the approach, y along
            the closing axis.
        width: (m,) between the contacts [m]; where one is hidden, of what is seen.
        score: (m,) cost, ascending; lower is better.
        terms: (m,) of the cost, by name.
        contacts: (m, 2, 3) in O [m], at the pad of positive y first; NaN where the cloud does not show it.
        reasons: why other candidates are none, each with their number.
    """

    poses: Array
    width: Array
    score: Array
    terms: dict[str, Array]
    contacts: Array
    reasons: dict[str, int]

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.score)

    @property
    def R(self) -> Array:
        """(m, 3, 3) the gripper's axes in O, as columns."""
        return rotations.matrix(self.poses[:, :4])

    @property
    def approach(self) -> Array:
        """(m, 3) unit directions in O in which the gripper comes."""
        return self.R[:, :, 2]

    @property
    def seen(self) -> Flags:
        """(m, 2) which contacts the cloud shows."""
        return np.asarray(np.isfinite(self.contacts).all(axis=2))

    def why_empty(self) -> str:
        """Return in words why there is none, the most frequent reason first; "" where there are some."""
        if len(self) or not self.reasons:
            return "" if len(self) else "nothing was tried"
        # What is told first is what stood in the way of candidates that were right in all else.
        weight = {"in collision": 1, "outside of the friction cone": 2, "met beside the pads": 2, "too wide": 3}
        weight |= {"too thin": 3, "into the table": 3, "both contacts hidden": 4, "too heavy": 5, "out of reach": 6}
        every = sorted(self.reasons.items(), key=lambda one: (weight.get(one[0], 0), one[1]), reverse=True)
        return ", ".join(f"{reason} ({count} candidates)" for reason, count in every)


class GraspProposer(Protocol):
    """What proposes grasps: the search here, or a network (GraspGen, Contact-GraspNet) behind the same call.

    What it gives is not believed: `rank` judges and scores it again.
    """

    def propose(self, points: Array, normals: Array, gripper: Gripper) -> Grasps:
        """Return grasps X_OG of an object; scores are the proposer's own.

        Args:
            points: (N, 3) in O, in random order [m].
            normals: (N, 3) outward, of length 1.
            gripper: what is to hold it.
        """
        ...


@dataclass(frozen=True)
class AntipodalProposer:
    """The search of this package as a proposer: as `propose`, with a count and a seed."""

    count: int = 10
    seed: int = 0

    def propose(self, points: Array, normals: Array, gripper: Gripper) -> Grasps:
        """See `GraspProposer.propose`."""
        return propose(points, normals, gripper, count=self.count, seed=self.seed)


def given_poses(poses: Array) -> Grasps:
    """Return poses X_OG (m, 7) from elsewhere as grasps without a score, for `rank`."""
    poses = np.asarray(poses, dtype=float).reshape(-1, 7)
    none = np.full(len(poses), np.nan)
    return Grasps(poses, none, none, {}, np.full((len(poses), 2, 3), np.nan), {})


@dataclass(frozen=True)
class Wanted:
    """What is asked of a ranking.

    Attributes:
        count: of grasps.
        seed: of all draws.
        triangles: (F, 3, 3) the object's surface, which the gripper does not cut [m]; None: the cloud is all there is.
        covariance: (6, 6) of the object's pose; see `success_over_poses`; None: certain.
        pose: X_WO (7,); None: O is W.
        reachable: whether an arm can; None: anywhere.
        guess: whether the sides of what one camera saw are guessed, see `hidden_sides`; else a finger only needs some
            room beyond what is seen, and what is thin may be the side of something thick.
    """

    count: int = 10
    seed: int = 0
    triangles: Array | None = None
    covariance: Array | None = None
    pose: Array | None = None
    reachable: Reachable | None = None
    guess: bool = True

    def __post_init__(self) -> None:
        """Refuse what cannot be asked."""
        if self.count < 1:
            raise GraspError(f"count {self.count}: at least one grasp is asked for")
        if self.seed < 0:
            raise GraspError(f"seed {self.seed}: must not be negative")
        if self.covariance is not None:
            given = np.asarray(self.covariance)
            if given.shape != (6, 6) or not np.isfinite(given).all() or np.linalg.eigvalsh(given)[0] < -1e-9:
                raise GraspError("covariance: must be finite, (6, 6), and without negative variances")

    @cached_property
    def laid_out(self) -> LaidOut:
        """The triangles, laid out once for all batches of candidates."""
        assert self.triangles is not None
        return laid_out(self.triangles)

    def whole(self, target: GraspTarget) -> GraspTarget:
        """Return what was seen of an object with what is guessed of the rest."""
        return with_hidden_sides(target, self.seed) if self.guess and target.viewpoint is not None else target

    def cloud(self, count: int) -> tuple[Array, Array]:
        """Return points (count, 3) on the triangles and the normals there: the same each time, made once."""
        if count not in self._clouds:
            assert self.triangles is not None
            self._clouds[count] = surface_cloud(self.triangles, count, self.seed)
        return self._clouds[count]

    @cached_property
    def _clouds(self) -> dict[int, tuple[Array, Array]]:
        return {}


def propose(
    points: Array,
    normals: Array,
    gripper: Gripper,
    *,
    wanted: Wanted | None = None,
    count: int = 10,
    seed: int = 0,
    **told: Array | float | None,
) -> Grasps:
    """Return the best grasps of an object that a cloud shows.

    Args:
        points: (N, 3) in O, in random order [m].
        normals: (N, 3) outward.
        gripper: what is to hold it.
        wanted: all that is asked, in place of the next two.
        count: how many.
        seed: of all draws: the same gives the same bits.
        **told: what else is known of the object: `viewpoint`, `table`, `surroundings`, `mass`, `centre`, `up`, as of
            `target_of`.

    Raises:
        GraspError: what is given cannot be; that nothing can be held is no error but an empty list with its reasons.
    """
    target = target_of(points, normals, **told)  # type: ignore[arg-type]
    return propose_for(target, gripper, wanted or Wanted(count, seed))


def propose_for(target: GraspTarget, gripper: Gripper, wanted: Wanted) -> Grasps:
    """Return the best grasps of an object; arguments as of `propose`."""
    target, rng = wanted.whole(target), np.random.default_rng(wanted.seed)
    reasons: Counter[str] = Counter()
    every: list[Judged] = []
    for attempt in range(TUNING.attempts):
        seen = target.sparser() if attempt == 0 else target
        found, of = grid(seen, gripper, rng, edges=attempt % 2 == 1 and target.viewpoint is None)
        refined = refine(seen, gripper, found, of)
        for part in (found, *refined):
            reasons.update(_counted(part))
        every += refined or [found]
        grasps = _ranked(seen, gripper, stacked(every), wanted, reasons)
        if len(grasps) == wanted.count:
            break
    return grasps


def rank(grasps: Grasps, target: GraspTarget, gripper: Gripper, wanted: Wanted | None = None) -> Grasps:
    """Return the grasps of a list that hold, scored anew and the best first; those that do not are counted.

    Args:
        grasps: from anywhere; their poses alone are read.
        target: the object; see `target_of`.
        gripper: that they are for.
        wanted: what is asked; None: as many as there are.
    """
    wanted = wanted or Wanted(max(len(grasps), 1))
    target = wanted.whole(target)
    found = judge(target, gripper, grasps.R, grasps.poses[:, 4:])
    return _ranked(target, gripper, found, wanted, Counter(_counted(found)))


def _counted(found: Judged) -> dict[str, int]:
    """Return how many poses are no grasps, by reason."""
    numbers = np.bincount(found.code, minlength=len(REASONS))
    return {reason: int(n) for reason, n in zip(REASONS[1:], numbers[1:], strict=True) if n}


def _ranked(target: GraspTarget, gripper: Gripper, found: Judged, wanted: Wanted, counted: Counter[str]) -> Grasps:
    """Return the best of poses that were judged, none like another, each looked at closer."""
    reasons = Counter(counted)
    order = np.argsort(found.score, kind="stable")
    order = order[np.isfinite(found.score[order])]
    share = TUNING.looked_closer if wanted.covariance is None else TUNING.looked_closer_uncertain
    step = int(np.ceil(share * wanted.count))
    order = _different(found, order, TUNING.batches * step)
    chosen: list[Judged] = []
    for start in range(0, len(order), step):
        part = _looked_closer(target, gripper, taken(found, order[start : start + step]), wanted, reasons)
        for one in np.argsort(part.score, kind="stable"):
            if len(chosen) < wanted.count and _is_reached(part, int(one), wanted, reasons):
                chosen.append(taken(part, np.array([one])))
        if len(chosen) >= wanted.count:
            break
    return _grasps(stacked(chosen) if chosen else taken(found, order[:0]), reasons)


def _looked_closer(
    target: GraspTarget, gripper: Gripper, part: Judged, wanted: Wanted, reasons: Counter[str]
) -> Judged:
    """Return those of some poses that hold on the mesh as well, with what samples of the object's pose cost them."""
    if wanted.triangles is not None:
        low, high = gripper.boxes(retreat=JUDGING.retreat)
        cut = meets_triangles(wanted.laid_out, part.R, part.p, low, high)
        reasons["in collision"] += int(cut.sum())
        # The search's points have gaps as wide as a handle; of so few poses, many points can be looked at.
        points, normals = wanted.cloud(target.enough(TUNING.fine_points))
        others = slice(target.own, None)
        fine = replace(
            target,
            points=np.concatenate([points, target.points[others]]),
            normals=np.concatenate([normals, target.normals[others]]),
            own=len(points),
        )
        part = judge(fine, gripper, part.R[~cut], part.p[~cut])
        reasons.update(_counted(part))
        part = taken(part, np.flatnonzero(part.code == 0))
    if wanted.covariance is not None:
        misses = cost.TUNING.misses * (1.0 - _success(target, gripper, part, wanted))
        part = replace(part, terms={**part.terms, "misses": misses})
    return part


def _success(target: GraspTarget, gripper: Gripper, part: Judged, wanted: Wanted) -> Array:
    assert wanted.covariance is not None
    pose = np.array([1.0, 0, 0, 0, 0, 0, 0]) if wanted.pose is None else wanted.pose
    return success_over_poses(
        target, gripper, part.R, part.p, np.asarray(wanted.covariance), pose, TUNING.samples, wanted.seed
    )


def _grasps(found: Judged, reasons: Counter[str]) -> Grasps:
    """Return poses as grasps, by ascending score."""
    found = taken(found, np.argsort(found.score, kind="stable"))
    contacts = found.p[:, None] + np.einsum("kij,ksj->ksi", found.R, found.closing.contact)
    contacts[~found.seen] = np.nan
    quaternions = np.array([rotations.normalized(rotations.from_matrix(one)) for one in found.R]).reshape(-1, 4)
    return Grasps(
        np.concatenate([quaternions, found.p], axis=1),
        found.closing.width,
        found.score,
        found.terms,
        contacts,
        {reason: count for reason, count in sorted(reasons.items()) if count},
    )


def _different(found: Judged, order: Indices, most: int) -> Indices:
    """Return those of an order that are like none before them, at the most so many.

    Half a turn about the approach changes nothing.
    """
    held = found.closing.contact[order].mean(axis=1)
    middle = found.p[order] + np.einsum("kij,kj->ki", found.R[order], held)
    y, z = found.R[order][:, :, 1], found.R[order][:, :, 2]
    limit = np.cos(np.deg2rad(TUNING.turned))
    left = np.arange(len(order))
    kept: list[int] = []
    while len(left) and len(kept) < most:
        one = int(left[0])
        kept.append(one)
        alike = np.linalg.norm(middle[left] - middle[one], axis=1) < TUNING.apart
        alike &= (np.abs(y[left] @ y[one]) > limit) & (z[left] @ z[one] > limit)
        left = left[~alike]
    return order[np.array(kept, dtype=np.intp)]


def approach_poses(pose: Array, retreat: float, count: int) -> Array:
    """Return the straight way (count, 7) to a pose (7,) from `retreat` [m] before it along z; the pose is the last."""
    back = np.linspace(retreat, 0.0, count)[:, None]
    way = np.tile(pose, (count, 1))
    way[:, 4:] -= back * rotations.matrix(pose[:4])[:, 2]
    return way


def _is_reached(found: Judged, one: int, wanted: Wanted, reasons: Counter[str]) -> bool:
    """Return whether the arm can go the whole approach of a grasp, and count it where it cannot."""
    if wanted.reachable is None:
        return True
    pose = np.array([1.0, 0, 0, 0, 0, 0, 0]) if wanted.pose is None else np.asarray(wanted.pose)
    R_WO = rotations.matrix(pose[:4])
    q = rotations.normalized(rotations.from_matrix(R_WO @ found.R[one]))
    X_WG = np.concatenate([q, R_WO @ found.p[one] + pose[4:]])
    if wanted.reachable(approach_poses(X_WG, JUDGING.retreat, TUNING.approach_poses)):
        return True
    reasons["out of reach"] += 1
    return False
