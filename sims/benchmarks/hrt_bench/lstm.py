"""A small LSTM in numpy, trained by backpropagation through time: it predicts the next row of a sequence.

    i, f, o = σ(·), g = tanh(·) of [x, h, 1] W,   c ← f ∘ c + i ∘ g,   h = o ∘ tanh c,   ŷ = [x, h, 1] V

(Hochreiter and Schmidhuber, Neural Computation 9, 1997; forget gate of Gers et al., 2000). V reads the input beside the
cells, so that an untrained network can say "as before".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

CLIP: Final = 1.0
"""Largest norm of a gradient."""
DECAY: Final = (0.9, 0.999)
"""Of Adam's means."""


@dataclass
class Weights:
    """Of C cells that read S numbers.

    Attributes:
        gates: (S + C + 1, 4 C): input, forget, output gate and candidate.
        read: (S + C + 1, S).
    """

    gates: Array
    read: Array

    @property
    def cells(self) -> int:
        """C."""
        return self.gates.shape[1] // 4

    @staticmethod
    def draw(size: int, cells: int, rng: np.random.Generator) -> Weights:
        """Before training: forget gates open, the prediction is the row itself."""
        gates = rng.normal(size=(size + cells + 1, 4 * cells)) / np.sqrt(size + cells)
        gates[-1] = 0.0
        gates[-1, cells : 2 * cells] = 1.0
        return Weights(gates, np.vstack([np.eye(size), np.zeros((cells + 1, size))]))


def step(weights: Weights, x: Array, h: Array, c: Array) -> tuple[Array, Array, Array, Array, Array]:
    """One row of B sequences.

    Args:
        weights: the network.
        x: (B, S).
        h: (B, C).
        c: (B, C).

    Returns:
        Prediction (B, S), h, c, and what backpropagation needs: gates (B, 4 C) after their functions, inputs
        (B, S + C + 1) of the gates.
    """
    C, one = weights.cells, np.ones((len(x), 1))
    z = np.hstack([x, h, one])
    a = z @ weights.gates
    a[:, : 3 * C] = 1.0 / (1.0 + np.exp(-a[:, : 3 * C]))
    a[:, 3 * C :] = np.tanh(a[:, 3 * C :])
    c = a[:, C : 2 * C] * c + a[:, :C] * a[:, 3 * C :]
    h = a[:, 2 * C : 3 * C] * np.tanh(c)
    return np.hstack([x, h, one]) @ weights.read, h, c, a, z


def loss_and_gradient(weights: Weights, batch: Array, skip: int = 0) -> tuple[float, Weights]:
    """Mean squared error of the next row, and its gradient.

    Args:
        weights: the network.
        batch: (T + 1, B, S) sequences.
        skip: rows at the start that are not scored: there the cells know nothing yet.
    """
    T, B, S = len(batch) - 1, batch.shape[1], batch.shape[2]
    C = weights.cells
    h, c = np.zeros((B, C)), np.zeros((B, C))
    kept = []
    by_y = np.zeros((T, B, S))
    scale = 1.0 / ((T - skip) * B * S)
    loss = 0.0
    for t in range(T):
        before = c
        y, h, c, a, z = step(weights, batch[t], h, c)
        kept.append((a, z, before, c, h))
        if t >= skip:
            error = y - batch[t + 1]
            loss += scale * float(np.sum(error**2))
            by_y[t] = 2.0 * scale * error
    gates, read = np.zeros_like(weights.gates), np.zeros_like(weights.read)
    by_h, by_c = np.zeros((B, C)), np.zeros((B, C))
    one = np.ones((B, 1))
    for t in range(T - 1, -1, -1):
        a, z, before, c, h = kept[t]
        i, f, o, g = np.split(a, 4, axis=1)
        read += np.hstack([batch[t], h, one]).T @ by_y[t]
        by_h = by_h + by_y[t] @ weights.read[S : S + C].T
        bent = np.tanh(c)
        by_c = by_c + by_h * o * (1.0 - bent**2)
        by_a = np.hstack(
            [
                by_c * g * i * (1.0 - i),
                by_c * before * f * (1.0 - f),
                by_h * bent * o * (1.0 - o),
                by_c * i * (1.0 - g**2),
            ]
        )
        gates += z.T @ by_a
        by_h, by_c = by_a @ weights.gates[S : S + C].T, by_c * f
    return loss, Weights(gates, read)


def train(
    runs: list[Array], cells: int, steps: int, seed: int, length: int = 50, batch: int = 32, rate: float = 4e-3
) -> tuple[Weights, list[float]]:
    """Adam on pieces drawn at random.

    Args:
        runs: (N, S) sequences in units of their own spread.
        cells: C.
        steps: of the optimiser.
        seed: of the first weights and the pieces.
        length: of a piece, in rows.
        batch: pieces per step.
        rate: of learning, falling to a twentieth.

    Returns:
        The network and the loss of each step.
    """
    rng = np.random.default_rng(seed)
    weights = Weights.draw(runs[0].shape[1], cells, rng)
    parts = [weights.gates, weights.read]
    first, second = [np.zeros_like(p) for p in parts], [np.zeros_like(p) for p in parts]
    losses = []
    for k in range(steps):
        which = rng.integers(len(runs), size=batch)
        starts = [int(rng.integers(len(runs[w]) - length)) for w in which]
        pieces = np.stack([runs[w][s : s + length + 1] for w, s in zip(which, starts, strict=True)], axis=1)
        loss, gradient = loss_and_gradient(weights, pieces, skip=5)
        losses.append(loss)
        found = [gradient.gates, gradient.read]
        norm = np.sqrt(sum(float(np.sum(g**2)) for g in found))
        now = rate * 0.05 ** (k / steps)
        for part, g, m, v in zip(parts, found, first, second, strict=True):
            g = g * min(1.0, CLIP / max(norm, 1e-12))
            m += (1.0 - DECAY[0]) * (g - m)
            v += (1.0 - DECAY[1]) * (g**2 - v)
            part -= now * (m / (1.0 - DECAY[0] ** (k + 1))) / (np.sqrt(v / (1.0 - DECAY[1] ** (k + 1))) + 1e-8)
    return weights, losses


def errors(weights: Weights, run: Array) -> Array:
    """(N, S) of each row against what the rows before it let expect; the first is zero."""
    h, c = np.zeros((1, weights.cells)), np.zeros((1, weights.cells))
    result = np.zeros_like(run)
    for t in range(len(run) - 1):
        y, h, c, _, _ = step(weights, run[t : t + 1], h, c)
        result[t + 1] = run[t + 1] - y[0]
    return result
