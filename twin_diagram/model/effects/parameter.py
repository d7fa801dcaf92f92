"""Parameters of effects: values with units and bounds, that identification may move or must leave alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ParameterKind:
    """What a parameter of the catalogue is.

    Attributes:
        unit: SI unit; of a joint's parameter, on a revolute joint.
        lower: lowest value that is physical.
        upper: highest.
        size: numbers of one value; ignored where there is a value per joint, None for lists of free length.
        default: value where a specification leaves it out; None: it must be given.
        help: one line for people.
        lessens: whether it may be below `lower`, to take away from what the arm's description states; `Model` sees to
            it that no more is taken than there is.
        prismatic_unit: on a prismatic joint, where that does not follow from `unit`: a phase, a thing of no joint's.
        optional: whether it may be left out though it has no default; `Effect.check` holds together which are given.
    """

    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    size: int | None = 1
    default: float | None = None
    help: str = ""
    lessens: bool = False
    prismatic_unit: str | None = None
    optional: bool = False

    def unit_on(self, prismatic: bool) -> str:
        """Return its unit on a revolute or prismatic joint; see `units.on_joint`."""
        if prismatic and self.prismatic_unit is not None:
            return self.prismatic_unit
        return units.on_joint(self.unit, prismatic)

    @property
    def unit_anywhere(self) -> str:
        """Its unit where nothing is known of the joint."""
        turning, prismatic = self.unit_on(False), self.unit_on(True)
        return turning if turning == prismatic else f"{turning} ({prismatic} where the joint is prismatic)"


@dataclass(frozen=True)
class Parameter:
    """A bounded, freezable value.

    Attributes:
        value: one number per joint for a joint effect, otherwise the value itself.
        lower: bounds that identification keeps to, same shape.
        upper: likewise.
        frozen: identification leaves it alone.
        unit: SI unit; of a joint's parameter, on a revolute joint.
    """

    value: Array
    lower: Array
    upper: Array
    frozen: bool = False
    unit: str = ""

    @staticmethod
    def of(kind: ParameterKind, value: Sequence[float] | Array, where: str) -> Parameter:
        """Return a value of a kind, checked.

        Raises:
            ModelError: it is not finite or outside the bounds; `where` names it in the message.
        """
        array = np.array(value, dtype=float)
        if not np.all(np.isfinite(array)):
            raise ModelError(f"{where}: {list(value)} is not finite")
        if (not kind.lessens and np.any(array < kind.lower)) or np.any(array > kind.upper):
            raise ModelError(
                f"{where}: {list(value)} {kind.unit_anywhere} is not within [{kind.lower:g}, {kind.upper:g}]"
            )
        array.setflags(write=False)
        return Parameter(array, np.minimum(array, kind.lower), np.full_like(array, kind.upper), False, kind.unit)
