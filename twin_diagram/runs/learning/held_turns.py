"""Tells how the tool may lean with what it holds: where the weight pulls beside the pads it turns between them.

What hangs far below the pads, as a bottle held at its neck, is a pendulum about the axis through them: leaning along
that axis asks nothing of their friction, leaning across it all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from twin_diagram.estimation.weighing.grip import Grip
from twin_diagram.runs.learning.felt_weight import Centre
from twin_diagram.runs.learning.motion import pose
from twin_diagram.runs.learning.weighing import TUNING as WEIGHING
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    friction: float = 0.4
    """Between pads and what they hold that is counted on: the least that things are said to have."""

    share: float = 0.4
    """Of what pads that touch all over carry by that, which is asked for: what is round or tapered they touch along a
    strip, and a load may lie a quarter of the size off the middle. A bottle of 0.96 kg, held where it is round, turns
    from half on."""

    least: float = 0.35
    """Shorter parts of a turn are left out [rad]: a patch is to be seen in two pictures."""

    parts: int = 2
    """Of a turn that is not held all along: what leans along the pads' axis is so twice a turn."""

    more: float = 0.5
    """Share of what may be asked that the gentlest parts may take beyond it where no part is held: a box of 1.45 kg
    turned from 1.8 on."""


TUNING = Tuning()


@dataclass(frozen=True)
class Weight:
    """What is known of the weight of what is held.

    Attributes:
        mass: [kg].
        centre_T: (3,) its centre in the tool's frame [m].
        grip: that holds it, with the share of it that may be asked for.
        felt: whether the turns of an earlier display told where it pulls; else it is taken to be in the middle.
    """

    mass: float
    centre_T: Array
    grip: Grip
    felt: bool = False

    @staticmethod
    def of(mass: float, centre_T: Array, force: float, *, felt: bool) -> Weight:
        """Return it of what both pads press with a force [N] each, all over."""
        low, high = WEIGHING.pad
        centre = (0.0, 0.0, 0.5 * (low + high))
        grip = Grip(force, TUNING.friction, 2.0 * WEIGHING.pad_half, high - low, centre, TUNING.share)
        return Weight(mass, np.asarray(centre_T, dtype=float), grip, felt)

    @staticmethod
    def of_lying(mass: float, force: float, points: Array, support: float, X_WT: Array) -> Weight:
        """Return it of what was just taken, which counts as full down to what it lay upon.

        Args:
            mass: [kg].
            force: with which each pad presses [N].
            points: (N, 3) of it in W, as it lay [m].
            support: height of what it lay upon [m].
            X_WT: (4, 4) of the tool when the fingers shut.
        """
        under = np.column_stack([points[:, :2], np.full(len(points), support)])
        centre_T = middle((np.vstack([points, under]) - X_WT[:3, 3]) @ X_WT[:3, :3])
        return Weight.of(mass, centre_T, force, felt=False)

    def seen(self, points_T: Array) -> Weight:
        """Return it as far as points (N, 3) of what is held tell, in the tool's frame: felt, or in their middle [m]."""
        if self.felt or not len(points_T):
            return self
        return replace(self, centre_T=middle(points_T))

    def use(self, R_WT: Array) -> Array:
        """Return the share (K,) of what may be asked of the grip that the weight takes in the tool's axes (K, 3, 3)."""
        force = -9.81 * self.mass * R_WT[:, 2]
        moment = np.cross(self.centre_T - np.array(self.grip.centre), force)
        return self.grip.use(np.concatenate([force, moment], axis=1))

    def asked(self, R_WT: Array) -> Array:
        """Return the share (K,) as `use` does, where it is only guessed for the worse side of the pads to pull to.

        What hangs beside the pads in a guess alone would else be leant to where that, and not the weight, hangs lower.
        """
        there = self.use(R_WT)
        return (
            there
            if self.felt
            else np.maximum(there, replace(self, centre_T=self.centre_T * [-1.0, 1.0, 1.0]).use(R_WT))
        )

    def held_all_round(self, R_WT: Array) -> bool:
        """Return whether it is held in the tool's axes (3, 3), and turned about its own z axis by any angle.

        What was felt counts as held: parts of the turn that hold it are known.
        """
        turns = Rotation.from_rotvec(np.outer(np.linspace(0.0, 2.0 * np.pi, 60), [0.0, 0.0, 1.0])).as_matrix()
        return self.felt or bool((self.asked(R_WT @ turns) <= 1.0).all())

    def turned_by(self, R_WT: Array) -> float:
        """Return by how much it has turned about the pads' axis in the tool's axes (3, 3) [rad]; see `about_pads`.

        What the pads hold has not. What asks for more hangs below them, or may: a box of 1.45 kg, taken at its end as
        it lay on others, turned by 60° as it was lifted.
        """
        if float(self.use(R_WT[None])[0]) <= 1.0:
            return 0.0
        down, arm = R_WT.T @ [0.0, 0.0, -1.0], self.centre_T - np.array(self.grip.centre)
        turn = float(np.arctan2(down[0], down[2]) - np.arctan2(arm[0], arm[2]))
        return float(np.arctan2(np.sin(turn), np.cos(turn)))


def about_pads(turn: float) -> Array:
    """Return the turn (4, 4) of what is held by an angle about the axis through both pads [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    centre = np.array([0.0, 0.0, 0.5 * sum(WEIGHING.pad)])
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return pose(R, centre - R @ centre)


def middle(points: Array) -> Array:
    """Return the middle (3,) of the box about points (N, 3)."""
    return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))


def parts_of(held: npt.NDArray[np.bool_], at: Array, most: int = TUNING.parts) -> list[tuple[float, float]]:
    """Return from where to where a turn is held, at most some parts of it, the longest first.

    Args:
        held: (K,) whether it is at angles of the last joint.
        at: (K,) those, ascending [rad].
        most: parts.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    found = [(float(at[begin]), float(at[end - 1])) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
    long = [part for part in found if part[1] - part[0] >= TUNING.least]
    return sorted(long, key=lambda part: part[0] - part[1])[:most]


def gentlest_parts(asked: Array, at: Array, most: float, parts: int = TUNING.parts) -> list[tuple[float, float]]:
    """Return from where to where a turn asks least of the grip: parts as short as they may be, the gentlest first.

    Args:
        asked: (K,) of the grip at angles of the last joint.
        at: (K,) those, ascending and even [rad].
        most: that may be asked in them.
        parts: at most.
    """
    wide = 1 + int(np.ceil(TUNING.least / float(at[1] - at[0])))
    if wide > len(at):
        return []
    worst = np.lib.stride_tricks.sliding_window_view(asked, wide).max(axis=1)
    found: list[int] = []
    for k in np.argsort(worst, kind="stable"):
        if len(found) < parts and worst[k] <= most and all(abs(int(k) - other) >= wide for other in found):
            found.append(int(k))
    return [(float(at[k]), float(at[k + wide - 1])) for k in found]


def gentlest_first(tilts: Sequence[float]) -> tuple[float, ...]:
    """Return tilts [rad] by how far they lean: what a first one shows tells whether a further one holds."""
    return tuple(sorted(tilts, key=abs))


def weight_felt(mass: float | None, centre: Centre | None, X_ST: Array, force: float) -> Weight | None:
    """Return what is known of the weight of what was shown before; None: nobody felt it.

    Args:
        mass: [kg].
        centre: where its weight pulls, in S.
        X_ST: (4, 4) of the tool.
        force: with which each pad presses [N].
    """
    if mass is None or centre is None:
        return None
    X_TS = np.linalg.inv(X_ST)
    return Weight.of(mass, X_TS[:3, :3] @ centre.mean + X_TS[:3, 3], force, felt=True)
