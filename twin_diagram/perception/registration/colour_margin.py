"""Tells by how much the colours speak for the way round that an object was found, whatever share of them fits.

Fine paint a pixel aside, or in another light, fits badly everywhere, and best where it belongs. What is another thing
has colours that fit no way round much better than the next; but a plain thing's fit one way much better if the object
is plain on one side: they say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.colour_contrast import painted_alike
from twin_diagram.perception.registration.colour_votes import TUNING as VOTES
from twin_diagram.perception.registration.colour_votes import colour_costs
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.turned_alike import turned


@dataclass(frozen=True)
class Tuning:
    """Constants, set on `sims/benchmarks/followed_scenes.py`, seeds 10 to 15, and half hidden cups."""

    other: float = 0.6
    """A turn by less is the same way round [rad]."""

    points: int = 150
    """Model points whose colours are compared."""

    shape: float = 0.9
    """Of what fits in shape to a smaller share, no colours are asked: it is another thing, or lies elsewhere."""

    most: float = 3.0
    """They say no more than this of a name [nat]."""

    clear: float = 5.0
    """Colours speak for a find that is likelier than all others by this [nat]: wrong ones had up to 2.0, right ones of
    which half fits 5.5 and more."""


TUNING = Tuning()


def colour_margin(model: ModelCloud, frame: Frame, one: RegisteredPose) -> float:
    """Return by how much colours are likelier as an object was found than in any turn that its shape allows [nat].

    0 where there is no such turn, or it shows nothing.

    Args:
        model: the object.
        frame: the image.
        one: the pose.
    """
    if not model.coloured or not len(model.mistaken) or one.shape < TUNING.shape:
        return 0.0
    R = np.concatenate([one.R[None], one.R @ model.mistaken])
    cost = colour_costs(model, frame, Poses(R, model.kept_in_place(one.R, one.p, R)), TUNING.points)
    others = cost[(turned(R, one.R) > TUNING.other) & (cost < VOTES.never)]
    return float(others.min() - cost[0]) if len(others) else 0.0


def turn_speaks(model: ModelCloud, frame: Frame, one: RegisteredPose) -> float:
    """Return by how much `colour_margin` speaks for what an object was found as [nat]; 0: not at all.

    Only as far as the image shows the paint that the object has there.
    """
    spoken = float(np.clip(0.5 * (colour_margin(model, frame, one) - TUNING.clear), 0.0, TUNING.most))
    return spoken * painted_alike(model, frame, one) if spoken > 0.0 else 0.0
