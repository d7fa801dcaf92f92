"""Turns of an object that nothing tells apart, neither its shape nor its colours: found, written down, and read.

A symmetry is an axis of O and how often the object repeats itself in a whole turn about it: `z 4` is a quarter turn
about z, `z any` every turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from twin_diagram.errors import AssetError
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a turned object counts as the same, with what set it."""

    points: int = 1500
    """Of the cloud that are turned."""

    share: float = 0.97
    """So many points lie on the surface again, in their colour: fewer than a cup's handle or a can's label has."""

    apart: tuple[float, float] = (0.0015, 0.01)
    """They are off the surface by no more than this [m], [of its radius]: what depth cameras tell a metre away."""

    colour: float = 0.12
    """Their colours differ by no more than this (of 1), which registration takes for light and shade."""

    parts: int = 16
    """In so many parts, farthest from the axis first, points are laid on the surface: the first refuses most turns."""

    neighbours: int = 6
    """Points whose mean colour is compared: a cloud's points lie elsewhere when turned."""

    facing: float = 0.5
    """Cosine between the normals of a point and of where it lies when turned."""

    counts: tuple[int, ...] = tuple(range(24, 1, -1))
    """Repetitions that are tried, the most first. Of more, `odd` would not tell all from any turn: 27 teeth lie within
    a fifth of a tooth after each of those; and on what a hand holds they are as small as what counts as the same."""

    same: float = 2.9999
    """Turns are the same from one to the other if that has a larger trace: 0.6°, as 360 of a whole turn are apart."""

    most: int = 720
    """So many turns are gone through: a degree's and their flips."""

    odd: tuple[float, ...] = (0.071, 0.187, 0.293, 0.437)
    """Shares of a whole turn that no such repetition has: after all of them, any turn is alike."""

    lit: float = 0.5
    """By how much more than the mean at most a lamp at one side lights what faces it: three times what faces away."""

    share_lit: float = 0.95
    """So many points are then of one paint: beside the edges of bands, and of shadows, not all are."""

    rounds: int = 8
    """Of the search for that light: what is painted otherwise counts less in each."""

    least_seen: float = 0.5
    """Share of points, and of where they come to lie, that pictures must have shown before what none showed is left
    out: of what stands, all turned upside down is compared with what nobody saw."""


TUNING = Tuning()
AXES = "xyz"
"""Of O."""
ANY = "any"
"""In the place of a number: every turn about that axis."""


def proposed(
    points: Array, normals: Array, colours: Array, unpainted: npt.NDArray[np.bool_] | None = None
) -> tuple[str, ...]:
    """Return the symmetries about the axes of O that shape and colours have.

    What is round may have been lit from one side when its pictures were taken: their light is in its colours. Nothing
    flat is told from another by that, so that it counts for any turn alone.

    Args:
        points: (M, 3) of the surface in O [m].
        normals: (M, 3) outward.
        colours: (M, 3) of 1.
        unpainted: (M,) which of them no picture showed; None: none.
    """
    cloud = _Cloud(points, normals, colours, unpainted)
    found = []
    for name, way in zip(AXES, np.eye(3), strict=True):
        if all(cloud.looks_same(share * way) for share in TUNING.odd) or cloud.is_round(way):
            found.append(f"{name} {ANY}")
            continue
        most = next((count for count in TUNING.counts if cloud.repeats(way, count)), 1)
        found += [f"{name} {most}"] if most > 1 else []
    return tuple(found)


class _Cloud:
    """A coloured surface that is turned and laid on itself."""

    def __init__(
        self, points: Array, normals: Array, colours: Array, unpainted: npt.NDArray[np.bool_] | None = None
    ) -> None:
        self._shown = np.ones(len(points), bool) if unpainted is None else ~unpainted
        self._points, self._normals, self._colours = points, normals, colours
        self._tree = cKDTree(points)
        k = min(TUNING.neighbours, len(points))
        # Of places on the surface that are drawn at random, one of 400 has none of the cloud so near (exp(−6)).
        self._spacing = self._tree.query(points, k=[k], workers=1)[0][:, 0]
        every = max(1, len(points) // TUNING.points)
        self._some, self._ways = points[::every], normals[::every]
        self._own = self.near(self._some)
        self._slack = max(TUNING.apart[0], TUNING.apart[1] * float(np.linalg.norm(points, axis=1).max()))

    def near(self, places: Array) -> Array:
        """Return the mean colours (N, 3) about places (N, 3)."""
        _, index = self._tree.query(places, k=min(TUNING.neighbours, len(self._points)), workers=1)
        return np.asarray(self._colours[index].mean(axis=1))

    def repeats(self, way: Array, count: int) -> bool:
        """Return whether the surface lies on itself after each of `count` turns about `way` (3,), not the first alone.

        A small turn moves what is nearly round by little, a larger one by more.
        """
        return all(self.looks_same(k / count * way) for k in range(1, count // 2 + 1))

    def looks_same(self, share: Array) -> bool:
        """Return whether the surface, turned by `share` (3,) of whole turns, lies on itself, in its colours."""
        turn = rotations.matrix(rotations.exp(2.0 * np.pi * share))
        places, ways = self._some @ turn.T, self._ways @ turn.T
        # What is unlike itself shows it far from the axis: most turns are refused by the first part of the points.
        order = np.argsort(-np.linalg.norm(np.cross(self._some, share), axis=1), kind="stable")
        good = len(order)
        for part in np.array_split(order, TUNING.parts):
            good -= len(part) - int(self._lies(places[part], ways[part], self._own[part]).sum())
            if good / len(order) < TUNING.share:
                return False
        return True

    def is_round(self, way: Array) -> bool:
        """Return whether any turn about `way` (3,) leaves what pictures showed alike, but for the light from one side.

        Where p comes to lie on q, both are of one paint, C_q / (1 + b·n_q) = C_p / (1 + b·n_p): linear in the light b.
        """
        own, mine = self._shown_beside(self._some, self._ways)
        pairs = []
        for share in TUNING.odd:
            turn = rotations.matrix(rotations.exp(2.0 * np.pi * share * way))
            places, ways = self._some @ turn.T, self._ways @ turn.T
            there, index = self._on_surface(places, ways)
            shown, its = self._shown_beside(places, ways)
            both = own & shown
            if both.mean() < TUNING.least_seen or there[both].mean() < TUNING.share:
                return False
            kept = both & there
            pairs.append((mine[kept], its[kept], np.stack([self._ways[kept], self._normals[index[kept, 0]]], axis=1)))
        colours, others, normals = (np.concatenate(each) for each in zip(*pairs, strict=True))
        across = normals - (normals @ way)[..., None] * way
        alike = _unlike_in_light(colours, others, across) < TUNING.colour
        parts = np.split(alike, np.cumsum([len(one) for one, _, _ in pairs])[:-1])
        return all(part.mean() >= TUNING.share_lit for part in parts)

    def _shown_beside(self, places: Array, ways: Array) -> tuple[npt.NDArray[np.bool_], Array]:
        """Return of places (N, 3), with normals (N, 3), which are not beside what no picture showed, and their colour.

        On a thin wall the nearest points are of either side: those of the own one count.
        """
        _, index = self._tree.query(places, k=min(TUNING.neighbours, len(self._points)), workers=1)
        beside = np.einsum("nki,ni->nk", self._normals[index], ways) > TUNING.facing
        told = beside & self._shown[index]
        count = told.sum(axis=1)
        mean = np.einsum("nk,nki->ni", told.astype(float), self._colours[index]) / np.maximum(count, 1)[:, None]
        return (count > 0) | ~beside.any(axis=1), mean

    def _lies(self, places: Array, ways: Array, colours: Array) -> npt.NDArray[np.bool_]:
        """Return which places (N, 3), with normals (N, 3) and colours (N, 3), lie on the surface, and alike there."""
        there, index = self._on_surface(places, ways)
        unlike = np.linalg.norm(self._colours[index].mean(axis=1) - colours, axis=1) / np.sqrt(3.0)
        return np.asarray(there & (unlike < TUNING.colour))

    def _on_surface(self, places: Array, ways: Array) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
        """Return which places (N, 3), with normals (N, 3), lie on the surface, and the nearest points (N, k) of it."""
        distance, index = self._tree.query(places, k=min(TUNING.neighbours, len(self._points)), workers=1)
        normal = self._normals[index]
        off = np.abs(np.einsum("nki,nki->nk", normal, places[:, None] - self._points[index]))
        # About an edge the very nearest point may be of the other side.
        there = ((off < self._slack) & (np.einsum("nki,ni->nk", normal, ways) > TUNING.facing)).any(axis=1)
        # Beside the edge of a sheet all is in its plane: there a turned card would lie on itself, whatever its outline.
        return there & (distance[:, 0] < self._spacing[index[:, 0]] + self._slack), index


def _unlike_in_light(mine: Array, its: Array, normals: Array) -> Array:
    """Return by how much colours differ (N,) of 1, but for the light from one side that explains most of it.

    Args:
        mine: (N, 3) colours of points, and …
        its: (N, 3) … of where they come to lie.
        normals: (N, 2, 3) of both.
    """
    J = mine[:, :, None] * normals[:, 1, None, :] - its[:, :, None] * normals[:, 0, None, :]
    apart = its - mine
    weight, light = np.ones(len(mine)), np.zeros(3)
    for _ in range(TUNING.rounds):
        A = np.einsum("n,nci,ncj->ij", weight, J, J) + 1e-9 * len(mine) * np.eye(3)
        light = np.linalg.solve(A, np.einsum("n,nci,nc->i", weight, J, apart))
        light *= min(1.0, TUNING.lit / max(float(np.linalg.norm(light)), 1e-9))
        off = np.linalg.norm(apart - J @ light, axis=1) / np.sqrt(3.0)
        weight = (1.0 + (2.0 * off / TUNING.colour) ** 2) ** -2.0
    return np.asarray(off / (1.0 + 0.5 * (normals @ light).sum(axis=1)))


def parsed(told: Sequence[str], where: str) -> tuple[tuple[int, int], ...]:
    """Return axis (0 to 2) and repetitions (0: any) of each symmetry.

    Args:
        told: such as `z 4`.
        where: it stands, for messages.

    Raises:
        AssetError: one that cannot be.
    """
    result = []
    for one in told:
        axis, _, count = one.partition(" ")
        times = 0 if count == ANY else max(int(count), 1) if count.isdecimal() else 1
        if len(axis) != 1 or axis not in AXES or times == 1 or times > 360:
            raise AssetError(f"{where}: symmetries holds {one!r}; one is an axis and a number, such as z 4, or x any")
        result.append((AXES.index(axis), times))
    return tuple(result)


def apart(R: Array, others: Array, symmetries: tuple[tuple[int, int], ...]) -> Array:
    """Return (N,) by what angles turns differ, up to symmetries [rad].

    Args:
        R: (3, 3).
        others: (N, 3, 3).
        symmetries: as `parsed` returns them.
    """
    alike = R @ _repeated(tuple(one for one in symmetries if one[1]))
    free = sorted({axis for axis, count in symmetries if not count})
    if len(free) > 1:
        return np.zeros(len(others))
    if free:
        cosine = others[:, :, free[0]] @ alike[:, :, free[0]].T
    else:
        cosine = 0.5 * (np.einsum("nij,tij->nt", others, alike) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine.max(axis=1), -1.0, 1.0)))


def angles(first: Array, second: Array, symmetries: tuple[tuple[int, int], ...]) -> Array:
    """Return (…,) by what angles orientations differ, up to symmetries [rad].

    Args:
        first: (…, 4) unit quaternions (w, x, y, z).
        second: (…, 4) likewise.
        symmetries: as `parsed` returns them.
    """
    between = rotations.matrix(rotations.multiply(rotations.conjugate(first), second))
    return apart(np.eye(3), between.reshape(-1, 3, 3), symmetries).reshape(between.shape[:-2])


@cache
def _repeated(symmetries: tuple[tuple[int, int], ...]) -> Array:
    """Return (T, 3, 3) all turns that follow from those about axes, none first."""
    steps = [rotations.matrix(rotations.exp(2.0 * np.pi / count * np.eye(3)[axis])) for axis, count in symmetries]
    found = [np.eye(3)]
    for one in found:  # grows as it goes; what is told of several axes may have no end
        for step in steps if len(found) < TUNING.most else []:
            if all(np.trace((one @ step).T @ other) < TUNING.same for other in found):
                found.append(one @ step)
    return np.array(found)
