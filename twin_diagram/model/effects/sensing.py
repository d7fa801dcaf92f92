"""What the encoders' readings mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from twin_diagram.model.effects.effect import Effect, register
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.signals.arrays import Array


@register
class EncoderOffset(Effect):
    """An encoder reads the true position plus an offset."""

    name: ClassVar[str] = "encoder_offset"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"offset": ParameterKind("rad", lower=-np.pi, upper=np.pi)}
    changes_plant: ClassVar[bool] = True

    def true_position(self, joints: Sequence[str], q: Array) -> Array:
        """See `Effect.true_position`."""
        return q - self.spread(joints, self.value("offset"))

    def measured_position(self, joints: Sequence[str], q: Array) -> Array:
        """See `Effect.measured_position`."""
        return q + self.spread(joints, self.value("offset"))
