"""What a model says of a link alone, before anything is found of it."""

from __future__ import annotations

from twin_diagram.model.effects.link_inertia import InertialParameters, about_centre
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


def link_inertia(model: Model, link: str) -> tuple[float, Array, Array]:
    """Return the mass, centre and inertia about it of a link alone, in its frame.

    Mass, centre (3,) and inertia (6,), with what the model adds to the link.
    """
    mass, centre, inertia = about_centre(model.bodies.links.inertia(link))
    for effect in model.present:
        if isinstance(effect, InertialParameters) and effect.links == (link,):
            mass = mass + float(effect.value("mass")[0])
            centre, inertia = centre + effect.value("com"), inertia + effect.value("inertia")
    return mass, centre, inertia
