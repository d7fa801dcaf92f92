"""Weighing: which motion tells most of a held object's inertia, and what its torques and its shape say of it.

`optimise_excitation` plans the motion, `weigh` reads the logs, `crlb` says what a motion could tell at best.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.estimation.weighing.bound import Bound, crlb
    from twin_diagram.estimation.weighing.excitation import (
        Excitation,
        ExcitationPlan,
        feed_forward,
        optimise_excitation,
        weight_torque,
    )
    from twin_diagram.estimation.weighing.grip import Grip
    from twin_diagram.estimation.weighing.held import WeighingError
    from twin_diagram.estimation.weighing.motion_limits import MotionLimits
    from twin_diagram.estimation.weighing.shape import Shape
    from twin_diagram.estimation.weighing.shape_prior import ShapePrior
    from twin_diagram.estimation.weighing.torque_data import EmptyRun, LoadedRun
    from twin_diagram.estimation.weighing.torque_fit import ArmDoubt
    from twin_diagram.estimation.weighing.weighing import Weighing, weigh

__all__ = [
    "ArmDoubt",
    "Bound",
    "EmptyRun",
    "Excitation",
    "ExcitationPlan",
    "Grip",
    "LoadedRun",
    "MotionLimits",
    "Shape",
    "ShapePrior",
    "Weighing",
    "WeighingError",
    "crlb",
    "feed_forward",
    "optimise_excitation",
    "weigh",
    "weight_torque",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
