"""Finds the nearest of many pairs of a ball and a solid, measuring as few of them as can be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.collision.solid_batch import SolidBatch
from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Pairs:
    """Balls of the arm and solids of bodies that may be near each other; M pairs.

    Attributes:
        batch: the solids.
        row, ball, body, solid: (M,) the configuration, and what is near what.
        p_O: (M, 3) the ball's centre in the body's frame [m].
        size: (M,) the ball's radius and what the body is grown by [m].
        at_least: (M,) what the distance is never below [m].
    """

    batch: SolidBatch
    row: Ints
    ball: Ints
    body: Ints
    solid: Ints
    p_O: Array
    size: Array
    at_least: Array

    def take(self, chosen: Ints) -> Pairs:
        """Return some of them."""
        fields = (self.row, self.ball, self.body, self.solid, self.p_O, self.size, self.at_least)
        return Pairs(self.batch, *(part[chosen] for part in fields))


@dataclass(frozen=True)
class Wanting:
    """Which of the parts of an arm and bodies are looked at: those that may lack most of the distance wanted.

    Attributes:
        margins: (N, B) or more columns: the distances that are wanted [m].
        most: so many parts and bodies are enough; whatever may be nearer than is wanted is looked at in any case.
        parts: G, how many parts the arm has.
    """

    margins: Array
    most: int
    parts: int

    def of_parts(self, row: Ints, body: Ints, part: Ints, at_least: Array, times: int) -> Ints:
        """Return the indices of what is looked at; see `most_wanting`.

        Args:
            row: (M,) the configuration.
            body: (M,) the body.
            part: (M,) the part of the arm.
            at_least: (M,) what the distance is never below [m].
            times: how many times `most`, as long as bounds are rough.
        """
        key = (row * self.margins.shape[1] + body) * self.parts + part
        return most_wanting(key, at_least - self.margins[row, body], times * self.most)


@dataclass(frozen=True)
class Nearest:
    """Of pairs, the nearest of each kind: M of them, see `Pairs`; `normal_O` (M, 3) points away from the body."""

    row: Ints
    ball: Ints
    body: Ints
    distance: Array
    normal_O: Array


def nearest_of(pairs: Pairs, key: Ints) -> Nearest:
    """Return, for each distinct key (M,), the nearest of its pairs, ordered by key.

    The pair that may be nearest is measured first, and then only those that may be nearer still.
    """
    first = smallest(key, pairs.at_least)
    distance, normal = pairs.batch.distance(pairs.solid[first], pairs.p_O[first])
    distance -= pairs.size[first]
    table = np.zeros(int(key.max(initial=-1)) + 1)
    table[key[first]] = distance
    rivals = pairs.at_least < table[key]
    rivals[first] = False
    others = np.flatnonzero(rivals)
    if len(others):
        more, slopes = pairs.batch.distance(pairs.solid[others], pairs.p_O[others])
        every = np.concatenate([first, others])
        distance = np.concatenate([distance, more - pairs.size[others]])
        normal = np.concatenate([normal, slopes])
        best = smallest(key[every], distance)
        first, distance, normal = every[best], distance[best], normal[best]
    return Nearest(pairs.row[first], pairs.ball[first], pairs.body[first], distance, normal)


def smallest(key: Ints, value: Array) -> Ints:
    """For each distinct key the index of its smallest value, ordered by key."""
    if not len(key):
        return np.zeros(0, dtype=int)
    # Keys are few and small: a table of them is quicker than sorting.
    least = np.full(int(key.max()) + 1, np.inf)
    np.minimum.at(least, key, value)
    ties = np.flatnonzero(value == least[key])[::-1]
    first = np.full(len(least), -1)
    first[key[ties]] = ties
    return first[first >= 0]


def most_wanting(key: Ints, score: Array, most: int) -> Ints:
    """Return which pairs (M,) belong to the keys of least score.

    To `most` keys, or to all whose score is below 0.
    """
    table = np.full(int(key.max(initial=-1)) + 1, np.inf)
    np.minimum.at(table, key, score)
    least = table[table < np.inf]
    if len(least) <= most:
        return np.arange(len(key))
    limit = max(0.0, float(np.partition(least, most - 1)[most - 1]))
    return np.flatnonzero(table[key] <= limit)


def expanded(count: Ints) -> tuple[Ints, Ints]:
    """Return which of the entries, that stand for `count` others each, each of these has, and its place there."""
    entry = np.repeat(np.arange(len(count)), count)
    return entry, np.arange(len(entry)) - np.repeat(np.cumsum(count) - count, count)


def into(R_WO: Array, v_W: Array) -> Array:
    """Return vectors (M, 3) of W in frames (M, 3, 3) of their own."""
    result: Array = v_W[:, :1] * R_WO[:, 0]
    result += v_W[:, 1:2] * R_WO[:, 1]
    result += v_W[:, 2:] * R_WO[:, 2]
    return result
