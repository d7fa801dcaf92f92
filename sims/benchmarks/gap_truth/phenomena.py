"""How MuJoCo's world shows each effect: joints, bodies, tendons, and torques applied at every step."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt

from gap_truth.chain import GRAVITY
from gap_truth.hidden import Hidden
from gap_truth.world import STEP, World, motor_dofs

Array = npt.NDArray[np.float64]


def install(world: World, hidden: Hidden) -> None:
    """Puts an effect into a world."""
    _INSTALL[hidden.name](world, hidden)


def _per_joint(world: World, hidden: Hidden, key: str, default: float = 0.0) -> Array:
    result = np.full(world.chain.n, default)
    result[list(hidden.joints)] = hidden.values[key]
    return result


def _viscous(world: World, hidden: Hidden) -> None:
    damping = _per_joint(world, hidden, "damping")
    if hidden.onset is None:
        world.damping = world.damping + damping
    else:
        world.loads.append(lambda t, q, v: -damping * v * hidden.acts(t))


def _coulomb(world: World, hidden: Hidden) -> None:
    if "torque" in hidden.values:
        forward = backward = _per_joint(world, hidden, "torque")
    else:
        forward, backward = (_per_joint(world, hidden, f"torque_{way}") for way in ("positive", "negative"))
    level, shift = 0.5 * (forward + backward), 0.5 * (forward - backward)
    if hidden.onset is None:
        world.friction = world.friction + level
    else:
        world.levels.append(lambda t, q, v, tau: level * hidden.acts(t))
    if np.any(shift):
        world.loads.append(lambda t, q, v: -shift * hidden.acts(t))


def _stribeck(world: World, hidden: Hidden) -> None:
    coulomb, static = (_per_joint(world, hidden, key) for key in ("coulomb", "static"))
    speed = _per_joint(world, hidden, "stribeck_velocity", 1.0)
    world.levels.append(lambda t, q, v, tau: coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2)))


def _load_dependent(world: World, hidden: Hidden) -> None:
    coefficient = _per_joint(world, hidden, "coefficient")
    world.levels.append(lambda t, q, v, tau: coefficient * np.abs(tau))


def _coupled(world: World, hidden: Hidden) -> None:
    i, j = hidden.joints
    world.tail += (
        f'<tendon><fixed name="wrist" damping="{hidden.values["damping"][0]}" '
        f'frictionloss="{hidden.values["torque"][0]}" solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001">'
        f'<joint joint="joint_{i + 1}" coef="1"/><joint joint="joint_{j + 1}" coef="1"/></fixed></tendon>'
    )


def _payload(world: World, hidden: Hidden) -> None:
    assert hidden.link is not None
    (mass,), com = hidden.values["mass"], hidden.values["com"]
    body = (
        f'<body name="payload" pos="{com[0]} {com[1]} {com[2]}">'
        f'<inertial pos="0 0 0" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/></body>'
    )
    world.hung[hidden.link] = world.hung.get(hidden.link, "") + body
    if hidden.onset is not None:

        def step(t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
            model.body_mass[model.body("payload").id] = mass if hidden.acts(t) else 1e-9

        world.steps.append(step)


def _inertial(world: World, hidden: Hidden) -> None:
    assert hidden.link is not None
    links = list(world.chain.links)
    values = hidden.values
    links[hidden.link] = links[hidden.link].with_lump(
        values["mass"][0], np.array(values["lump_com"]), np.diag(values["lump_inertia"])
    )
    world.chain = replace(world.chain, links=tuple(links))


def _rotor(world: World, joints: tuple[int, ...], inertia: list[float]) -> None:
    links = list(world.chain.links)
    for j, more in zip(joints, inertia, strict=True):
        links[j] = replace(links[j], rotor=links[j].rotor + more)
    world.chain = replace(world.chain, links=tuple(links))


def _reflected(world: World, hidden: Hidden) -> None:
    _rotor(world, hidden.joints, hidden.values["inertia"])


def tilted_gravity(roll: float, pitch: float) -> Array:
    """Gravity in the frame of a base that is rolled about world x and then pitched about world y."""
    x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    return np.asarray((y @ x).T @ GRAVITY)


def _tilt(world: World, hidden: Hidden) -> None:
    world.gravity = tilted_gravity(hidden.values["roll"][0], hidden.values["pitch"][0])


def spring_torque(hidden: Hidden, k: int, q: Array) -> Array:
    """What the motor gives more at angles of the k-th joint of a `joint_spring` [N·m]."""
    values = hidden.values
    if "stiffness" in values:
        return np.asarray(values["stiffness"][k] * (q - values["rest_angle"][k]))
    # A gas spring between the links: its line of action, and with it its length, turns with the joint.
    angle, ratio = q - values["zero"][k], values["ratio"][k]
    length = np.sqrt(1.0 + ratio**2 - 2.0 * ratio * np.cos(angle))
    return np.asarray(values["amplitude"][k] * np.sin(angle) / length)


def _spring(world: World, hidden: Hidden) -> None:
    def load(t: float, q: Array, v: Array) -> Array:
        result = np.zeros(world.chain.n)
        if hidden.acts(t):
            for k, j in enumerate(hidden.joints):
                result[j] = -spring_torque(hidden, k, q[j])
        return result

    world.loads.append(load)


def _elasticity(world: World, hidden: Hidden) -> None:
    _rotor(world, hidden.joints, hidden.values["rotor_inertia"])
    for j, stiffness in zip(hidden.joints, hidden.values["stiffness"], strict=True):
        world.soft[j] = {"stiffness": stiffness, "damping": 0.04 * np.sqrt(stiffness * world.chain.links[j].rotor)}


def _backlash(world: World, hidden: Hidden) -> None:
    _rotor(world, hidden.joints, hidden.values["rotor_inertia"])
    for j, gap in zip(hidden.joints, hidden.values["gap"], strict=True):
        world.soft[j] = {"gap": gap}


def _ripple(world: World, hidden: Hidden) -> None:
    amplitude, cycles, phase = (_per_joint(world, hidden, key) for key in ("amplitude", "cycles", "phase"))
    world.loads.append(lambda t, q, v: -amplitude * np.sin(cycles * q + phase))


def _gain(world: World, hidden: Hidden) -> None:
    gain = _per_joint(world, hidden, "gain", 1.0)
    world.motors.append(lambda t, q, v, tau: tau * gain if hidden.acts(t) else tau)


def _bias(world: World, hidden: Hidden) -> None:
    bias = _per_joint(world, hidden, "torque")
    world.motors.append(lambda t, q, v, tau: tau + bias * hidden.acts(t))


def _saturation(world: World, hidden: Hidden) -> None:
    limit = _per_joint(world, hidden, "limit", np.inf)
    world.motors.insert(0, lambda t, q, v, tau: np.clip(tau, -limit, limit))


def _delay(world: World, hidden: Hidden) -> None:
    steps = round(hidden.values["delay"][0] / STEP)
    queue: deque[Array] = deque()

    def motor(t: float, q: Array, v: Array, tau: Array) -> Array:
        queue.append(tau)
        return queue.popleft() if len(queue) > steps else queue[0]

    world.motors.insert(0, motor)


def _offset(world: World, hidden: Hidden) -> None:
    world.offset = world.offset + _per_joint(world, hidden, "offset")


def _push(world: World, hidden: Hidden) -> None:
    wrench, name = np.array(hidden.values["wrench"]), f"link_{(hidden.link or 0) + 1}"

    def step(t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        body = model.body(name).id
        data.xfrc_applied[body] = 0.0
        if hidden.acts(t):
            # MuJoCo takes forces at the centre of mass; poses are those of the step before.
            arm = data.xpos[body] - data.xipos[body]
            data.xfrc_applied[body, :3] = wrench[:3]
            data.xfrc_applied[body, 3:] = wrench[3:] + np.cross(arm, wrench[:3])

    world.steps.append(step)


def _thermal(world: World, hidden: Hidden) -> None:
    level, left, constant = (_per_joint(world, hidden, k, 1.0) for k in ("torque", "left", "time_constant"))
    level[[j for j in range(world.chain.n) if j not in hidden.joints]] = 0.0
    world.levels.append(lambda t, q, v, tau: level * (left + (1.0 - left) * np.exp(-t / constant)))


def _cable(world: World, hidden: Hidden) -> None:
    i, j = hidden.joints
    rest: list[float] = []

    def load(t: float, q: Array, v: Array) -> Array:
        if not rest:
            rest.append(float(q[i] - q[j]))
        result = np.zeros(world.chain.n)
        pull = hidden.values["stiffness"][0] * (q[i] - q[j] - rest[0])
        result[i], result[j] = -pull, pull
        return result

    world.loads.append(load)


def _drag(world: World, hidden: Hidden) -> None:
    drag = _per_joint(world, hidden, "drag")
    world.loads.append(lambda t, q, v: -drag * v * np.abs(v))


def _bouc_wen(world: World, hidden: Hidden) -> None:
    """dz/dt = v (1 − |z|^p (1 + sign(v z)) / 2) / travel, torque −A z."""
    level, power = _per_joint(world, hidden, "torque"), _per_joint(world, hidden, "power", 1.0)
    travel = _per_joint(world, hidden, "travel", 1.0)
    z = np.zeros(world.chain.n)

    def load(t: float, q: Array, v: Array) -> Array:
        z[:] += STEP * v / travel * (1.0 - np.abs(z) ** power * (0.5 + 0.5 * np.sign(v * z)))
        return -level * z

    world.loads.append(load)


def _slosh(world: World, hidden: Hidden) -> None:
    assert hidden.link is not None
    (mass,), (length,), at = hidden.values["mass"], hidden.values["length"], hidden.values["at"]
    damping = 2.0 * hidden.values["damping_ratio"][0] * mass * length**2 * np.sqrt(9.81 / length)
    # A spherical pendulum: two crossed hinges, free to turn whichever way the link stands.
    small = 0.05 * mass * length**2
    world.hung[hidden.link] = (
        f'<body name="liquid" pos="{at[0]} {at[1]} {at[2]}">'
        f'<inertial pos="0 0 {length}" mass="{mass}" diaginertia="{small} {small} {small}"/>'
        f'<joint name="slosh_1" type="hinge" axis="1 0 0" damping="{damping}"/>'
        f'<joint name="slosh_2" type="hinge" axis="0 1 0" damping="{damping}"/></body>'
    )


def _loose(world: World, hidden: Hidden) -> None:
    assert hidden.link is not None
    (mass,), (play,) = hidden.values["mass"], hidden.values["play"]
    at, way = hidden.values["at"], hidden.values["way"]
    world.hung[hidden.link] = (
        f'<body name="loose" pos="{at[0]} {at[1]} {at[2]}">'
        f'<inertial pos="0 0 0" mass="{mass}" diaginertia="1e-4 1e-4 1e-4"/>'
        f'<joint name="slide" type="slide" axis="{way[0]} {way[1]} {way[2]}" limited="true" '
        f'range="{-0.5 * play} {0.5 * play}" damping="{0.5 * mass}" solreflimit="0.004 1"/></body>'
    )


def _speed_constant(world: World, hidden: Hidden) -> None:
    loss = _per_joint(world, hidden, "loss")
    world.motors.append(lambda t, q, v, tau: tau * np.maximum(1.0 - loss * np.abs(v), 0.1))


def _uneven_friction(world: World, hidden: Hidden) -> None:
    level, turns, phase = (_per_joint(world, hidden, k) for k in ("torque", "turns", "phase"))
    world.levels.append(lambda t, q, v, tau: level * (1.0 + np.cos(turns * q + phase)))


def _lag(world: World, hidden: Hidden) -> None:
    constant = _per_joint(world, hidden, "time_constant", 1e-9)
    state: list[Array] = []

    def motor(t: float, q: Array, v: Array, tau: Array) -> Array:
        now = tau if not state else state[0] + (1.0 - np.exp(-STEP / constant)) * (tau - state[0])
        state[:] = [now]
        return now

    world.motors.append(motor)


_INSTALL: dict[str, Callable[[World, Hidden], None]] = {
    "viscous_friction": _viscous,
    "coulomb_friction": _coulomb,
    "stribeck_friction": _stribeck,
    "load_dependent_friction": _load_dependent,
    "coupled_friction": _coupled,
    "payload": _payload,
    "inertial_parameters": _inertial,
    "reflected_inertia": _reflected,
    "gravity_tilt": _tilt,
    "joint_spring": _spring,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "torque_ripple": _ripple,
    "torque_constant": _gain,
    "torque_bias": _bias,
    "torque_saturation": _saturation,
    "time_delay": _delay,
    "encoder_offset": _offset,
    "external_force": _push,
    "actuator_fault": _gain,
    "thermal_drift": _thermal,
    "cable_coupling": _cable,
    "quadratic_drag": _drag,
    "hysteresis": _bouc_wen,
    "sloshing": _slosh,
    "speed_dependent_constant": _speed_constant,
    "position_dependent_friction": _uneven_friction,
    "loose_payload": _loose,
    "motor_lag": _lag,
}

__all__ = ["install", "motor_dofs", "spring_torque", "tilted_gravity"]
