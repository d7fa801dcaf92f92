"""Draws the signature of each effect of the catalogue: what it adds to a logged torque, against what brings it out.

Nothing is drawn by hand: a UR5e moves, and the model with the effect says what its motors log beyond what the model
without it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from twin_diagram.model import Model
from twin_diagram.model.effects import Effect, make
from twin_diagram.scenario import EffectSpec, models_dir

Array = npt.NDArray[np.float64]

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
PAN, LIFT, ELBOW, WRIST = 0, 1, 2, 3


@dataclass(frozen=True)
class Tuning:
    """Motion and look of all pictures, chosen by hand."""

    home: tuple[float, ...] = (0.0, -1.0, 1.2, -0.6, -0.8, 0.0)
    """About which the arm swings [rad]."""
    slow: tuple[tuple[float, float], ...] = ((0.25, 0.9), (0.6, 0.15))
    """Frequencies [Hz] and sizes [rad] of each joint's sines."""
    fast: tuple[tuple[float, float], ...] = ((1.0, 0.3), (2.3, 0.06))
    """Where acceleration matters."""
    lags: tuple[float, ...] = (0.0, 0.9, 2.1, 0.4, 1.6, 3.0)
    """Phases by joint [rad]; two joints in phase would show each other's torque."""
    sweep: float = 1.3
    """To either side, where poses are held [rad]."""
    seconds: float = 4.0
    rate: float = 500.0
    """Samples [Hz]."""
    size: tuple[float, float] = (3.7, 2.3)
    """Of a picture [inch]."""
    colour: str = "#6a3fb5"


TUNING = Tuning()


@dataclass(frozen=True)
class Motion:
    """Of all joints, (N, 6) but for `time` (N,) [s], [rad], [rad/s], [rad/s²], and the torque without the effect."""

    time: Array
    q: Array
    v: Array
    a: Array
    tau: Array


Axis = Callable[[Motion, Array], Array]
"""From the motion and the torque logged with the effect (N, 6) to what is laid off to the right (N,)."""


class Moves(Enum):
    """How the arm moves in a picture."""

    SLOW = "all joints swing"
    FAST = "all joints swing fast"
    HELD = "one joint is held at one angle after the other"


@dataclass(frozen=True)
class Signature:
    """How one effect is shown.

    Attributes:
        parameters: values, for one joint each.
        joint: whose torque is drawn.
        axis: what is laid off to the right.
        label: of it.
        moves: how the arm moves.
        joints, links: it sits on; by default on `joint`.
        onset, end: [s].
        span: part of the run that is drawn [s].
    """

    parameters: Mapping[str, Sequence[float]]
    joint: int
    axis: Axis
    label: str
    moves: Moves = Moves.SLOW
    joints: tuple[str, ...] | None = None
    links: tuple[str, ...] = ()
    onset: float | None = None
    end: float | None = None
    span: tuple[float, float] = (0.0, np.inf)


def _time(motion: Motion, logged: Array) -> Array:
    return motion.time


def _angle(joint: int) -> Axis:
    return lambda motion, logged: motion.q[:, joint]


def _speed(*joints: int) -> Axis:
    return lambda motion, logged: motion.v[:, list(joints)].sum(axis=1)


def _acceleration(joint: int) -> Axis:
    return lambda motion, logged: motion.a[:, joint]


def _torque(joint: int) -> Axis:
    return lambda motion, logged: logged[:, joint]


ANGLE, SPEED, TORQUE, TIME = "angle [rad]", "speed [rad/s]", "logged torque [N·m]", "time [s]"
HELD = "angle at which the joint is held [rad]"

SIGNATURES: dict[str, Signature] = {
    "viscous_friction": Signature({"damping": [6.0]}, ELBOW, _speed(ELBOW), SPEED),
    "coulomb_friction": Signature({"torque": [5.0]}, ELBOW, _speed(ELBOW), SPEED),
    "stribeck_friction": Signature(
        {"coulomb": [3.0], "static": [6.0], "stribeck_velocity": [0.15]}, ELBOW, _speed(ELBOW), SPEED
    ),
    "load_dependent_friction": Signature({"coefficient": [0.15]}, ELBOW, _torque(ELBOW), TORQUE),
    "coupled_friction": Signature(
        {"damping": [0.8], "torque": [1.5]},
        WRIST,
        _speed(WRIST, WRIST + 1),
        "sum of both joints' speeds [rad/s]",
        joints=JOINTS[WRIST : WRIST + 2],
    ),
    "payload": Signature(
        {"mass": [2.0], "com": [0.0, 0.0, 0.1]}, LIFT, _angle(LIFT), HELD, moves=Moves.HELD, joints=()
    ),
    "inertial_parameters": Signature(
        {"mass": [1.5], "com": [0.05, 0.0, 0.0]},
        LIFT,
        _angle(LIFT),
        HELD,
        moves=Moves.HELD,
        joints=(),
        links=("forearm_link",),
    ),
    "reflected_inertia": Signature(
        {"inertia": [0.4]}, ELBOW, _acceleration(ELBOW), "acceleration [rad/s²]", moves=Moves.FAST
    ),
    "gravity_tilt": Signature({"roll": [0.05], "pitch": [0.03]}, PAN, _angle(PAN), HELD, moves=Moves.HELD, joints=()),
    "joint_spring": Signature(
        {"curve": [0.2, 0.8, 1.2, 1.6, 2.2, -9.0, -8.0, 0.0, 8.0, 9.0]}, ELBOW, _angle(ELBOW), ANGLE
    ),
    "joint_elasticity": Signature(
        {"stiffness": [3000.0], "rotor_inertia": [0.5]}, ELBOW, _time, TIME, moves=Moves.FAST, span=(1.0, 3.0)
    ),
    "backlash": Signature(
        {"gap": [0.004], "rotor_inertia": [0.3]}, WRIST, _time, TIME, moves=Moves.FAST, span=(1.0, 3.0)
    ),
    "torque_ripple": Signature({"amplitude": [2.0], "cycles": [16.0], "phase": [0.0]}, ELBOW, _angle(ELBOW), ANGLE),
    "torque_constant": Signature({"gain": [0.9]}, ELBOW, _torque(ELBOW), TORQUE),
    "torque_bias": Signature({"torque": [1.5]}, ELBOW, _torque(ELBOW), TORQUE),
    "torque_saturation": Signature({"limit": [12.0]}, ELBOW, _torque(ELBOW), TORQUE),
    "time_delay": Signature({"delay": [0.02]}, ELBOW, _time, TIME, moves=Moves.FAST, joints=(), span=(1.0, 3.0)),
    "encoder_offset": Signature({"offset": [0.05]}, LIFT, _angle(LIFT), HELD, moves=Moves.HELD),
    "external_force": Signature(
        {"wrench": [0.0, 0.0, -10.0, 0.0, 0.0, 0.0]},
        ELBOW,
        _time,
        TIME,
        joints=(),
        links=("tool0",),
        onset=1.5,
        end=2.5,
    ),
    "actuator_fault": Signature({"gain": [0.6]}, ELBOW, _time, TIME, onset=2.0),
}


def effect_of(name: str) -> Effect:
    """Return the effect that is drawn, with its values."""
    how = SIGNATURES[name]
    joints = list((JOINTS[how.joint],) if how.joints is None else how.joints)
    parameters = {key: list(value) for key, value in how.parameters.items()}
    return make(EffectSpec(name, joints, list(how.links), parameters, onset=how.onset, end=how.end))


def motion_of(model: Model, how: Signature) -> Motion:
    """Return how the arm moves, and the torque that the model without any effect asks for."""
    time = np.arange(round(TUNING.seconds * TUNING.rate)) / TUNING.rate
    q, v, a = np.tile(TUNING.home, (len(time), 1)), np.zeros((len(time), 6)), np.zeros((len(time), 6))
    if how.moves is Moves.HELD:
        q[:, how.joint] += np.linspace(-TUNING.sweep, TUNING.sweep, len(time))
        return Motion(time, q, v, a, model.inverse_dynamics(q, v, a))
    for frequency, size in TUNING.fast if how.moves is Moves.FAST else TUNING.slow:
        w = 2.0 * np.pi * frequency
        angle = w * time[:, None] + np.array(TUNING.lags)
        q, v, a = q + size * np.sin(angle), v + size * w * np.cos(angle), a - size * w**2 * np.sin(angle)
    return Motion(time, q, v, a, model.inverse_dynamics(q, v, a, time=time))


def signature(model: Model, name: str) -> tuple[Array, Array]:
    """Return what is laid off to the right and upward: (N,), and (N,) logged less modelled torque [N·m]."""
    how, effect = SIGNATURES[name], effect_of(name)
    motion = motion_of(model, how)
    if name == "torque_saturation":  # the motion is what the bounded torque gave; logged is what was asked for
        logged, reached = motion.tau, effect.applied(model.joints, motion.tau)
    else:
        with_it = model.with_effects([effect])
        logged, reached = with_it.inverse_dynamics(motion.q, motion.v, motion.a, time=motion.time), motion.tau
    shown = (motion.time >= how.span[0]) & (motion.time <= how.span[1])
    return how.axis(motion, logged)[shown], (logged - reached)[shown, how.joint]


def draw(name: str, right: Array, up: Array, path: Path) -> None:
    """Write one picture."""
    with matplotlib.rc_context({"svg.fonttype": "none", "font.size": 8.5, "font.family": "sans-serif"}):
        figure = Figure(figsize=TUNING.size, layout="constrained")
        axes = figure.subplots()
        axes.axhline(0.0, color="0.75", linewidth=0.8)
        axes.plot(right, up, color=TUNING.colour, linewidth=1.4)
        axes.set_xlabel(SIGNATURES[name].label)
        axes.set_ylabel("logged less modelled [N·m]")
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(path, metadata={"Date": None})


def draw_all(folder: Path) -> None:
    """Write a picture of each effect of the catalogue into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    model = Model.load(models_dir() / "arms" / "ur5e.urdf")
    for name in SIGNATURES:
        draw(name, *signature(model, name), folder / f"{name}.svg")
