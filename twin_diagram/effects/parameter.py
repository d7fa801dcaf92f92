"""Parameters of effects: values with units and bounds, that identification may move or must leave alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import ModelError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ParameterKind:
    """What a parameter of the catalogue is.

    Attributes:
        unit: SI unit.
        lower: lowest value that is physical.
        upper: highest.
        size: numbers of one value; ignored where there is a value per joint, None for lists of free length.
        default: value where a specification leaves it out; None: it must be given.
        help: one line for people.
        lessens: whether it may be below `lower`, to take away from what the arm's description states; `Model` sees to
            it that no more is taken than there is.
    """

    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    size: int | None = 1
    default: float | None = None
    help: str = ""
    lessens: bool = False


@dataclass(frozen=True)
class Parameter:
    """A bounded, freezable value.

    Attributes:
        value: one number per joint for a joint effect, otherwise the value itself.
        lower: bounds that identification keeps to, same shape.
        upper: likewise.
        frozen: identification leaves it alone.
        unit: SI unit.
    """

    value: Array
    lower: Array
    upper: Array
    frozen: bool = False
    unit: str = ""

    @staticmethod
    def of(kind: ParameterKind, value: Sequence[float] | Array, where: str) -> Parameter:
        """A value of a kind, checked.

        Raises:
            ModelError: it is not finite or outside the bounds; `where` names it in the message.
        """
        array = np.array(value, dtype=float)
        if not np.all(np.isfinite(array)):
            raise ModelError(f"{where}: {list(value)} is not finite")
        if (not kind.lessens and np.any(array < kind.lower)) or np.any(array > kind.upper):
            raise ModelError(f"{where}: {list(value)} {kind.unit} is not within [{kind.lower:g}, {kind.upper:g}]")
        array.setflags(write=False)
        return Parameter(array, np.minimum(array, kind.lower), np.full_like(array, kind.upper), False, kind.unit)
