"""What two fingers can hold: forces and moments between the pads and the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.weighing.held import WeighingError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Grip:
    """A pinch between two pads, in the tool frame T: y along the closing axis, z along the approach.

    Attributes:
        force: with which each finger presses [N].
        friction: coefficient between pad and object that may be counted on.
        pad_width: of what the pads touch, along x [m].
        pad_length: the same along z [m].
        centre: (3,) of what they touch, in T [m].
        share: of what they carry that a motion may ask for.
    """

    force: float
    friction: float = 0.4
    pad_width: float = 0.02
    pad_length: float = 0.03
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    share: float = 0.8

    def __post_init__(self) -> None:
        for name in ("force", "friction", "pad_width", "pad_length", "share"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0.0:
                raise WeighingError(f"grip: {name} must be a positive number, not {value}")

    @property
    def capacity(self) -> Array:
        """(6,) force (x, y, z) [N] and moment (x, y, z) [N·m] about the pads' centre that each can carry alone.

        Along x and z friction of both pads holds, about y their torsion: a disc of the pads' area with even pressure
        carries ⅔ of its radius times its friction (Howe and Cutkosky 1996, "Practical force-motion models for sliding
        manipulation"). About x and z pressure moves to the pads' edges, along y it is taken from one finger.
        """
        slide = 2.0 * self.friction * self.force
        radius = np.sqrt(self.pad_width * self.pad_length / np.pi)
        turn = 2.0 / 3.0 * radius * slide
        return np.array([slide, self.force, slide, self.force * self.pad_length, turn, self.force * self.pad_width])

    def use(self, wrench: Array) -> Array:
        """Return the share (N,) of what may be asked that wrenches (N, 6) take, forces before moments; 1 is the limit.

        The limit surface is taken as an ellipsoid (Goyal, Ruina and Papadopoulos 1991).
        """
        return np.linalg.norm(wrench / self.capacity, axis=-1) / self.share

    def slope(self, wrench: Array) -> Array:
        """Return the derivative (N, 6) of `use`."""
        scaled = wrench / self.capacity
        size = np.maximum(np.linalg.norm(scaled, axis=-1, keepdims=True), 1e-12)
        return scaled / size / self.capacity / self.share
