"""An arm in MuJoCo with whatever is hidden in it, its controller, and its log.

What is hidden is installed by `gap_truth.phenomena`: a world is a list of hooks, called at every step of the
integrator, and never a law of `twin_diagram.model.effects`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
import numpy.typing as npt

from gap_truth.chain import GRAVITY, Chain, compile_model, mass_matrix, mjcf
from gap_truth.excitation import Motion

Array = npt.NDArray[np.float64]

CONTROL_PERIOD = 1e-3
"""Of the drive's controller, which holds its torque in between [s]."""

STEP = 5e-4
"""Of the integrator; MuJoCo's dry friction needs its own time constant to be two of them [s]."""

Motor = Callable[[float, Array, Array, Array], Array]
"""(time, q, v, torque before) → torque after, each (n,)."""

Load = Callable[[float, Array, Array], Array]
"""(time, q, v) → torque on the joints (n,) [N·m]."""

Level = Callable[[float, Array, Array, Array], Array]
"""(time, q, v, transmitted torque) → level of dry friction (n,) [N·m]."""


@dataclass
class World:
    """An arm before it is compiled.

    Attributes:
        chain: with the masses that the truth has.
        soft, hung, tail: see `chain.mjcf`.
        gravity: in the base's frame [m/s²].
        offset: measured less true position (n,) [rad].
        damping: viscous friction (n,) [N·m·s/rad].
        friction: dry friction (n,) [N·m].
        motors: what becomes of the commanded torque.
        loads: torques on the joints.
        levels: dry friction beyond the constant one.
        starts: called once with the compiled model and its data.
        steps: called before every step with (time, model, data).
    """

    chain: Chain
    soft: dict[int, dict[str, float]] = field(default_factory=dict)
    hung: dict[int, str] = field(default_factory=dict)
    tail: str = ""
    gravity: Array = field(default_factory=GRAVITY.copy)
    offset: Array = field(default_factory=lambda: np.zeros(0))
    damping: Array = field(default_factory=lambda: np.zeros(0))
    friction: Array = field(default_factory=lambda: np.zeros(0))
    motors: list[Motor] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    levels: list[Level] = field(default_factory=list)
    starts: list[Callable[[mujoco.MjModel, mujoco.MjData], None]] = field(default_factory=list)
    steps: list[Callable[[float, mujoco.MjModel, mujoco.MjData], None]] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name in ("offset", "damping", "friction"):
            if len(getattr(self, name)) != self.chain.n:
                setattr(self, name, np.zeros(self.chain.n))

    def compile(self, integrator: str) -> mujoco.MjModel:
        """The MuJoCo model."""
        text = mjcf(
            self.chain,
            timestep=STEP,
            integrator=integrator,
            soft=self.soft,
            hung=self.hung,
            tail=self.tail,
        )
        model = compile_model(text)
        model.opt.gravity[:] = self.gravity
        dofs = motor_dofs(model, self.chain.n)
        model.dof_damping[dofs] += self.damping
        model.dof_frictionloss[dofs] = self.friction
        return model


@dataclass(frozen=True)
class Controller:
    """Joint-wise PD about a motion that is known beforehand, with a feed-forward.

    Attributes:
        stiffness: (n,) [N·m/rad].
        damping: (n,) [N·m·s/rad].
        corner: (n,) of the filter that makes velocities out of positions [rad/s].
        limit: (n,) largest torque that is commanded [N·m].
        resolution: (n,) of the encoders [rad].
    """

    stiffness: Array
    damping: Array
    corner: Array
    limit: Array
    resolution: Array


@dataclass(frozen=True)
class Truth:
    """What happened, without noise, at the log's samples.

    Attributes:
        time: (N,) since the simulation's begin [s].
        q: positions as an ideal encoder would measure them (N, n) [rad].
        v: (N, n) [rad/s].
        a: (N, n) [rad/s²], of the same instant as q, v and the torque.
        torque: commanded, and held until the next control tick (N, n) [N·m].
        held: mean of the commanded torque from this sample to the next (N, n) [N·m].
        encoder: quantised positions (N, n) [rad].
        velocity: the drive's estimate (N, n) [rad/s].
        asked: commanded positions (N, n) [rad].
    """

    time: Array
    q: Array
    v: Array
    a: Array
    torque: Array
    held: Array
    encoder: Array
    velocity: Array
    asked: Array


UNSTABLE = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)

# Warnings are looked at here; MuJoCo would write them to a file in the working folder.
mujoco.set_mju_user_warning(lambda message: None)


CHATTER = 0.25
"""Share of a motor's torque that a controller at rest with itself does not jump by from one log sample to the next."""

CHATTERING = 10
"""Jumps of a joint in a run from which on it is said to chatter."""


class DivergedError(RuntimeError):
    """The simulated arm left its work space."""


def motor_dofs(model: mujoco.MjModel, n: int) -> npt.NDArray[np.int64]:
    """Velocity indices of the motors' joints."""
    return np.array([model.jnt_dofadr[model.joint(f"joint_{k + 1}").id] for k in range(n)])


def simulate(
    world: World, control: Controller, motion: Motion, feedforward: Array, every: int, integrator: str
) -> Truth:
    """Lets the arm follow a motion.

    Args:
        world: with everything installed.
        control: its controller.
        motion: at the control period.
        feedforward: (N, n) [N·m].
        every: control ticks per log sample.
        integrator: MuJoCo's name.

    Raises:
        DivergedError: it did not follow at all.
    """
    model = world.compile(integrator)
    data = mujoco.MjData(model)
    n = world.chain.n
    dofs = motor_dofs(model, n)
    data.qpos[dofs] = motion.q[0] - world.offset
    for start in world.starts:
        start(model, data)
    mujoco.mj_forward(model, data)
    substeps = round(CONTROL_PERIOD / STEP)
    keep = 1.0 - np.exp(-control.corner * CONTROL_PERIOD)
    lsb, count = control.resolution, len(motion.q)
    rows: list[list[Array]] = []
    last = np.round((data.qpos[dofs] + world.offset) / lsb) * lsb
    estimate = np.zeros(n)
    dynamic = bool(world.levels)
    moves = bool(world.loads)
    for tick in range(count):
        now = tick * CONTROL_PERIOD
        q, v = data.qpos[dofs], data.qvel[dofs]
        encoder = np.round((q + world.offset) / lsb) * lsb
        estimate = estimate + keep * ((encoder - last) / CONTROL_PERIOD - estimate)
        last = encoder
        torque = (
            feedforward[tick]
            + control.stiffness * (motion.q[tick] - encoder)
            + control.damping * (motion.v[tick] - estimate)
        )
        torque = np.clip(torque, -control.limit, control.limit)
        if tick % every:
            rows[-1][4] = rows[-1][4] + torque
        for part in range(substeps):
            t = now + part * STEP
            if part:
                q, v = data.qpos[dofs], data.qvel[dofs]
            applied = torque
            for motor in world.motors:
                applied = motor(t, q, v, applied)
            if moves:
                for load in world.loads:
                    applied = applied + load(t, q, v)
            for step in world.steps:
                step(t, model, data)
            if dynamic:
                # Friction of the step before stands for that of this one: half a millisecond.
                transmitted = applied + data.qfrc_constraint[dofs]
                level = world.friction
                for law in world.levels:
                    level = level + law(t, q, v, transmitted)
                model.dof_frictionloss[dofs] = level
            data.qfrc_applied[dofs] = applied
            mujoco.mj_step(model, data)
            if part == 0 and tick % every == 0:
                rows.append([q + world.offset, v, data.qacc[dofs], torque, torque, encoder, estimate])
        if tick % 500 == 0:
            away = np.abs(data.qpos[dofs] - motion.q[tick]).max()
            if away > 1.5 or any(data.warning[kind].number for kind in UNSTABLE):
                raise DivergedError(f"at {now:g} s a joint is {away:g} rad from where it should be, or too fast")
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns[4] = columns[4] / every
    jumps = np.abs(np.diff(columns[3], axis=0)) > CHATTER * control.limit
    if np.max(np.sum(jumps, axis=0)) > CHATTERING:
        raise DivergedError("a controller chatters: nobody would take a log of that")
    time = CONTROL_PERIOD * every * np.arange(len(rows))
    return Truth(time, *columns, asked=motion.q[::every])


class Nominal:
    """Inverse dynamics of the description alone, by MuJoCo."""

    def __init__(self, chain: Chain, gravity: Array = GRAVITY) -> None:
        self.chain = chain
        self.model = compile_model(mjcf(chain, timestep=STEP))
        self.model.opt.gravity[:] = gravity
        self.data = mujoco.MjData(self.model)

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torques (N, n) for a motion (N, n) [N·m]."""
        result = np.empty_like(q)
        model, data = self.model, self.data
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            result[k] = data.qfrc_inverse
        return result

    def inertia(self, q: Array) -> Array:
        """(n, n) mass matrix at a pose (n,)."""
        self.data.qpos[:] = q
        mujoco.mj_forward(self.model, self.data)
        return mass_matrix(self.model, self.data)
