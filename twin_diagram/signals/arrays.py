"""The array type that all maths of this package takes and gives."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""Real numbers; shapes, units and frames stand in the docstrings."""

Ints = npt.NDArray[np.int64]
"""Whole numbers, mostly indices."""
