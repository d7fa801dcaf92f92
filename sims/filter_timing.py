"""What the filter costs: one update, its Drake calls alone, a rollout of 100 ms, and how both grow with the joints.

    python sims/filter_timing.py

Times are this process's CPU time on one core. 6 joints are a UR5e, 7 a Panda, 12 and 18 are two and three UR5e in one
plant. With viscous friction per joint as parameters the 6 joints make 24 states: q, v, the torque unmodelled, θ.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.estimation.arm_terms import ArmTerms, Laws
from twin_diagram.estimation.ekf import Ekf
from twin_diagram.estimation.parameters import ParameterSet
from twin_diagram.estimation.rollout import rollout
from twin_diagram.resources import models_dir
from twin_diagram.scenario import Filter

OUTLINE = {6: 4.8, 12: 9.3, 18: 14.1}
"""Of the outline's table of growth [ms]."""


def arms(n: int) -> ArmTerms:
    """N joints: a Panda for 7, else as many UR5e as make them."""
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    name, root = ("panda.urdf", "panda_link0") if n == 7 else ("ur5e.urdf", "base_link")
    for index in range(1 if n == 7 else n // 6):
        (arm,) = parser.AddModels(str(models_dir() / "arms" / name))
        base = plant.GetFrameByName(root, arm)
        plant.WeldFrames(plant.world_frame(), base, RigidTransform([1.5 * index, 0.0, 0.0]))
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


def measure(n: int) -> tuple[int, float, float, float, float]:
    """States, update (median, 99th percentile), its Drake calls and a rollout of 100 ms [ms] for n joints."""
    terms = arms(n)
    ekf = Ekf(terms, Filter(parameters=["viscous_friction"]))
    home, phase, rng = np.full(n, 0.5), np.arange(n), np.random.default_rng(0)
    messages = []
    for k in range(1300):
        angle = 0.01 * k + phase
        q, v, a = home + 0.3 * np.sin(angle), 0.6 * np.cos(angle), -1.2 * np.sin(angle)
        tau = terms.inverse_dynamics(q, v, a) + 2.0 * np.tanh(v / 0.01)
        messages.append((q, v + 1e-3 * rng.normal(size=n), tau, 0.005 * k))
    for message in messages[:300]:
        ekf.observe(*message)
    median, tail = spent(lambda k: ekf.observe(*messages[300 + k]), 1000)

    def drake(k: int) -> None:
        q, v, _, _ = messages[k]
        terms.mass_matrix(q)
        terms.inverse_dynamics(q, v, 0.0)
        terms.derivatives(q, v, v)

    parameters = ParameterSet(terms, ekf.params)
    times = 0.005 * np.arange(21)

    def roll(k: int) -> None:
        window = messages[k : k + 21]
        torques = np.array([tau for _, _, tau, _ in window])
        rollout(terms, parameters, np.concatenate(window[0][:2]), parameters.mean, times, torques)

    return ekf.belief.size, median, tail, spent(drake, 300)[0], spent(roll, 100)[0]


def main() -> None:
    """Prints the table."""
    argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0]).parse_args()
    print("| joints | states | update, median / p99 [ms] | outline | its Drake calls [ms] | rollout of 100 ms [ms] |")
    print("|---|---|---|---|---|---|")
    sizes, medians = [6, 7, 12, 18], []
    for n in sizes:
        size, median, tail, bare, rolled = measure(n)
        medians.append(median)
        outline = f"{OUTLINE[n]}" if n in OUTLINE else "–"
        print(f"| {n} | {size} | {median:.2f} / {tail:.2f} | {outline} | {bare:.2f} | {rolled:.2f} |", flush=True)
    exponent = np.polyfit(np.log(sizes), np.log(medians), 1)[0]
    print(f"update ∝ joints^{exponent:.2f}; the outline's figures: joints^{np.log(14.1 / 4.8) / np.log(3):.2f}")


if __name__ == "__main__":
    main()
