"""The arm's physics: its description, rigid bodies, named effects, and what they predict together."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.model.effects.effect import Effect
    from twin_diagram.model.effects.parameter import Parameter, ParameterKind
    from twin_diagram.model.effects.serialisation import register
    from twin_diagram.model.model import Model
    from twin_diagram.model.prediction import load_model_for, predict, torque_residual, torque_residual_rms

__all__ = [
    "Effect",
    "Model",
    "Parameter",
    "ParameterKind",
    "load_model_for",
    "predict",
    "register",
    "torque_residual",
    "torque_residual_rms",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
