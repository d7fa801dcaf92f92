"""Makes a library's objects ready for pictures that have no colours: their own would speak for what is as bright."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.without_colours import in_shades


class PictureContent(Enum):
    """What pictures show of things."""

    COLOURS = "colours"
    SHADES = "shades"
    SHAPE = "shape"


def as_pictured(library: Sequence[Known], content: PictureContent, view_points: int) -> tuple[Known, ...]:
    """Return objects as such pictures show them.

    Args:
        library: the objects, with their colours.
        content: of the pictures.
        view_points: of their models; see `ModelCloud.of`.
    """
    if content == PictureContent.SHADES:
        return tuple(Known.of(ModelCloud.of(in_shades(one.model.asset), view_points)) for one in library)
    return tuple(one.bare if content == PictureContent.SHAPE else one for one in library)
