"""A motor that loses torque: its record. Its candidates are those of a torque constant that starts within a log."""

from __future__ import annotations

from twin_diagram.gap.candidates.merging import beside
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import effort
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.actuation import ActuatorFault


def sentence(effect: Effect) -> str:
    """Return the share of torque that is left on each joint."""
    parts = (f"{100.0 * x:.3g} % on {j}" for j, x in zip(effect.joints, effect.value("gain"), strict=True))
    return f"a fault leaves of the motors' {effort(effect)} {', '.join(parts)}"


register(
    EffectRecord(
        effect=ActuatorFault,
        title="A failing motor",
        explanation="From some moment on, the motor gives only part of its torque.",
        sentence=sentence,
        keys={"gain": "torque applied over torque logged"},
        merge=beside,
        motor=True,
        held=frozenset({"gain"}),
        wakes=frozenset({Wakes.LOAD, Wakes.TIME}),
    )
)
