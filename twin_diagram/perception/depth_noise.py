"""How exact depth is, as the camera's data sheet tells, and what to do where it is worse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

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

    lags: tuple[int, int] = (1, 10)
    """Second differences over so many pixels show white noise alone, and white noise and patches [px]."""

    least: float = 0.0002
    """No depth camera is taken to be better: RMS error at 1 m [1/m]."""

    waves: float = 0.5
    """Variance of what lasts over that of patches, as cameras have it: one picture does not tell it from shape."""

    white: float = 0.2
    """Patches of less variance than this share of white noise's are none: curved things make some."""

    levels: tuple[float, float] = (0.15, 0.6)
    """Two quantiles of sizes tell the noise and how many differences are across an edge, far larger: both are of small
    sizes, and so far apart that a share of edges shows."""

    edges: float = 0.38
    """More differences across edges than this share cannot be told: nearly all of the second quantile's."""

    enough: int = 2000
    """Second differences, or pixels, below this number say nothing."""

    crowded: int = 20
    """A depth that so many pixels show has neighbours one unit of the file away by chance, were nothing rounded but by
    the file: one in e²⁰ has none."""

    uneven: tuple[float, float] = (1.2, 0.25)
    """Depths are a disparity's where gaps between crowded ones are so many times the least, for this share of pixels
    and more: they grow by depth's square, a file's unit does not."""

    stepped: float = 0.05
    """Rounding leaves a plane second differences of one step at most. Of those of up to three, so many have more: up to
    3 % by a ball and edges alone, 3 to 8 % where noise is a fifth of a step, 10 to 16 % where it is a third."""

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


def excess_of(scatter: float, count: int) -> float:
    """Return by how much residuals are larger than they should be: 1 where they are not, or where too few tell.

    It is a factor on the standard deviation, robust against a third of outliers: there are `count` residuals, and their
    median size is `scatter` standard deviations.
    """
    factor = TUNING.normal * scatter
    # So many residuals scatter by themselves: what is within that is none.
    return factor if count >= TUNING.fewest and factor > 1.0 + 2.0 / np.sqrt(count) else 1.0


def measured(depth: npt.NDArray[np.floating]) -> DepthSigma:
    """Return the noise that a depth image (h, w) [m] shows; 0 is no depth.

    On a plane the inverse of depth is linear in the pixels: second differences along rows hold noise alone, over a
    pixel the white part, over more pixels that which neighbours share, too. Their median size is the planes' where
    these fill most of the image. Stereo's error is that of the inverse, the same for all depths. A picture with too
    little in it, or with no noise, is taken for one of the least noise. White noise is a renderer's, unless depth comes
    in steps of disparity: a camera that rounds these may hide patches, and has what lasts. Steps of the file itself
    look like patches on what is flat: where they are all there is, that is what depth is off by.
    """
    step = _steps_alone(depth)
    if step > 0.0:
        return DepthSigma(floor=step / float(np.sqrt(12.0)), growth=TUNING.least)
    with np.errstate(divide="ignore"):
        inverse = np.where(depth > 0.0, 1.0 / depth.astype(float), np.nan)
    variance, beside_edges = [], []
    for lag in TUNING.lags:
        second = inverse[:, : -2 * lag] - 2.0 * inverse[:, lag:-lag] + inverse[:, 2 * lag :]
        size = np.abs(second[np.isfinite(second)])
        if len(size) < TUNING.enough:
            return DepthSigma(growth=TUNING.least)
        variance.append((TUNING.normal * float(np.median(size))) ** 2)
        beside_edges.append(_deviation(size) ** 2)
    scale = depth.shape[1] / TUNING.width
    (near, patch_near), (far, patch_far) = ((6.0, _second(lag, TUNING.patch * scale)) for lag in TUNING.lags)
    # Two equations: white and patches. What a patch leaves over one pixel is little, but not nothing.
    parts = np.linalg.solve([[near, patch_near], [far, patch_far]], np.transpose([variance, beside_edges]))
    (white, alone), (patch, patch_alone) = np.maximum(parts, 0.0).tolist()
    waves = TUNING.waves * patch
    # Over more pixels more differences are across an edge: that is no patch. What comes in steps has few sizes only.
    rounded = _rounded_disparity(depth)
    none = patch <= TUNING.white * white or (patch_alone <= TUNING.white * alone and not rounded)
    if none or patch < TUNING.least**2:
        patch, waves = 0.0, TUNING.waves * white if rounded and white > TUNING.least**2 else 0.0
    growth = max(float(np.sqrt(white + patch + waves)), TUNING.least)
    return DepthSigma(0.0, growth, 0.0, patch / growth**2, waves / growth**2)


def _deviation(size: Array) -> float:
    """Return the deviation of normal numbers' sizes (N,) of which some are something else's, far larger."""
    low, high = np.quantile(size, TUNING.levels)
    shares = np.linspace(0.0, TUNING.edges, 100)
    first, second = (ndtri(0.5 + 0.5 * level / (1.0 - shares)) for level in TUNING.levels)
    share = np.interp(high / max(low, 1e-300), second / first, shares)
    return float(low / ndtri(0.5 + 0.5 * TUNING.levels[0] / (1.0 - share)))


def _steps_alone(depth: npt.NDArray[np.floating]) -> float:
    """Return the step [m] in which depth (h, w) [m] is told, where it shows no noise beside; 0 otherwise."""
    value, count = np.unique(depth[depth > 0.0], return_counts=True)
    crowded = np.minimum(count[1:], count[:-1]) >= TUNING.crowded
    if not crowded.any():
        return 0.0
    step, lag = float(np.diff(value.astype(float))[crowded].min()), TUNING.lags[1]
    near, middle, far = depth[:, : -2 * lag], depth[:, lag:-lag], depth[:, 2 * lag :]
    second = np.abs(near.astype(float) - 2.0 * middle + far)[(near > 0.0) & (middle > 0.0) & (far > 0.0)] / step
    # Whole numbers, up to what the file's floats leave.
    inside = second < 3.5
    alone = inside.sum() >= TUNING.enough and np.mean(second[inside] > 1.5) < TUNING.stepped
    return step if alone and not _rounded_disparity(depth) else 0.0


def _rounded_disparity(depth: npt.NDArray[np.floating]) -> bool:
    """Return whether depth (h, w) [m] with noise comes in steps that grow with depth, not in the file's unit alone."""
    value, count = np.unique(depth[depth > 0.0], return_counts=True)
    gap, pixels = np.diff(value.astype(float)), np.minimum(count[1:], count[:-1])
    gap, pixels = gap[pixels >= TUNING.crowded], pixels[pixels >= TUNING.crowded]
    if pixels.sum() < TUNING.enough:
        return False
    times, share = TUNING.uneven
    return bool(pixels[gap > times * gap.min()].sum() > share * pixels.sum())


def _second(lag: int, sigma: float) -> float:
    """Return the variance of second differences of a field of variance 1, white noise blurred by a Gaussian."""
    return float(6.0 - 8.0 * np.exp(-(lag**2) / (4.0 * sigma**2)) + 2.0 * np.exp(-(lag**2) / sigma**2))
