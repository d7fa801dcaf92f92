"""The robot's motions, and what is hidden in it; drives it with the torques that a model asks for."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from twin_diagram.logs import Log
from twin_diagram.model import Model
from twin_diagram.scenario import resolve
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.station.mujoco import TUNING as MUJOCO
from twin_diagram.station.mujoco import MujocoStation, Secret

URDF = Path(resolve("arms/iiwa7.urdf"))
HOME = np.array([0.0, 0.6, 0.0, -1.3, 0.0, 0.9, 0.0])
REACH = np.array([0.9, 0.5, 0.8, 0.6, 1.0, 0.8, 1.0])
"""Of motions about it [rad]."""
LOG_PERIOD = 0.002
SECRETS = {
    "payload": Secret(payload=2.2, payload_at=(0.03, 0.02, 0.09)),
    "friction": Secret(friction={"iiwa_joint_4": 6.0}),
    "both": Secret(payload=2.2, payload_at=(0.03, 0.02, 0.09), friction={"iiwa_joint_4": 6.0}),
    "nothing": Secret(),
}


class Commands(LeafSystem):
    """What the arm is asked: positions, and the torques that a model says they take.

    .. pydrake_system::

        name: Commands
        output_ports:
        - position
        - torque
    """

    def __init__(self, position: Array, torque: Array) -> None:
        """`position`, `torque`: (N, n), one row every `PERIOD`."""
        super().__init__()
        for name, table in (("position", position), ("torque", torque)):
            self.DeclareVectorOutputPort(name, table.shape[1], self._reader(table), {self.time_ticket()})

    @staticmethod
    def _reader(table: Array):  # type: ignore[no-untyped-def]
        def read(context: Context, output: BasicVector) -> None:
            output.SetFromVector(table[min(round(context.get_time() / MUJOCO.period), len(table) - 1)])

        return read


def robot(secret: str, seed: int, run: int) -> MujocoStation:
    """Return the robot with one of `SECRETS` in it; `run` draws its noise."""
    return MujocoStation(URDF, SECRETS[secret], HOME, seed=100 * seed + run)


def exploring(duration: float, seed: int) -> Array:
    """A sum of sines about the home pose (N, n), at rest at both ends [rad]."""
    rng = np.random.default_rng([seed, 1])
    time = np.arange(0.0, duration, MUJOCO.period)
    harmonics = np.arange(1, 7)
    size = rng.uniform(0.3, 1.0, (6, 7)) / harmonics[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 7))
    wave = np.einsum("thn,hn->tn", np.sin(0.75 * harmonics[None, :, None] * time[:, None, None] + phase), size)
    wave *= REACH / np.abs(wave).max(axis=0)
    return HOME + wave * (ease(time / 1.5) * ease((time[-1] - time) / 1.5))[:, None]


def task(seed: int) -> Array:
    """Moves between poses with short rests (N, n) [rad]."""
    rng = np.random.default_rng([seed, 2])
    poses = [HOME, *(HOME + rng.uniform(-1.0, 1.0, (5, 7)) * REACH), HOME]
    moving, still = np.arange(0.0, 1.6, MUJOCO.period), round(0.3 / MUJOCO.period)
    parts = [np.repeat(HOME[None], still, axis=0)]
    for a, b in pairwise(poses):
        parts += [a + (b - a) * ease(moving / 1.6)[:, None], np.repeat(b[None], still, axis=0)]
    return np.concatenate(parts)


def ease(s: Array) -> Array:
    """From 0 to 1 with speed and acceleration zero at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def drive(station: MujocoStation, model: Model, position: Array) -> Log:
    """Lets the arm follow a motion (N, n) with a model's torques as feed-forward; answers the log."""
    velocity = np.gradient(position, MUJOCO.period, axis=0)
    torque = model.inverse_dynamics(position, velocity, np.gradient(velocity, MUJOCO.period, axis=0))
    builder = DiagramBuilder()
    builder.AddSystem(station)
    commands = builder.AddSystem(Commands(position, torque))
    builder.Connect(commands.GetOutputPort("position"), station.GetInputPort(ports.POSITION_COMMANDED))
    builder.Connect(commands.GetOutputPort("torque"), station.GetInputPort(ports.TORQUE_COMMANDED))
    names = (ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED, ports.MEASUREMENT_TIME)
    sinks = [LogVectorOutput(station.GetOutputPort(name), builder, LOG_PERIOD) for name in names]
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(MUJOCO.period * (len(position) - 1))
    q, v, tau, at = (sink.FindLog(simulator.get_context()).data().T for sink in sinks)
    fresh = np.flatnonzero(at[:, 0] >= 0.0)
    fresh = fresh[np.append(True, np.diff(at[fresh, 0]) > 0.0)]
    asked = position[np.minimum(np.round(at[fresh, 0] / MUJOCO.period).astype(int), len(position) - 1)]
    return Log(
        at[fresh, 0],
        station.joints,
        position=q[fresh],
        velocity=v[fresh],
        torque=tau[fresh],
        position_commanded=asked,
        source="drive",
    )
