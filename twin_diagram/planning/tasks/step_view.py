"""What a step knows of the world: objects, tool and fingers at a tick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar, overload

import numpy as np

from twin_diagram.planning.collision.hand_shape import Palm
from twin_diagram.planning.tasks.grasp_choice import ShapeGrasps
from twin_diagram.planning.tasks.grasp_from_above import NO_PALM
from twin_diagram.planning.tasks.in_hand import Eye
from twin_diagram.planning.tasks.standing_beside import StandingBeside
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement, Track

Read = TypeVar("Read")
"""What a packed row stands for."""


class PackedRows(Sequence[Read], Generic[Read]):
    """Rows of which each is unpacked once it is asked for: a step looks at one or two objects of all."""

    def __init__(self, rows: Array, unpack: Callable[[Array], Read]) -> None:
        """Keep a copy of the rows.

        Args:
            rows: (K, size).
            unpack: of one row.
        """
        self._rows, self._unpack = np.array(rows), unpack
        self._known: dict[int, Read] = {}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> Read: ...

    @overload
    def __getitem__(self, index: slice) -> list[Read]: ...

    def __getitem__(self, index: int | slice) -> Read | list[Read]:
        """Return what a row stands for, or some; raises IndexError for one that is not there."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        if index not in self._known:
            self._known[index] = self._unpack(self._rows[index])
        return self._known[index]


@dataclass(frozen=True)
class Takeable:
    """An object of the library, as far as taking it goes.

    Attributes:
        pieces: corners (m, 3) of the convex pieces that hold it, in O [m].
        symmetric: whether it looks the same however it is turned about its z axis.
        shape: grasps of its shape; none where nobody asked for them.
    """

    pieces: tuple[Array, ...]
    symmetric: bool
    shape: ShapeGrasps = field(default_factory=ShapeGrasps)

    @property
    def radius(self) -> float:
        """Of the upright cylinder about the object's z axis that holds it [m]."""
        return float(np.linalg.norm(np.concatenate(self.pieces)[:, :2], axis=1).max())


@dataclass(frozen=True)
class StepView:
    """What is known now.

    Attributes:
        now: [s].
        X_WT: (7) the tool.
        speed: of its origin [m/s].
        tracks: of the library's objects.
        measured: of the newest image, one for each of the library's objects.
        opening: between the fingers [m].
        finger_speed: of the fastest finger [m/s].
        widest: the fingers' greatest opening [m].
        reach: number of joint positions that reach the goal; `NEVER` where the planner has none.
        palm: of the hand.
        eye: the camera, as far as calibration goes; None where nothing is told of its errors.
        beside: what stands there besides the library's objects.
    """

    now: float
    X_WT: Array
    speed: float
    tracks: Sequence[Track]
    measured: Sequence[PoseMeasurement]
    opening: float
    finger_speed: float
    widest: float
    reach: float
    eye: Eye | None = None
    palm: Palm = NO_PALM
    beside: StandingBeside = field(default_factory=StandingBeside)
