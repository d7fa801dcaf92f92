"""Curves of the angle whose level is as free as an offset's, so that what is no curve speaks for none.

Made of pieces that are each drawn to zero, a curve falls to nothing at angles that a fit has not seen, where an offset
holds: motion that was left out speaks for the offset then, whatever there is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.signals.arrays import Array


def with_free_level(curve: Candidate, free: float) -> Candidate:
    """Return the same curves, made of a level and of what bends them: pieces are drawn to the level, not to zero.

    Args:
        curve: of pieces that together are 1 everywhere, on one joint; its coefficients may be anything.
        free: prior standard deviation of the level [N·m].
    """
    T = np.column_stack([np.ones(curve.size), curve.spread[:, None] * across(1.0 / curve.spread)])
    return replace(
        curve,
        columns=curve.columns @ T,
        spread=np.concatenate([[free], np.ones(curve.size - 1)]),
        parameters=lambda c, covariance: curve.parameters(T @ c, T @ covariance @ T.T),
    )


def across(direction: Array) -> Array:
    """Return (k, k − 1) unit directions, at right angles to each other and to one (k,)."""
    return np.linalg.svd(direction[None])[2][1:].T
