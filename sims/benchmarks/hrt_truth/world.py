"""Lets a hidden arm follow a motion, and says what ideal sensors would have read."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from filter_truth import BANDWIDTH, HOME, URDF

from hrt_truth.hidden import LAST, LIMIT, PAYLOAD, Fault, Hidden, N
from hrt_truth.streams import Array
from twin_diagram.station.mujoco import TUNING as MUJOCO

EVERY = 5
"""Drive periods per message: 200 Hz."""
COUNT = 2.0 * np.pi / 2**19
"""Of the drive's own encoder [rad]."""


@dataclass(frozen=True)
class Happened:
    """A run without noise, at the messages' times; n joints.

    Attributes:
        time: (N,) [s].
        q, v: (N, n), true.
        encoder: (N, n) as the drive's encoder says [rad].
        tau: (N, n) as the drive believes that it gave, mean since the message before [N·m].
        asked, asked_rate: (N, n).
        hand: (N, 7) pose in W.
        hand_speed: (N, 3) [m/s].
        imu: (N, 6) angular velocity, specific force, in the hand's frame.
        wrench: (N, 6) moment, force, on what the hand carries, in the last link's frame.
        mass: (N,) payload [kg].
        friction: (N, n) [N·m].
        began, ended: of the fault [s]; NaN.
    """

    time: Array
    q: Array
    v: Array
    encoder: Array
    tau: Array
    asked: Array
    asked_rate: Array
    hand: Array
    hand_speed: Array
    imu: Array
    wrench: Array
    mass: Array
    friction: Array
    began: float
    ended: float


class Drive:
    """Joint-wise PD with the weight of the arm as described; no part of it knows the payload."""

    def __init__(self) -> None:
        self._model = mujoco.MjModel.from_xml_path(str(URDF))
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = HOME
        mujoco.mj_forward(self._model, self._data)
        inertia = np.zeros((N, N))
        mujoco.mj_fullM(self._model, self._data, inertia)
        diagonal = inertia.diagonal() + np.array([1.0, 1.0, 0.6, 0.1, 0.1, 0.1])
        self.stiffness, self.damping = diagonal * BANDWIDTH**2, 2.0 * diagonal * BANDWIDTH

    def torque(self, q: Array, v: Array, asked: Array, rate: Array) -> Array:
        """(n,) [N·m]."""
        self._data.qpos[:], self._data.qvel[:] = q, 0.0
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_rne(self._model, self._data, 0, self._data.qfrc_bias)
        tau = self._data.qfrc_bias + self.stiffness * (asked - q) + self.damping * (rate - v)
        return np.asarray(np.clip(tau, -LIMIT, LIMIT))


def run(hidden: Hidden, asked: Array, rate: Array, fault: Fault | None = None) -> Happened:
    """Runs an arm.

    Args:
        hidden: the arm.
        asked: (K + 1, n) positions that the drive is told, at `PERIOD` [rad].
        rate: (K + 1, n) its speeds [rad/s].
        fault: what goes wrong; nothing where None.
    """
    fault = fault or Fault()
    model, drive = hidden.compile(), Drive()
    data = mujoco.MjData(model)
    data.qpos[:] = asked[0]
    payload, link = model.body(PAYLOAD).id, model.body(LAST).id
    rng = np.random.default_rng([hidden.seed, 43])
    away = rng.normal(size=3)
    away /= np.linalg.norm(away)
    rows: list[tuple[Array, ...]] = []
    tau_sum, began, ended, shown = np.zeros(N), np.nan, np.nan, np.zeros(N)
    gain, pull, slip = np.ones(N), 0.0, None
    velocity, acceleration, wrench = np.zeros(6), np.zeros(6), np.zeros(6)
    mujoco.mj_forward(model, data)
    for k in range(len(asked)):
        t = k * MUJOCO.period
        if np.isnan(began) and t >= fault.at - 1e-9 and _ready(fault, data):
            began = t
            _begin(fault, model, data, payload, away, gain, shown)
            if fault.kind == "grasp_slip":
                slip = Slip(model, data, payload, fault, away)
        if began <= t and fault.kind == "contact":
            if t >= began + fault.lasts and np.isnan(ended):
                data.xfrc_applied[payload] = 0.0
                ended = t
        elif slip is not None:
            slip.move(model, data, t - began)
        elif began <= t and fault.kind == "encoder_spoofed":
            pull += fault.size * MUJOCO.period
            shown[fault.joint] = pull
        read = np.round(data.qpos / COUNT) * COUNT + shown
        tau = drive.torque(read, data.qvel, asked[k], rate[k])
        if k % EVERY == 0:
            data.qfrc_applied[:] = gain * tau
            mujoco.mj_forward(model, data)
            # MuJoCo moves positions by the speeds at a step's end, so that its speeds are half a step old.
            old = data.qvel.copy()
            data.qvel[:] += 0.5 * model.opt.timestep * data.qacc
            mujoco.mj_forward(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, link, velocity, 1)
            mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, link, acceleration, 1)
            R, p = data.xmat[link].reshape(3, 3), data.xpos[link]
            root = model.body_rootid[payload]
            inner = data.cfrc_int[payload]
            wrench[:3] = R.T @ (inner[:3] + np.cross(data.subtree_com[root] - p, inner[3:]))
            wrench[3:] = R.T @ inner[3:]
            rows.append(
                (
                    np.array([t]),
                    data.qpos.copy(),
                    data.qvel.copy(),
                    read,
                    tau_sum / EVERY if k else tau,
                    asked[k],
                    rate[k],
                    np.concatenate([data.xquat[link], p]),
                    R @ velocity[3:],
                    np.concatenate([velocity[:3], acceleration[3:]]),
                    wrench.copy(),
                    np.array([model.body_mass[payload]]),
                    model.dof_frictionloss.copy(),
                )
            )
            tau_sum = np.zeros(N)
            data.qvel[:] = old
        tau_sum = tau_sum + tau
        data.qfrc_applied[:] = gain * tau
        mujoco.mj_step(model, data, nstep=2)
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Happened(
        columns[0][:, 0], *columns[1:11], mass=columns[11][:, 0], friction=columns[12], began=began, ended=ended
    )


class Slip:
    """A held load that slides in the hand and is held again: s(t) has no jerk at its ends.

    Whatever slides must be accelerated, and the hand feels it: F = −m (s̈ + 2 ω × ṡ). A load that friction lets go of
    by half its weight falls with g/2 and no faster, so that 5 mm take some 77 ms.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, payload: int, fault: Fault, away: Array) -> None:
        self._payload, self._size, self._lasts = payload, fault.size, fault.lasts
        R = data.xmat[payload].reshape(3, 3)
        self._way = -R[2] if fault.down else away * np.sign(-R[2] @ away)  # nothing slips upwards
        self._from = model.body_ipos[payload].copy()

    def move(self, model: mujoco.MjModel, data: mujoco.MjData, since: float) -> None:
        """Sets where the load is, and what its sliding asks of the hand, `since` seconds after it began."""
        s = min(since / self._lasts, 1.0)
        path = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / self._lasts
        bend = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self._lasts**2
        model.body_ipos[self._payload] = self._from + self._size * path * self._way
        way = data.xmat[self._payload].reshape(3, 3) @ self._way
        omega = data.cvel[self._payload, :3]
        push = self._size * (bend * way + 2.0 * rate * np.cross(omega, way))
        data.xfrc_applied[self._payload, :3] = -model.body_mass[self._payload] * push


def _ready(fault: Fault, data: mujoco.MjData) -> bool:
    if fault.kind not in ("motor_lost", "motor_weak"):
        return True
    loaded, fast = abs(data.qfrc_applied[fault.joint]), abs(data.qvel[fault.joint])
    return bool(loaded >= fault.loaded and fast >= fault.moving)


def _begin(
    fault: Fault, model: mujoco.MjModel, data: mujoco.MjData, payload: int, away: Array, gain: Array, shown: Array
) -> None:
    if fault.kind == "payload_added":
        model.body_mass[payload] += fault.size
    elif fault.kind == "friction_third":
        model.dof_frictionloss[:] /= 3.0
    elif fault.kind in ("motor_lost", "motor_weak"):
        gain[fault.joint] = fault.size
    elif fault.kind == "contact":
        data.xfrc_applied[payload, :3] = fault.size * away
    elif fault.kind == "encoder_jump":
        shown[fault.joint] = fault.size
    if fault.kind == "payload_added":
        mujoco.mj_setConst(model, mujoco.MjData(model))
