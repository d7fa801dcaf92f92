"""Refuses arms of which a joint moves no mass: their motion under a torque has no answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How little counts as none; by hand, far below what any arm has."""

    none: float = 1e-12
    """Inertia about a joint, or mass behind one that is prismatic [kg·m²], [kg]."""

    least: float = 1e-12
    """Smallest eigenvalue of a mass matrix whose diagonal was scaled to one."""

    poses: int = 3
    """In which it is looked at: in a single one masses may lie on an axis by chance."""


TUNING = Tuning()


def check(description: str, joints: Sequence[str], mass: Callable[[Array], Array]) -> None:
    """Raise where an arm's mass matrix is not positive.

    Args:
        description: its file.
        joints: names.
        mass: the mass matrix (n, n) at positions (n,).

    Raises:
        ModelError: a joint moves no mass, or the matrix is not positive.
    """
    poses = np.random.default_rng(0).uniform(-1.0, 1.0, (TUNING.poses, len(joints)))
    matrices = np.array([mass(q) for q in poses])
    if not np.all(np.isfinite(matrices)):
        raise ModelError(f"{description}: its masses and inertias do not give a finite mass matrix")
    moved = np.diagonal(matrices, axis1=1, axis2=2).max(axis=0)
    still = [joint for joint, inertia in zip(joints, moved, strict=True) if inertia <= TUNING.none]
    if still:
        raise ModelError(f"{description}: joint {still[-1]!r} moves no mass: give the links behind it an <inertial>")
    scale = np.sqrt(moved)
    scaled = matrices / (scale[:, None] * scale)
    if np.linalg.eigvalsh(scaled).min(axis=1).max() < TUNING.least:
        raise ModelError(f"{description}: its mass matrix is not positive: a link's mass or inertia is wrong or lacks")
