"""How far a case's true torque is from the nearest other explanation, in units of its noise.

Signatures are compared below `BAND` in the frequency domain, each frequency in units of the noise that is there: the
torque sensor's, white and coloured, and what the encoder's resolution and the clock's jitter make of the arm's inertia.
A distance of d is what a test between two hypotheses that knows both would see as a mean of d standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter1d
from scipy.signal.windows import tukey

from gap_truth import explanations
from gap_truth.cases import Case
from gap_truth.explanations import Explanation, Setting
from gap_truth.world import Nominal, Truth

Array = npt.NDArray[np.float64]

BAND = 20.0
"""[Hz]"""

CUT = 0.3
"""Left out at each end [s]."""

REST = 0.02
"""A slower joint may stick [rad/s]."""

SETTLE = 0.02
"""About such a time it may still [s]."""

CONTAINED = 0.03
"""A richer explanation that leaves less than this part of the signature contains the truth, and is no rival."""

DRY = ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "coupled_friction")


@dataclass(frozen=True)
class Part:
    """One true effect at one place.

    Attributes:
        name: of the catalogue.
        place: see `explanations.Explanation`.
        strength: distance to saying nothing of it.
        separation: to the nearest other explanation, nothing included.
        nearest: that explanation's name; empty: nothing.
        where: its place.
    """

    name: str
    place: tuple[int, ...]
    strength: float
    separation: float
    nearest: str
    where: tuple[int, ...]


def signature(case: Case, run: Truth, things: bool = True) -> tuple[Setting, Array]:
    """A run's motion between samples, and the torque (N − 1, n) that the given model does not account for.

    Held torques and differences of velocities are exact means over a sample, which knocks and stiff springs do not
    alias.
    """
    period = case.period
    q, v = 0.5 * (run.q[1:] + run.q[:-1]), 0.5 * (run.v[1:] + run.v[:-1])
    a = np.diff(run.v, axis=0) / period
    setting = Setting(case.chain, run.time[:-1] + 0.5 * period, q, v, a, run.held[:-1])
    missing = run.held[:-1] - setting.load
    for thing in case.baseline:
        level = np.array(next(iter(thing.values.values())))
        missing = missing - level * (setting.sign if thing.name == "coulomb_friction" else v)
    return setting, missing


def _fast_length(count: int) -> int:
    """The greatest length up to `count` of which a transform is quick."""
    return next(m for m in range(count, 0, -1) if next_fast_len(m) == m)


class Whitening:
    """Takes signals to independent numbers of variance one where they are noise, below `BAND` or in the whole band."""

    def __init__(self, case: Case, setting: Setting, whole_band: bool = False) -> None:
        period = setting.period
        kept = (setting.time >= setting.time[0] + CUT) & (setting.time <= setting.time[-1] - CUT)
        self.kept = np.flatnonzero(kept)
        self.kept = self.kept[: _fast_length(len(self.kept))]
        count = len(self.kept)
        frequency = np.fft.rfftfreq(count, period)
        self.bins = np.flatnonzero(frequency <= (0.5 / period if whole_band else min(BAND, 0.2 / period)))
        f = frequency[self.bins]
        reading = case.control.resolution**2 / 12.0 + np.mean(setting.v**2, axis=0) * case.noise.jitter**2
        M = Nominal(case.chain).inertia(np.mean(setting.q, axis=0))
        inertial = (2.0 * np.pi * f[:, None]) ** 4 * ((M**2) @ reading)
        self.scale = np.sqrt(2.0 / count) / np.sqrt(case.noise.density(f, period) + inertial)
        self.scale[0] /= np.sqrt(2.0)
        self.taper = tukey(count, min(1.0, 1.0 / (count * period)))[:, None] * _moving(case, setting)[self.kept]

    def __call__(self, signal: Array, rows: tuple[int, ...]) -> Array:
        """(N, len(rows), k) to (F', len(rows), k), real and imaginary parts one after the other."""
        shape = signal.shape[1:]
        taken = (signal[self.kept] * self.taper[:, list(rows), None]).reshape(len(self.kept), -1)
        spectrum = np.fft.rfft(taken, axis=0)[self.bins].reshape(-1, *shape) * self.scale[:, list(rows), None]
        return np.concatenate([spectrum.real, spectrum.imag])


def _moving(case: Case, setting: Setting) -> Array:
    """(N, n) 0 where the given model's own dry friction may hold a joint, which speaks for no name, else 1."""
    result = np.ones_like(setting.v)
    for thing in case.baseline:
        if thing.name in DRY:
            for j in thing.joints:
                still = np.abs(setting.v[:, j]) < REST
                result[:, j] = 1.0 - maximum_filter1d(still.astype(float), 2 * round(SETTLE / setting.period) + 1)
    return result


def spread(white: Array, rows: tuple[int, ...], n: int) -> Array:
    """(F', r, k) on some joints to (F' n, k) on all."""
    result = np.zeros((len(white), n, white.shape[2]))
    result[:, list(rows)] = white
    return result.reshape(-1, white.shape[2])


class Comparison:
    """Distances of one case's signature from explanations, all whitened once."""

    def __init__(self, case: Case, run: Truth | None = None) -> None:
        self.case = case
        self.setting, missing = signature(case, run or case.fit)
        self.white = Whitening(case, self.setting)
        self.n = case.chain.n
        self.target = spread(self.white(missing[..., None], tuple(range(self.n))), tuple(range(self.n)), self.n)[:, 0]

    def columns(self, explanation: Explanation) -> Array:
        """(F' n, k)."""
        return spread(self.white(explanation.columns, explanation.rows), explanation.rows, self.n)

    def distance(self, others: Array, explanation: Explanation | None, known: Array | None = None) -> float:
        """What is left of the signature with `others` (F' n, m) and an explanation fitted to it."""
        if explanation is None:
            left, _ = _fit(self.target, others, (False,) * others.shape[1])
            return left
        own = self.columns(explanation) if known is None else known
        if explanation.quadratic:
            return _fit_point(self.target, others, own)
        A = np.hstack([others, own])
        left, _ = _fit(self.target, A, (False,) * others.shape[1] + explanation.positive)
        return left

    def parts(self) -> list[Part]:
        """The true effects, each with its separation."""
        true = [
            (thing.name, place, explanation)
            for thing in self.case.hidden
            for place, explanation in explanations.of_truth(self.setting, thing)
        ]
        own = [_linear(e, self.columns(e)) for _, _, e in true]
        rivals = [(e, self.columns(e)) for e in explanations.everything(self.setting, list(self.case.hidden))]
        empty = np.zeros((len(self.target), 0))
        # One effect alone is known exactly. Of several, what their columns miss is taken off, and of dry friction what
        # it does while a joint sticks, which is no function of the motion and speaks for no name.
        sticks = any(thing.name in DRY for thing in self.case.hidden)
        misfit = _fit(self.target, np.hstack(own), ())[0] if len(true) > 1 or sticks else 0.0
        result = []
        for k, (name, place, explanation) in enumerate(true):
            others = np.hstack([empty, *(c for i, c in enumerate(own) if i != k)])
            strength = _less(self.distance(others, None), misfit)
            best, nearest, where = strength, "", ()
            present = {(n, p) for i, (n, p, _) in enumerate(true)}
            for rival, white in rivals:
                if (rival.name, rival.place) in present:
                    continue
                d = _less(self.distance(others, rival, white), misfit)
                if d < best and not (rival.parameters > explanation.parameters and d < CONTAINED * strength):
                    best, nearest, where = d, rival.name, rival.place
            result.append(Part(name, place, strength, best, nearest, where))
        return result

    def modelled_parts(self) -> list[Part]:
        """The same where the truth's own columns, as they fit the signature, stand for it.

        Of many effects beside dry friction, what a joint does while it sticks is as large as the smallest of them, and
        any explanation that takes a little of it would seem near.
        """
        true = [
            (thing.name, place, explanation)
            for thing in self.case.hidden
            for place, explanation in explanations.of_truth(self.setting, thing)
        ]
        own = [self.columns(explanation) for _, _, explanation in true]
        W = np.hstack(own)
        _, sizes = _fit(self.target, W, ())
        owner = np.repeat(np.arange(len(own)), [c.shape[1] for c in own])
        inner, present = W.T @ W, {(name, place) for name, place, _ in true}
        best = [(_left(inner, sizes, owner != k, (), inner[:, :0], inner[:0, :0]), "", ()) for k in range(len(own))]
        strength = [d for d, _, _ in best]
        for rival in explanations.everything(self.setting, list(self.case.hidden)):
            if (rival.name, rival.place) in present:
                continue
            columns = self.columns(rival)
            cross, square = W.T @ columns, columns.T @ columns
            for k, (_, _, explanation) in enumerate(true):
                d = _left(inner, sizes, owner != k, rival.positive, cross, square)
                contained = rival.parameters > explanation.parameters and d < CONTAINED * strength[k]
                if d < best[k][0] and not contained:
                    best[k] = d, rival.name, rival.place
        return [Part(name, place, strength[k], *best[k]) for k, (name, place, _) in enumerate(true)]

    def outside(self) -> Part:
        """A case beyond the catalogue: how far from its nearest explanation."""
        thing = self.case.hidden[0]
        empty = np.zeros((len(self.target), 0))
        strength = self.distance(empty, None)
        best, nearest, where = strength, "", ()
        for rival in explanations.everything(self.setting, []):
            d = self.distance(empty, rival)
            if d < best:
                best, nearest, where = d, rival.name, rival.place
        return Part(thing.name, thing.joints, strength, best, nearest, where)


def separations(case: Case) -> list[Part]:
    """Of every true effect at every place; of a clean case none."""
    if not case.hidden:
        return []
    comparison = Comparison(case)
    if case.kind == "joints":
        return comparison.modelled_parts()
    return [comparison.outside()] if case.kind == "outside" else comparison.parts()


def _left(
    inner: Array, sizes: Array, kept: npt.NDArray[np.bool_], positive: tuple[bool, ...], cross: Array, square: Array
) -> float:
    """What is left of columns times sizes, where some of them and a rival's are fitted to it.

    Args:
        inner: products of the columns (p, p).
        sizes: (p,) that they have.
        kept: (p,) which are fitted.
        positive: which of the rival's m may not be negative.
        cross: products of the columns with the rival's (p, m).
        square: of the rival's (m, m).
    """
    right = np.concatenate([inner[kept] @ sizes, cross.T @ sizes])
    gram = np.block([[inner[np.ix_(kept, kept)], cross[kept]], [cross[kept].T, square]])
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-24))
    gram, right = gram / np.outer(scale, scale), right / scale
    bound = np.concatenate([np.zeros(int(np.sum(kept)), dtype=bool), np.array(positive, dtype=bool)])
    if len(bound) < len(right):
        bound = np.append(bound, np.zeros(len(right) - len(bound), dtype=bool))
    free = np.ones(len(right), dtype=bool)
    while True:
        index = np.flatnonzero(free)
        x = np.zeros(len(right))
        x[index] = np.linalg.lstsq(gram[np.ix_(index, index)], right[index], rcond=1e-10)[0]
        if not np.any(wrong := bound & (x < 0.0)):
            return float(np.sqrt(max(0.0, float(sizes @ inner @ sizes - x @ right))))
        free[int(np.argmin(np.where(wrong, x, np.inf)))] = False


def _less(distance: float, misfit: float) -> float:
    return float(np.sqrt(max(0.0, distance**2 - misfit**2)))


def _linear(explanation: Explanation, columns: Array) -> Array:
    return columns[:, :4] if explanation.quadratic else columns


def fitted(y: Array, A: Array) -> Array:
    """Coefficients of plain least squares."""
    return _fit(y, A, ())[1]


def _fit(y: Array, A: Array, positive: tuple[bool, ...]) -> tuple[float, Array]:
    """Least squares; parameters that would be negative and may not are left out, the worst first."""
    k = A.shape[1]
    kept = np.ones(k, dtype=bool)
    bound = np.array([*positive, *([False] * (k - len(positive)))], dtype=bool)
    size = np.sqrt(np.sum(A**2, axis=0)) + 1e-12
    B = A / size
    gram, right = B.T @ B, B.T @ y
    x = np.zeros(k)
    while np.any(kept):
        index = np.flatnonzero(kept)
        x[:] = 0.0
        x[index] = np.linalg.lstsq(gram[np.ix_(index, index)], right[index], rcond=1e-10)[0]
        wrong = bound & (x < 0.0)
        if not np.any(wrong):
            break
        kept[int(np.argmin(np.where(wrong, x, np.inf)))] = False
        x[:] = 0.0
    return float(np.linalg.norm(y - B @ x)), x / size


def _fit_point(y: Array, others: Array, columns: Array) -> float:
    """A point mass: the inertia's six columns follow from mass m and h = m com, by a few Gauss–Newton steps."""
    m = others.shape[1]
    _, x = _fit(y, np.hstack([others, columns[:, :4]]), ())
    best = float("inf")
    for _ in range(6):
        mass, h = x[m], x[m + 1 : m + 4]
        if abs(mass) < 1e-6:
            break
        tensor = (h @ h * np.eye(3) - np.outer(h, h)) / mass
        second = np.array([tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]])
        slope = np.zeros((6, 4))
        slope[:, 0] = -second / mass
        for i in range(3):
            e = np.eye(3)[i]
            t = (2.0 * h[i] * np.eye(3) - np.outer(e, h) - np.outer(h, e)) / mass
            slope[:, 1 + i] = [t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]]
        residual = y - others @ x[:m] - columns[:, :4] @ x[m:] - columns[:, 4:] @ second
        left = float(np.linalg.norm(residual))
        if left > best * (1.0 + 1e-9):
            break
        best = left
        _, step = _fit(residual, np.hstack([others, columns[:, :4] + columns[:, 4:] @ slope]), ())
        x = x + step
    return min(best, float(np.linalg.norm(y)) if m == 0 else _fit(y, others, ())[0])


def as_dict(part: Part, case: Case) -> dict[str, object]:
    """For the truth file."""
    names = case.chain

    def said(place: tuple[int, ...]) -> list[str]:
        return [names.joints[i] if i >= 0 else names.link_names[-1 - i] for i in place]

    return {
        **{key: value for key, value in vars(replace(part)).items()},
        "place": said(part.place),
        "where": said(part.where),
    }
