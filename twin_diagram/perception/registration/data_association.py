"""What the image shows in the places where the model's visible points should be, for one pose or for many at once.

Projective data association: each visible point of the model is paired with what stands at its pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration import point_kernels as kernels
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of what counts as a pair, chosen by hand.

    `sims/closed_loop.py --seeds 20` shows their effect.
    """

    table_thickness: float = 0.006
    """A point of the image this near to the table's top is the table's, unless the model point itself is as low [m]."""

    least_cosine: float = 0.5
    """Between the normals of a model point and of what is seen in its place."""

    least_facing: float = 0.1
    """Cosine between a normal and the line of sight from which a point counts as seen."""

    buried: float = 0.015
    """A model point so far below the table's top, where what is seen is not, is nowhere [m]: of the table's height and
    an object's so much may be wrong."""

    @property
    def limits(self) -> kernels.LookLimits:
        """As `look_up` takes them."""
        return kernels.LookLimits(self.table_thickness, self.least_cosine, self.least_facing, self.buried)


TUNING = Tuning()


@dataclass(frozen=True)
class Poses:
    """B poses X_WO: `R` (B, 3, 3), `p` (B, 3)."""

    R: Array
    p: Array

    def __getitem__(self, index: npt.NDArray[np.int64] | slice) -> Poses:
        """Return a selection."""
        return Poses(self.R[index], self.p[index])

    def moved(self, step: Array) -> Poses:
        """Return the poses turned and shifted by `step` (B, 6)."""
        return Poses(exp(step[:, :3]) @ self.R, self.p + step[:, 3:])


@dataclass(frozen=True)
class Looked:
    """What an image shows where the model's visible points should be, B poses of P points each.

    Attributes:
        told: (B, P, COLUMNS) numbers, of which the properties are views.
        flags: (B, P) bits.
        coloured: whether the model has colours that say anything.
    """

    told: Array
    flags: npt.NDArray[np.uint8]
    coloured: bool = True

    @property
    def r(self) -> Array:
        """(B, P, 3) points relative to the object's origin, axes of W."""
        return self.told[..., kernels.R_AT : kernels.R_AT + 3]

    @property
    def n(self) -> Array:
        """(B, P, 3) normals in W."""
        return self.told[..., kernels.N_AT : kernels.N_AT + 3]

    @property
    def facing(self) -> Array:
        """(B, P) cosine between normal and line of sight."""
        return self.told[..., kernels.FACING]

    @property
    def colour(self) -> Array:
        """(B, P, 3) the model's."""
        return self.told[..., kernels.COLOUR : kernels.COLOUR + 3]

    @property
    def u(self) -> Array:
        """(B, P) pixel coordinates."""
        return self.told[..., kernels.U]

    @property
    def v(self) -> Array:
        """(B, P) pixel coordinates."""
        return self.told[..., kernels.V]

    @property
    def z(self) -> Array:
        """(B, P) depth of the model points [m]."""
        return self.told[..., kernels.Z]

    @property
    def distance(self) -> Array:
        """(B, P) n · (y - x), seen point to model surface [m]."""
        return self.told[..., kernels.DISTANCE]

    @property
    def deeper(self) -> Array:
        """(B, P) seen depth minus the model point's [m]; what shows no depth is seen at 0."""
        return self.told[..., kernels.DEEPER]

    @property
    def texture(self) -> Array:
        """(B, P) squared slope of the model's colours [1/m²]."""
        return self.told[..., kernels.TEXTURE]

    @cached_property
    def painted(self) -> Mask:
        """(B, P) whether pictures showed the colours that the model has."""
        return self.texture < kernels.UNPAINTED

    @cached_property
    def seen(self) -> Mask:
        """(B, P) whether there is depth, and it is not the robot's."""
        return self.flags & kernels.SEEN != 0

    @cached_property
    def near(self) -> Mask:
        """(B, P) seen, and not the table below or behind the model point."""
        return self.flags & kernels.NEAR != 0

    @cached_property
    def matched(self) -> Mask:
        """(B, P) near, and what is seen does not face another way: the floor of a mug is not its rim."""
        return self.flags & kernels.MATCHED != 0

    @cached_property
    def robot(self) -> Mask:
        """(B, P) whether the pixel shows the robot."""
        return self.flags & kernels.ROBOT != 0

    @cached_property
    def buried(self) -> Mask:
        """(B, P) seen, and the model point is inside of the table: nothing hides it, it cannot be there."""
        return self.flags & kernels.BURIED != 0

    @cached_property
    def counted(self) -> Mask:
        """(B, P) whether the point is no repetition."""
        return self.flags & kernels.COUNTED != 0


def look(model: ModelCloud, frame: Frame, poses: Poses, count: int, level: int) -> Looked:
    """Look the visible points of the model, at most `count` each, up in the image."""
    count = min(count, model.views.shape[1])
    told = np.empty((len(poses.p), count, kernels.COLUMNS))
    flags = np.empty((len(poses.p), count), dtype=np.uint8)
    kernels.look_up(
        one_layout(poses.R),
        one_layout(poses.p),
        model.seen,
        frame.images,
        frame.view,
        TUNING.limits,
        count,
        level,
        told,
        flags,
    )
    return Looked(told, flags, model.coloured)
