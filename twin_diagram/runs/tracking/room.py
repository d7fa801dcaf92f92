"""How many objects and things are followed at a time: a library of any size, and alikes beside it."""

from __future__ import annotations

from dataclasses import replace

from twin_diagram import scenario

FURTHER = 8
"""Alikes, and things that grow, for which there is room at least beside the first of each of the library's objects: a
library may be larger than `scenario.Slots` has instances, and then none was ever looked for."""


def slots_for(objects: int) -> scenario.Slots:
    """Return room for a library of so many objects and their alikes; no port's size limits it here."""
    usual = scenario.Slots()
    return replace(usual, instances=max(usual.instances, objects + FURTHER))
