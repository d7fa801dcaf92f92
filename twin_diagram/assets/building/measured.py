"""What was measured of an object's inertia, beside what its shape says: values, standard errors, where each is from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

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
        centre_covariance: (3, 3) of the centre, whose diagonal `centre_std` tells; None: each error is of its own.
        inertia_covariance: (6, 6) the same of the inertia.
    """

    mass: float
    centre: Array
    inertia: Array
    mass_std: float
    centre_std: Array
    inertia_std: Array
    by: dict[str, str]
    centre_covariance: Array | None = None
    inertia_covariance: Array | None = None

    def __post_init__(self) -> None:
        """Refuse what no body has."""
        moments = np.linalg.eigvalsh(self.inertia)
        good = np.isfinite([self.mass, *self.centre, *moments]).all() and self.mass > 0 and moments[0] > 0
        # The pseudo-inertia is positive where no principal moment exceeds the sum of the others.
        if not good or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise AssetError(f"mass {self.mass:g} kg with principal moments {moments} kg·m²: no body has these")

    def turned(self, R: Array) -> MeasuredInertia:
        """Return it in axes turned by R (3, 3): p' = R p; standard errors along the new axes."""
        six = np.stack([_elements(R @ unit @ R.T) for unit in _UNITS], axis=1)
        centre_std, centre = _after(R, self.centre_std, self.centre_covariance)
        inertia_std, inertia = _after(six, self.inertia_std, self.inertia_covariance)
        return MeasuredInertia(
            self.mass,
            R @ self.centre,
            R @ self.inertia @ R.T,
            self.mass_std,
            centre_std,
            inertia_std,
            self.by,
            centre,
            inertia,
        )


def _elements(tensor: Array) -> Array:
    return np.array([tensor[i, j] for i, j in SIX])


_UNITS: Final = [np.array([[float((i, j) in (at, at[::-1])) for j in range(3)] for i in range(3)]) for at in SIX]
"""Inertias (3, 3) of which one element is 1, in the order of `SIX`."""


def _after(change: Array, std: Array, covariance: Array | None) -> tuple[Array, Array | None]:
    """Return standard errors (k,) and covariance (k, k) of what a linear change (k, k) makes of numbers."""
    if covariance is None and np.isfinite(std).all():
        covariance = np.diag(std**2)
    if covariance is not None:
        changed = change @ covariance @ change.T
        return np.sqrt(np.maximum(np.diag(changed), 0.0)), changed
    share = change**2
    # What is not known at all, and has no part in it, leaves it known.
    return np.sqrt(np.sum(share * np.where(share > 0.0, std**2, 0.0), axis=1)), None


def from_shape_alone(solid: EvenBody, density: float) -> MeasuredInertia:
    """Return what an even body of a density [kg/m³] would have; its errors are not known, and told as infinite."""
    mass = density * solid.volume
    unknown = np.full(6, np.inf)
    by = dict.fromkeys(("mass", "centre", "inertia"), "from shape alone")
    return MeasuredInertia(mass, solid.centre, solid.inertia(mass), np.inf, unknown[:3], unknown, by)
