"""The compiled part of `active_set`: the point nearest to another that keeps to bounds on rows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled


class BoundedRows(NamedTuple):
    """What x is to keep to: low <= rows · x <= high.

    Attributes:
        rows: (R, m).
        turned: (m, R) the same, so that loops over rows go along the memory.
        length: (R,) of each row.
        low: (R,) bounds from below.
        high: (R,) from above.
        broken: rows that are broken by more than this are taken in.
        endless: bounds beyond ± this are none.
    """

    rows: Array
    turned: Array
    length: Array
    low: Array
    high: Array
    broken: float
    endless: float


class ActiveRows(NamedTuple):
    """The rows that hold x, the first so many of `which`: on which side, and at what price.

    Attributes:
        which: (k,) rows.
        side: (k,) 1 at the lower bound, −1 at the upper one.
        price: (k,) multipliers.
        Q: (k, m) directions that span them.
        R: (k, k) their triangle: rows are R-combinations of Q.
        inside: (R,) whether a row is among them.
    """

    which: Ints
    side: Array
    price: Array
    Q: Array
    R: Array
    inside: npt.NDArray[np.bool_]


@compiled
def solve(
    wish: Array, rows: Array, low: Array, high: Array, units: int, broken: float, endless: float, most: int
) -> tuple[Array, bool, int]:
    """Return the point x nearest to a wish with low <= rows · x <= high.

    Args:
        wish: (m,)
        rows: (R, m); the first `units` are rows of the identity, each another one.
        low: (R,) bounds from below.
        high: (R,) from above.
        units: see there.
        broken: rows that are broken by more than this are taken in.
        endless: bounds beyond ± this are none.
        most: steps at most.

    Returns:
        x, whether it keeps all bounds, and how many steps it took.
    """
    count, size = rows.shape
    turned = rows.T.copy()
    length = np.zeros(count)
    for j in range(size):
        for r in range(count):
            length[r] += turned[j, r] * turned[j, r]
    length = np.sqrt(length)
    x = wish.copy()
    bounds = BoundedRows(rows, turned, length, low, high, broken, endless)
    room = min(size, count) + 1
    line, square = np.zeros((room, size)), np.zeros((room, room))
    held = ActiveRows(np.zeros(room, np.int64), np.zeros(room), np.zeros(room), line, square, np.zeros(count, np.bool_))
    active = 0
    for r in range(units):
        # These stand at right angles, so that all that are broken can be taken in at once.
        at = 0
        while rows[r, at] == 0.0:
            at += 1
        sign = 1.0 if x[at] < low[r] else -1.0 if x[at] > high[r] else 0.0
        if sign != 0.0:
            bound = low[r] if sign > 0.0 else high[r]
            held.which[active], held.side[active], held.price[active] = r, sign, abs(x[at] - bound)
            held.Q[active, at], held.R[active, active] = sign, 1.0
            x[at], held.inside[r] = bound, True
            active += 1
    value = np.zeros(count)
    for j in range(size):
        for r in range(count):
            value[r] += turned[j, r] * x[j]
    return _steps(x, value, bounds, held, active, most)


@compiled
def _steps(
    x: Array, value: Array, bounds: BoundedRows, held: ActiveRows, active: int, most: int
) -> tuple[Array, bool, int]:
    """Take broken rows in until none is left; x (m,) and `value` (R,), rows · x, change in place."""
    turned, price, Q, R = bounds.turned, held.price, held.Q, held.R
    size, count = turned.shape
    room = len(price)
    d, r_, z, change = np.zeros(room), np.zeros(room), np.zeros(size), np.zeros(count)
    steps = 0
    while True:
        new, sign = _most_broken(value, bounds, held.inside)
        if new < 0:
            # None that could be taken in; what is empty, or at odds with itself, may yet be broken.
            return x, _keeps(value, bounds, 100.0 * bounds.broken), steps
        cost = 0.0
        while True:
            steps += 1
            if steps > most:
                return x, False, steps
            _across(sign, bounds.rows[new], Q, active, d, z)
            square = _dot(z, z)
            _backwards(R, d, active, r_)
            # How far until a multiplier vanishes, and until the row is kept.
            until, gone = np.inf, -1
            for k in range(active):
                if r_[k] > 0.0 and price[k] < until * r_[k]:
                    until, gone = price[k] / r_[k], k
            full = np.inf
            if square > 1e-18 * bounds.length[new] * bounds.length[new]:
                lack = bounds.low[new] - value[new] if sign > 0.0 else value[new] - bounds.high[new]
                full = max(lack, 0.0) / square
            step = min(until, full)
            if not step < np.inf:
                return x, False, steps  # the rows contradict each other
            for k in range(active):
                price[k] -= step * r_[k]
            cost += step
            if full < np.inf:
                for j in range(size):
                    x[j] += step * z[j]
                change[:] = 0.0
                for j in range(size):
                    for r in range(count):
                        change[r] += turned[j, r] * z[j]
                for r in range(count):
                    value[r] += step * change[r]
            if full <= until:
                if active + 1 >= room:
                    return x, False, steps
                long = np.sqrt(square)
                for j in range(size):
                    Q[active, j] = z[j] / long
                R[:active, active] = d[:active]
                R[active, active] = long
                held.which[active], held.side[active], price[active], held.inside[new] = new, sign, cost, True
                active += 1
                break
            held.inside[held.which[gone]] = False
            active = _drop(gone, active, held)


@compiled
def _most_broken(value: Array, bounds: BoundedRows, inside: npt.NDArray[np.bool_]) -> tuple[int, float]:
    """Return the row outside the active ones that is broken by most of its length, and on which side; −1: none."""
    low, high, length, broken, endless = bounds.low, bounds.high, bounds.length, bounds.broken, bounds.endless
    worst, new, sign = 0.0, -1, 0.0
    for r in range(len(value)):
        if inside[r] or length[r] == 0.0:
            continue
        below, above = low[r] - value[r], value[r] - high[r]
        if below > broken and below > worst * length[r] and low[r] > -endless:
            worst, new, sign = below / length[r], r, 1.0
        if above > broken and above > worst * length[r] and high[r] < endless:
            worst, new, sign = above / length[r], r, -1.0
    return new, sign


@compiled
def _keeps(value: Array, bounds: BoundedRows, broken: float) -> bool:
    """Return whether no row is broken by more than that."""
    low, high, endless = bounds.low, bounds.high, bounds.endless
    for r in range(len(value)):
        if low[r] - value[r] > broken and low[r] > -endless:
            return False
        if value[r] - high[r] > broken and high[r] < endless:
            return False
    return True


@compiled
def _across(sign: float, row: Array, Q: Array, active: int, d: Array, z: Array) -> None:
    """Fill in what of a row the active ones span, `d`, and what they do not, `z`; twice, so that rounding adds none."""
    for j in range(len(z)):
        z[j] = sign * row[j]
    d[:active] = 0.0
    for _ in range(2):
        for k in range(active):
            part = _dot(Q[k], z)
            d[k] += part
            for j in range(len(z)):
                z[j] -= part * Q[k, j]


@compiled
def _backwards(R: Array, d: Array, active: int, r: Array) -> None:
    """Fill in R⁻¹ d."""
    for k in range(active - 1, -1, -1):
        total = d[k]
        for i in range(k + 1, active):
            total -= R[k, i] * r[i]
        r[k] = total / R[k, k]


@compiled
def _drop(gone: int, active: int, held: ActiveRows) -> int:
    """Leave an active row out, by rotations that keep R a triangle; returns how many are left."""
    which, side, price, Q, R = held.which, held.side, held.price, held.Q, held.R
    for k in range(gone, active - 1):
        which[k], side[k], price[k] = which[k + 1], side[k + 1], price[k + 1]
        for i in range(k + 2):
            R[i, k] = R[i, k + 1]
    active -= 1
    size = Q.shape[1]
    for k in range(gone, active):
        a, b = R[k, k], R[k + 1, k]
        long = np.hypot(a, b)
        c, s = a / long, b / long
        for i in range(k, active):
            u, v = R[k, i], R[k + 1, i]
            R[k, i], R[k + 1, i] = c * u + s * v, c * v - s * u
        for j in range(size):
            u, v = Q[k, j], Q[k + 1, j]
            Q[k, j], Q[k + 1, j] = c * u + s * v, c * v - s * u
    return active


@compiled
def _dot(a: Array, b: Array) -> float:
    """Return a · b, by four sums side by side: one after the other each addition would wait for the one before."""
    s, t, u, v = 0.0, 0.0, 0.0, 0.0
    whole = len(a) // 4 * 4
    for j in range(0, whole, 4):
        s += a[j] * b[j]
        t += a[j + 1] * b[j + 1]
        u += a[j + 2] * b[j + 2]
        v += a[j + 3] * b[j + 3]
    for j in range(whole, len(a)):
        s += a[j] * b[j]
    return (s + t) + (u + v)
