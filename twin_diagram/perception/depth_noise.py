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

    patch: float = 78.5
    """Area over which neighbours err alike: 4πσ² of a Gaussian with σ = 2.5 px [px]."""

    wave: float = 2830.0
    """The same of what lasts: σ = 15 px [px]."""

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

    def left_by_averaging(self, area: float, width: int) -> float:
        """Return which share of the variance is left in the mean over some pixels that lie together.

        Args:
            area: how many there are [px].
            width: of the image [px].
        """
        pixels = max(area, 1.0) * (TUNING.width / width) ** 2
        white = max(0.0, 1.0 - self.correlated - self.lasting)
        patches, waves = TUNING.patch / (TUNING.patch + pixels), TUNING.wave / (TUNING.wave + pixels)
        return white / max(area, 1.0) + self.correlated * patches + self.lasting * waves


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
    return max(1.0, TUNING.normal * float(np.median(np.abs(residual) / sigma)))
