"""What was measured of an object's inertia, beside what its shape says: values, standard errors, where each is from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.assets.building.inertia import EvenBody
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of an inertia's numbers: xx, yy, zz, xy, xz, yz."""


@dataclass(frozen=True)
class MeasuredInertia:
    """An object's mass, centre and inertia, in the frame of its surface.

    Attributes:
        mass: [kg]
        centre: (3,) of mass [m].
        inertia: (3, 3) about the centre [kg·m²].
        mass_std: standard error [kg].
        centre_std: (3,) [m].
        inertia_std: (6,) in the order of `SIX` [kg·m²].
        by: for `mass`, `centre` and `inertia` where it is from: `measured`, `partly` or `from shape alone`.
    """

    mass: float
    centre: Array
    inertia: Array
    mass_std: float
    centre_std: Array
    inertia_std: Array
    by: dict[str, str]

    def __post_init__(self) -> None:
        """Refuse what no body has."""
        moments = np.linalg.eigvalsh(self.inertia)
        good = np.isfinite([self.mass, *self.centre, *moments]).all() and self.mass > 0 and moments[0] > 0
        # The pseudo-inertia is positive where no principal moment exceeds the sum of the others.
        if not good or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise AssetError(f"mass {self.mass:g} kg with principal moments {moments} kg·m²: no body has these")

    def turned(self, R: Array) -> MeasuredInertia:
        """Return it in axes turned by R (3, 3): p' = R p; standard errors along the new axes.

        Errors of the six elements count as independent; an element off the diagonal stands in the matrix twice.
        """
        centre_std = np.sqrt(np.maximum(np.diag(R @ np.diag(self.centre_std**2) @ R.T), 0.0))
        std = np.zeros((3, 3))
        for value, (i, j) in zip(self.inertia_std, SIX, strict=True):
            std[i, j] = std[j, i] = value
        squares = np.array([[_variance(R[i], R[j], std) for j in range(3)] for i in range(3)])
        return MeasuredInertia(
            self.mass,
            R @ self.centre,
            R @ self.inertia @ R.T,
            self.mass_std,
            centre_std,
            np.array([np.sqrt(squares[i, j]) for i, j in SIX]),
            self.by,
        )


def _variance(a: Array, b: Array, std: Array) -> float:
    """Return the variance of a · I b for directions (3,), where each of I's six elements has an error of its own."""
    both = np.outer(a, b)
    share = (np.triu(both) + np.triu(both.T, 1)) ** 2
    # What is not known at all, and has no part in it, leaves it known.
    return float(np.sum(share * np.where(share > 0.0, std**2, 0.0)))


def from_shape_alone(solid: EvenBody, density: float) -> MeasuredInertia:
    """Return what an even body of a density [kg/m³] would have; its errors are not known, and told as infinite."""
    mass = density * solid.volume
    unknown = np.full(6, np.inf)
    by = dict.fromkeys(("mass", "centre", "inertia"), "from shape alone")
    return MeasuredInertia(mass, solid.centre, solid.inertia(mass), np.inf, unknown[:3], unknown, by)
