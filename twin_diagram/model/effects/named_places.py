"""Joints and links that effects name: each must be there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect


def check_places(plant: MultibodyPlant, joints: Sequence[str], effects: Iterable[Effect]) -> None:
    """Check that all joints and links that effects name are there.

    Raises:
        ModelError: one is not.
    """
    for effect in effects:
        for joint in effect.joints:
            if joint not in joints:
                raise ModelError(
                    f"effects.{effect.name}.joints: the arm has no joint {joint!r}; its joints are {', '.join(joints)}"
                )
        for link in effect.links:
            if not plant.HasBodyNamed(link):
                raise ModelError(f"effects.{effect.name}.links: the model has no link {link!r}")
