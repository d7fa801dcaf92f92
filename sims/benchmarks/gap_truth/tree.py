"""Rigid-body mechanics of a serial chain for many samples at once, to work out what explanations look like.

Written out from Newton's and Euler's laws, all in the base's axes; a test holds it to MuJoCo's inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap_truth.chain import GRAVITY, Chain

Array = npt.NDArray[np.float64]

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Frames:
    """Where the links are and how they move, per link: lists of (N, …), in base axes.

    Attributes:
        R: orientations (N, 3, 3).
        p: origins (N, 3) [m].
        axis: of the joints (N, 3).
        w: angular velocities (N, 3) [rad/s].
        dw: angular accelerations (N, 3) [rad/s²].
        a: of the origins, less gravity (N, 3) [m/s²].
    """

    R: list[Array]
    p: list[Array]
    axis: list[Array]
    w: list[Array]
    dw: list[Array]
    a: list[Array]


def frames(chain: Chain, q: Array, v: Array, a: Array, gravity: Array = GRAVITY) -> Frames:
    """For positions, velocities and accelerations, each (N, n)."""
    count = len(q)
    R, p = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
    w, dw = np.zeros((count, 3)), np.zeros((count, 3))
    acceleration = np.broadcast_to(-gravity, (count, 3))
    result = Frames([], [], [], [], [], [])
    for k, link in enumerate(chain.links):
        arm = R @ link.position
        acceleration = acceleration + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
        p = p + arm
        R = R @ link.rotation @ _turn(link.axis, q[:, k])
        axis = R @ link.axis
        rate = axis * v[:, k, None]
        dw = dw + axis * a[:, k, None] + np.cross(w, rate)
        w = w + rate
        for target, value in zip(
            (result.R, result.p, result.axis, result.w, result.dw, result.a),
            (R, p, axis, w, dw, acceleration),
            strict=True,
        ):
            target.append(value)
    return result


def _turn(axis: Array, angle: Array) -> Array:
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))


def _wrench(f: Frames, k: int, mass: float, h: Array, inertia: Array) -> tuple[Array, Array]:
    """Force and moment about the origin that link k needs: h = mass × com and inertia about the origin, its axes."""
    R = f.R[k]
    h = R @ h
    tensor = R @ inertia @ np.swapaxes(R, 1, 2)
    force = mass * f.a[k] + np.cross(f.dw[k], h) + np.cross(f.w[k], np.cross(f.w[k], h))
    spin = np.einsum("nij,nj->ni", tensor, f.w[k])
    moment = np.cross(h, f.a[k]) + np.einsum("nij,nj->ni", tensor, f.dw[k]) + np.cross(f.w[k], spin)
    return force, moment


def _torques(f: Frames, k: int, force: Array, moment: Array, n: int) -> Array:
    """What the joints up to k give for a wrench at link k's origin (N, n)."""
    result = np.zeros((len(force), n))
    for i in range(k + 1):
        result[:, i] = np.einsum("nj,nj->n", f.axis[i], moment + np.cross(f.p[k] - f.p[i], force))
    return result


def inverse_dynamics(chain: Chain, f: Frames, a: Array | None = None) -> Array:
    """Torques (N, n) [N·m]; with the rotors where accelerations `a` (N, n) are given."""
    total = np.zeros((len(f.p[0]), chain.n)) if a is None else a * chain.column("rotor")
    for k, link in enumerate(chain.links):
        com = link.com
        tensor = link.inertia + link.mass * (com @ com * np.eye(3) - np.outer(com, com))
        total += _torques(f, k, *_wrench(f, k, link.mass, link.mass * com, tensor), chain.n)
    return total


def regressor(chain: Chain, f: Frames, k: int) -> Array:
    """(N, n, 10) torque per mass, mass × com and inertia about the origin (xx, yy, zz, xy, xz, yz) of link k."""
    columns = []
    for index in range(10):
        mass, h, tensor = 0.0, np.zeros(3), np.zeros((3, 3))
        if index == 0:
            mass = 1.0
        elif index < 4:
            h[index - 1] = 1.0
        else:
            i, j = PAIRS[index - 4]
            tensor[i, j] = tensor[j, i] = 1.0
        columns.append(_torques(f, k, *_wrench(f, k, mass, h, tensor), chain.n))
    return np.stack(columns, axis=-1)


def pushes(chain: Chain, f: Frames, k: int) -> Array:
    """(N, n, 6) torque that the motors are spared per force (3) and moment (3) on link k's origin, base axes."""
    count = len(f.p[0])
    columns = []
    for index in range(6):
        unit = np.zeros((count, 3))
        unit[:, index % 3] = 1.0
        zero = np.zeros((count, 3))
        columns.append(_torques(f, k, *((unit, zero) if index < 3 else (zero, unit)), chain.n))
    return -np.stack(columns, axis=-1)
