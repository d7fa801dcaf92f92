"""Links' inertial parameters by coordinates of which any are physical, drawn to what the description says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.correction.physical_coordinates import log_cholesky
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    centre: float = 0.15
    """A link's centre is off by the order of this at a spread of 1 [m]."""

    least: float = 1e-3
    """A second moment's root counts as at least this large for its spread [m·√kg]."""


TUNING = Tuning()

DIAGONAL = np.arange(4)
"""Of a factor."""

ROW, COLUMN = np.triu_indices(4, 1)
"""Places of the ten coordinates in a triangular factor: its diagonal, then what is above it."""


@dataclass(frozen=True)
class Links:
    """The given arm's, one per body.

    Attributes:
        names: (n) of the links.
        described: (n, 10) about each link's origin, in its frame.
        mean: (n, 10) their coordinates.
        scale: (n, 10) in which coordinates are of the order of one.
        heavy: (n,) whether a link has any mass to be off.
    """

    names: tuple[str, ...]
    described: Array
    mean: Array
    scale: Array
    heavy: npt.NDArray[np.bool_]

    @staticmethod
    def of(model: Model) -> Links:
        """Return those of a model."""
        told = [link_inertia(model, link) for link in model.tree.link]
        heavy = np.array([mass > 0.0 for mass, _, _ in told])
        some = [one if one[0] > 0.0 else (1.0, np.zeros(3), np.full(6, 1.0)) for one in told]
        mean = np.stack([log_cholesky(*one) for one in some])
        described = parameters(mean)
        return Links(model.tree.link, described, mean, np.stack([scale_of(z) for z in mean]), heavy)


def parameters(z: Array) -> Array:
    """Return (n, 10) about each link's origin from coordinates (n, 10)."""
    F = _factors(z)
    return _parameters_of(F @ F.transpose(0, 2, 1))


def slopes(z: Array) -> Array:
    """Return (n, 10, 10) derivative of `parameters`: [:, i, k] of parameter i by coordinate k."""
    F = _factors(z)
    dF = np.zeros((len(z), 10, 4, 4))
    dF[:, DIAGONAL, DIAGONAL, DIAGONAL] = F[:, DIAGONAL, DIAGONAL]
    dF[:, 4 + np.arange(6), ROW, COLUMN] = 1.0
    half = dF @ F.transpose(0, 2, 1)[:, None]
    return _parameters_of(half + half.transpose(0, 1, 3, 2)).transpose(0, 2, 1)


def _factors(z: Array) -> Array:
    """Return (n, 4, 4) upper triangular factors of the pseudo-inertias."""
    F = np.zeros((len(z), 4, 4))
    F[:, DIAGONAL, DIAGONAL] = np.exp(np.clip(z[:, :4], -20.0, 10.0))
    F[:, ROW, COLUMN] = z[:, 4:]
    return F


def _parameters_of(P: Array) -> Array:
    """Return (…, 10) of pseudo-inertias (…, 4, 4)."""
    second = np.stack([P[..., 0, 0], P[..., 1, 1], P[..., 2, 2]], axis=-1)
    moments = np.sum(second, axis=-1, keepdims=True) - second
    products = -np.stack([P[..., 0, 1], P[..., 0, 2], P[..., 1, 2]], axis=-1)
    return np.concatenate([P[..., 3, 3][..., None], P[..., :3, 3], moments, products], axis=-1)


def scale_of(z: Array) -> Array:
    """Return (10,) of coordinates: logarithms as they are, centres by length, products by their rows' own size."""
    size = np.exp(z[:4])
    centres = np.maximum(TUNING.centre * size[3], size[ROW])
    return np.concatenate([np.ones(4), np.where(COLUMN == 3, centres, np.maximum(size[ROW], TUNING.least))])
