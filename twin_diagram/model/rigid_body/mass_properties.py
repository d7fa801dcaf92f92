"""A body's mass, centre and second moments, and the ten inertial parameters that stand for them.

The ten are in the order of `KinematicTree.inertia`: mass, mass × centre (3), inertia about the frame's origin
(xx, yy, zz, xy, xz, yz). A body is physical where its mass and its second moments Σ about the centre are positive
definite, which is what a positive definite pseudo-inertia says (Wensing, Kim and Slotine 2018, "Linear matrix
inequalities for physically consistent inertial parameter identification", eq. 5 to 9).
"""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array


def tensors(six: Array) -> Array:
    """Return symmetric matrices (…, 3, 3) of (…, 6) xx, yy, zz, xy, xz, yz."""
    order = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
    return np.asarray(six)[..., order]


def six_of(tensor: Array) -> Array:
    """Return (…, 6) xx, yy, zz, xy, xz, yz of symmetric matrices (…, 3, 3)."""
    return np.stack([tensor[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=-1)


def inertia_of(second: Array) -> Array:
    """Return inertia tensors tr(Σ) 1 − Σ (…, 3, 3) of second moments Σ (…, 3, 3)."""
    return np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second


def second_of(inertia: Array) -> Array:
    """Return second moments (…, 3, 3) of inertia tensors: the inverse of `inertia_of`."""
    return 0.5 * np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - inertia


def parameters_of(mass: Array, centre: Array, second: Array) -> Array:
    """Return ten inertial parameters (…, 10).

    Args:
        mass: (…) [kg].
        centre: (…, 3) of mass, in the frame [m].
        second: (…, 3, 3) Σ = ∫ r rᵀ dm about the centre [kg·m²].
    """
    mass = np.asarray(mass, dtype=float)
    about_origin = second + mass[..., None, None] * centre[..., :, None] * centre[..., None, :]
    return np.concatenate([mass[..., None], mass[..., None] * centre, six_of(inertia_of(about_origin))], axis=-1)


def about_centre(parameters: Array) -> tuple[Array, Array, Array]:
    """Return mass (…), centre (…, 3) and inertia tensor about the centre (…, 3, 3) of ten parameters (…, 10)."""
    mass = parameters[..., 0]
    centre = parameters[..., 1:4] / mass[..., None]
    square = np.sum(centre**2, axis=-1)[..., None, None] * np.eye(3) - centre[..., :, None] * centre[..., None, :]
    return mass, centre, tensors(parameters[..., 4:]) - mass[..., None, None] * square


def is_physical(parameters: Array) -> bool:
    """Return whether ten parameters (10,) are those of some distribution of mass."""
    if not np.all(np.isfinite(parameters)) or parameters[0] <= 0.0:
        return False
    return bool(np.linalg.eigvalsh(second_of(about_centre(parameters)[2]))[0] > 0.0)
