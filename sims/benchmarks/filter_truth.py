"""A UR5e in MuJoCo that wanders about, as a stream of messages: truth for the filter's experiments.

It shares nothing with the filter but the description. Friction is within a tenth of what the twin is told, the payload
is not told at all. Needs the `demo` extra.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws
from twin_diagram.scenario.resources import models_dir
from twin_diagram.station.mujoco import Secret, compile_robot

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", *(f"wrist_{k}_joint" for k in (1, 2, 3)))
HOME = np.array([0.0, -1.3, 1.6, -1.8, -1.57, 0.0])
COULOMB = np.array([6.0, 6.0, 4.0, 1.5, 1.5, 1.5])
VISCOUS = np.array([6.0, 6.0, 4.0, 1.0, 1.0, 1.0])
ROTOR = np.array([1.0, 1.0, 0.6, 0.1, 0.1, 0.1])
"""Reflected inertia of the motors, told and true alike: without it the last joint would weigh next to nothing."""
RATE = 200.0
BANDWIDTH = 2.0 * np.pi * 5.0
"""Of the drive's position loop [rad/s]."""
URDF: Path = models_dir() / "arms" / "ur5e.urdf"


def told() -> ArmTerms:
    """What the twin is told: the description and nominal friction."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(URDF))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    for name, damping in zip(JOINTS, VISCOUS, strict=True):
        plant.GetJointByName(name).set_default_damping(damping)
    for name, rotor in zip(JOINTS, ROTOR, strict=True):
        next(
            actuator
            for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
            if actuator.joint().name() == name
        ).set_default_rotor_inertia(rotor)
    plant.Finalize()
    return ArmTerms(plant, JOINTS, tool_frame="tool0", laws=Laws(dry=lambda q, v, tau: (COULOMB, COULOMB)))


@dataclass
class Truth:
    """One hidden arm, drawn from a seed.

    Attributes:
        seed: of all that is random.
        mass: of the payload [kg].
        added, added_at: further payload [kg] from a time on [s].
        friction_left, friction_at: share of dry friction left from a time on [s].
        liveliness: how far it swings, 1 being lively, 0 rest.
        velocity_noise, torque_noise: [rad/s], share of the effort limit.
    """

    seed: int
    mass: float = 0.0
    added: float = 0.0
    added_at: float = np.inf
    friction_left: float = 1.0
    friction_at: float = np.inf
    liveliness: float = 1.0
    velocity_noise: float = 1e-3
    torque_noise: float = 0.003
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: np.ndarray = field(default_factory=lambda: COULOMB.copy())

    @staticmethod
    def draw(seed: int, **changes: Any) -> Truth:
        """An arm with 0 to 2 kg and friction within a tenth of nominal."""
        rng = np.random.default_rng([seed, 7])
        return Truth(
            seed,
            mass=float(rng.uniform(0.0, 2.0)),
            com=tuple(np.array([0.0, 0.0, 0.08]) + rng.uniform(-0.02, 0.02, 3)),
            friction=COULOMB * rng.uniform(0.9, 1.1, 6),
            **changes,
        )

    def messages(self, duration: float) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Time [s], measured q, v, τ and the true [q, v], at 200 Hz."""
        rng = np.random.default_rng([self.seed, 8])
        damping = VISCOUS * rng.uniform(0.9, 1.1, 6)
        secret = Secret(
            max(self.mass, 1e-6),
            self.com,
            dict(zip(JOINTS, self.friction, strict=True)),
            dict(zip(JOINTS, damping, strict=True)),
        )
        model = compile_robot(URDF, secret)
        model.dof_armature[:] = ROTOR
        mujoco.mj_setConst(model, mujoco.MjData(model))  # else dry friction is as soft as links without rotors want it
        data = mujoco.MjData(model)
        data.qpos[:] = HOME
        limit = np.array([150.0, 150.0, 150.0, 28.0, 28.0, 28.0])
        # A sum of slow sines that never repeats, and stands still now and then.
        amplitude = self.liveliness * rng.uniform(0.1, 0.45, (3, 6)) / np.arange(1, 4)[:, None]
        omega = rng.uniform(0.5, 1.6, (3, 6)) * np.arange(1, 4)[:, None]
        phase = rng.uniform(0.0, 2.0 * np.pi, (3, 6))
        # Torque as of a position drive with computed feed-forward of its own nominal model.
        bare = mujoco.MjModel.from_xml_path(str(URDF))
        own = mujoco.MjData(bare)
        inertia = np.zeros((6, 6))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        stiffness, gain = inertia.diagonal() * BANDWIDTH**2, 2.0 * inertia.diagonal() * BANDWIDTH
        count = 2.0 * np.pi / 2**19
        steps, dt = round(duration * 1000), 1e-3
        tau, tau_sum, changed, slick = np.zeros(6), np.zeros(6), False, False
        body = model.nbody - 1
        clock = 0.0
        for k in range(steps + 1):
            t = k * dt
            pace = min(t / 1.0, 1.0) * (0.5 - 0.5 * np.tanh(4.0 * np.sin(0.13 * t + phase[0, 0]) - 3.6))
            clock += pace * dt
            angle = omega * clock + phase
            goal = HOME + np.sum(amplitude * (np.sin(angle) - np.sin(phase)), axis=0)
            rate = np.sum(amplitude * omega * np.cos(angle), axis=0) * pace
            if k % 5 == 0:
                noise = rng.normal(size=12)
                # MuJoCo's speeds are half a step older than its positions.
                v = data.qvel + 0.5 * model.opt.timestep * data.qacc
                yield (
                    t,
                    np.round(data.qpos / count) * count,
                    v + self.velocity_noise * noise[:6],
                    (tau if k == 0 else tau_sum / 5.0) + self.torque_noise * limit * noise[6:],
                    np.concatenate([data.qpos, v]),
                )
                tau_sum = np.zeros(6)
            if t >= self.added_at and not changed:
                changed = True
                model.body_mass[body] += self.added
                mujoco.mj_setConst(model, mujoco.MjData(model))
            if t >= self.friction_at and not slick:
                slick = True
                model.dof_frictionloss[:] = self.friction * self.friction_left
            own.qpos[:], own.qvel[:] = data.qpos, 0.0
            mujoco.mj_forward(bare, own)
            tau = own.qfrc_bias + stiffness * (goal - data.qpos) + gain * (rate - data.qvel)
            tau = np.clip(tau, -limit, limit)
            tau_sum = tau_sum + tau
            data.qfrc_applied[:] = tau
            mujoco.mj_step(model, data, nstep=2)
