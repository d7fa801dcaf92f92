"""Tells how probable it is that an object lies as it is shown, within what is claimed of its pose.

Of a small or far thing depth leaves open some centimetre and some degrees. The claim says so, and poses that far from
the one shown are hypotheses, too: of their own, they would count the same doubt a second time. A mug 1.3 m off, right
to 11 mm and 6°, was told at 0.48 for two hypotheses 9 mm aside, where a deviation of 8 mm was claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.assets import symmetry
from twin_diagram.perception.registration.alternatives import PoseHypothesis, share_of_first
from twin_diagram.perception.registration.rotation import log
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, with what set them."""

    inside: float = 12.59
    """Squared error over the claim up to which a pose is within it: χ² of six degrees of freedom, 0.95."""

    turned: float = 0.5
    """What is turned by more is another pose [rad]: 30° are a flip (`sims/benchmarks/followed_scenes.py`)."""

    moved: float = 0.5
    """And what is shifted by more, of the object's radius: then another thing may stand in its place, as of alikes."""

    wide: float = 0.5
    """A claim whose deviation is more than this share of those is of no one pose: a box on a forearm, 30° claimed, was
    40° off (seed 100403)."""

    most: float = 0.75
    """Poses that differ make no pose surer than this: it is known roughly. Claims of 0.9 and more are of poses right
    to some millimetres (`sims/benchmarks/foreign_things.py`)."""


TUNING = Tuning()


def claimed_share(
    hypotheses: Sequence[PoseHypothesis], spread: Array, radius: float, symmetries: tuple[tuple[int, int], ...]
) -> float:
    """Return how probable it is that an object lies as the first of its hypotheses, within what is claimed of it.

    Of a frame that shows it: what was known roughly and is hidden since is no more likely than the pose alone.

    Args:
        hypotheses: whose probabilities sum to 1; the first is shown.
        spread: (6, 6) covariance that is claimed (rotation, translation; W).
        radius: of the object [m].
        symmetries: of the object; see `assets.symmetry.parsed`.
    """
    first, alone = hypotheses[0], share_of_first(hypotheses, symmetries)
    turned, moved = TUNING.turned, TUNING.moved * radius
    free = first.R[:, [axis for axis, count in symmetries if not count]]
    told = np.eye(3) - free @ free.T
    most = np.linalg.eigvalsh([told @ spread[:3, :3] @ told, spread[3:, 3:]])[:, -1]
    if np.any(most > np.square(TUNING.wide * np.array([turned, moved]))):
        return alone
    R = np.stack([one.R for one in hypotheses])
    off = np.stack([one.p for one in hypotheses]) - first.p
    error = np.concatenate([log(R @ first.R.T), off], axis=1)
    near = np.einsum("ni,ni->n", error, np.linalg.solve(spread, error.T).T) <= TUNING.inside
    near &= symmetry.apart(first.R, R, symmetries) <= turned
    near &= np.linalg.norm(off, axis=1) <= moved
    within = float(np.array([one.probability for one in hypotheses])[near].sum())
    return max(alone, min(within, TUNING.most))
