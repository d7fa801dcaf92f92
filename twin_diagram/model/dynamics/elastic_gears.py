"""How a yielding gear twists while its motor moves as measured.

With the link at q = θ + e behind a motor at θ, and τ the torque that the link would need if it followed rigidly,

    M ë + loss K ė + K e = −τ(θ)    for a spring,        e within ± gap / 2, without rebound, for play,

M being the links' mass matrix at the joints that yield (Spong 1987, with the motors' motion prescribed). What the
motors must give beyond the rigid arm's torque is M ë, and what gravity changes at θ + e. Springs alone are integrated
by a Gauss method, which neither damps nor blows up; play, and springs beside it, by steps with impulses at its ends.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from twin_diagram.model.dynamics.backlash import play
from twin_diagram.model.effects.elasticity import TUNING as ELASTICITY
from twin_diagram.model.effects.elasticity import Gear
from twin_diagram.model.rigid_body.rigid_tree import RigidTree
from twin_diagram.signals.arrays import Array

LinkLoad = Callable[[Array, Array, Array], Array]
"""(q, v, a), each (N, n), to the torque (N, n) of what lies behind the gears; `TorqueLaw.link_load`."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: fewer passes or coarser steps would show in the tests of gears."""

    passes: int = 2
    """Passes over a motion with play: gravity at the twisted gear is that of the pass before."""

    spring_passes: int = 3
    """Bound on Newton's passes over a motion of springs alone."""

    linearised: int = 2
    """Of them, those that work the load's derivatives out anew."""

    settled: float = 3e-4
    """Passes end where the load is what it was foreseen to be, to this part of what the gears change."""

    tiny: float = 1e-5
    """Step of the load's derivatives [rad], [rad/s]."""

    coarsest: float = 0.004
    """Steps of springs alone are no longer than this [s],"""

    fine: float = 0.35
    """nor than this part of a swing [rad]."""

    farthest: float = 0.7
    """Twists beyond this are no gear's [rad]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Twist:
    """Twists of the joints that yield.

    Attributes:
        angle: (N, s) link less motor [rad].
        rate: (N, s) [rad/s].
        torque: (N, n) what the motors must give beyond the rigid arm's torque [N·m].
    """

    angle: Array
    rate: Array
    torque: Array


class Untwisted:
    """What links need along one motion while no gear has twisted: the same whatever a gear's stiffness, loss and gap.

    One serves one motion, and an arm that differs in its yielding gears alone; it remembers what was worked out.

    Attributes:
        roughly: springs alone are as a first pass foresees them, where only which of them suits best is asked.
    """

    def __init__(self) -> None:
        """Start with nothing."""
        self.roughly = False
        self._known: dict[tuple[object, ...], tuple[Array, ...]] = {}

    def rough(self) -> Untwisted:
        """Return what shares all that is remembered, and has springs worked out roughly."""
        result = copy(self)
        result.roughly = True
        return result

    def once(self, key: tuple[object, ...], work: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        """Return what `work` does, of a key's first call; not to be changed."""
        if key not in self._known:
            self._known[key] = work()
        return self._known[key]


@dataclass(frozen=True)
class YieldingJoints:
    """Joints whose gears yield, and how.

    Attributes:
        joints: (s,) their columns in the arm's arrays.
        stiffness: (s,) infinite where there is play alone [N·m/rad].
        half: (s,) half of the play, zero where there is a spring alone [rad].
        loss: (s,) damping over stiffness [s].
    """

    joints: npt.NDArray[np.int64]
    stiffness: Array
    half: Array
    loss: Array

    def __len__(self) -> int:
        return len(self.joints)

    def chosen(self, which: npt.NDArray[np.bool_]) -> YieldingJoints:
        """Return those of them for which `which` (s,) holds."""
        return YieldingJoints(self.joints[which], self.stiffness[which], self.half[which], self.loss[which])


def in_series(gears: list[tuple[int, Gear]]) -> YieldingJoints:
    """Add up the compliances and gaps of each joint's gears; their losses weigh as their compliances do.

    Args:
        gears: each with the column of its joint.
    """
    joints = sorted({joint for joint, _ in gears})
    compliance = np.array([sum(1.0 / gear.stiffness for j, gear in gears if j == joint) for joint in joints])
    half = np.array([0.5 * sum(gear.gap for j, gear in gears if j == joint) for joint in joints])
    lost = np.array([sum(gear.loss / gear.stiffness for j, gear in gears if j == joint) for joint in joints])
    loss = np.divide(lost, compliance, out=np.full(len(joints), ELASTICITY.loss), where=compliance > 0.0)
    with np.errstate(divide="ignore"):
        return YieldingJoints(np.array(joints, dtype=np.int64), 1.0 / compliance, half, loss)


def twist(
    tree: RigidTree,
    link_load: LinkLoad,
    gears: YieldingJoints,
    motion: tuple[Array, Array, Array],
    period: float,
    beyond: Array | None = None,
    bare: Untwisted | None = None,
) -> Twist:
    """Work out the twists for a motion sampled at a constant rate.

    Args:
        tree: of the arm's bodies and rotors.
        link_load: the torque of what lies behind the gears.
        gears: that yield.
        motion: the motors' true positions, velocities and accelerations, each (N, n) [rad, rad/s, rad/s²].
        period: between samples [s].
        beyond: (N, n) what the motors gave beyond the rigid arm's torque, as measured [N·m]: it tells how the gears
            swung when the motion began, which the motors' motion does not. None: they begin with the least swing.
        bare: of the same motion, where other gears are tried on it, too.
    """
    q, v, a = motion
    joints, stiffness, half = gears.joints, gears.stiffness, gears.half
    bare = bare or Untwisted()
    calm = np.isfinite(stiffness) & (half == 0.0)
    begin = np.full((2, len(joints)), np.nan)
    if np.any(calm):
        alone = _coarsely(tree, link_load, gears.chosen(calm), motion, period, beyond, bare)
        if np.all(calm):
            return alone
        # Springs that begin at rest would ring for as long as they are damped.
        begin[:, calm] = alone.angle[0], alone.rate[0]
    columns, rigid = bare.once((*joints, "play"), lambda: (_links_mass(tree, q)[:, :, joints], link_load(q, v, a)))
    block = columns[:, joints]
    load = rigid
    slope = np.zeros_like(columns)
    angle = np.zeros((len(q), len(joints)))

    def turned(angle: Array) -> Array:
        twisted = q.copy()
        twisted[:, joints] += angle
        return link_load(twisted, v, a)

    for k in np.flatnonzero(calm):  # gravity that turns with a link shifts the frequency at which it swings
        slope[:, :, k] = (turned(TUNING.tiny * np.eye(len(joints))[k]) - rigid) / TUNING.tiny
    for _ in range(TUNING.passes):
        at_zero = (load - _times(slope, angle))[:, joints]
        angle, rate, acceleration = play(
            block, at_zero, stiffness, half, gears.loss, period, begin, slope[:, joints] if np.any(calm) else None
        )
        load = turned(angle)
    torque = np.einsum("kis,ks->ki", columns, acceleration) + load - rigid
    return Twist(angle, rate, torque)


def _coarsely(
    tree: RigidTree,
    link_load: LinkLoad,
    springs: YieldingJoints,
    motion: tuple[Array, Array, Array],
    period: float,
    beyond: Array | None,
    bare: Untwisted,
) -> Twist:
    """Springs at no finer steps than their swing needs: a smooth motion at 1 kHz is the same at 250 Hz."""
    q, v, a = motion
    joints, stiffness = springs.joints, springs.stiffness
    inertia = tree.mass_matrix(q[:: max(1, len(q) // 20)])
    links = np.diagonal(inertia, axis1=1, axis2=2)[:, joints] - tree.rotor[joints]
    fastest = float(np.max(np.sqrt(stiffness / np.maximum(np.min(links, axis=0), 1e-6))))
    stride = int(min(TUNING.coarsest, TUNING.fine / fastest) / period + 1e-6)
    if stride < 2 or len(q) < 50 * stride:
        return _springs(tree, link_load, springs, motion, period, beyond, bare)
    index = np.arange(0, len(q), stride)
    thin = None if beyond is None else beyond[index]
    found = _springs(tree, link_load, springs, (q[index], v[index], a[index]), stride * period, thin, bare)
    rows = np.arange(len(q))
    whole = (scipy.interpolate.CubicSpline(index, signal)(rows) for signal in (found.angle, found.rate, found.torque))
    return Twist(*whole)


def _springs(
    tree: RigidTree,
    link_load: LinkLoad,
    springs: YieldingJoints,
    motion: tuple[Array, Array, Array],
    h: float,
    beyond: Array | None,
    bare: Untwisted,
) -> Twist:
    """Newton's method on the whole motion: the links' load is linearised about the twists of the pass before.

    Each pass solves M ë + (loss K + C) ė + (K + G) e = what is left of the load, C and G being the load's derivatives.
    Gravity that turns with the link shifts the frequency at which it swings, so that substituting twists alone would
    take as many passes as there are swings.
    """
    q, v, a = motion
    joints, stiffness, loss = springs.joints, springs.stiffness, springs.loss
    s = len(joints)
    diagonal = np.arange(s)
    key = (*joints, len(q))
    (rigid,) = bare.once((*key, "load"), lambda: (link_load(q, v, a),))
    angle: Array
    rate: Array
    acceleration: Array
    angle, rate, acceleration = (np.zeros((len(q), s)) for _ in range(3))

    def link(e: Array, de: Array, dde: Array) -> Array:
        moved = q.copy(), v.copy(), a.copy()
        for signal, more in zip(moved, (e, de, dde), strict=True):
            signal[:, joints] += more
        return link_load(*moved)

    def linearised(load: Array) -> tuple[Array, Array, Array]:
        twisted = q.copy()
        twisted[:, joints] += angle
        M = _links_mass(tree, twisted)[:, :, joints]
        return M, *_derivatives(link, load, (angle, rate, acceleration), np.empty_like(M))

    load = rigid
    for number in range(TUNING.spring_passes):
        if number < TUNING.linearised:
            M, G, C = linearised(load) if number else bare.once((*key, "slopes"), lambda: linearised(rigid))
            whole = G[:, joints].copy(), C[:, joints].copy()
            whole[0][:, diagonal, diagonal] += stiffness
            whole[1][:, diagonal, diagonal] += loss * stiffness
        rest = load - _times(M, acceleration) - _times(C, rate) - _times(G, angle)
        states = _linear(M[:, joints], whole[1], whole[0], -rest[:, joints], h)
        torque = np.einsum("kis,ksm->kim", np.concatenate([G, C, M], axis=2), states)
        torque[:, :, 0] += rest - rigid
        states = states[:, :, 0] + states[:, :, 1:] @ _start(states, torque, -load[:, joints] / stiffness, beyond)
        angle, rate, acceleration = states[:, :s], states[:, s : 2 * s], states[:, 2 * s :]
        if np.max(np.abs(angle)) > TUNING.farthest:  # a gear that folds over is beyond any linearisation
            scale = TUNING.farthest / np.max(np.abs(angle))
            angle, rate, acceleration = scale * angle, scale * rate, scale * acceleration
        foreseen = rest + _times(M, acceleration) + _times(C, rate) + _times(G, angle)
        load = foreseen if bare.roughly else link(angle, rate, acceleration)
        if bare.roughly or np.linalg.norm(load - foreseen) < TUNING.settled * np.linalg.norm(load - rigid):
            break
    return Twist(angle, rate, load - rigid)


def _links_mass(tree: RigidTree, q: Array) -> Array:
    """Return mass matrices (N, n, n) without rotors."""
    mass = tree.mass_matrix(q)
    mass[:, range(tree.n), range(tree.n)] -= tree.rotor
    return mass


def _derivatives(link: LinkLoad, load: Array, twist: tuple[Array, Array, Array], like: Array) -> tuple[Array, Array]:
    """Return the links' load (N, n) differentiated by the gears' angles and rates (N, s), each as `like` (N, n, s)."""
    angle, rate, acceleration = twist
    G, C = np.empty_like(like), np.empty_like(like)
    for k in range(angle.shape[1]):
        more = np.zeros(angle.shape)
        more[:, k] = TUNING.tiny
        G[:, :, k] = (link(angle + more, rate, acceleration) - load) / TUNING.tiny
        C[:, :, k] = (link(angle, rate + more, acceleration) - load) / TUNING.tiny
    return G, C


def _linear(M: Array, D: Array, K: Array, force: Array, h: float) -> Array:
    """M ë + D ė + K e = force (N, s), from rest and freely from each unit of the start: (N, 3s, 1 + 2s) of e, ė, ë.

    Steps are those of the two-stage Gauss method, with coefficients of the step's middle and a force that is linear in
    time: of fourth order, neither damped nor unstable however stiff the springs.
    """
    samples, s = force.shape
    inverse: Any = np.linalg.inv(M)
    A = np.zeros((samples, 2 * s, 2 * s))
    A[:, :s, s:] = np.eye(s)
    A[:, s:, :s], A[:, s:, s:] = -inverse @ K, -inverse @ D
    b = np.zeros((samples, 2 * s))
    b[:, s:] = _times(inverse, force)
    m = 2 * s + 2
    Z = np.zeros((samples - 1, m, m))  # of (e, ė, 1, share of the step)
    Z[:, : 2 * s, : 2 * s] = 0.5 * h * (A[1:] + A[:-1])
    Z[:, : 2 * s, 2 * s] = h * b[:-1]
    Z[:, : 2 * s, 2 * s + 1] = h * (b[1:] - b[:-1])
    Z[:, 2 * s + 1, 2 * s] = 1.0
    square = Z @ Z / 12.0
    onward: Any = np.linalg.solve(np.eye(m) - 0.5 * Z + square, np.eye(m) + 0.5 * Z + square)
    state = _onward(onward[:, : 2 * s, : 2 * s + 1])
    acceleration = np.matmul(A[:, s:], state)
    acceleration[:, :, 0] += b[:, s:]
    return np.concatenate([state, acceleration], axis=1)


def _onward(steps: Array) -> Array:
    """Return (N, m, 1 + m) where x ↦ Φ x + d leads, step by step: from rest, and freely from each unit of the start.

    Steps of stretches of a square root of their number are put together side by side, then stretch after stretch.

    Args:
        steps: (N − 1, m, m + 1) each with Φ and then d.
    """
    count, m = len(steps), steps.shape[1]
    length = max(1, int(np.sqrt(count)))
    stretches = -(-count // length)
    whole = np.zeros((stretches * length, m + 1, m + 1))
    whole[:, range(m + 1), range(m + 1)] = 1.0
    whole[:count, :m] = steps
    along = whole.reshape(stretches, length, m + 1, m + 1)
    for k in range(1, length):
        along[:, k] = along[:, k] @ along[:, k - 1]
    for k in range(1, stretches):
        along[k] = along[k] @ along[k - 1, -1]
    result = np.concatenate([np.eye(m, m + 1)[None], whole[:count, :m]])
    return np.roll(result, 1, axis=2)


def _start(states: Array, torque: Array, calm: Array, beyond: Array | None) -> Array:
    """Return (2s,) how the gears' motion begins.

    That which the measured torque asks for, else that which swings least.
    """
    s = calm.shape[1]
    if beyond is None:
        A, y = states[:, :s, 1:].reshape(-1, 2 * s), (calm - states[:, :s, 0]).ravel()
    else:
        scale = np.median(np.abs(np.diff(beyond, 2, axis=0)), axis=0)
        scale = 1.0 / np.maximum(scale, 1e-3 * np.max(scale) + 1e-12)
        A = (torque[:, :, 1:] * scale[:, None]).reshape(-1, 2 * s)
        y = ((beyond - torque[:, :, 0]) * scale).ravel()
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(A / size, y, rcond=1e-9)[0] / size)


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("kis,ks->ki", matrix, vector))
