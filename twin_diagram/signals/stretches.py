"""How long a condition holds, of samples that follow one another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def stretches(condition: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Return (m, 2) first sample of each run of samples for which a condition (N,) holds, and the next one."""
    held = np.concatenate([[False], condition, [False]])
    return np.flatnonzero(held[1:] != held[:-1]).reshape(-1, 2)
