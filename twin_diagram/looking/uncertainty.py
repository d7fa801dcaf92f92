"""Draws what the filter does not know, in Meshcat: ellipsoids of position covariance, and the arm as it will be.

The ghost is a chain of the arm's link origins, predicted ahead; an ellipsoid stands about each that matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from pydrake.geometry import Ellipsoid, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from twin_diagram.estimation.link_frame import LinkFrame
from twin_diagram.signals import Array

PATH: Final = "twin/uncertainty"
COLOUR: Final = Rgba(0.95, 0.55, 0.05, 0.35)
GHOST: Final = Rgba(0.10, 0.45, 1.0, 0.6)
SMALLEST: Final = 1e-4
"""No semi-axis is drawn shorter than this [m]: it would not be seen, and Meshcat refuses zero."""


def ellipsoid(covariance: Array, deviations: float = 3.0, scale: float = 1.0) -> tuple[Array, Array]:
    """Semi-axes (3,) [m] and their directions, a rotation (3, 3), of a position's covariance (3, 3) [m²].

    Args:
        covariance: symmetric; what rounding makes negative counts as zero.
        deviations: how many standard deviations the surface is from the centre.
        scale: further magnification, for what is too small to see.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    axes = np.maximum(deviations * scale * np.sqrt(np.maximum(values, 0.0)), SMALLEST)
    if np.linalg.det(vectors) < 0.0:
        vectors[:, 0] = -vectors[:, 0]
    return axes, vectors


def position_covariance(frame: LinkFrame, q: Array, P: Array) -> tuple[Array, Array]:
    """Of a frame's origin: p_WF (3,) [m] and its covariance (3, 3) [m²] from that of the joints.

    Args:
        frame: on the arm.
        q: (n,) [rad].
        P: (n, n) covariance of q [rad²].
    """
    _, p_WF, J = frame.jacobian(q)
    return p_WF, J[3:] @ P @ J[3:].T


class UncertaintyView:
    """Ellipsoids and ghost in one Meshcat."""

    def __init__(self, meshcat: Meshcat, frames: Sequence[LinkFrame], scale: float = 1.0) -> None:
        """Chooses what is drawn.

        Args:
            meshcat: where.
            frames: whose origins, in order from the base; the last is the hand.
            scale: magnification of the ellipsoids.
        """
        self._meshcat, self._frames, self._scale = meshcat, list(frames), scale

    def draw(self, q: Array, P: Array, q_ahead: Array | None = None, time: float | None = None) -> None:
        """Draws one moment.

        Args:
            q: (n,) joint angles believed [rad].
            P: (n, n) their covariance [rad²].
            q_ahead: (n,) as predicted, for the ghost; None: no ghost.
            time: of the recording [s].
        """
        for index, frame in enumerate(self._frames):
            p_WF, covariance = position_covariance(frame, q, P)
            axes, R = ellipsoid(covariance, scale=self._scale)
            path = f"{PATH}/{index}"
            self._meshcat.SetObject(path, Ellipsoid(*axes), COLOUR)
            self._meshcat.SetTransform(path, RigidTransform(RotationMatrix(R), p_WF), time)
        if q_ahead is not None:
            chain = np.array([frame.pose(q_ahead)[1] for frame in self._frames]).T
            self._meshcat.SetLine(f"{PATH}/ghost", chain, 6.0, GHOST)
