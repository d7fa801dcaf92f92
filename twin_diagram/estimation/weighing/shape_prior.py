"""How an object's mass may lie within its surface: evenly, in its wall, or with a load hidden somewhere inside.

A body is described by a vector u (10): log mass, the centre's offset d (3) from where even mass has it [m], and a
symmetric matrix E (xx, yy, zz, xy, xz, yz). With a share f of the mass in a load at p, the rest spread as the shape
says with second moments S per mass about its centre, the centre is off by d = f p, and about the new centre

    Σ = m · L exp(E) Lᵀ,   L Lᵀ = (1 − f) S + f ρ² S_solid + (1/f − 1) d dᵀ,

with ρ the load's own size over the object's. Any u is a physical body. E, drawn with `spread`, is what the shape does
not say; p is as likely anywhere in the object, so d has the covariance f² S_solid. f, ρ and the wall's share are
not known: each combination is a hypothesis with its own weight, and the posterior is a mixture of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt

from twin_diagram.estimation.weighing.held import WeighingError
from twin_diagram.estimation.weighing.shape import Shape
from twin_diagram.model.rigid_body.mass_properties import parameters_of, tensors
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ShapePrior:
    """A shape and how much it is trusted.

    Attributes:
        shape: of the object's surface.
        spread: standard deviation of E's elements: relative errors of second moments that no hypothesis has.
        centre_spread: of the centre where no load moves it: errors of the reconstruction, uneven density [m].
        loads: shares f of the mass that a hidden load may have, 0 for none; and how likely each is.
        load_sizes: ρ, and how likely each is.
        walls: shares of the other mass in the surface, and how likely each is.
        ignore: the shape says nothing: only that the object is some body of about this size.
    """

    shape: Shape
    spread: float = 0.08
    centre_spread: float = 1.5e-3
    loads: tuple[tuple[float, float], ...] = (
        (0.0, 0.3), (0.07, 0.08), (0.12, 0.08), (0.18, 0.1), (0.25, 0.1), (0.33, 0.1), (0.42, 0.1), (0.52, 0.08),
        (0.65, 0.06),
    )  # fmt: skip
    load_sizes: tuple[tuple[float, float], ...] = ((0.15, 0.6), (0.45, 0.4))
    walls: tuple[tuple[float, float], ...] = ((0.0, 0.6), (0.35, 0.2), (1.0, 0.2))
    ignore: bool = False

    def __post_init__(self) -> None:
        if not (self.spread > 0.0 and self.centre_spread > 0.0):
            raise WeighingError(f"shape prior: spreads must be positive, not {self.spread}, {self.centre_spread}")
        if any(not 0.0 <= f < 1.0 for f, _ in self.loads):
            raise WeighingError(f"shape prior: a load's share of the mass is from 0 to below 1, not {self.loads}")

    @staticmethod
    def none(shape: Shape) -> ShapePrior:
        """Return what says nothing but that there is a body: torques alone decide."""
        return ShapePrior(shape, spread=1.0, centre_spread=1.0, loads=((0.0, 1.0),), walls=((0.0, 1.0),), ignore=True)

    @cached_property
    def hypotheses(self) -> Hypotheses:
        """All combinations."""
        sizes = ((0.0, 1.0),)
        rows = [
            (f, size, wall, p * p_size * p_wall)
            for (f, p), (wall, p_wall) in product(self.loads, self.walls)
            for size, p_size in (self.load_sizes if f > 0.0 else sizes)
        ]
        f, size, wall, weight = (np.array(column) for column in zip(*rows, strict=True))
        solid, thin = self.shape.second, self.shape.shell_second
        centre = (1.0 - wall)[:, None] * self.shape.centre + wall[:, None] * self.shape.shell_centre
        own = (1.0 - wall)[:, None, None] * solid + wall[:, None, None] * thin
        base = (1.0 - f)[:, None, None] * own + (f * size**2)[:, None, None] * solid
        offset = (f**2)[:, None, None] * solid + self.centre_spread**2 * np.eye(3)
        by_load = np.where(f > 0.0, 1.0 / np.maximum(f, 1e-9) - 1.0, 0.0)
        return Hypotheses(centre, base, offset, by_load, np.log(weight / weight.sum()), self.spread)


@dataclass(frozen=True)
class Hypotheses:
    """Of H ways in which the mass may lie.

    Attributes:
        centre: (H, 3) of the mass without a load [m].
        base: (H, 3, 3) second moments per mass that do not depend on d [m²].
        offset: (H, 3, 3) covariance of d [m²].
        by_load: (H,) how much d dᵀ adds.
        log_weight: (H,) logarithms of probabilities.
        spread: of E's elements.
    """

    centre: Array
    base: Array
    offset: Array
    by_load: Array
    log_weight: Array
    spread: float

    def __len__(self) -> int:
        return len(self.log_weight)

    def parameters(self, u: Array, which: npt.NDArray[np.int64] | None = None) -> Array:
        """Return ten inertial parameters (…, H, 10) of vectors u (…, H, 10); `which` (…,): of these hypotheses."""
        pick = slice(None) if which is None else which
        d, E = u[..., 1:4], tensors(u[..., 4:])
        structure = self.base[pick] + self.by_load[pick][..., None, None] * d[..., :, None] * d[..., None, :]
        L = np.linalg.cholesky(structure)
        values, vectors = np.linalg.eigh(E)
        grown = (vectors * np.exp(np.clip(values, -20.0, 20.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
        mass = np.exp(np.clip(u[..., 0], -20.0, 10.0))
        second = mass[..., None, None] * (L @ grown @ np.swapaxes(L, -1, -2))
        return parameters_of(mass, self.centre[pick] + d, second)

    @cached_property
    def information(self) -> Array:
        """(H, 10, 10) of u beforehand; of the mass nothing."""
        result = np.zeros((len(self), 10, 10))
        result[:, 1:4, 1:4] = np.linalg.inv(self.offset)
        # Off-diagonal elements stand twice in E: half the variance keeps the prior alike in all directions.
        each = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]) / self.spread**2
        result[:, range(4, 10), range(4, 10)] = each
        return result

    def drawn(self, mass: float, count: int, random: np.random.Generator) -> Array:
        """Return ten parameters (count, 10) of bodies of that mass [kg], as likely as they are beforehand."""
        which = random.choice(len(self), size=count, p=np.exp(self.log_weight))
        u = np.zeros((count, 10))
        u[:, 0] = np.log(mass)
        u[:, 1:4] = np.einsum("nij,nj->ni", np.linalg.cholesky(self.offset)[which], random.normal(size=(count, 3)))
        u[:, 4:] = self.spread * random.normal(size=(count, 6)) * np.sqrt([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
        return self.parameters(u, which)
