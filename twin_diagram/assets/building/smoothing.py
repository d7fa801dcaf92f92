"""Meshes smoothed without shrinking and without rounding edges off.

Taubin's λ|μ steps (SIGGRAPH 1995) with SyncTwin's gate (section III-B, mesh simplification): a neighbour counts, w_ij
= 1, where the two vertices' normals differ by no more than a threshold, θ_ij = arccos(n_iᵀ n_j) ≤ θ_th, and else not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

from twin_diagram.signals.arrays import Array

Faces = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Tuning:
    """Constants of the smoothing; the gate is the paper's."""

    gate: float = float(np.radians(30.0))
    """Largest angle between the normals of vertices that smooth each other [rad]."""

    inward: float = 0.5
    """Share λ of the way to the neighbours' mean."""

    outward: float = -0.526
    """Share μ of the way back: 1/λ + 1/μ = 0.1, the pass band's edge that Taubin gives."""

    normal_rounds: int = 3
    """Times that normals are averaged over neighbours within 1½ gates before they gate: single ones are rough."""


TUNING = Tuning()


def edges_of(faces: Faces) -> Faces:
    """Return each edge once, (E, 2), the lower index first."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    count = int(faces.max()) + 1
    key = np.sort(pairs[:, 0] * count + pairs[:, 1])
    key = key[np.append(True, key[1:] != key[:-1])]  # many times faster than `np.unique`
    return np.stack([key // count, key % count], axis=1)


def vertex_normals(vertices: Array, faces: Faces) -> Array:
    """Return (V, 3) unit normals, faces weighted by area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(flat[:, k], 3), minlength=len(vertices)) for k in range(3)], axis=1
    )
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20))


def smoothed(vertices: Array, faces: Faces, rounds: int, gate: float = TUNING.gate) -> Array:
    """Return vertices (V, 3) after `rounds` pairs of steps in and out; faces (F, 3) stay."""
    edges = edges_of(faces)
    count = len(vertices)
    both = np.concatenate([edges, edges[:, ::-1]])

    def mean_of(weights: Array) -> sparse.csr_matrix:
        matrix = sparse.csr_matrix((weights, (both[:, 0], both[:, 1])), shape=(count, count))
        total = np.asarray(matrix.sum(axis=1)).ravel()
        return sparse.diags(1 / np.maximum(total, 1e-12)) @ matrix

    normals = vertex_normals(vertices, faces)
    for _ in range(TUNING.normal_rounds):
        pulls = np.einsum("ei,ei->e", normals[both[:, 0]], normals[both[:, 1]]) > np.cos(1.5 * gate)
        normals = normals + mean_of(pulls.astype(float)) @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    alike = np.einsum("ei,ei->e", normals[both[:, 0]], normals[both[:, 1]]) >= np.cos(gate)
    gated = mean_of(alike.astype(float))
    lonely = np.asarray(gated.sum(axis=1)).ravel() < 0.5
    out = vertices.copy()
    for _ in range(rounds):
        for share in (TUNING.inward, TUNING.outward):
            step = gated @ out - out
            step[lonely] = 0
            out = out + share * step
    return out
