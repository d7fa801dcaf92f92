"""Where a link is, by a cloud: what a camera and a lidar measure alike, and its way into the filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Demultiplexer

from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.sensors import CloudError
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import POSE_SIZE

SIZE: Final = POSE_SIZE + 36
"""Numbers in a measurement: the pose X_WO as quaternion wxyz and position [m], and R (6, 6) row by row."""


def measured(taken: float, now: float, arm_state: Array, align: Callable[[Array], tuple[Array, Array]]) -> Array:
    """Return a measurement (43,): pose and R; NaN for the pose, and R zero, where there is none.

    Args:
        taken: when the cloud was [s]; negative before the first.
        now: time that the state belongs to [s].
        arm_state: (2n,) x̂ = (q, v).
        align: makes pose (7,) and R (6, 6) from joint positions (n,) to begin at; may raise `CloudError`.
    """
    result = np.full(SIZE, np.nan)
    result[POSE_SIZE:] = 0.0  # then the filter takes the sensor's own
    if taken < 0.0:
        return result
    q, v = arm_state.reshape(2, -1)
    try:
        z, R = align(q - v * (now - taken))
    except CloudError:
        return result
    result[:POSE_SIZE], result[POSE_SIZE:] = z, R.ravel()
    return result


def near(points: Array, middle: Array, radius: float, most: int) -> Array:
    """Return the points (K, 3) within a radius of a place (3,) [m].

    Where they are more than `most`, so many of them, spread evenly.
    """
    away = points - middle
    inside = points[np.einsum("ij,ij->i", away, away) < radius**2]
    return inside if len(inside) <= most else inside[np.arange(most) * len(inside) // most]


def feed(builder: DiagramBuilder, measurement: OutputPort, ekf: AdaptiveEkf, sensor: str) -> None:
    """Give a filter's sensor of kind `body_pose` what `measured` made.

    Args:
        builder: holds both.
        measurement: (43,).
        ekf: the filter.
        sensor: its name.
    """
    parts = builder.AddNamedSystem(f"{sensor}_parts", Demultiplexer([POSE_SIZE, SIZE - POSE_SIZE]))
    builder.Connect(measurement, parts.get_input_port())
    builder.Connect(parts.get_output_port(0), ekf.GetInputPort(f"{sensor}.reading"))
    builder.Connect(parts.get_output_port(1), ekf.GetInputPort(f"{sensor}.noise"))
