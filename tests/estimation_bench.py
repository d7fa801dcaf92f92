"""A Panda in a discrete plant of its own, with payload, dry friction, a joint controller and sensor noise: truth for
filters.

It shares nothing with the filter but the arm's description.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, SpatialInertia, UnitInertia

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario.resources import models_dir

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
HOME = np.array([0.6, 0.2, 0.0, -2.1, 0.0, 2.3, 1.4])
AWAY = np.array([-0.6, 0.3, 0.05, -2.05, -0.05, 2.35, 0.3])
COULOMB = np.array([0.30, 0.29, 0.29, 0.28, 0.20, 0.20, 0.20])
VISCOUS = np.array([0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.2])
STEP = 0.0025


@dataclass
class Recording:
    """What the sensors said, and the truth, at 200 Hz."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    q_true: np.ndarray
    v_true: np.ndarray


@dataclass
class World:
    """The truth, drawn from a seed."""

    mass: float = 0.8
    com: np.ndarray = field(default_factory=lambda: np.array([0.01, -0.01, 0.16]))
    coulomb: np.ndarray = field(default_factory=lambda: COULOMB.copy())
    viscous: np.ndarray = field(default_factory=lambda: VISCOUS.copy())
    seed: int = 0
    added_mass: float = 0.0
    added_at: float = np.inf
    added_over: float = 0.0
    """So long it takes to be added, evenly [s]."""
    dead_joint: int = -1
    dead_at: float = np.inf
    motor_left: float = 0.0
    push: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Force on the hand, in W [N]."""
    push_at: float = np.inf
    friction_at: float = np.inf
    friction_left: float = 1.0
    """Share of dry friction that is left from `friction_at` on."""
    period: float = 0.0
    start: float = 0.5
    stroke: float = 4.0

    @staticmethod
    def draw(seed: int, **changes) -> World:
        rng = np.random.default_rng(seed)
        return World(
            mass=float(rng.uniform(0.2, 1.5)),
            com=np.array([0.0, 0.0, 0.18]) + rng.uniform(-0.03, 0.03, 3),
            coulomb=COULOMB * rng.uniform(0.9, 1.1, 7),
            viscous=VISCOUS * rng.uniform(0.9, 1.1, 7),
            seed=seed,
            **changes,
        )


def twin_terms() -> ArmTerms:
    """What the twin is told: no payload, nominal friction."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(models_dir() / "arms" / "panda_hand.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0"))
    for name, damping in zip(JOINTS, VISCOUS, strict=True):
        plant.GetJointByName(name).set_default_damping(damping)
    plant.Finalize()
    return ArmTerms(plant, JOINTS, tool_frame="panda_tcp", laws=Laws(dry=lambda q, v, tau: (COULOMB, COULOMB)))


def simulate(world: World, duration: float = 10.0) -> Recording:
    """Runs the arm from y = +0.3 to y = −0.3 and, with `period` > 0, to and fro."""
    plant = MultibodyPlant(STEP)
    plant.SetUseSampledOutputPorts(False)
    Parser(plant).AddModels(str(models_dir() / "arms" / "panda_hand.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0"))
    link = plant.GetBodyByName("panda_link7")
    loads = []
    for name, mass in (("payload", world.mass), ("added", 0.0)):
        inertia = SpatialInertia(mass, np.zeros(3), UnitInertia.SolidSphere(0.03), skip_validity_check=True)
        body = plant.AddRigidBody(name, link.model_instance(), inertia)
        frame = plant.AddFrame(FixedOffsetFrame(name + "_frame", link.body_frame(), RigidTransform(world.com)))
        plant.WeldFrames(frame, body.body_frame())
        loads.append(body)
    stiffness = np.array([600.0] * 4 + [250.0] * 3)
    motors, brakes = [], []
    for i, name in enumerate(JOINTS):
        joint = plant.GetJointByName(name)
        joint.set_default_damping(world.viscous[i])
        motors.append(
            next(a for a in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()) if a.joint().name() == name)
        )
        motors[i].set_controller_gains(PdControllerGains(p=stiffness[i], d=2.0 * np.sqrt(stiffness[i])))
    for name, level in zip(JOINTS, world.coulomb, strict=True):
        brake = plant.AddJointActuator(f"{name}_dry", plant.GetJointByName(name), effort_limit=level)
        brake.set_controller_gains(PdControllerGains(p=0.0, d=1e6))
        brakes.append(brake)
    for i in (1, 2):
        finger = next(
            a
            for a in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
            if a.joint().name() == f"panda_finger_joint{i}"
        )
        finger.set_controller_gains(PdControllerGains(p=2000.0, d=80.0))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    instance = plant.GetModelInstanceByName("panda_hand")
    nu = plant.num_actuators()
    position_of = [plant.GetJointByName(name).position_start() for name in JOINTS]
    velocity_of = [plant.GetJointByName(name).velocity_start() for name in JOINTS]
    q = np.zeros(plant.num_positions())
    q[position_of] = HOME
    plant.SetPositions(context, q)
    rng = np.random.default_rng([world.seed, 1])

    listed = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]
    order = {a.name(): a.input_start() for a in listed}
    of_motor = np.array([order[m.name()] for m in motors])
    row = {a.name(): k for k, a in enumerate(listed)}
    of_row = np.array([row[m.name()] for m in motors])
    desired_port = plant.get_desired_state_input_port(instance)
    feed_port = plant.get_actuation_input_port()
    gravity_terms = twin_terms()
    resolution = 2 * np.pi / 2**19

    n_steps = round(duration / STEP)
    out = Recording(*(np.zeros((n_steps // 2 + 1, 7)) for _ in range(6)))
    out.time = np.zeros(n_steps // 2 + 1)
    kept = 0
    torque = np.zeros(7)
    state = np.zeros(2 * nu)
    feed = np.zeros(nu)
    changed = dead = pushed = False
    lost = 0.0
    for k in range(n_steps + 1):
        t = k * STEP
        q, v = plant.GetPositions(context)[position_of], plant.GetVelocities(context)[velocity_of]
        # The drive's own feed-forward knows the bare arm alone.
        feed[of_motor] = gravity_terms.inverse_dynamics(q, np.zeros(7), 0.0)
        goal, rate = _path(world, t)
        state[of_row], state[nu + of_row] = goal, rate
        if t >= world.added_at and not changed:
            changed = t >= world.added_at + world.added_over
            share = 1.0 if changed else (t - world.added_at) / world.added_over
            inertia = SpatialInertia(share * world.added_mass, np.zeros(3), UnitInertia.SolidSphere(0.03))
            loads[1].SetSpatialInertiaInBodyFrame(context, inertia)
        if world.dead_joint >= 0 and t >= world.dead_at and not dead:
            dead = True
        if t >= world.push_at and not pushed:
            pushed = True
            force = ExternallyAppliedSpatialForce()
            force.body_index = plant.GetBodyByName("panda_hand").index()
            force.F_Bq_W = SpatialForce(np.zeros(3), np.array(world.push))
            plant.get_applied_spatial_force_input_port().FixValue(context, Value([force]))
        desired_port.FixValue(context, state)
        feed_port.FixValue(context, feed)
        if k % 2 == 0:
            out.time[kept] = t
            out.q_true[kept], out.v_true[kept] = q, v
            out.q[kept] = np.round(q / resolution) * resolution
            out.v[kept] = v + rng.normal(0.0, 1e-3, 7)
            out.tau[kept] = torque + rng.normal(0.0, 0.05, 7)
            kept += 1
        if dead:
            # The motor loses part of its torque, and the drive does not notice: taken off through the feed-forward.
            j = world.dead_joint
            lost = (1.0 - world.motor_left) * torque[j]
            feed[of_motor[j]] -= lost
            feed_port.FixValue(context, feed)
        help_ = np.zeros(7)
        if t >= world.friction_at:
            # The brakes' limits are the model's; what they brake too much is given back where the joint slides.
            help_ = (1.0 - world.friction_left) * world.coulomb * np.tanh(v / 0.01)
            feed[of_motor] += help_
            feed_port.FixValue(context, feed)
        context.SetDiscreteState(plant.EvalUniquePeriodicDiscreteUpdate(context))
        context.SetTime((k + 1) * STEP)
        # The controller acts on the step's end; the plant's own output would add up the two actuators of a joint.
        after, speed = plant.GetPositions(context)[position_of], plant.GetVelocities(context)[velocity_of]
        torque = feed[of_motor] + stiffness * (goal - after) + 2.0 * np.sqrt(stiffness) * (rate - speed)
        torque -= help_
        if dead:
            torque[world.dead_joint] += lost
    return out


def _path(world: World, t: float) -> tuple[np.ndarray, np.ndarray]:
    if world.period > 0.0:
        s = max(t - world.start, 0.0) / world.period
        blend = 0.5 - 0.5 * np.cos(2 * np.pi * s)
        rate = np.pi / world.period * np.sin(2 * np.pi * s) if t > world.start else 0.0
    else:
        s = np.clip((t - world.start) / world.stroke, 0.0, 1.0)
        blend = s**3 * (10 - 15 * s + 6 * s * s)
        rate = 30 * s * s * (1 - s) ** 2 / world.stroke
    return HOME + blend * (AWAY - HOME), rate * (AWAY - HOME)


@dataclass
class Figures:
    """How a filter did on a recording."""

    mass_error: float
    mass_std: float
    moment_nees: float
    joint_rms: float
    joint_max: float
    velocity_rms: float
    state_nees: float
    counters: dict[str, int]


def follow(ekf: Ekf, world: World, run: Recording) -> Figures:
    """Runs a filter over a recording."""
    belief, n = ekf.belief, 7
    errors, nees = [], []
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        errors.append(belief.x[: 2 * n] - np.concatenate([run.q_true[k], run.v_true[k]]))
        nees.append(errors[-1] @ np.linalg.solve(belief.P[: 2 * n, : 2 * n], errors[-1]) / (2 * n))
    errors = np.array(errors)
    mass = world.mass + (world.added_mass if world.added_at < run.time[-1] else 0.0)
    moment_error = belief.theta[1:4] - mass * world.com
    return Figures(
        mass_error=float(belief.theta[0] - mass),
        mass_std=float(np.sqrt(belief.P[3 * n, 3 * n])),
        moment_nees=float(moment_error @ np.linalg.solve(belief.P[3 * n + 1 :, 3 * n + 1 :], moment_error)),
        joint_rms=float(np.sqrt(np.mean(errors[:, :n] ** 2))),
        joint_max=float(np.abs(errors[:, :n]).max()),
        velocity_rms=float(np.sqrt(np.mean(errors[:, n:] ** 2))),
        state_nees=float(np.mean(nees[20:])),
        counters={entry.name.lower(): int(belief.header[entry]) for entry in Entry if entry >= Entry.ACCEPTED},
    )
