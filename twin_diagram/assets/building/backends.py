"""What turns posed frames of one object into its surface: one small interface, and the TSDF that comes along.

A backend of one's own (BundleSDF, a neural surface, Gaussian splats) reads the same frames, from memory or from the
folder that `write_transforms` makes of them, and hands back triangles with a texture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin_diagram.assets.building.reconstruct import FrameSource, reconstruct
from twin_diagram.assets.building.texture_atlas import lay_out, textured
from twin_diagram.assets.mesh import Image
from twin_diagram.logs.frames.transforms_folder import TransformsFolder
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ColouredSurface:
    """A closed, coloured surface.

    Attributes:
        corners: (F, 3, 3) of its triangles in the frames' W, counter-clockwise from outside [m].
        uv: (F, 3, 2), v upwards.
        texture: (h, w, 3).
        unseen: share of the surface that no picture shows.
        noise: standard deviation of depth on it, as found [m].
        blank: as the texture, white where no picture showed the surface: colours are made up there; None: nowhere.
    """

    corners: Array
    uv: Array
    texture: Image
    unseen: float
    noise: float
    blank: Image | None = None


class ShapeBackend(Protocol):
    """What makes a shape of posed, masked frames."""

    def shape(self, frames: FrameSource, where: str, say: Callable[[str], None]) -> ColouredSurface:
        """Return the surface of the object that the masks show, in the frames' W.

        Raises:
            FramesError: frames that cannot be used; one line that begins with `where`.
        """
        ...


@dataclass(frozen=True)
class TsdfBackend:
    """The project's own: poses refined together, a truncated signed distance field, an atlas of the best pictures.

    Attributes:
        held: the object is held in a hand and stands on nothing.
        seed: of all that is drawn.
    """

    held: bool = True
    seed: int = 0

    def shape(self, frames: FrameSource, where: str, say: Callable[[str], None] = lambda text: None) -> ColouredSurface:
        """See `ShapeBackend.shape`."""
        hands = frames.hands if isinstance(frames, TransformsFolder) else ()
        found = reconstruct(frames, where, self.seed, say, held=self.held, hands=hands)
        atlas = lay_out(len(found.faces))
        picture, blank = textured(found.views, found.vertices, found.faces, atlas)
        corners = np.asarray(found.vertices)[found.faces]
        return ColouredSurface(corners, atlas.uv, picture, float(found.unseen), float(found.noise), blank)
