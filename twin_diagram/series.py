"""How a yielding gear twists while its motor moves as measured.

With the link at q = θ + e behind a motor at θ, and τ the torque that the link would need if it followed rigidly,

    M ë + loss K ė + K e = −τ(θ)    for a spring,        e within ± gap / 2, without rebound, for play,

M being the links' mass matrix at the joints that yield (Spong 1987, with the motors' motion prescribed). What the
motors must give beyond the rigid arm's torque is M ë, and what gravity changes at θ + e. Springs alone are integrated
by a Gauss method, which neither damps nor blows up; play, and springs beside it, by steps with impulses at its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import mul
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from twin_diagram.effects.elasticity import LOSS, Gear

if TYPE_CHECKING:
    from twin_diagram.model import Model

Array = npt.NDArray[np.float64]
Rows = list[list[list[float]]]
"""Of a matrix per sample."""

Springs = tuple[npt.NDArray[np.int64], Array, Array]
"""Joints, stiffness and loss, each (s,)."""

LONGEST_STEP = 0.001
"""Samples farther apart than this are integrated in several steps where there is play [s]."""

FOLLOWED = 0.5
"""Springs that swing through less than this in a step are followed [rad]."""

PASSES = 2
"""Gravity at the twisted gear is worked out from the pass before."""

SPRING_PASSES = 3
LINEARISED = 2
"""Of them, those that work the load's derivatives out anew."""

SETTLED = 3e-4
"""Passes end where the load is what it was foreseen to be, to this part of what the gears change."""

TINY = 1e-5
"""Step of the load's derivatives [rad], [rad/s]."""

COARSEST = 0.004
"""Steps are no longer than this [s],"""

FINE = 0.35
"""nor than this part of a swing [rad]."""

FARTHEST = 0.7
"""Twists beyond this are no gear's [rad]."""


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


def merged(gears: list[tuple[int, Gear]]) -> tuple[tuple[npt.NDArray[np.int64], Array, Array], Array]:
    """Joints that yield, with the stiffness and half the play of each: compliances and gaps in series add up.

    Beside them the loss of each, as compliances weigh it.
    """
    joints = sorted({joint for joint, _ in gears})
    compliance = np.array([sum(1.0 / gear.stiffness for j, gear in gears if j == joint) for joint in joints])
    half = np.array([0.5 * sum(gear.gap for j, gear in gears if j == joint) for joint in joints])
    lost = np.array([sum(gear.loss / gear.stiffness for j, gear in gears if j == joint) for joint in joints])
    loss = np.divide(lost, compliance, out=np.full(len(joints), LOSS), where=compliance > 0.0)
    with np.errstate(divide="ignore"):
        return (np.array(joints, dtype=np.int64), 1.0 / compliance, half), loss


def twist(model: Model, q: Array, v: Array, a: Array, period: float, beyond: Array | None = None) -> Twist:
    """Twists for a motion sampled at a constant rate.

    Args:
        model: without onsets, with gears that yield.
        q: (N, n) the motors' true positions [rad].
        v: (N, n) [rad/s].
        a: (N, n) [rad/s²].
        period: between samples [s].
        beyond: (N, n) what the motors gave beyond the rigid arm's torque, as measured [N·m]: it tells how the gears
            swung when the motion began, which the motors' motion does not. None: they begin with the least swing.
    """
    joints, stiffness, half = model.yielding
    calm = np.isfinite(stiffness) & (half == 0.0)
    springs: Springs = joints[calm], stiffness[calm], model.loss[calm]
    begin = np.full((2, len(joints)), np.nan)
    if np.any(calm):
        alone = _coarsely(model, q, v, a, period, springs, beyond)
        if np.all(calm):
            return alone
        # Springs that begin at rest would ring for as long as they are damped.
        begin[:, calm] = alone.angle[0], alone.rate[0]
    mass = model.tree.mass_matrix(q)
    mass[:, range(model.tree.n), range(model.tree.n)] -= model.tree.rotor
    columns = mass[:, :, joints]
    block = columns[:, joints]
    rigid = load = model.link_load(q, v, a)
    slope = np.zeros_like(columns)
    angle = np.zeros((len(q), len(joints)))

    def turned(angle: Array) -> Array:
        twisted = q.copy()
        twisted[:, joints] += angle
        return model.link_load(twisted, v, a)

    for k in np.flatnonzero(calm):  # gravity that turns with a link shifts the frequency at which it swings
        slope[:, :, k] = (turned(TINY * np.eye(len(joints))[k]) - rigid) / TINY
    for _ in range(PASSES):
        at_zero = (load - _times(slope, angle))[:, joints]
        angle, rate, acceleration = play(
            block, at_zero, stiffness, half, model.loss, period, begin, slope[:, joints] if np.any(calm) else None
        )
        load = turned(angle)
    torque = np.einsum("kis,ks->ki", columns, acceleration) + load - rigid
    return Twist(angle, rate, torque)


def _coarsely(
    model: Model, q: Array, v: Array, a: Array, period: float, springs: Springs, beyond: Array | None
) -> Twist:
    """Springs at no finer steps than their swing needs: a smooth motion at 1 kHz is the same at 250 Hz."""
    joints, stiffness, _ = springs
    inertia = model.tree.mass_matrix(q[:: max(1, len(q) // 20)])
    links = np.diagonal(inertia, axis1=1, axis2=2)[:, joints] - model.tree.rotor[joints]
    fastest = float(np.max(np.sqrt(stiffness / np.maximum(np.min(links, axis=0), 1e-6))))
    stride = int(min(COARSEST, FINE / fastest) / period + 1e-6)
    if stride < 2 or len(q) < 50 * stride:
        return _springs(model, q, v, a, period, springs, beyond)
    index = np.arange(0, len(q), stride)
    thin = None if beyond is None else beyond[index]
    found = _springs(model, q[index], v[index], a[index], stride * period, springs, thin)
    rows = np.arange(len(q))
    whole = (CubicSpline(index, signal)(rows) for signal in (found.angle, found.rate, found.torque))
    return Twist(*whole)


def _springs(model: Model, q: Array, v: Array, a: Array, h: float, springs: Springs, beyond: Array | None) -> Twist:
    """Newton's method on the whole motion: the links' load is linearised about the twists of the pass before.

    Each pass solves M ë + (loss K + C) ė + (K + G) e = what is left of the load, C and G being the load's derivatives.
    Gravity that turns with the link shifts the frequency at which it swings, so that substituting twists alone would
    take as many passes as there are swings.
    """
    joints, stiffness, loss = springs
    s = len(joints)
    diagonal = np.arange(s)
    rigid = model.link_load(q, v, a)
    angle: Array
    rate: Array
    acceleration: Array
    angle, rate, acceleration = (np.zeros((len(q), s)) for _ in range(3))

    def link(e: Array, de: Array, dde: Array) -> Array:
        moved = q.copy(), v.copy(), a.copy()
        for signal, more in zip(moved, (e, de, dde), strict=True):
            signal[:, joints] += more
        return model.link_load(*moved)

    load = rigid
    for number in range(SPRING_PASSES):
        if number < LINEARISED:
            twisted = q.copy()
            twisted[:, joints] += angle
            M = model.tree.mass_matrix(twisted)
            M[:, range(model.tree.n), range(model.tree.n)] -= model.tree.rotor
            M = M[:, :, joints]
            G, C = np.empty_like(M), np.empty_like(M)
            for k in range(s):
                more = np.zeros((len(q), s))
                more[:, k] = TINY
                G[:, :, k] = (link(angle + more, rate, acceleration) - load) / TINY
                C[:, :, k] = (link(angle, rate + more, acceleration) - load) / TINY
            whole = G[:, joints].copy(), C[:, joints].copy()
            whole[0][:, diagonal, diagonal] += stiffness
            whole[1][:, diagonal, diagonal] += loss * stiffness
        rest = load - _times(M, acceleration) - _times(C, rate) - _times(G, angle)
        states = _linear(M[:, joints], whole[1], whole[0], -rest[:, joints], h)
        torque = np.einsum("kis,ksm->kim", np.concatenate([G, C, M], axis=2), states)
        torque[:, :, 0] += rest - rigid
        states = states[:, :, 0] + states[:, :, 1:] @ _start(states, torque, -load[:, joints] / stiffness, beyond)
        angle, rate, acceleration = states[:, :s], states[:, s : 2 * s], states[:, 2 * s :]
        if np.max(np.abs(angle)) > FARTHEST:  # a gear that folds over is beyond any linearisation
            scale = FARTHEST / np.max(np.abs(angle))
            angle, rate, acceleration = scale * angle, scale * rate, scale * acceleration
        foreseen = rest + _times(M, acceleration) + _times(C, rate) + _times(G, angle)
        load = link(angle, rate, acceleration)
        if np.linalg.norm(load - foreseen) < SETTLED * np.linalg.norm(load - rigid):
            break
    return Twist(angle, rate, load - rigid)


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
    Phi, driven = onward[:, : 2 * s, : 2 * s], onward[:, : 2 * s, 2 * s]
    state = np.zeros((samples, 2 * s, 1 + 2 * s))
    state[0, :, 1:] = np.eye(2 * s)
    for k in range(1, samples):
        np.matmul(Phi[k - 1], state[k - 1], out=state[k])
        state[k, :, 0] += driven[k - 1]
    acceleration = np.matmul(A[:, s:], state)
    acceleration[:, :, 0] += b[:, s:]
    return np.concatenate([state, acceleration], axis=1)


def _start(states: Array, torque: Array, calm: Array, beyond: Array | None) -> Array:
    """(2s,) how the gears' motion begins: that which the measured torque asks for, else that which swings least."""
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


def play(
    mass: Array,
    load: Array,
    stiffness: Array,
    half: Array,
    loss: Array,
    period: float,
    begin: Array | None = None,
    slope: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Twists of gears of which some have play, by steps with impulses, in plain numbers.

    With K the stiffness of the gears that press against their springs, a step is linear: v ← A⁻¹ (M v − h push), with
    A = M + h θ (loss + θ h) diag(K) and push = load + K e + K (1 − θ) (loss + θ h) v. Springs whose swing the steps can
    follow have θ = ½, which does not damp it, the others θ = 1, which does not let it grow. Which gears press changes,
    but seldom: each choice is inverted once for all samples. What impulses change in a sample's speed is shared by the
    two samples about it.

    Args:
        mass: (N, s, s) inertia of what the gears move [kg·m²].
        load: (N, s) torque that moves it [N·m].
        stiffness: (s,), infinite where there is play alone [N·m/rad].
        half: (s,) of the gaps, zero where there is a spring alone [rad].
        loss: (s,) of the springs [s].
        period: between samples [s].
        begin: (2, s) angle and rate at the first sample; NaN, or None: at rest where the load has pushed them.
        slope: (N, s, s) of the load over the gears' angles [N·m/rad]; None: it is given as it is there.

    Returns:
        angle, rate and acceleration, each (N, s).
    """
    samples, s = load.shape
    hard = ~np.isfinite(stiffness)
    if s == 1 and hard[0]:
        alone = play_alone(mass[:, 0, 0], load[:, 0], float(half[0]), period)
        return alone[0][:, None], alone[1][:, None], alone[2][:, None]
    parts = max(1, int(np.ceil(period / LONGEST_STEP - 1e-9)))
    h = period / parts
    shares = [(part + 0.5) / parts for part in range(parts)]
    bounded = np.flatnonzero(hard).tolist()
    springs = np.flatnonzero(~hard & (half == 0.0)).tolist()
    both = np.flatnonzero(~hard & (half > 0.0)).tolist()
    fastest = np.where(hard, 0.0, stiffness) / np.min(np.diagonal(mass, axis1=1, axis2=2), axis=0)
    theta = np.where((half == 0.0) & (h * np.sqrt(fastest) < FOLLOWED), 0.5, 1.0)
    tables: dict[int, tuple[Rows, Rows]] = {}

    def table(pressing: int) -> tuple[Rows, Rows]:
        """A⁻¹ M and h A⁻¹ per sample."""
        chosen = [j in springs or bool(pressing >> j & 1) for j in range(s)]
        firm = np.where(chosen, stiffness, 0.0)
        inverse: Any = np.linalg.inv(mass + np.diag(h * theta * (loss + theta * h) * firm))
        return (inverse @ mass).tolist(), (h * inverse).tolist()

    K, gap, loads, new = np.where(hard, 0.0, stiffness).tolist(), half.tolist(), load.tolist(), theta.tolist()
    slopes = None if slope is None else slope.tolist()
    lossy = (np.where(hard, 0.0, stiffness) * (1.0 - theta) * (loss + theta * h)).tolist()
    e = [-x / k - np.sign(x) * g if k else -np.sign(x) * g for x, k, g in zip(loads[0], K, gap, strict=True)]
    v = [0.0] * s
    if begin is not None:
        e, v = np.where(np.isnan(begin), [e, v], begin).tolist()
    angle, rate = [e], [v]
    for k in range(1, samples):
        for share in shares:
            push = [(1.0 - share) * x + share * y for x, y in zip(loads[k - 1], loads[k], strict=True)]
            if slopes is not None:
                middle = [x + 0.5 * h * y for x, y in zip(e, v, strict=True)]
                push = [x + sum(map(mul, row, middle)) for x, row in zip(push, slopes[k], strict=True)]
            for j in springs:
                push[j] += K[j] * e[j] + lossy[j] * v[j]
            pressing = 0
            for j in both:
                ahead = e[j] + h * v[j]
                if abs(ahead) > gap[j]:
                    push[j] += K[j] * (e[j] - (gap[j] if ahead > 0.0 else -gap[j]))
                    pressing |= 1 << j
            if pressing not in tables:
                tables[pressing] = table(pressing)
            onward, driven = tables[pressing]
            old = v
            v = [
                sum(map(mul, row, v)) - sum(map(mul, other, push))
                for row, other in zip(onward[k], driven[k], strict=True)
            ]
            _keep_within(driven[k], v, [(j, (-gap[j] - e[j]) / h, (gap[j] - e[j]) / h) for j in bounded])
            e = [x + h * (t * y + (1.0 - t) * z) for x, y, z, t in zip(e, v, old, new, strict=True)]
        angle.append(e)
        rate.append(v)
    rates = np.array(rate)
    return np.array(angle), rates, _between(np.diff(rates, axis=0) / period)


def _between(steps: Array) -> Array:
    """Means of the steps (N − 1, s) before and after each of N samples."""
    whole = np.concatenate([steps[:1], steps, steps[-1:]])
    return np.asarray(0.5 * (whole[1:] + whole[:-1]))


def play_alone(mass: Array, load: Array, half: float, period: float) -> tuple[Array, Array, Array]:
    """Twist of one gear with play alone: plain numbers, which are twenty times as fast.

    Args:
        mass: (N,) inertia of what the gear moves [kg·m²].
        load: (N,) torque that moves it [N·m].
        half: of the gap [rad].
        period: between samples [s].

    Returns:
        angle, rate and acceleration, each (N,).
    """
    parts = max(1, int(np.ceil(period / LONGEST_STEP - 1e-9)))
    h = period / parts
    shares = [(part + 0.5) / parts for part in range(parts)]
    pull = (-h * load / mass).tolist()
    e, v = (-half if load[0] > 0.0 else half), 0.0
    angle, rate = [e], [v]
    for k in range(1, len(pull)):
        first, more = pull[k - 1], pull[k] - pull[k - 1]
        for share in shares:
            v += first + share * more
            ahead = e + h * v
            if ahead > half:
                v, ahead = (half - e) / h, half
            elif ahead < -half:
                v, ahead = (-half - e) / h, -half
            e = ahead
        angle.append(e)
        rate.append(v)
    rates = np.array(rate)
    return np.array(angle), rates, _between(np.diff(rates[:, None], axis=0) / period)[:, 0]


def _keep_within(inverse: list[list[float]], v: list[float], bounds: list[tuple[int, float, float]]) -> None:
    """Changes speeds by the impulses that keep each bounded one within its bounds.

    Args:
        inverse: of the inertia, or a multiple of it.
        v: speeds.
        bounds: joints with their least and greatest speeds.
    """
    if all(low <= v[j] <= high for j, low, high in bounds):
        return
    impulses = [0.0] * len(bounds)
    for _ in range(30):
        before = impulses.copy()
        for place, (j, low, high) in enumerate(bounds):
            alone = v[j] - inverse[j][j] * impulses[place]
            wanted = (min(max(alone, low), high) - alone) / inverse[j][j]
            for i, row in enumerate(inverse):
                v[i] += row[j] * (wanted - impulses[place])
            impulses[place] = wanted
        if len(bounds) == 1 or impulses == before:
            return
