"""How exact depth is, as the camera's data sheet tells, and what to do where it is worse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.errors import ScenarioError
from twin_diagram.scenario.depth_sheets import SHEETS
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the comparison with what is measured, with what set them."""

    normal: float = 1.4826
    """Standard deviation of normal residuals over the median of their sizes."""

    width: float = 640.0
    """Figures in pixels are those of images so wide [px]."""

    patch: float = 2.5
    """Deviation of the Gaussian that makes neighbours err alike, of white noise [px]: d of them are correlated by
    exp(-d² / 4σ²), and 4πσ² of them err as one."""

    wave: float = 15.0
    """The same of what lasts [px]."""

    fewest: int = 30
    """Residuals below this number say nothing about the sheet: their scale is off by a seventh and more."""


TUNING = Tuning()


@dataclass(frozen=True)
class DepthSigma:
    """RMS error of depth z: floor + growth · (z - start)² [m], and what of it neighbouring pixels share; hashable."""

    floor: float = SHEETS["ideal"].floor
    growth: float = SHEETS["ideal"].growth
    start: float = SHEETS["ideal"].start
    correlated: float = SHEETS["ideal"].correlated
    lasting: float = SHEETS["ideal"].lasting

    @staticmethod
    def of(told: scenario.DepthNoise) -> DepthSigma:
        """Return the noise that the scenario tells.

        Raises:
            ScenarioError: there is no such sheet.
        """
        if told.sheet not in SHEETS:
            raise ScenarioError("twin.camera.depth_noise.sheet", f"{told.sheet!r} is none of {', '.join(SHEETS)}")
        sheet = SHEETS[told.sheet]
        own = (told.floor, told.growth, told.start, told.correlated, told.lasting)
        return DepthSigma(*(of_sheet if value is None else value for value, of_sheet in zip(own, sheet, strict=True)))

    def __call__(self, z: npt.NDArray[np.floating]) -> Array:
        """Return the standard deviation [m] at depths z [m], any shape."""
        return np.asarray(self.floor + self.growth * (z - self.start) ** 2)


def excess(residual: Array, sigma: Array) -> float:
    """Return by how much residuals are larger than they should be: 1 where they are not.

    Args:
        residual: (N,) of what fits [m].
        sigma: (N,) expected standard deviations [m].

    Returns:
        Factor on the standard deviation, robust against a third of outliers; 1 where there are too few to tell.
    """
    if len(residual) < TUNING.fewest:
        return 1.0
    factor = TUNING.normal * float(np.median(np.abs(residual) / sigma))
    # So many residuals scatter by themselves: what is within that is none.
    return factor if factor > 1.0 + 2.0 / np.sqrt(len(residual)) else 1.0
