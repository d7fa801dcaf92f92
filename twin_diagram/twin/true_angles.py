"""The door between what encoders read and where joints are: known offsets are taken off here, and nowhere behind it.

    station ──measured──► − offset ──► filter, scene, planner, stop monitor ──► + offset ──commanded──► station

Behind the door all is in true joint angles: the arm's state, plans, a controller's commands. Logs stay as the station
has them. Where the twin mends its model, an offset that it finds while it runs moves the door, in that Context alone.
"""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
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


TAKEN: Final = "true_position"
"""Name of the system that takes offsets off what is measured; its shift is `<name>_shift`."""
PUT: Final = "measured_position_commanded"
"""Name of the system that puts them on what is commanded."""


def shifted(builder: DiagramBuilder, name: str, port: OutputPort, shift: Array | None) -> OutputPort:
    """Return a port with what another says plus `shift` (n,); itself where there is none."""
    if shift is None:
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


class Door:
    """The door of a twin that is built, and the offsets of the models that it was given.

    Attributes:
        offsets: (n,) each by the model's number, as `ModelUser` counts them [rad].
    """

    def __init__(self, diagram: Diagram, offset: Array) -> None:
        """Find it in the twin's Diagram; `offset` (n,) is that of the model that it was built with."""
        self.offsets = [offset]
        self._taken = cast(ConstantVectorSource, diagram.GetSubsystemByName(f"{TAKEN}_shift"))
        self._put = cast(ConstantVectorSource, diagram.GetSubsystemByName(f"{PUT}_shift"))
        self._diagram = diagram

    def move(self, context: Context, number: int) -> Array:
        """Move it to the offset of a model in one Context of the twin.

        Returns:
            By how much true angles (n,) are others now than they seemed [rad].
        """
        put = self._put.get_mutable_source_value(self._diagram.GetMutableSubsystemContext(self._put, context))
        taken = self._taken.get_mutable_source_value(self._diagram.GetMutableSubsystemContext(self._taken, context))
        before, after = np.array(put.value()), self.offsets[number]
        put.SetFromVector(cast(Any, after))
        taken.SetFromVector(cast(Any, -after))
        return np.asarray(before - after)
