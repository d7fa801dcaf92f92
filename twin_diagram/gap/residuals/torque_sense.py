"""Whether logged torques can be what a description's motors gave: their sign and unit, before anything is fitted.

A fit would answer a wrong unit with links a thousand times too heavy, and be sure of it. Rough motion is enough to see
that, so a log that is refused does not wait for SciPy's filters to be loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import LogError
from twin_diagram.logs import Log, fingerprint
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: no arm is described so wrongly."""

    alike: float = 0.8
    """Cosine between logged and predicted torque from which on a joint tells: friction takes it down."""

    far: float = 20.0
    """Factor between them, of all joints that tell, that no wrong description makes; a wrong unit does."""

    odd: float = 4.0
    """The same from which on it is worth a word."""

    near: float = 3.0
    """Factor about a thousand, within which that is meant."""

    beyond: float = 3.0
    """Times its limits that a torque in N·m cannot be; light placeholders in a description do not touch that."""

    block: float = 0.03
    """Over which positions and torques are averaged before they are compared [s]: arms move slower, noise is faster."""

    certain: float = 0.95
    """Cosine from which on a joint's torque is nothing but its description's with the other sign."""

    same: float = 2.0
    """Factor within which such a torque is as large as described."""

    crossed: float = 0.1
    """Share of what two joints' torques leave that is left where they are exchanged, and taken for each other's."""

    alone: float = 0.3
    """Share of each one's squares that is then left at most."""

    most: float = 0.5
    """Share of the joints that tell and have limits that must be beyond them: a few may be stated too low."""

    blocks: int = 4000
    """That are compared at most, of each log."""


TUNING = Tuning()


def checked(model: Model, logs: Sequence[Log]) -> list[str]:
    """Return what is odd about torques' sign or size.

    Args:
        model: the given one, with the logs' joints in their order.
        logs: to fit, checked.

    Raises:
        LogError: all joints that tell have the other sign, or another unit; one of them surely has the other sign;
            two have each other's.
    """
    parts = [_roughly(model.for_run(fingerprint(log)), log) for log in logs]
    torque, predicted, rest = (np.concatenate([part[k] for part in parts]) for k in range(3))
    names, source = model.joints, logs[0].source
    for a, b in exchanged(torque, predicted):
        raise LogError(
            f"{source}: the torques of {names[a]} and {names[b]} are those that the description needs of each other; "
            "their columns are exchanged in the log, or the joints in the description"
        )
    cosine, scale = agreement(torque, predicted)
    tells = np.abs(cosine) > TUNING.alike
    if not np.any(tells):
        return []
    against = tells & (cosine < 0.0)
    turned = against & negated(torque, predicted, rest)
    if np.any(turned) and np.array_equal(turned, tells):
        raise LogError(
            f"{source}: torques have the opposite sign of those that the description needs; what moves a joint to "
            "larger positions is positive"
        )
    sure = turned & (cosine < -TUNING.certain) & (np.abs(np.log(np.abs(scale))) < np.log(TUNING.same))
    if np.any(sure) and not np.all(against[tells]):
        joints = ", ".join(name for name, one in zip(names, sure, strict=True) if one)
        raise LogError(
            f"{source}: the torque of {joints} has the opposite sign of what the description needs, those of other "
            "joints have not; turn its sign in the log, or its axis in the description"
        )
    size = float(np.exp(np.median(np.log(np.abs(scale[tells])))))
    apart = np.abs(np.log(np.abs(scale[tells])))
    if np.all(apart > np.log(TUNING.far)) and (size < 1.0 or beyond_limits(model, torque, tells)):
        raise LogError(
            f"{source}: torques are some {size:.2g} times those that the description needs; {_unit(size)}; the log "
            "format has N·m at the joint, motor torque times gear ratio"
        )
    joints = ", ".join(name for name, other in zip(names, against, strict=True) if other)
    odd = [f"{source}: the torque of {joints} has the opposite sign of what the description needs"] if joints else []
    if np.all(apart > np.log(TUNING.odd)):
        odd.append(
            f"{source}: torques are some {size:.2g} times those that the description needs; if they are currents, or "
            "were measured before the gear, --torque-constants makes torques at the joints of them"
        )
    return odd


def negated(torque: Array, predicted: Array, rest: Array) -> npt.NDArray[np.bool_]:
    """Return (n,) whether torques are rather a description's with the other sign than those of an arm that hangs.

    There gravity alone pulls the other way; what friction takes is on neither side.

    Args:
        torque: (N, n) logged [N·m].
        predicted: (N, n) of the description [N·m].
        rest: (N, n) what gravity has of that [N·m].
    """
    signs, hangs = (np.sum((torque - other) ** 2, axis=0) for other in (-predicted, predicted - 2.0 * rest))
    return np.asarray(signs < hangs)


def exchanged(torque: Array, predicted: Array) -> list[tuple[int, int]]:
    """Return pairs of joints whose torques (N, n) are far nearer to what a model predicts of each other."""
    apart = np.sum((torque[:, :, None] - predicted[:, None, :]) ** 2, axis=0)
    own = np.diag(apart)
    crossed = apart + apart.T < TUNING.crossed * (own[:, None] + own)
    near = apart < TUNING.alone * np.sum(torque**2, axis=0)[:, None]
    return [(int(a), int(b)) for a, b in np.argwhere(np.triu(crossed & near & near.T, 1))]


def beyond_limits(model: Model, torque: Array, tells: npt.NDArray[np.bool_]) -> bool:
    """Return whether torques (N, n) of most joints that tell (n,) are larger than those joints can give."""
    limits = model.limits.effort
    known = tells & np.isfinite(limits) & (limits > 0.0)
    over = np.max(np.abs(torque), axis=0)[known] > TUNING.beyond * limits[known]
    return bool(len(over) and np.mean(over) > TUNING.most)


def agreement(torque: Array, predicted: Array) -> tuple[Array, Array]:
    """Return (n,) cosine between two torques (N, n), and (n,) the one that is logged over the other."""
    both = np.sum(torque * predicted, axis=0)
    squares = np.maximum(np.sum(predicted**2, axis=0), 1e-30)
    cosine = both / np.sqrt(squares * np.maximum(np.sum(torque**2, axis=0), 1e-30))
    return cosine, np.where(both == 0.0, 1.0, both / squares)


def _roughly(model: Model, log: Log) -> tuple[Array, Array, Array]:
    """Return torque that is logged, that a model predicts, and that it has at rest, each (M, n): means over blocks."""
    each = max(1, round(TUNING.block / log.period))
    count = int((log.time[-1] - log.time[0]) / log.period) // each
    block = each * log.period
    even = log.time[0] + log.period * (0.5 + np.arange(count * each))
    q, torque = (
        np.stack([np.interp(even, log.time, x).reshape(count, each).mean(axis=1) for x in signal.T], axis=1)
        for signal in (log.position, log.motor_torque)
    )
    some = slice(1, -1, max(1, count // TUNING.blocks))
    v = ((q[2:] - q[:-2]) / (2.0 * block))[:: some.step]
    a = (np.diff(q, 2, axis=0) / block**2)[:: some.step]
    seen = torque[some] if any(effect.loses for effect in model.effects) else None
    moving = model.inverse_dynamics(q[some], v, a, seen=seen)
    return torque[some], moving, model.inverse_dynamics(q[some], 0.0 * v, 0.0 * a, seen=seen)


def _unit(size: float) -> str:
    if abs(np.log(size / 1e3)) < np.log(TUNING.near):
        return "it looks like mN·m"
    if abs(np.log(size * 1e3)) < np.log(TUNING.near):
        return "it looks like kN·m"
    return "it looks like torques before the gear, or currents (see --torque-constants)"
