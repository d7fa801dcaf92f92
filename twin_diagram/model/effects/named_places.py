"""Joints and links that effects name: each must be there."""

from __future__ import annotations

from collections.abc import Iterable

from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.links import link_of
from twin_diagram.model.effects.effect import Effect


def check_places(plant: MultibodyPlant, arm: Arm, effects: Iterable[Effect]) -> None:
    """Check that all joints and links that effects name are there.

    Raises:
        ModelError: one is not, or several are called so.
    """
    for effect in effects:
        for joint in effect.joints:
            if joint not in arm.joints:
                raise ModelError(
                    f"effects.{effect.name}.joints: the arm has no joint {joint!r}; its joints are "
                    f"{', '.join(arm.joints)}"
                )
        for link in effect.links:
            try:
                link_of(plant, arm, link)
            except ModelError as error:
                raise ModelError(f"effects.{effect.name}.links: {error}") from error
