"""What effects change in a rigid model."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin_diagram.signals.arrays import Array


@dataclass
class RigidChange:
    """What an effect changes in the rigid model itself, so that plain dynamics already hold it.

    Attributes:
        inertia: (10,) per link name, as in `rigid_tree.RigidTree`, but about the link's own frame.
        rotor: reflected inertia per joint name [kg·m²].
        damping: per joint name [N·m·s/rad].
    """

    inertia: dict[str, Array] = field(default_factory=dict)
    rotor: dict[str, float] = field(default_factory=dict)
    damping: dict[str, float] = field(default_factory=dict)
