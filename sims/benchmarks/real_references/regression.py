"""A measured log as linear equations: torque on links' inertial parameters, friction, offset and rotor, below 10 Hz."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twin_diagram.logs import read_log
from twin_diagram.logs.differentiation import below_cutoff, motion
from twin_diagram.model.prediction import load_model_for
from twin_diagram.signals.arrays import Array

SIGN_SPEED = 0.01
"""Speed at which dry friction's smooth sign has reached three quarters [rad/s]."""


@dataclass(frozen=True)
class Equations:
    """One log.

    Attributes:
        columns: (n, M, P) per joint: 10 n inertial parameters, then n each of viscous, Coulomb, offset, rotor.
        torque: (n, M) logged [N·m].
        described: (10 n,) of the description, in the bodies' moving frames.
        stated: (n, M) torque of the description with all that it states; a rotor where it shows.
        seconds: that the log lasts.
    """

    columns: Array
    torque: Array
    described: Array
    stated: Array
    seconds: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.torque)

    @property
    def start(self) -> Array:
        """(P,) the description alone: no friction, no offset, no rotor."""
        return np.concatenate([self.described, np.zeros(4 * self.n)])

    @property
    def before(self) -> Array:
        """(n,) root mean square of what the description leaves [N·m]."""
        return np.asarray(np.sqrt(np.mean((self.torque - self.stated) ** 2, axis=1)))

    def left(self, parameters: Array) -> Array:
        """(n,) root mean square of what parameters (P,) leave [N·m]."""
        return np.asarray(np.sqrt(np.mean((self.torque - self.columns @ parameters) ** 2, axis=1)))


def equations(model: Path, log: Path, side: str) -> Equations:
    """Of a log, in the contract's band; velocities are those of the filtered positions, not the drives'."""
    given, own, _ = load_model_for(read_log(log), model)
    smooth = motion(replace(own, velocity=None), cutoff=10.0)
    q, v, a = smooth.position, smooth.velocity, smooth.acceleration
    n, eye = len(given.joints), np.eye(len(given.joints))
    parts = [given.tree.regressor(q, v, a, body) for body in range(n)]
    parts += [x[:, :, None] * eye for x in (v, np.tanh(v / SIGN_SPEED), np.ones_like(v), a)]
    whole = np.concatenate(parts, axis=2)
    stated = given.inverse_dynamics(q, v, a) - (given.tree.rotor * a if side == "link" else 0.0)
    columns = below_cutoff(whole.reshape(len(whole), -1), smooth.log).reshape(-1, n, whole.shape[2])
    return Equations(
        columns=columns.transpose(1, 0, 2),
        torque=below_cutoff(smooth.log.motor_torque, smooth.log).T,
        described=np.asarray(given.tree.inertia, dtype=float).ravel(),
        stated=below_cutoff(stated, smooth.log).T,
        seconds=float(own.time[-1] - own.time[0]),
    )
