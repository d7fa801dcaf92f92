"""An arm's bodies and joints, and where they are at many positions at once.

The loop runs over joints, and the samples are a vector. All spatial vectors are taken about the world's origin and
expressed in W, so that sums along the tree are products with its ancestor matrix (Featherstone, *Rigid Body Dynamics
Algorithms*, 2008, ch. 5 and 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

Motion = tuple[Array, Array, Array]
"""Of all bodies: angular velocity, angular acceleration, and acceleration of Mo less gravity, each (3, n, N), in W."""


@dataclass(frozen=True)
class KinematicTree:
    """The arm as n bodies, body i moved by joint i, with the constants of each.

    Attributes:
        parent: (n,) index of the body that joint i hangs on, -1 for the world.
        revolute: (n,) whether joint i turns (else it slides).
        axis: (n, 3) its axis in frame M_i.
        R_PF: (n, 3, 3), p_PF: (n, 3): joint i's fixed frame in its parent body's frame M.
        inertia: (n, 10) mass, mass × centre (3), inertia about Mo (xx, yy, zz, xy, xz, yz), in M_i [kg, kg·m, kg·m²].
        rotor: (n,) reflected rotor inertia [kg·m²] (kg where the joint slides).
        damping: (n,) [N·m·s/rad].
        stiffness: (n,), rest: (n,): of springs that the description holds [N·m/rad], [rad].
        gravity: (3,) in W [m/s²].
        link: name of each body's own link, the child link of joint i.
    """

    parent: npt.NDArray[np.int64]
    revolute: npt.NDArray[np.bool_]
    axis: Array
    R_PF: Array
    p_PF: Array
    inertia: Array
    rotor: Array
    damping: Array
    stiffness: Array
    rest: Array
    gravity: Array
    link: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.parent)

    @cached_property
    def ancestors(self) -> Array:
        """(n, n): 1 where joint j moves body i."""
        result = np.eye(self.n)
        for i in self.outward:
            if self.parent[i] >= 0:
                result[i] += result[self.parent[i]]
        return result

    @cached_property
    def outward(self) -> list[int]:
        """The joints with each after its parent, however the user orders them."""

        def depth(i: int) -> int:
            return 0 if self.parent[i] < 0 else 1 + depth(int(self.parent[i]))

        return sorted(range(self.n), key=depth)

    @cached_property
    def turns(self) -> Array:
        """(n, 9, 3): R_PF [1, K, K²], transposed, with K the cross product with the axis; for Rodrigues' formula."""
        result = []
        for R, axis in zip(self.R_PF, self.axis, strict=True):
            K = _skew(axis)
            result.append((R @ np.hstack([np.eye(3), K, K @ K])).T)
        return np.array(result)


@dataclass(frozen=True)
class Kinematics:
    """Positions of all bodies; arrays are (3, n, N), so that each component is contiguous over the samples."""

    tree: KinematicTree
    ancestors: Array
    R: Array  # (3, 3, n, N) R_WM
    p: Array  # (3, n, N) p_WMo
    angular: Array  # (3, n, N) joint axes as spatial vectors about Wo
    linear: Array

    @staticmethod
    def of(tree: KinematicTree, q: Array) -> Kinematics:
        """Return a tree's kinematics at positions (n, N)."""
        n, samples = q.shape
        R = np.empty((n, 3, 3, samples))
        p: Array = np.empty((n, 3, samples))
        z: Array = np.empty((n, 3, samples))
        world_R = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, samples))
        for i in tree.outward:
            parent = tree.parent[i]
            R_WP = R[parent] if parent >= 0 else world_R
            p_WP = p[parent] if parent >= 0 else np.zeros((3, 1))
            if tree.revolute[i]:  # three constant products instead of one with a matrix per sample
                parts = np.matmul(tree.turns[i], R_WP)
                R[i] = parts[:, 0:3] + np.sin(q[i]) * parts[:, 3:6] + (1.0 - np.cos(q[i])) * parts[:, 6:9]
                p[i] = p_WP + np.matmul(tree.p_PF[i], R_WP)
            else:
                R[i] = np.matmul(tree.R_PF[i].T, R_WP)
                p[i] = p_WP + np.matmul(tree.p_PF[i], R_WP) + np.matmul(tree.axis[i], R[i]) * q[i]
            z[i] = np.matmul(tree.axis[i], R[i])
        p = np.ascontiguousarray(p.transpose(1, 0, 2))
        z = np.ascontiguousarray(z.transpose(1, 0, 2))
        turns = tree.revolute[:, None]
        return Kinematics(
            tree,
            tree.ancestors,
            np.ascontiguousarray(R.transpose(1, 2, 0, 3)),
            p,
            np.where(turns, z, 0.0),
            np.where(turns, cross(p, z), z),
        )

    def moments(self) -> tuple[Array, Array]:
        """Return the first moments (3, n, N) and inertia tensors (3, 3, n, N) about Mo, in W."""
        h = np.einsum("abin,ib->ain", self.R, self.tree.inertia[:, 1:4])
        xx, yy, zz, xy, xz, yz = self.tree.inertia[:, 4:].T
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        RI = np.einsum("abin,bci->acin", self.R, tensor)
        return h, np.einsum("acin,bcin->abin", RI, self.R)

    def accelerations(self, v: Array, a: Array | None, gravity: Array) -> Motion:
        """Return angular velocity, angular acceleration, and acceleration of Mo less gravity, each (3, n, N)."""
        angular_rate, linear_rate = self.angular * v, self.linear * v
        w = self.ancestors @ angular_rate
        v_O = self.ancestors @ linear_rate
        angular_change, linear_change = cross(w, angular_rate), cross(v_O, angular_rate) + cross(w, linear_rate)
        if a is not None:
            angular_change += self.angular * a
            linear_change += self.linear * a
        alpha = self.ancestors @ angular_change
        a_O = self.ancestors @ linear_change - gravity[:, None, None]
        a_M = a_O + cross(alpha, self.p) + cross(w, v_O + cross(w, self.p))
        return w, alpha, a_M

    def inverse_dynamics(self, v: Array, a: Array | None, gravity: Array) -> Array:
        """Return the joint torques (n, N) of the bodies alone."""
        return self.torques(self.accelerations(v, a, gravity))

    def torques(self, motion: Motion) -> Array:
        """Return the joint torques (n, N) of the bodies alone, by what `accelerations` returns."""
        w, alpha, a_M = motion
        h, tensor = self.moments()
        force = self.tree.inertia[:, 0, None] * a_M + cross(alpha, h) + cross(w, cross(w, h))
        moment = _apply(tensor, alpha) + cross(w, _apply(tensor, w)) + cross(h, a_M) + cross(self.p, force)
        return self.project(self.ancestors.T @ moment, self.ancestors.T @ force)

    def project(self, moment: Array, force: Array) -> Array:
        """Return the joint torques (n, N) of spatial forces about Wo, one per body with all that it carries."""
        return np.einsum("ain,ain->in", self.angular, moment) + np.einsum("ain,ain->in", self.linear, force)

    def mass_matrix(self) -> Array:
        """Return (n, n, N), by composite bodies."""
        m = self.tree.inertia[:, 0, None]
        h, tensor = self.moments()
        h_O = h + m * self.p
        outer = np.einsum("ain,bin->abin", self.p, 2.0 * h + m * self.p)
        tensor_O = tensor - 0.5 * (outer + outer.transpose(1, 0, 2, 3))
        tensor_O[range(3), range(3)] += np.einsum("ain,ain->in", self.p, 2.0 * h + m * self.p)
        below = self.ancestors.T
        m, h_O, tensor_O = below @ m, below @ h_O, below @ tensor_O
        momentum = m * self.linear + cross(self.angular, h_O)
        angular_momentum = _apply(tensor_O, self.angular) + cross(h_O, self.linear)
        full = np.einsum("ain,ajn->ijn", angular_momentum, self.angular)
        full += np.einsum("ain,ajn->ijn", momentum, self.linear)
        lower = full * self.ancestors[:, :, None]
        diagonal = lower[range(self.tree.n), range(self.tree.n)].copy()
        result = lower + lower.transpose(1, 0, 2)
        result[range(self.tree.n), range(self.tree.n)] = diagonal
        return result

    def regressor(self, v: Array, a: Array, gravity: Array, body: int) -> Array:
        """Return (n, 10, N) of one body."""
        return self.shares(self.accelerations(v, a, gravity), body)

    def shares(self, motion: Motion, body: int) -> Array:
        """Return `regressor` (n, 10, N) of one body, by what `accelerations` returns."""
        w, alpha, a_M = (x[:, body] for x in motion)
        R = self.R[:, :, body]
        samples = w.shape[-1]
        force = np.zeros((3, 10, samples))
        moment = np.zeros((3, 10, samples))
        force[:, 0] = a_M
        for k in range(3):  # a first moment along axis k
            axis = R[:, k]
            force[:, 1 + k] = cross(alpha, axis) + cross(w, cross(w, axis))
            moment[:, 1 + k] = cross(axis, a_M)
        local_alpha, local_w = np.einsum("ban,bn->an", R, alpha), np.einsum("ban,bn->an", R, w)
        for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
            unit = np.zeros((3, 3))
            unit[i, j] = unit[j, i] = 1.0
            local = unit @ local_alpha + cross(local_w, unit @ local_w)
            moment[:, 4 + k] = np.einsum("abn,bn->an", R, local)
        moment += cross(np.broadcast_to(self.p[:, body, None], force.shape), force)
        moved = self.ancestors[body][:, None, None]
        return moved * (np.einsum("ain,akn->ikn", self.angular, moment) + np.einsum("ain,akn->ikn", self.linear, force))


def cross(a: Array, b: Array) -> Array:
    """Return products of vectors (3, …)."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    np.subtract(a[1] * b[2], a[2] * b[1], out=result[0])
    np.subtract(a[2] * b[0], a[0] * b[2], out=result[1])
    np.subtract(a[0] * b[1], a[1] * b[0], out=result[2])
    return result


def _apply(tensor: Array, vector: Array) -> Array:
    return np.einsum("abin,bin->ain", tensor, vector)


def _skew(axis: Array) -> Array:
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
