"""Makes sensor streams out of what happened: noise, bias, rates, delays, outliers, outages."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from hrt_truth.hidden import LIMIT, Fault, Hidden, N
from hrt_truth.streams import Array, Streams, Truth
from hrt_truth.world import EVERY, Happened
from twin_diagram.station.mujoco import TUNING as MUJOCO

LIDAR_AT = np.array([1.5, 0.0, 1.0])


LOOK_COVERED = (0.008, 0.187, 0.398, 0.6, 0.77)
LOOK_BRIGHTNESS = (0.039, 0.142, 0.432, 0.677)
"""Mean looks in the bins of `train_camera_noise`."""
MEASURED = np.stack(
    [
        [
            [1.1, 0.99, 1.0, 1.23],
            [1.29, 1.26, 1.15, 1.54],
            [1.79, 1.33, 1.6, 3.43],
            [4.02, 1.76, 2.39, 2.54],
            [5.83, 6.94, 8.27, 9.31],
        ],
        [
            [1.21, 0.94, 1.0, 1.98],
            [2.87, 1.61, 1.71, 2.49],
            [2.92, 2.01, 1.72, 7.95],
            [3.71, 4.58, 3.12, 10.69],
            [9.22, 7.89, 6.75, 24.82],
        ],
    ],
    axis=-1,
)
"""(5, 4, 2) deviations of rotation and position over those of a good look, by covered share and brightness, in 656
rendered frames that the noise model was not trained on; where fewer than eight frames fell, between the neighbours."""


@dataclass(frozen=True)
class Defects:
    """Of all sensors; the defaults are the outline's (section 3.3).

    Attributes:
        encoder, velocity: white noise [rad], [rad/s].
        camera_p, camera_r: of a good look at the hand [m], [rad].
        camera_rate, camera_latency: [1/s], [s].
        outliers: share of the camera's poses that are of something else.
        covered: intervals without camera [s].
        gyro, accel: white noise [rad/s], [m/s²].
        gyro_bias, accel_bias: standard deviations of the constant errors.
        force, moment: white noise [N], [N·m].
        force_bias, moment_bias: standard deviations.
        lidar_p: at 1 m, growing with distance squared [m].
        encoder_worse: (start, end, factor) of a spell of noise; None.
    """

    encoder: float = 1e-3
    velocity: float = 1e-2
    camera_p: float = 0.003
    camera_r: float = 0.026
    camera_rate: float = 30.0
    camera_latency: float = 0.035
    outliers: float = 0.03
    covered: tuple[tuple[float, float], ...] = ()
    gyro: float = 1e-3
    accel: float = 1e-2
    gyro_bias: float = 0.005
    accel_bias: float = 0.05
    force: float = 0.1
    moment: float = 0.01
    force_bias: float = 0.5
    moment_bias: float = 0.02
    lidar_p: float = 0.01
    encoder_worse: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Case:
    """Everything that a run is made of.

    Attributes:
        hidden: the arm.
        duration: [s].
        fault: what goes wrong.
        defects: of the sensors.
        busy: hardly a rest between moves.
    """

    hidden: Hidden
    duration: float = 12.0
    fault: Fault = field(default_factory=Fault)
    defects: Defects = field(default_factory=Defects)
    busy: bool = False


def look_factor(covered: Array, brightness: Array) -> Array:
    """By how much a look multiplies the camera's deviations (C, 2), rotation and position: as `MEASURED`."""
    inside = [np.clip(x, at[0], at[-1]) for x, at in ((covered, LOOK_COVERED), (brightness, LOOK_BRIGHTNESS))]
    return np.asarray(RegularGridInterpolator((LOOK_COVERED, LOOK_BRIGHTNESS), MEASURED)(np.column_stack(inside)))


def sense(case: Case, happened: Happened) -> tuple[Streams, Truth]:
    """The streams of a run, and its truth."""
    d, fault, h = case.defects, case.fault, happened
    seed = case.hidden.seed
    rng = np.random.default_rng([seed, 44])
    count = len(h.time)
    encoder = np.full((count, 1), d.encoder)
    if d.encoder_worse is not None:
        start, end, factor = d.encoder_worse
        encoder[(h.time >= start) & (h.time < end)] *= factor
    q = h.encoder + encoder * rng.normal(size=(count, N))
    v = h.v + d.velocity * rng.normal(size=(count, N))
    tau = h.tau + case.hidden.torque_bias + case.hidden.torque_noise * LIMIT * rng.normal(size=(count, N))

    rows, look, camera, wrong = _camera(case, h, np.random.default_rng([seed, 45]))
    camera_time = h.time[rows]
    rng = np.random.default_rng([seed, 46])
    bias = rng.normal(size=6) * np.repeat([d.gyro_bias, d.accel_bias], 3)
    imu = h.imu + bias + rng.normal(size=(count, 6)) * np.repeat([d.gyro, d.accel], 3)
    if fault.kind == "gyro_bias":
        imu[h.time >= h.began, int(seed) % 3] += fault.size
    rng = np.random.default_rng([seed, 47])
    bias = rng.normal(size=6) * np.repeat([d.moment_bias, d.force_bias], 3)
    wrench = h.wrench + bias + rng.normal(size=(count, 6)) * np.repeat([d.moment, d.force], 3)
    rng = np.random.default_rng([seed, 48])
    some = np.arange(7, count, 20)
    reach = np.linalg.norm(h.hand[some, 4:] - LIDAR_AT, axis=1)
    std = d.lidar_p * np.maximum(reach, 1.0) ** 2
    lidar = _noisy(h.hand[some], std, 2.0 * std, rng)
    streams = Streams(
        time=h.time,
        q=q,
        v=v,
        tau=tau,
        asked=h.asked,
        asked_rate=h.asked_rate,
        camera_time=camera_time,
        camera_arrives=camera_time + d.camera_latency,
        camera=camera,
        camera_look=look,
        imu_time=h.time,
        imu=imu,
        wrench_time=h.time,
        wrench=wrench,
        lidar_time=h.time[some],
        lidar_arrives=h.time[some] + 0.05,
        lidar=lidar,
        lidar_range=reach,
    )
    truth = Truth(
        time=h.time,
        q=h.q,
        v=h.v,
        hand=h.hand,
        hand_speed=h.hand_speed,
        mass=h.mass,
        friction=h.friction,
        torque_error=case.hidden.torque_bias,
        fault=np.array([h.began, h.ended]),
        outliers=wrong,
    )
    return streams, truth


def _camera(case: Case, h: Happened, rng: np.random.Generator) -> tuple[np.ndarray, Array, Array, Array]:
    """Rows of the captures, look (C, 2), poses (C, 7), outliers (C,)."""
    d, fault = case.defects, case.fault
    times = np.arange(1.0 / d.camera_rate, h.time[-1], 1.0 / d.camera_rate)
    for start, end in d.covered:
        times = times[(times < start) | (times >= end)]
    rows = np.round(times / (MUJOCO.period * EVERY)).astype(int)
    count = len(rows)
    # Somebody walks through now and then, and the light changes slowly.
    phase = rng.uniform(0.0, 2.0 * np.pi, 4)
    covered = np.clip(1.6 * np.sin(0.9 * times + phase[0]) * np.sin(0.37 * times + phase[1]) - 0.5, 0.0, 0.95)
    brightness = np.clip(0.5 + 0.42 * np.sin(0.21 * times + phase[2]) * np.sin(0.5 * times + phase[3]), 0.02, 0.98)
    factor = look_factor(covered, brightness)
    poses = _noisy(h.hand[rows], d.camera_p * factor[:, 1], d.camera_r * factor[:, 0], rng)
    wrong = rng.random(count) < d.outliers
    size = rng.uniform(0.05, 0.3, (count, 1))
    there = rng.normal(size=(count, 3))
    poses[wrong, 4:] += (size * there / np.linalg.norm(there, axis=1, keepdims=True))[wrong]
    if fault.kind == "camera_spoofed":
        there = rng.normal(size=3)
        poses[:, 4:] += np.maximum(times - fault.at, 0.0)[:, None] * fault.size * there / np.linalg.norm(there)
    look = np.column_stack([covered, brightness]) + 0.03 * rng.normal(size=(count, 2))
    return rows, np.clip(look, 0.0, 1.0), poses, wrong.astype(float)


def _noisy(poses: Array, std_p: Array, std_r: Array, rng: np.random.Generator) -> Array:
    """Poses (C, 7) with white noise, deviations (C,) [m], [rad]."""
    turn = Rotation.from_rotvec(rng.normal(size=(len(poses), 3)) * std_r[:, None])
    xyzw = (turn * Rotation.from_quat(poses[:, [1, 2, 3, 0]])).as_quat()
    p = poses[:, 4:] + rng.normal(size=(len(poses), 3)) * std_p[:, None]
    return np.column_stack([xyzw[:, 3], xyzw[:, :3], p])
