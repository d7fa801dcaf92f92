"""What an update, a rollout and more joints cost, in process CPU time."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from filter_truth import HOME, told
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia, UnitInertia

from hrt_bench.estimate import Array
from hrt_bench.ours import OUTLINE
from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.ekf import Ekf
from twin_diagram.estimation.rollout import rollout

REPEATS = 600
SIZES = (6, 7, 12, 18)


def chain(n: int) -> ArmTerms:
    """A serial arm of n joints, each turned against the last."""
    plant = MultibodyPlant(0.0)
    parent = plant.world_body()
    for k in range(n):
        inertia = SpatialInertia(2.0, np.array([0.1, 0.0, 0.0]), UnitInertia(0.02, 0.02, 0.02))
        body = plant.AddRigidBody(f"link{k}", inertia)
        axis = np.eye(3)[k % 3]
        joint = RevoluteJoint(
            f"joint{k}", plant.AddFrame(_offset(plant, f"mount{k}", parent)), body.body_frame(), axis, 0.5
        )
        plant.AddJoint(joint)
        plant.AddJointActuator(f"motor{k}", joint, 100.0)
        parent = body
    plant.Finalize()
    return ArmTerms(plant, [f"joint{k}" for k in range(n)])


def _offset(plant: MultibodyPlant, name: str, parent: Any) -> Any:
    from pydrake.math import RigidTransform
    from pydrake.multibody.tree import FixedOffsetFrame

    return FixedOffsetFrame(name, parent.body_frame(), RigidTransform([0.2, 0.0, 0.0]))


def messages(terms: ArmTerms, q: Array) -> Array:
    """CPU time of each message of the arm, prediction and update (REPEATS,) [ms]."""
    ekf, rng = Ekf(terms, OUTLINE), np.random.default_rng(0)
    tau = terms.inverse_dynamics(q, np.zeros(terms.n), 0.0)
    spent = []
    for k in range(REPEATS + 50):
        now = time.process_time_ns()
        ekf.observe(q + 1e-3 * rng.normal(size=terms.n), 1e-2 * rng.normal(size=terms.n), tau, 0.005 * k)
        spent.append(1e-6 * (time.process_time_ns() - now))
    return np.array(spent[50:])


def bare(terms: ArmTerms, q: Array) -> Array:
    """CPU time of the Drake calls alone that one message needs (REPEATS,) [ms]."""
    zero, spent = np.zeros(terms.n), []
    for _ in range(REPEATS):
        now = time.process_time_ns()
        terms.mass_matrix(q)
        terms.load(q, zero, zero)
        terms.derivatives(q, zero, zero)
        terms.payload_regressor(q, zero, zero)
        spent.append(1e-6 * (time.process_time_ns() - now))
    return np.array(spent)


def measure() -> list[dict[str, Any]]:
    """All of it."""
    arm = told()
    records: list[dict[str, Any]] = []
    for name, spent in (("update, 6 joints", messages(arm, HOME)), ("its Drake calls alone", bare(arm, HOME))):
        records.append({"what": name, "median_ms": float(np.median(spent)), "p99_ms": float(np.quantile(spent, 0.99))})
    records.append(_rollout(arm))
    sizes = []
    for n in SIZES:
        spent = messages(arm if n == 6 else chain(n), HOME if n == 6 else np.full(n, 0.3))
        sizes.append(float(np.median(spent)))
        records.append({"what": f"growth, {n} joints", "median_ms": sizes[-1]})
    exponent = np.polyfit(np.log(SIZES), np.log(sizes), 1)[0]
    records.append({"what": "growth, exponent", "exponent": float(exponent)})
    return records


def _rollout(arm: ArmTerms) -> dict[str, Any]:
    """100 ms at steps of 5 ms, against steps of 0.1 ms."""
    parameters = Ekf(arm, OUTLINE).parameters
    state = np.concatenate([HOME, np.array([0.5, -0.4, 0.6, 0.3, -0.5, 0.8])])
    tau = arm.inverse_dynamics(HOME, state[6:], 0.0) + np.array([5.0, -8.0, 4.0, 1.0, -1.0, 0.5])
    theta, spent, q = np.zeros(parameters.size), [], np.zeros(6)
    for _ in range(60):
        now = time.process_time_ns()
        q, _ = rollout(arm, parameters, state, theta, np.linspace(0.0, 0.1, 21), np.tile(tau, (21, 1)))
        spent.append(1e-6 * (time.process_time_ns() - now))
    fine, _ = rollout(arm, parameters, state, theta, np.linspace(0.0, 0.1, 1001), np.tile(tau, (1001, 1)))
    return {
        "what": "rollout of 100 ms, steps of 5 ms",
        "median_ms": float(np.median(spent)),
        "p99_ms": float(np.quantile(spent, 0.99)),
        "error_rad": float(np.abs(q - fine).max()),
    }
