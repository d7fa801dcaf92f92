"""A lidar's ranges as points: along which beams they lie, and a LeafSystem that says so in a Diagram."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem

from twin_diagram.scenario import Lidar
from twin_diagram.signals.arrays import Array


def beams(lidar: Lidar) -> Array:
    """Return the unit vectors (rows · columns, 3) in S, row by row from the top, from left to right.

    X is forward, Z up.
    """
    azimuth = 0.5 * lidar.width * np.linspace(1.0, -1.0, lidar.columns)
    elevation = 0.5 * lidar.height * np.linspace(1.0, -1.0, lidar.rows)
    up, left = np.meshgrid(elevation, azimuth, indexing="ij")
    return np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=-1).reshape(-1, 3)


class ScanCloud(LeafSystem):
    """A lidar's ranges as a cloud.

    .. pydrake_system::

        name: ScanCloud
        input_ports:
        - ranges
        output_ports:
        - point_cloud

    `ranges` (rows · columns) [m] along `beams`, 0 where there was no echo; `point_cloud` (PointCloud with xyzs, m, in
    S) of those that had one. Computed when asked for: no state, no rate, no latency.
    """

    def __init__(self, lidar: Lidar) -> None:
        """`lidar`: as its data sheet tells."""
        super().__init__()
        self._beams = beams(lidar)
        self._ranges = self.DeclareVectorInputPort("ranges", len(self._beams))
        self.DeclareAbstractOutputPort(
            "point_cloud",
            lambda: Value(PointCloud(0)),
            self._calc,
            prerequisites_of_calc={self._ranges.ticket()},
        )

    def _calc(self, context: Context, output: Any) -> None:
        ranges = cast(Array, self._ranges.Eval(context))
        met = ranges > 0.0
        cloud = PointCloud(int(np.count_nonzero(met)))
        cloud.mutable_xyzs()[:] = (ranges[met, None] * self._beams[met]).T
        output.set_value(cloud)
