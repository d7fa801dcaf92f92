"""What two effects of one law at one place are together, parameter by parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Parameters = dict[str, list[float]]
"""Key → values, as in `EffectSpec.parameters`."""

Merge = Callable[[Parameters, Parameters], Parameters | None]
"""What is there and what is added, each of one place → both as one; None: they stay beside each other."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    rounded: float = 0.05
    """A payload may be told this much heavier when it is put down than it was when it was picked up, friction
    likewise."""

    nothing: float = 1e-9
    """What is left below this is nothing."""


TUNING = Tuning()


def beside(here: Parameters, more: Parameters) -> Parameters | None:
    """Return None: two of them are two."""
    del here, more
    return None


def summed(here: Parameters, more: Parameters) -> Parameters:
    """Return the sum of every parameter."""
    return {key: (np.array(here[key]) + np.array(more[key])).tolist() for key in here}


def multiplied(here: Parameters, more: Parameters) -> Parameters:
    """Return the product of every parameter."""
    return {key: (np.array(here[key]) * np.array(more[key])).tolist() for key in here}


def least(here: Parameters, more: Parameters) -> Parameters:
    """Return the smaller value of every parameter."""
    return {key: np.minimum(here[key], more[key]).tolist() for key in here}
