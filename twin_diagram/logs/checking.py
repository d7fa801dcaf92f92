"""Whether a log makes sense: units, gaps, limits, and whether a model can explain its joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import LogError
from twin_diagram.logs.joint_limits import JointLimits
from twin_diagram.logs.measured_log import SPARE, Log
from twin_diagram.signals import units


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand, so that logs of arms as they are sold pass."""

    slowest: float = 0.25
    """Longest time between samples that a joint log can have and be of use [s]."""

    gap: float = 2.5
    """A step this many times the median is a gap."""

    counts: float = 100.0
    """Beyond its limits by more than this, it counts something else: fifteen turns [rad]."""

    millimetres: float = 3.0
    """Beyond its limits by this many times its travel, a slide's position is likewise no metres."""


TUNING = Tuning()


@dataclass(frozen=True)
class LogWarning:
    """Something about a log that its user should know.

    Attributes:
        code: `gap`, `jitter`, `beyond_limits`, `torque_beyond_limits`, `velocity_scale`, `no_motion`, `no_torque`,
            `unknown_joint`, `left_out`, `wrapped`, `parted`, `motors_off`, `spike`, `torque_side`.
        message: one line.
        joint: that it is about, or empty.
    """

    code: str
    message: str
    joint: str = ""


def check(log: Log, arm: JointLimits | None = None) -> list[LogWarning]:
    """Look for what makes a log useless (an error) or doubtful (a warning).

    Args:
        log: as `read_log` gave it.
        arm: whose log it is to be (`Model.limits`); None: only what the log says by itself is checked.

    Raises:
        LogError: no torque; time, angles or velocities that are in other units; a joint of the model that is missing.
    """
    _ = log.motor_torque
    warnings = [LogWarning("left_out", note) for note in log.notes]
    if arm is not None and log.numbered:
        log = log.named(arm.joints)
    _check_time_unit(log)
    warnings += _gaps(log)
    warnings += _velocity_scale(log)
    warnings += _dead(log)
    if arm is not None:
        warnings += _against(log, arm)
        log = log.select(arm.joints)
    return warnings + _of_some(log)


def _of_some(log: Log) -> list[LogWarning]:
    """Tell of which joints something is not logged that is logged of others."""
    result = []
    for signal in SPARE:
        if lacking := log.lacking(signal):
            instead = "; there, positions alone tell it" if signal == "velocity_estimated" else ""
            message = f"{log.source}: {signal} is not there of {', '.join(lacking)}{instead}"
            result.append(LogWarning("left_out", message))
    return result


def _check_time_unit(log: Log) -> None:
    if log.period > TUNING.slowest:
        for unit, scale in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
            if 4e-4 <= log.period / scale <= 0.1:
                raise LogError(
                    f"{log.source}: time: samples are {log.period:g} s apart; it looks like {unit}, "
                    "the log format has seconds"
                )
        raise LogError(f"{log.source}: time: samples are {log.period:g} s apart, too far to tell dynamics from")


def _gaps(log: Log) -> list[LogWarning]:
    steps = np.diff(log.time)
    result = []
    gaps = np.flatnonzero(steps > TUNING.gap * log.period)
    if len(gaps):
        k = int(gaps[np.argmax(steps[gaps])])
        result.append(
            LogWarning(
                "gap",
                f"{log.source}: {len(gaps)} gap(s) in time; the longest is {steps[k]:.4g} s at {log.time[k]:.13g} s "
                f"(samples are {log.period:.4g} s apart)",
            )
        )
    jitter = float(np.std(steps[steps <= TUNING.gap * log.period]) / log.period)
    if jitter > 0.1:
        message = f"{log.source}: time: steps vary by {100 * jitter:.0f} % of {log.period:.4g} s"
        result.append(LogWarning("jitter", message))
    return result


def _velocity_scale(log: Log) -> list[LogWarning]:
    """Compare the logged velocity with what the positions do over some samples."""
    if log.velocity is None:
        return []
    result = []
    stride = max(1, len(log) // 400)
    time, position = log.time[::stride], log.position[::stride]
    difference = np.diff(position, axis=0) / np.diff(time)[:, None]
    area = 0.5 * (log.velocity[1:] + log.velocity[:-1]) * np.diff(log.time)[:, None]
    travelled = np.vstack([np.zeros((1, area.shape[1])), np.cumsum(area, axis=0)])[::stride]
    logged = np.diff(travelled, axis=0) / np.diff(time)[:, None]
    for k, joint in enumerate(log.joints):
        x, y = difference[:, k], logged[:, k]
        if not (np.std(x) > 0.0 and np.std(y) > 0.0) or abs(np.corrcoef(x, y)[0, 1]) < 0.9:
            continue
        scale = float(x @ y / (x @ x))
        for factor, what in (
            (1e3, "time in milliseconds"),
            (1e-3, "velocity in thousandths, or time in milliseconds"),
            (np.pi / 180.0, "positions in degrees but velocities in rad/s"),
            (180.0 / np.pi, "velocities in degrees per second but positions in rad"),
        ):
            if abs(scale / factor - 1.0) < 0.1:
                raise LogError(
                    f"{log.source}: velocity_estimated.{joint} is {scale:.4g} times the change of "
                    f"position_measured.{joint}; it looks like {what}"
                )
        if abs(scale - 1.0) > 0.2:
            message = f"{log.source}: velocity_estimated.{joint} is {scale:.3g} times what its positions do"
            result.append(LogWarning("velocity_scale", message, joint))
    return result


def _dead(log: Log) -> list[LogWarning]:
    result = []
    if not np.any(np.ptp(log.position, axis=0) > 1e-4):
        result.append(LogWarning("no_motion", f"{log.source}: no joint moves"))
    for k, joint in enumerate(log.joints):
        if not np.any(log.motor_torque[:, k]):
            result.append(LogWarning("no_torque", f"{log.source}: the torque of {joint} is zero throughout", joint))
        elif not np.ptp(log.motor_torque[:, k]) and np.ptp(log.position[:, k]) > 1e-4:
            result.append(LogWarning("no_torque", f"{log.source}: the torque of {joint} never changes", joint))
    return result


def _against(log: Log, arm: JointLimits) -> list[LogWarning]:
    missing = [joint for joint in arm.joints if joint not in log.joints]
    if missing:
        why = "".join(f" ({note.removeprefix(f'{log.source}: ')})" for note in log.notes)
        if len(missing) < len(arm.joints):
            why += "; if it is held where it is, or another arm's, name those of the arm with --joints"
        raise LogError(
            f"{log.source}: joint {missing[0]!r} of the model is missing; the log holds {', '.join(log.joints)}{why}"
        )
    result = [
        LogWarning("unknown_joint", f"{log.source}: {joint} is no joint of the arm and is left out", joint)
        for joint in log.joints
        if joint not in arm.joints
    ]
    own = log.select(arm.joints)
    revolute = arm.revolute
    outside = arm.outside(own.position)
    turned = np.where(revolute, outside, 0.0)
    if arm.in_degrees(own.position):
        k = int(np.argmax(turned))
        joint, value = own.joints[k], own.position[np.argmax(np.abs(own.position[:, k])), k]
        raise LogError(
            f"{log.source}: position_measured.{joint} reaches {value:.4g}, its limits are {arm.lower[k]:.4g} to "
            f"{arm.upper[k]:.4g} rad; it looks like degrees, the log format has radians"
        )
    if np.any(turned > TUNING.counts):
        k = int(np.argmax(turned))
        raise LogError(
            f"{log.source}: position_measured.{own.joints[k]} reaches {np.abs(own.position[:, k]).max():.4g}, its "
            f"limits are {arm.lower[k]:.4g} to {arm.upper[k]:.4g} rad; it looks like an encoder's counts, or a motor's "
            "angle before the gear; the log format has radians at the joint"
        )
    far = outside > TUNING.millimetres * np.maximum(arm.upper - arm.lower, 0.01)
    if np.any(long := ~revolute & far & (arm.outside(1e-3 * own.position) < 0.01)):
        k = int(np.argmax(long))
        raise LogError(
            f"{log.source}: position_measured.{own.joints[k]} reaches {np.abs(own.position[:, k]).max():.4g}, its "
            f"limits are {arm.lower[k]:.4g} to {arm.upper[k]:.4g} m; it looks like millimetres, the log format has "
            "metres"
        )
    for k, joint in enumerate(own.joints):
        if outside[k] > 0.01:
            message = f"{log.source}: position_measured.{joint} leaves the joint's limits by {outside[k]:.3g}"
            result.append(LogWarning("beyond_limits", message, joint))
        largest, limit = np.abs(own.motor_torque[:, k]).max(), arm.effort[k]
        if 0.0 < 1.5 * limit < largest:
            effort, unit = "torque" if revolute[k] else "force", units.on_joint(units.TORQUE, not revolute[k])
            message = (
                f"{log.source}: the {effort} of {joint} reaches {largest:.4g}, its limit is {limit:.4g} "
                f"({unit}, joint side)"
            )
            result.append(LogWarning("torque_beyond_limits", message, joint))
    return result
