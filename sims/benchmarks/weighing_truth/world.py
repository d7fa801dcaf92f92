"""A simulated arm that moves objects, and its torque sensors as scorers set them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from twin_diagram import scenario
from twin_diagram.estimation.weighing import (
    Excitation,
    ExcitationPlan,
    Grip,
    MotionLimits,
    WeighingError,
    optimise_excitation,
)
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.logs.measured_log import Log
from twin_diagram.model import Model

Array = np.ndarray
MODEL = Path(__file__).resolve().parents[3] / "models" / "arms" / "iiwa7_wsg.urdf"
POSTURE = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.0, 0.0])
RATE = 200.0
"""Of the torques [1/s]."""
COUNT = 2.0 * np.pi / 2**19
"""Of an encoder [rad]."""
WIDE, WIDEST = (0.05, 0.12, 0.2), 0.53
"""Frequencies of the motion that calibrates [Hz], and its size at each [rad]."""
SPEED_NOISE = 1e-3
"""Of the drives' speeds [rad/s]."""
POSE = (0.0005, 0.002)
"""By what an object sits otherwise in the hand than told, each axis [m], [rad]."""


@dataclass(frozen=True)
class Sensors:
    """Per joint: gain error, bias [N·m], viscous [N·m·s/rad] and dry friction [N·m], and white noise [N·m]."""

    gain: Array
    bias: Array
    viscous: Array
    dry: Array
    noise: float

    @staticmethod
    def draw(random: np.random.Generator, noise: float, joints: int, gain: float = 0.01) -> Sensors:
        """As scorers set them; frictions up to 0.5 are remnants behind the gear."""
        return Sensors(
            gain * random.normal(size=joints),
            0.2 * random.normal(size=joints),
            random.uniform(0.0, 0.5, joints),
            random.uniform(0.0, 0.5, joints),
            noise,
        )


def arm(torque_side: str) -> Model:
    """The iiwa 7 with a WSG-50."""
    return Model.load(scenario.ArmModel(model=str(MODEL), tool_frame="wsg_tcp"), torque_side=torque_side)


def grasp(size: Array, random: np.random.Generator) -> RigidTransform:
    """X_TO: the thinnest axis (x) between the fingers, the longest anywhere about it, up to a quarter off."""
    turn = RollPitchYaw(0.0, random.uniform(-np.pi, np.pi), 0.0).ToRotationMatrix()
    R_TO = turn @ RollPitchYaw(0.0, 0.0, np.pi / 2).ToRotationMatrix()
    off = random.uniform(-0.25, 0.25, 3) * size * np.array([0.0, 1.0, 1.0])
    return RigidTransform(R_TO, -(R_TO @ off))


def excite(model: Model, X_TO: RigidTransform, parameters: Array, force: float, plan: ExcitationPlan) -> Excitation:
    """An excitation; where the grip does not carry it, from a posture in which the hand hangs straight down."""
    postures = (POSTURE, np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.14, 0.0]))
    for posture in postures:
        for firm in (1.0, 1.5):
            try:
                limits = MotionLimits.of(model)
                return optimise_excitation(model, X_TO, parameters, posture, limits, Grip(firm * force), plan=plan)
            except WeighingError as error:
                last = error
    raise last


def moved(X_TO: RigidTransform, random: np.random.Generator) -> RigidTransform:
    """Where an object sits in truth that is told to sit at X_TO."""
    angle = POSE[1] * random.normal(size=3)
    return X_TO @ RigidTransform(RotationMatrix(RollPitchYaw(*angle)), POSE[0] * random.normal(size=3))


def record(
    model: Model, motion: Excitation, sensors: Sensors, random: np.random.Generator, held: tuple | None = None
) -> Log:
    """A log of a motion; `held`: X_TO and true parameters of what is in the hand."""
    return measured(model, *motion.sampled(RATE), sensors, random, held)


def calibration(model: Model, sensors: Sensors, random: np.random.Generator) -> Log:
    """A log of the empty arm, each joint swinging widely and slowly for 20 s: what tells gains by its own weight."""
    draw, time, n = np.random.default_rng(5), np.arange(0.0, 20.0, 1.0 / RATE), len(model.joints)
    q, v, a = np.tile(POSTURE, (len(time), 1)), np.zeros((len(time), n)), np.zeros((len(time), n))
    for frequency in WIDE:
        w = 2.0 * np.pi * frequency * (1.0 + 0.15 * draw.uniform(-1.0, 1.0, n))
        size, angle = WIDEST * draw.uniform(0.6, 1.3, n), np.outer(time, w) + draw.uniform(0.0, 2.0 * np.pi, n)
        q, v, a = q + size * np.sin(angle), v + size * w * np.cos(angle), a - size * w**2 * np.sin(angle)
    return measured(model, time, (q, v, a), sensors, random)


def measured(
    model: Model,
    time: Array,
    motion: tuple[Array, Array, Array],
    sensors: Sensors,
    random: np.random.Generator,
    held: tuple | None = None,
) -> Log:
    """What is logged of joint angles, speeds and accelerations (N, n) at some times (N,)."""
    q, v, a = motion
    torque = model.inverse_dynamics(q, v, a)
    if held is not None:
        torque = torque + Held.in_tool(model, held[0]).regressor(model, q, v, a) @ held[1]
    torque = torque + sensors.viscous * v + sensors.dry * np.tanh(v / 0.01)
    torque = (1.0 + sensors.gain) * torque + sensors.bias + sensors.noise * random.normal(size=torque.shape)
    speed = v + SPEED_NOISE * random.normal(size=v.shape)
    return Log(time, model.joints, np.round(q / COUNT) * COUNT, velocity=speed, torque=torque)
