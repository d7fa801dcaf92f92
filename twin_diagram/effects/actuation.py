"""What becomes of the logged torque before it reaches the joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from twin_diagram.effects.effect import Effect, register
from twin_diagram.effects.fitting import Fitting
from twin_diagram.effects.parameter import ParameterKind

Array = npt.NDArray[np.float64]


@register
class TorqueBias(Effect):
    """A constant torque applied beyond what is logged."""

    name: ClassVar[str] = "torque_bias"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"torque": ParameterKind("N·m")}

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.applied`."""
        return tau + self.spread(joints, self.value("torque"))

    def logged(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.logged`."""
        return tau - self.spread(joints, self.value("torque"))

    def fittings(self) -> list[Fitting]:
        """An actuator that always gives the same."""
        return [
            Fitting(f"{joint}_torque_bias", joint, torque=float(torque))
            for joint, torque in zip(self.joints, self.value("torque"), strict=True)
        ]

    def sentence(self) -> str:
        """See `Effect.sentence`."""
        parts = (f"{x:.4g} N·m on {j}" for j, x in zip(self.joints, self.value("torque"), strict=True))
        return f"a constant torque beyond the logged one of {', '.join(parts)}"
