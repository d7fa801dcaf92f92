"""What makers' data sheets tell of depth cameras: how the RMS error of depth grows with depth."""

from __future__ import annotations

from typing import NamedTuple


class DepthSheet(NamedTuple):
    """Coefficients of an RMS error of depth z: floor + growth · (z - start)².

    Attributes:
        floor: at `start` [m].
        growth: what is added 1 m beyond it [1/m].
        start: where it is least [m].
        correlated: share of the variance that neighbouring pixels have in common.
        lasting: share of it that lasts and spreads wider.
    """

    floor: float
    growth: float
    start: float
    correlated: float = 0.6
    lasting: float = 0.3


SHEETS: dict[str, DepthSheet] = {
    "ideal": DepthSheet(0.0, 0.0008, 0.0, 0.0, 0.0),
    "d415": DepthSheet(0.0, 0.0015, 0.0),
    "d435": DepthSheet(0.0, 0.0038, 0.0),
    "kinect1": DepthSheet(0.0012, 0.0019, 0.4),
}
"""By name. Stereo: z² · s / (f · b) with a subpixel error s of 0.08 px, as the makers of the D415 and the D435 reckon;
`kinect1`: Nguyen, Izadi, Lovell: Modeling Kinect Sensor Noise, 3DIMPVT 2012; `ideal`: a renderer with little noise."""
