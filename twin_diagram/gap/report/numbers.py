"""Numbers for people, with their errors."""

from __future__ import annotations

import math

import numpy as np

from twin_diagram.gap.findings import Estimate


def with_error(estimate: Estimate) -> str:
    """Return a value ± its standard error, to the digits that the error leaves meaning."""
    if isinstance(estimate.value, (list, tuple, np.ndarray)):
        errors = np.broadcast_to(np.asarray(estimate.std, dtype=float), np.shape(estimate.value))
        inside = ", ".join(_pair(float(x), float(s)) for x, s in zip(estimate.value, errors, strict=True))
        number = f"({inside})"
    else:
        number = _pair(float(estimate.value), float(np.max(estimate.std)))
    unit = "" if estimate.unit in ("1", "") else f" {estimate.unit}"
    return number + unit


def _pair(value: float, std: float) -> str:
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(value)):
        return number(value)
    decimals = max(0, 1 - math.floor(math.log10(std)))
    if decimals > 6:
        return f"{value:.4g} ± {std:.2g}"
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def number(value: float) -> str:
    """Return three significant digits, without an exponent where one can do without."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if -4 <= size < 5:
        return f"{value:.{max(0, 2 - size)}f}"
    return f"{value:.3g}"
