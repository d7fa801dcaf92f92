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
"""Places of what is above the diagonal in a triangular factor: coordinates five to ten."""

FACTOR_ROW, FACTOR_COLUMN = np.concatenate([DIAGONAL, ROW]), np.concatenate([DIAGONAL, COLUMN])
"""Places of all ten coordinates in it."""


def _of_pseudo() -> Array:
    """Return (10, 4, 4) symmetric weights with which each parameter is a sum over a pseudo-inertia's entries."""
    S = np.zeros((10, 4, 4))
    S[0, 3, 3] = 1.0
    for k in range(3):
        S[1 + k, k, 3] = S[1 + k, 3, k] = 0.5
        S[4 + k, [i for i in range(3) if i != k], [i for i in range(3) if i != k]] = 1.0
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        S[7 + k, i, j] = S[7 + k, j, i] = -0.5
    return S


OF_PSEUDO = _of_pseudo()
"""Parameters by pseudo-inertias' entries."""


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
    return np.asarray((F @ F.transpose(0, 2, 1)).reshape(-1, 16) @ OF_PSEUDO.reshape(10, 16).T)


def slopes(z: Array) -> Array:
    """Return (n, 10, 10) derivative of `parameters`: [:, i, k] of parameter i by coordinate k."""
    F = _factors(z)
    by_factor = 2.0 * (OF_PSEUDO @ F[:, None])[:, :, FACTOR_ROW, FACTOR_COLUMN]
    by_factor[:, :, :4] *= F[:, None, DIAGONAL, DIAGONAL]  # these are exponentials of their coordinates
    return np.asarray(by_factor)


def by_coordinates(by_parameters: Array, blocks: Array) -> Array:
    """Return derivatives (Z, …) by coordinates of those (Z, …) by parameters: links' come first, the others are alike.

    Args:
        by_parameters: rows, of which the first 10 k are links'.
        blocks: (k, 10, 10) of each link's parameters by its coordinates.
    """
    result, links = by_parameters.copy(), by_parameters[: 10 * len(blocks)]
    if len(blocks):
        some = blocks.transpose(0, 2, 1) @ links.reshape(len(blocks), 10, -1)
        result[: len(links)] = some.reshape(links.shape)
    return result


def _factors(z: Array) -> Array:
    """Return (n, 4, 4) upper triangular factors of the pseudo-inertias."""
    F = np.zeros((len(z), 16))
    F[:, ::5] = np.exp(np.minimum(np.maximum(z[:, :4], -20.0), 10.0))
    F[:, 4 * ROW + COLUMN] = z[:, 4:]
    return F.reshape(-1, 4, 4)


def scale_of(z: Array) -> Array:
    """Return (10,) of coordinates: logarithms as they are, centres by length, products by their rows' own size."""
    size = np.exp(z[:4])
    centres = np.maximum(TUNING.centre * size[3], size[ROW])
    return np.concatenate([np.ones(4), np.where(COLUMN == 3, centres, np.maximum(size[ROW], TUNING.least))])
