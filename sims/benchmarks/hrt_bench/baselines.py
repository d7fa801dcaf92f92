"""The outline's baselines: physics alone, vision alone, encoders alone; the fixed EKF is `ours.FIXED`."""

from __future__ import annotations

import numpy as np
from hrt_truth import world
from hrt_truth.hidden import Hidden
from hrt_truth.streams import Streams

from hrt_bench.estimate import AHEAD, STRIDE, Array, Estimate, Kinematics
from twin_diagram.station.mujoco import TUNING as MUJOCO

MEMORY = 0.6
"""Share of the old velocity that a differencing baseline keeps at each image."""
JUMP = 0.06
"""A pose farther than this from where it should be is left out, but not three in a row [m]."""


def physics_only(streams: Streams, nominal: tuple[Array, Array]) -> Estimate:
    """The arm as described, with its drive, told the same commands: nothing is measured.

    Args:
        streams: for their times.
        nominal: positions and speeds that the drive is told at its own period.
    """
    h = world.run(Hidden(0), *nominal)
    count = len(streams.time)
    return Estimate(h.hand, h.hand_speed, {s: _later(h.hand[:, 4:], s, count) for s in AHEAD}, np.full(count, np.nan))


def told_commands(streams: Streams) -> tuple[Array, Array]:
    """What the drive was told, at its own period, from what the messages say."""
    t = np.arange(round(streams.time[-1] / MUJOCO.period) + 1) * MUJOCO.period
    columns = range(streams.asked.shape[1])
    return (
        np.column_stack([np.interp(t, streams.time, streams.asked[:, j]) for j in columns]),
        np.column_stack([np.interp(t, streams.time, streams.asked_rate[:, j]) for j in columns]),
    )


def _later(p: Array, horizon: float, count: int) -> Array:
    starts = np.arange(0, count, STRIDE) + round(horizon / (world.EVERY * MUJOCO.period))
    result = np.full((len(starts), 3), np.nan)
    result[starts < count] = p[starts[starts < count]]
    return result


def vision_only(streams: Streams) -> Estimate:
    """The newest pose that has arrived, held; its speed from low-passed differences."""
    count = len(streams.time)
    hand, speed = np.zeros((count, 7)), np.zeros((count, 3))
    newest, v = streams.camera[0], np.zeros(3)
    last, at, strange = streams.camera_time[0], 0, 0
    age = np.zeros(count)
    for k, now in enumerate(streams.time):
        while at < len(streams.camera_time) and streams.camera_arrives[at] <= now + 1e-9:
            z, t = streams.camera[at], streams.camera_time[at]
            far = np.linalg.norm(z[4:] - newest[4:] - v * (t - last)) > JUMP
            strange = strange + 1 if far else 0
            if 0 < strange < 3:
                at += 1
                continue
            if t > last:
                v = MEMORY * v + (1.0 - MEMORY) * (z[4:] - newest[4:]) / (t - last)
            newest, last = z, t
            at += 1
        hand[k], speed[k], age[k] = newest, v, now - last
    ahead = {s: _carried(hand[:, 4:], speed, s + age) for s in AHEAD}
    return Estimate(hand, speed, ahead, np.full(count, np.nan))


def encoders_only(streams: Streams, kinematics: Kinematics) -> Estimate:
    """Forward kinematics of the newest message."""
    hand = kinematics.poses(streams.q)
    speed = kinematics.speeds(streams.q, streams.v)
    ahead = {s: _carried(hand[:, 4:], speed, np.full(len(hand), s)) for s in AHEAD}
    return Estimate(hand, speed, ahead, np.full(len(hand), np.nan))


def _carried(p: Array, v: Array, span: Array) -> Array:
    return (p + v * span[:, None])[::STRIDE]
