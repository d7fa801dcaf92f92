"""Play in a gear: its record; its candidates are made in `gears`."""

from __future__ import annotations

from dataclasses import dataclass

from twin_diagram.gap.candidates.gears import rebuilt, swinging
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.elasticity import Backlash, JointElasticity
from twin_diagram.model.effects.inertia import ReflectedInertia


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    gaps: float = 3.0
    """Of the search for a gap [nats]."""

    share: float = 0.025
    """Of what the rotor brings, which play must bring beyond it."""

    teeth: float = 0.02
    """Relative standard error of a gap for what the law leaves out: teeth give way where they meet."""


TUNING = Tuning()


def sentence(effect: Effect) -> str:
    """Return its gap on each joint."""
    parts = (
        f"{1e3 * gap:.4g} m{effect.unit('gap', j)} on {j}"
        for j, gap in zip(effect.joints, effect.value("gap"), strict=True)
    )
    return f"play in the gear of {', '.join(parts)}"


register(
    EffectRecord(
        effect=Backlash,
        title="Play in a gear",
        explanation="The motor turns a little before the link follows, each time the torque changes side.",
        sentence=sentence,
        keys={"gap": "total play"},
        shapes=swinging(("gap", 0.6, 1.7)),
        rebuilt=rebuilt,
        shape_cost=TUNING.gaps,
        rivals=frozenset({ReflectedInertia.name, JointElasticity.name}),
        plainer=ReflectedInertia.name,
        plainer_share=TUNING.share,
        share_of_own=True,
        merge=summed,
        joint_by_joint=True,
        swung=True,
        unseen=0.01,  # set on training logs
        adds=frozenset({"rotor_inertia"}),
        scanned="gap",
        sharp=True,
        left_out={"gap": (0.0, TUNING.teeth)},
        wakes=frozenset({Wakes.REVERSAL}),
    )
)
