"""What a message, its Drake calls and a rollout of 100 ms cost, and how that grows with the joints: CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from hrt_bench.estimate import Array
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.short_rollout import short_rollout
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter
from twin_diagram.scenario.resources import models_dir

SIZES = (6, 7, 12, 18)
MESSAGES = 1000
ROTOR = 0.1
"""Reflected inertia of each motor [kg·m²]: without it the last joint would weigh next to nothing."""
OUTLINE = {6: 4.8, 12: 9.3, 18: 14.1}
"""Of the outline's table of growth [ms]."""
Message = tuple[Array, Array, Array, float]


def arms(n: int) -> ArmTerms:
    """N joints: a Panda for 7, else as many UR5e in one plant as make them."""
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    name, root = ("panda.urdf", "panda_link0") if n == 7 else ("ur5e.urdf", "base_link")
    for index in range(1 if n == 7 else n // 6):
        (arm,) = parser.AddModels(str(models_dir() / "arms" / name))
        base = plant.GetFrameByName(root, arm)
        plant.WeldFrames(plant.world_frame(), base, RigidTransform([1.5 * index, 0.0, 0.0]))
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        actuator.set_default_rotor_inertia(ROTOR)
    plant.Finalize()
    found = [plant.get_joint(i) for i in plant.GetJointIndices() if plant.get_joint(i).num_velocities() == 1]
    level = np.full(len(found), 2.0)
    names = [f"{plant.GetModelInstanceName(joint.model_instance())}::{joint.name()}" for joint in found]
    return ArmTerms(plant, names, laws=Laws(dry=lambda q, v, tau: (level, level)))


def spent(call: Callable[[int], object], count: int) -> tuple[float, float]:
    """Median and 99th percentile of `count` calls [ms]."""
    times = []
    for k in range(count):
        start = time.process_time_ns()
        call(k)
        times.append(time.process_time_ns() - start)
    return float(np.median(times)) * 1e-6, float(np.percentile(times, 99)) * 1e-6


def motion(terms: ArmTerms, count: int) -> list[Message]:
    """Messages of an arm in motion, at 200 Hz."""
    n, rng = terms.n, np.random.default_rng(0)
    home, phase = np.full(n, 0.5), np.arange(n)
    found = []
    for k in range(count):
        angle = 0.01 * k + phase
        q, v, a = home + 0.3 * np.sin(angle), 0.6 * np.cos(angle), -1.2 * np.sin(angle)
        tau = terms.inverse_dynamics(q, v, a) + 2.0 * np.tanh(v / 0.01)
        found.append((q, v + 1e-3 * rng.normal(size=n), tau, 0.005 * k))
    return found


def measure_size(n: int) -> dict[str, Any]:
    """With n joints and their viscous friction to learn: 24 states where n is 6 (q, v, unmodelled torque, θ)."""
    terms = arms(n)
    ekf = Ekf(terms, Filter(parameters=["viscous_friction"]))
    messages = motion(terms, 300 + MESSAGES)
    for message in messages[:300]:
        ekf.observe(*message)
    median, tail = spent(lambda k: ekf.observe(*messages[300 + k]), MESSAGES)

    def drake(k: int) -> None:
        q, v, _, _ = messages[k]
        terms.mass_matrix(q)
        terms.inverse_dynamics(q, v, 0.0)
        terms.derivatives(q, v, v)

    bare = spent(drake, 300)
    parameters = ParameterSet(terms, ekf.params)
    times, fine = 0.005 * np.arange(21), 1e-4 * np.arange(1001)

    def roll(k: int, at: Array = times) -> Array:
        # The torque of a message holds until the next.
        torques = np.array([tau for _, _, tau, _ in messages[k : k + 21]])
        held = torques[np.minimum(np.ceil(at / 0.005 - 1e-6).astype(int), 20)]
        return short_rollout(terms, parameters, np.concatenate(messages[k][:2]), parameters.mean, at, held)[0]

    rolled = spent(roll, 100)
    errors = [np.abs(roll(k) - roll(k, fine)).max() for k in range(0, MESSAGES, MESSAGES // 8)]
    return {
        "what": f"{n} joints, {ekf.belief.size} states",
        "joints": n,
        "states": ekf.belief.size,
        "update_ms": median,
        "update_p99_ms": tail,
        "drake_ms": bare[0],
        "drake_p99_ms": bare[1],
        "rollout_ms": rolled[0],
        "rollout_p99_ms": rolled[1],
        "rollout_error_rad": float(np.max(errors)),
    }


def measure() -> list[dict[str, Any]]:
    """All sizes."""
    return [measure_size(n) for n in SIZES]


def table(records: list[dict[str, Any]]) -> list[str]:
    """As lines of text, with the exponent of the growth."""
    lines = [
        "joints  states  update, median / p99 [ms]  outline [ms]  its Drake calls, median / p99 [ms]  "
        "rollout of 100 ms [ms]  its error against steps of 0.1 ms [rad]"
    ]
    for r in records:
        lines.append(
            f"{r['joints']:6d}  {r['states']:6d}  {r['update_ms']:15.2f} / {r['update_p99_ms']:4.2f}  "
            f"{OUTLINE.get(r['joints'], '–'):>16}  {r['drake_ms']:23.2f} / {r['drake_p99_ms']:4.2f}  "
            f"{r['rollout_ms']:27.2f}  {r['rollout_error_rad']:.1e}"
        )
    if len(records) > 1:
        joints, medians = [r["joints"] for r in records], [r["update_ms"] for r in records]
        exponent = np.polyfit(np.log(joints), np.log(medians), 1)[0]
        lines.append(f"update ∝ joints^{exponent:.2f}; outline: joints^{np.log(14.1 / 4.8) / np.log(3):.2f}")
    return lines
