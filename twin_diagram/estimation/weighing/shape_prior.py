"""How mass may lie within a surface: evenly, in its wall, denser to one end, or with a load hidden somewhere inside.

A body is described by a vector u (10): log mass, the centre's offset d (3) from where even mass has it [m], and a
symmetric matrix E (xx, yy, zz, xy, xz, yz). With a share f of the mass in a load at p, the rest spread as the shape
says with second moments S per mass about its centre, the centre is off by d = f p, and about the new centre

    Σ = m · L exp(E) Lᵀ,   L Lᵀ = (1 − f) S + f ρ² S_solid + (1/f − 1) d dᵀ,

with ρ the load's own size over the object's. Any u is a physical body. E, drawn with `spread`, is what the shape does
not say. Small parts of the load are as likely anywhere in the object, so p has the covariance (1 − ρ²) S_solid, and no
load leaves the box about the surface. Where density changes steadily from end to end, or one end is filled with
something denser, the second moments about the middle stay what they are, so that d dᵀ is taken away instead, times
1 / (1 + r²) with r = dᵀ S⁻¹ d, which leaves any d a body. f, ρ and the wall's share are not known: each combination is
a hypothesis with its own weight, and the posterior is a mixture of them.
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
class Tuning:
    """Constants of this module."""

    edge: float = 0.1
    """Softness of the box that loads do not leave, as a share of it: surfaces round off its corners, scans err."""

    rougher: float = 2.5
    """Spread of E over that elsewhere where one end is denser: how density changes from end to end is not told."""


TUNING = Tuning()


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
        plain: how likely it is that an object without a load or a wall is of one material, and the spread of E then:
            errors of the reconstruction.
        ends: how likely it is that density changes from end to end, and the deviation of d then, over that of the mass.
        ignore: the shape says nothing: only that the object is some body of about this size.
    """

    shape: Shape
    spread: float = 0.06
    centre_spread: float = 1.5e-3
    loads: tuple[tuple[float, float], ...] = (
        (0.0, 0.5), (0.07, 0.04), (0.13, 0.05), (0.2, 0.06), (0.28, 0.06), (0.36, 0.06), (0.45, 0.06), (0.55, 0.06),
        (0.66, 0.05), (0.77, 0.04), (0.88, 0.02),
    )  # fmt: skip
    load_sizes: tuple[tuple[float, float], ...] = ((0.1, 0.4), (0.4, 0.3), (0.75, 0.3))
    walls: tuple[tuple[float, float], ...] = ((0.0, 0.85), (0.35, 0.1), (1.0, 0.05))
    plain: tuple[float, float] = (0.5, 0.02)
    ends: tuple[float, float] = (0.15, 0.35)
    ignore: bool = False

    def __post_init__(self) -> None:
        if not (self.spread > 0.0 and self.centre_spread > 0.0):
            raise WeighingError(f"shape prior: spreads must be positive, not {self.spread}, {self.centre_spread}")
        if any(not 0.0 <= f < 1.0 for f, _ in self.loads):
            raise WeighingError(f"shape prior: a load's share of the mass is from 0 to below 1, not {self.loads}")

    @staticmethod
    def none(shape: Shape) -> ShapePrior:
        """Return what says nothing but that there is a body: torques alone decide."""
        return ShapePrior(
            shape,
            spread=1.0,
            centre_spread=1.0,
            loads=((0.0, 1.0),),
            walls=((0.0, 1.0),),
            plain=(0.0, 0.02),
            ends=(0.0, 0.35),
            ignore=True,
        )

    @cached_property
    def hypotheses(self) -> Hypotheses:
        """All combinations."""
        sizes = ((0.0, 1.0),)
        rows = [
            (f, size, wall, p * p_size * p_wall)
            for (f, p), (wall, p_wall) in product(self.loads, self.walls)
            for size, p_size in (self.load_sizes if f > 0.0 else sizes)
        ]
        likely, reach = self.ends
        rows = [(f, size, wall, p * (1.0 - likely)) for f, size, wall, p in rows]
        if likely > 0.0:
            rows += [(-1.0, 0.0, wall, likely * p_wall) for wall, p_wall in self.walls]
        one, of_one = self.plain
        each = []
        for row in rows:
            share = one if row[0] == row[2] == 0.0 else 0.0
            usual = self.spread * (TUNING.rougher if row[0] < 0.0 else 1.0)
            each += [(*row[:3], row[3] * (1.0 - share), usual), (*row[:3], row[3] * share, of_one)]
        columns = zip(*(row for row in each if row[3] > 0.0), strict=True)
        f, size, wall, weight, spread = (np.array(column) for column in columns)
        ended = f < 0.0
        f = np.where(ended, 0.0, f)
        solid, thin = self.shape.second, self.shape.shell_second
        centre = (1.0 - wall)[:, None] * self.shape.centre + wall[:, None] * self.shape.shell_centre
        own = (1.0 - wall)[:, None, None] * solid + wall[:, None, None] * thin
        base = (1.0 - f)[:, None, None] * own + (f * size**2)[:, None, None] * solid
        loose = np.where(ended, reach**2, f**2 * (1.0 - size**2))
        offset = loose[:, None, None] * solid + self.centre_spread**2 * np.eye(3)
        by_load = np.where(f > 0.0, 1.0 / np.maximum(f, 1e-9) - 1.0, 0.0)
        room = np.maximum((1.0 - size)[:, None] * self.shape.half - np.abs(centre - self.shape.middle), 0.0)
        most = np.where(ended, 0.5, f)[:, None] * room + 2.0 * self.centre_spread
        by_load = np.where(ended, -1.0, by_load)
        return Hypotheses(centre, base, offset, most, by_load, np.log(weight / weight.sum()), spread, wall)


@dataclass(frozen=True)
class Hypotheses:
    """Of H ways in which the mass may lie.

    Attributes:
        centre: (H, 3) of the mass without a load [m].
        base: (H, 3, 3) second moments per mass that do not depend on d [m²].
        offset: (H, 3, 3) covariance of d [m²].
        most: (H, 3) how far d can be along each axis [m].
        by_load: (H,) how much d dᵀ adds; below zero: one end is denser.
        log_weight: (H,) logarithms of probabilities.
        spread: (H,) of E's elements.
        wall: (H,) share of the other mass in the surface.
    """

    centre: Array
    base: Array
    offset: Array
    most: Array
    by_load: Array
    log_weight: Array
    spread: Array
    wall: Array

    def __len__(self) -> int:
        return len(self.log_weight)

    def parameters(self, u: Array, which: npt.NDArray[np.int64] | None = None) -> Array:
        """Return ten inertial parameters (…, H, 10) of vectors u (…, H, 10); `which` (…,): of these hypotheses."""
        pick = slice(None) if which is None else which
        d, E = u[..., 1:4], tensors(u[..., 4:])
        r = np.einsum("...i,...ij,...j->...", d, self.stiff[pick], d)
        by_d = np.where(self.by_load[pick] < 0.0, -1.0 / (1.0 + r**2), self.by_load[pick])
        structure = self.base[pick] + by_d[..., None, None] * d[..., :, None] * d[..., None, :]
        L = np.linalg.cholesky(structure)
        values, vectors = np.linalg.eigh(E)
        grown = (vectors * np.exp(np.clip(values, -20.0, 20.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
        mass = np.exp(np.clip(u[..., 0], -20.0, 10.0))
        second = mass[..., None, None] * (L @ grown @ np.swapaxes(L, -1, -2))
        return parameters_of(mass, self.centre[pick] + d, second)

    def outside(self, u: Array) -> Array:
        """Return half the squares (…, H) of how far d is beyond `most`, over a tenth of it: what leaves the object."""
        over = np.maximum(np.abs(u[..., 1:4]) - self.most, 0.0) / (TUNING.edge * self.most)
        return np.asarray(0.5 * np.sum(over**2, axis=-1))

    @cached_property
    def stiff(self) -> Array:
        """(H, 3, 3) inverse of `base`."""
        return np.asarray(np.linalg.inv(self.base))

    @cached_property
    def information(self) -> Array:
        """(H, 10, 10) of u beforehand; of the mass nothing."""
        result = np.zeros((len(self), 10, 10))
        result[:, 1:4, 1:4] = np.linalg.inv(self.offset)
        # Off-diagonal elements stand twice in E: half the variance keeps the prior alike in all directions.
        each = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
        result[:, range(4, 10), range(4, 10)] = each / self.spread[:, None] ** 2
        return result

    def drawn(self, mass: float, count: int, random: np.random.Generator) -> Array:
        """Return ten parameters (count, 10) of bodies of that mass [kg], as likely as they are beforehand."""
        which = random.choice(len(self), size=count, p=np.exp(self.log_weight))
        u = np.zeros((count, 10))
        u[:, 0] = np.log(mass)
        u[:, 1:4] = np.einsum("nij,nj->ni", np.linalg.cholesky(self.offset)[which], random.normal(size=(count, 3)))
        u[:, 4:] = self.spread[which, None] * random.normal(size=(count, 6)) * np.sqrt([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
        return self.parameters(u, which)
