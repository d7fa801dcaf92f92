"""The door between what encoders read and where joints are: known offsets are taken off here, and nowhere behind it.

    station ──measured──► − offset ──► filter, scene, planner, stop monitor ──► + offset ──commanded──► station

Behind the door all is in true joint angles: the arm's state, plans, a controller's commands. Logs stay as the station
has them.
"""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, ConstantVectorSource

from twin_diagram.model.effects import make
from twin_diagram.model.effects.sensing import EncoderOffset
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


def offset_of(model: Model) -> Array:
    """Return (n,) by how much a model's encoders read too much [rad]; one with an onset counts from the start."""
    result = np.zeros(len(model.joints))
    for effect in model.present:
        if isinstance(effect, EncoderOffset):
            result = effect.measured_position(model.joints, result)
    return result


def behind_door(model: Model, offset: Array) -> Model:
    """Return the model for positions from which `offset` (n,) is taken; what it knows beyond that stays in it."""
    effects = [effect for effect in model.effects if not isinstance(effect, EncoderOffset)]
    left = offset_of(model) - offset
    if len(effects) == len(model.effects) and not left.any():
        return model
    off = {joint: float(value) for joint, value in zip(model.joints, left, strict=True) if value}
    beyond = [make(EffectSpec(EncoderOffset.name, list(off), [], {"offset": list(off.values())}))] if off else []
    return model.with_effects([*effects, *beyond])


def shifted(builder: DiagramBuilder, name: str, port: OutputPort, shift: Array) -> OutputPort:
    """Return a port with what another says plus `shift` (n,); itself where that is nothing."""
    if not shift.any():
        return port
    adder = add_shift(builder, name, shift)
    builder.Connect(port, adder.get_input_port(0))
    return adder.get_output_port()


def add_shift(builder: DiagramBuilder, name: str, shift: Array) -> Adder:
    """Add a system whose output is its first input plus `shift` (n,)."""
    adder = builder.AddNamedSystem(name, Adder(2, len(shift)))
    source = builder.AddNamedSystem(f"{name}_shift", ConstantVectorSource(shift))
    builder.Connect(source.get_output_port(), adder.get_input_port(1))
    return adder
