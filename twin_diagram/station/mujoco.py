"""An arm that lives in MuJoCo, behind the ports of every station: a robot that the twin's simulator knows nothing of.

Its drive follows `arm.position_commanded` with a joint-wise PD on encoder counts and adds `arm.torque_commanded`.
MuJoCo has its own integrator, its own law of dry friction and no code in common with `twin_diagram.model.effects`.
Needs the `demo` extra.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, DiscreteValues, LeafSystem

from twin_diagram.errors import StationError
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import ports

try:
    import mujoco
except ImportError as error:
    raise StationError("an arm in MuJoCo needs the package mujoco: pip install 'twin-diagram[demo]'") from error


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    period: float = 1e-3
    """Of the drive [s]."""

    steps: int = 2
    """Of the integrator in one period of the drive."""

    bandwidth: float = 2.0 * np.pi * 4.0
    """Of the drive's position loop [rad/s]."""

    damping: float = 1.6
    """Of the position loop: twice its damping ratio; it hardly overshoots."""

    corner: float = 60.0
    """Of the low pass through which the drive differentiates [Hz]: above all that the arm does."""

    encoder: float = 2.0 * np.pi / 2**19
    """Resolution [rad]."""

    torque_noise: float = 0.003
    """White noise of a measured torque, as a share of the rated torque."""

    rated: float = 300.0
    """The rated torque of joints whose description names none, or a larger one [N·m]."""

    noises: int = 16384
    """Messages after which the noise repeats: sixteen seconds."""


TUNING = Tuning()


KEEP: Final = 1.0 - np.exp(-2.0 * np.pi * TUNING.corner * TUNING.period)
"""Share of each new difference that the drive's low pass takes."""


DRAKE: Final = "{http://drake.mit.edu}"
"""The namespace of Drake's own tags in a URDF, as ElementTree writes it."""


@dataclass(frozen=True)
class Secret:
    """What is true of the robot and not in its description.

    Attributes:
        payload: mass on the last link [kg].
        payload_at: its centre in that link's frame [m].
        friction: dry friction by joint [N·m].
        damping: viscous friction by joint [N·m·s/rad].
    """

    payload: float = 0.0
    payload_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: Mapping[str, float] = field(default_factory=dict)
    damping: Mapping[str, float] = field(default_factory=dict)


def compile_robot(urdf: Path, secret: Secret) -> mujoco.MjModel:
    """Return the description with what it does not say."""
    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.option.timestep = TUNING.period / TUNING.steps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if secret.payload > 0.0:
        body = spec.bodies[-1].add_body(name="secret_payload", ipos=secret.payload_at, explicitinertial=True)
        body.mass, body.inertia = secret.payload, [1e-4] * 3
    model = spec.compile()
    rotors = rotor_inertias(urdf)
    for k in range(model.njnt):
        name, dof = model.joint(k).name, model.jnt_dofadr[k]
        model.dof_armature[dof] = rotors.get(name, 0.0)
        model.dof_damping[dof] += secret.damping.get(name, 0.0)
        model.dof_frictionloss[dof] = secret.friction.get(name, 0.0)
    # MuJoCo's dry friction is soft unless told otherwise: it would look viscous up to 0.2 rad/s.
    model.dof_solref[:] = [TUNING.period, 1.0]
    model.dof_solimp[:, :3] = [0.99, 0.999, 0.001]
    # How soft it is goes by the inertia that was reckoned before the rotors were added.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def rotor_inertias(urdf: Path) -> dict[str, float]:
    """Return reflected rotor inertias that a description states for Drake, by joint [kg·m²]."""
    result = {}
    for transmission in ET.parse(urdf).getroot().iter("transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        if joint is None or actuator is None:
            continue
        ratio, rotor = actuator.find(f"{DRAKE}gear_ratio"), actuator.find(f"{DRAKE}rotor_inertia")
        if ratio is not None and rotor is not None:
            result[joint.get("name", "")] = float(rotor.get("value", 0)) * float(ratio.get("value", 0)) ** 2
    return result


class MujocoArm(LeafSystem):
    """A robot in MuJoCo with its drive and its sensors.

    .. pydrake_system::

        name: MujocoArm
        input_ports:
        - arm.position_commanded
        - arm.torque_commanded
        output_ports:
        - arm.position_measured
        - arm.velocity_estimated
        - arm.torque_measured
        - arm.measurement_time

    Runs at 1 kHz; messages have no latency. Positions are encoder counts [rad], velocities the drive's estimate
    [rad/s], torques what the motors gave, with white noise of 0.3 % of the rated torque [N·m]. All state is one
    discrete vector; MuJoCo's own data are scratch. Joints are in MuJoCo's order, from the base on. From a given time
    on another secret may hold instead: something was picked up, a bearing went dry.

    Attributes:
        joints: names.
        stiffness, damping: (n,) of the drive [N·m/rad], [N·m·s/rad].
    """

    def __init__(
        self,
        urdf: Path,
        secret: Secret,
        home: Sequence[float],
        seed: int = 0,
        later: Secret | None = None,
        change: float = np.inf,
    ) -> None:
        """Start the robot at rest.

        Args:
            urdf: its description.
            secret: what is true of it besides.
            home: (n,) positions at the start [rad].
            seed: of the torques' noise.
            later: what holds in the place of `secret` from `change` on; None: nothing changes.
            change: when it does [s].
        """
        super().__init__()
        self._model = compile_robot(urdf, secret)
        self._data = mujoco.MjData(self._model)
        self._later = self._model if later is None else compile_robot(urdf, later)
        self._later_data = self._data if later is None else mujoco.MjData(self._later)
        self._change = change
        self.joints = tuple(self._model.joint(k).name for k in range(self._model.njnt))
        n = len(self.joints)
        self._n = n
        self._home = np.array(home, dtype=float)
        self._data.qpos[:] = self._home
        mujoco.mj_forward(self._model, self._data)
        inertia = np.zeros((n, n))
        mujoco.mj_fullM(self._model, self._data, inertia)
        self.stiffness = np.diag(inertia) * TUNING.bandwidth**2
        self.damping = TUNING.damping * np.diag(inertia) * TUNING.bandwidth
        efforts = _efforts(urdf)
        self._limit = np.array([efforts.get(name, np.inf) for name in self.joints])
        rng = np.random.default_rng([seed, 7])
        self._noise = rng.normal(size=(TUNING.noises, n)) * TUNING.torque_noise * np.minimum(self._limit, TUNING.rated)

        # qpos, qvel, MuJoCo's warm start, encoder, velocity, torque as measured, command, the command's rate, time
        rest, counts = np.zeros(n), np.round(self._home / TUNING.encoder) * TUNING.encoder
        start = np.concatenate([self._home, rest, rest, counts, rest, rest, self._home, rest, [NEVER]])
        state = self.DeclareDiscreteState(start)
        self._command = self.DeclareVectorInputPort(ports.POSITION_COMMANDED, n)
        self._forward = self.DeclareVectorInputPort(ports.TORQUE_COMMANDED, n)
        self.DeclarePeriodicDiscreteUpdateEvent(TUNING.period, 0.0, self._update)
        ticket = {self.discrete_state_ticket(state)}
        for port, first, size in (
            (ports.POSITION_MEASURED, 3 * n, n),
            (ports.VELOCITY_ESTIMATED, 4 * n, n),
            (ports.TORQUE_MEASURED, 5 * n, n),
            (ports.MEASUREMENT_TIME, 8 * n, 1),
        ):
            self.DeclareVectorOutputPort(port, size, self._reader(first, size), prerequisites_of_calc=ticket)

    @staticmethod
    def _reader(first: int, size: int):  # type: ignore[no-untyped-def]
        def read(context: Context, output: BasicVector) -> None:
            output.SetFromVector(context.get_discrete_state_vector().value()[first : first + size])

        return read

    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        n, now = self._n, context.get_time()
        changed = now >= self._change - 1e-9
        model, data = (self._later, self._later_data) if changed else (self._model, self._data)
        state = context.get_discrete_state_vector().value().copy()
        q, v, warm, encoder, velocity, _, asked, rate = state[:-1].reshape(8, n)
        measured = np.round(q / TUNING.encoder) * TUNING.encoder
        command = self._command.Eval(context) if self._command.HasValue(context) else self._home
        # Both rates go through the same filter, so that it delays neither against the other.
        velocity = velocity + KEEP * ((measured - encoder) / TUNING.period - velocity)
        rate = rate + KEEP * ((command - asked) / TUNING.period - rate)
        torque = self.stiffness * (command - measured) + self.damping * (rate - velocity)
        if self._forward.HasValue(context):
            torque = torque + self._forward.Eval(context)
        torque = np.clip(torque, -self._limit, self._limit)
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = q, v, warm
        data.time = now
        data.qfrc_applied[:] = torque
        for _ in range(TUNING.steps):
            mujoco.mj_step(model, data)
        shown = torque + self._noise[round(now / TUNING.period) % len(self._noise)]
        parts = [data.qpos, data.qvel, data.qacc_warmstart, measured, velocity, shown, command, rate, [now]]
        discrete.get_mutable_vector().SetFromVector(np.concatenate(parts))


class MujocoStation(Diagram):
    """`MujocoArm` with the ports of every station.

    .. pydrake_system::

        name: MujocoStation
        input_ports:
        - arm.position_commanded
        - arm.torque_commanded
        output_ports:
        - arm.position_measured
        - arm.velocity_estimated
        - arm.torque_measured
        - arm.measurement_time

    Attributes:
        joints: names, in the ports' order.
    """

    def __init__(
        self,
        urdf: Path,
        secret: Secret,
        home: Sequence[float],
        seed: int = 0,
        later: Secret | None = None,
        change: float = np.inf,
    ) -> None:
        """Build the robot; arguments as of `MujocoArm`."""
        super().__init__()
        builder = DiagramBuilder()
        arm = builder.AddNamedSystem("arm", MujocoArm(urdf, secret, home, seed, later, change))
        self.joints = arm.joints
        for name in ports.input_names(arm):
            builder.ExportInput(arm.GetInputPort(name), name)
        for name in ports.output_names(arm):
            builder.ExportOutput(arm.GetOutputPort(name), name)
        builder.BuildInto(self)
        ports.check(self, len(arm.joints), 0, ())


def _efforts(urdf: Path) -> dict[str, float]:
    """Return what joints may give at most, by name; a continuous one need not say, and 0 says nothing."""
    joints = ((joint, joint.find("limit")) for joint in ET.parse(urdf).getroot().findall("joint"))
    told = {j.get("name", ""): float(limit.get("effort", "inf")) for j, limit in joints if limit is not None}
    return {name: effort for name, effort in told.items() if effort > 0.0}
