"""Whether logged torques can be what a description's motors gave: their sign and unit, before anything is fitted.

A fit would answer a wrong unit with links a thousand times too heavy, and be sure of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import LogError
from twin_diagram.gap.residuals.prepared_logs import Records
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


TUNING = Tuning()


def checked(records: Records) -> list[str]:
    """Return what is odd about torques' sign or size.

    Args:
        records: of the fit.

    Raises:
        LogError: all joints that tell have the other sign, or another unit.
    """
    torque, predicted = records.torque, records.torque - records.residual
    names = records.model.joints
    cosine, scale = agreement(torque, predicted)
    tells = np.abs(cosine) > TUNING.alike
    if not np.any(tells):
        return []
    source = records.records[0].source
    against = tells & (cosine < 0.0)
    if np.all(against[tells]) and float(np.sum(torque * records.motion[1])) < 0.0:  # friction takes power, gives none
        raise LogError(
            f"{source}: torques have the opposite sign of those that the description needs; what moves a joint to "
            "larger positions is positive"
        )
    size = float(np.exp(np.median(np.log(np.abs(scale[tells])))))
    apart = np.abs(np.log(np.abs(scale[tells])))
    limits = records.model.limits.effort
    finite = np.isfinite(limits) & (limits > 0.0)
    over = np.max(np.abs(torque), axis=0)[finite] > TUNING.beyond * limits[finite]
    if np.all(apart > np.log(TUNING.far)) and (size < 1.0 or (len(over) and np.all(over))):
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


def agreement(torque: Array, predicted: Array) -> tuple[Array, Array]:
    """Return (n,) cosine between two torques (N, n), and (n,) the one that is logged over the other."""
    both = np.sum(torque * predicted, axis=0)
    squares = np.maximum(np.sum(predicted**2, axis=0), 1e-30)
    cosine = both / np.sqrt(squares * np.maximum(np.sum(torque**2, axis=0), 1e-30))
    return cosine, np.where(both == 0.0, 1.0, both / squares)


def _unit(size: float) -> str:
    if abs(np.log(size / 1e3)) < np.log(TUNING.near):
        return "it looks like mN·m"
    if abs(np.log(size * 1e3)) < np.log(TUNING.near):
        return "it looks like kN·m"
    return "it looks like torques before the gear, or currents (see --torque-constants)"
