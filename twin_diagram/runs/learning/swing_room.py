"""Where in the cell there is room to swing what is held: postures of the arm high over everything."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.weighing import Excitation, WeighingError
from twin_diagram.estimation.weighing.excitation import NotClear
from twin_diagram.runs.learning.motion import Mover, pointing, pose
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    places: tuple[tuple[float, float, float], ...] = ((0.45, 0.0, 0.55), (0.5, 0.0, 0.5), (0.4, 0.0, 0.6))
    """Of the finger tips about which it is swung [m]."""

    apart: float = 0.2
    """Postures in which no joint is farther off than this are alike [rad]."""

    most: int = 3
    """Postures about which a motion is looked for: one takes up to a minute of a core, a further grasp for want of one
    half a minute of the cell and more of a core."""

    feeble: float = 0.5
    """Share of speeds, accelerations or torques of which a motion takes more where nothing hems it in: of seven motions
    of four objects six took 0.66 to 0.9. A large box's, found in a corner of what may be, took 0.44, and told its worst
    moment to 26 %, about other postures to 12 and 13."""


TUNING = Tuning()


def goals_for_swinging(mover: Mover, q: Array) -> Iterator[Array]:
    """Yield joint angles (G, n) of each place that are clear, the nearest to some (n,) first, where there are any."""
    for place in TUNING.places:
        X_WT = pose(pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])), np.array(place))
        goals = mover.goals(X_WT, q)
        if len(goals):
            yield goals


def postures_for_swinging(mover: Mover, q: Array) -> Iterator[Array]:
    """Yield postures (n,) to swing it about: that in which the arm is (n,), then others, unlike each other."""
    told = [q]
    yield q
    for goals in goals_for_swinging(mover, q):
        for goal in goals:
            if len(told) < TUNING.most and all(np.abs(goal - other).max() > TUNING.apart for other in told):
                told.append(goal)
                yield goal
                break


def first_with_room(mover: Mover, q: Array, search: Callable[[Array], Excitation]) -> Excitation:
    """Return the motion that a search finds about the first posture that leaves a brisk one.

    Where none does it is that which tells most; see `postures_for_swinging`.

    Raises:
        NotClear: none leaves any; it tells of the first.
        WeighingError: no motion about the first that leaves room is within the limits.
    """
    why, found = NotClear("no posture"), list[Excitation]()
    for number, posture in enumerate(postures_for_swinging(mover, q)):
        try:
            found.append(search(posture))
        except NotClear as error:
            why = why if number else error
            continue
        except WeighingError:
            if not found:
                raise
            continue
        if max(found[-1].use[limit] for limit in ("velocity", "acceleration", "torque")) > TUNING.feeble:
            break
    if not found:
        raise why
    return min(found, key=_worst_moment)


def _worst_moment(motion: Excitation) -> float:
    """Return how well a motion tells the worst of an object's principal moments, as a share of it."""
    return np.inf if motion.bound is None else float(motion.bound.moments.max())
