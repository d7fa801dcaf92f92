"""The compiled part of `active_set`: the point nearest to another that keeps to bounds on rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled


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
    # Active rows: which, on which side, with what multiplier; Q (k, m) spans them, R is their triangle.
    room = min(size, count) + 1
    which, side, price = np.zeros(room, np.int64), np.zeros(room), np.zeros(room)
    Q, R = np.zeros((room, size)), np.zeros((room, room))
    inside = np.zeros(count, np.bool_)
    active = 0
    for r in range(units):
        # These stand at right angles, so that all that are broken can be taken in at once.
        at = 0
        while rows[r, at] == 0.0:
            at += 1
        sign = 1.0 if x[at] < low[r] else -1.0 if x[at] > high[r] else 0.0
        if sign != 0.0:
            bound = low[r] if sign > 0.0 else high[r]
            which[active], side[active], price[active] = r, sign, abs(x[at] - bound)
            Q[active, at], R[active, active] = sign, 1.0
            x[at], inside[r] = bound, True
            active += 1
    value = np.zeros(count)
    for j in range(size):
        for r in range(count):
            value[r] += turned[j, r] * x[j]
    return _steps(
        x, rows, turned, length, value, low, high, which, side, price, Q, R, inside, active, broken, endless, most
    )


@compiled
def _steps(
    x: Array, rows: Array, turned: Array, length: Array, value: Array, low: Array, high: Array,
    which: Ints, side: Array, price: Array, Q: Array, R: Array, inside: npt.NDArray[np.bool_], active: int,
    broken: float, endless: float, most: int,
) -> tuple[Array, bool, int]:  # fmt: skip
    """Take broken rows in until none is left."""
    count, size = rows.shape
    room = len(which)
    d, r_, z, change = np.zeros(room), np.zeros(room), np.zeros(size), np.zeros(count)
    steps = 0
    while True:
        new, sign = _most_broken(value, low, high, length, inside, broken, endless)
        if new < 0:
            # None that could be taken in; what is empty, or at odds with itself, may yet be broken.
            return x, _keeps(value, low, high, 100.0 * broken, endless), steps
        cost = 0.0
        while True:
            steps += 1
            if steps > most:
                return x, False, steps
            _across(sign, rows[new], Q, active, d, z)
            square = _dot(z, z)
            _backwards(R, d, active, r_)
            # How far until a multiplier vanishes, and until the row is kept.
            until, gone = np.inf, -1
            for k in range(active):
                if r_[k] > 0.0 and price[k] < until * r_[k]:
                    until, gone = price[k] / r_[k], k
            full = np.inf
            if square > 1e-18 * length[new] * length[new]:
                lack = low[new] - value[new] if sign > 0.0 else value[new] - high[new]
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
                which[active], side[active], price[active], inside[new] = new, sign, cost, True
                active += 1
                break
            inside[which[gone]] = False
            active = _drop(gone, active, which, side, price, Q, R)


@compiled
def _most_broken(
    value: Array, low: Array, high: Array, length: Array, inside: npt.NDArray[np.bool_], broken: float, endless: float
) -> tuple[int, float]:
    """Return the row outside the active ones that is broken by most of its length, and on which side; −1: none."""
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
def _keeps(value: Array, low: Array, high: Array, broken: float, endless: float) -> bool:
    """Return whether no row is broken."""
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
def _drop(gone: int, active: int, which: Ints, side: Array, price: Array, Q: Array, R: Array) -> int:
    """Leave an active row out, by rotations that keep R a triangle; returns how many are left."""
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
