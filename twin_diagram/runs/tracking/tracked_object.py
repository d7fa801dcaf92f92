"""One object as the tracker knows it after a frame."""

from __future__ import annotations

from dataclasses import dataclass

from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class TrackedObject:
    """One object after a frame, in the tracker's frame T.

    Attributes:
        track: number that stays with it.
        asset: name in the library; None: unknown.
        status: see `ObjectStatus`, lower case; `lost` once it is improbable.
        probability: that it is there, the one that is named, and at that pose of all `hypotheses`, up to symmetries.
        visible: share of its camera-facing surface that this frame shows.
        R, p: pose; of an unknown thing no turn, and the middle of its points.
        covariance: (6, 6), rotation then translation.
        hypotheses: poses that the frame allows, with probabilities that sum to 1; the first is the pose.
        pieces: vertices of convex pieces, of unknown things.
        found: in this very frame.
        named: probability of its name: even where a plain body would show the same.
        by_shape: shape alone tells it.
        free: numbers of the axes of O about which no turn is told.
    """

    track: int
    asset: str | None
    status: str
    probability: float
    visible: float
    R: Array
    p: Array
    covariance: Array
    hypotheses: tuple[PoseHypothesis, ...]
    pieces: tuple[Array, ...]
    found: bool
    named: float = 0.0
    by_shape: bool = False
    free: tuple[int, ...] = ()
