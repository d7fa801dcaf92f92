"""How sure it is that a thing found is the one that it is named, and not another of nearly its shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array

NAMING_SIZE: Final = 3
"""Numbers of a packed `Naming`."""


@dataclass(frozen=True)
class Tuning:
    """Constants, set on rendered sequences of grey, repainted and stretched things, whose truth is known."""

    certain: float = 6.0
    """Odds of what somebody told [nat], and the longest of all."""

    enough: float = 3.0
    """Odds as long are not asked for again [nat] …"""

    looks: int = 30
    """… nor are others after so many images. Depth's errors last, but what stands beside a thing may go: of a mug that
    a carton's edge ran along five images denied the name, and no further one was asked when it was carried away."""

    follows: float = 0.25
    """By such a share the odds of what shape has not told of follow each image's: 5 to 10 tell of one thing."""


TUNING = Tuning()


@dataclass(frozen=True)
class Naming:
    """How sure an object's name is.

    Attributes:
        odds: logarithm of the odds that it is what it is named.
        looks: images whose mean that is; 0: none has told yet.
        asked: images that were asked, whatever they told.
    """

    odds: float = TUNING.certain
    looks: int = 0
    asked: int = 0

    @property
    def probability(self) -> float:
        """That it is what it is named."""
        return float(1.0 / (1.0 + np.exp(-self.odds)))

    @property
    def settled(self) -> bool:
        """Whether further images are not asked."""
        return self.odds >= TUNING.enough or self.looks >= TUNING.looks

    def after(self, other: Naming) -> Naming:
        """Return it with what another image told.

        Where shape tells nothing, the word is with colours until it does; not against what somebody told.
        """
        asked = self.asked + 1
        if other.looks:
            looks = self.looks + other.looks
            return Naming((self.looks * self.odds + other.looks * other.odds) / looks, looks, asked)
        follows = 0.0 if self.looks or self.odds >= TUNING.certain else TUNING.follows
        return Naming(self.odds + follows * (other.odds - self.odds), self.looks, asked)

    def pack(self) -> Array:
        """Return it as a vector (NAMING_SIZE,)."""
        return np.array([self.odds, float(self.looks), float(self.asked)])

    @staticmethod
    def unpack(vector: Array) -> Naming:
        """Return the inverse of `pack`."""
        return Naming(float(vector[0]), int(vector[1]), int(vector[2]))
