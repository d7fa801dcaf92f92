"""Reads ROS bags, of ROS 2 (.mcap, .db3, a bag's folder) and of ROS 1 (.bag), in which `sensor_msgs/JointState` is.

Takes the package `rosbags`, which is pure Python: no ROS is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin_diagram.errors import LogError
from twin_diagram.logs.measured_log import Log
from twin_diagram.logs.message_stamps import in_order, seconds
from twin_diagram.signals.arrays import Array

JOINT_STATES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
"""The type of joint states by ROS 2's name and by ROS 1's."""
USUAL = "/joint_states"
"""The topic by ROS's convention."""
SIGNALS = ("position", "velocity", "effort")
"""Fields of a joint state that hold a number per joint."""
REAL = 10**18
"""Stamps beyond this are of a real clock, which began in 1970, and not of a simulation's [ns]."""


@dataclass
class _Group:
    """Messages that tell of the same joints."""

    joints: tuple[str, ...]
    stamps: list[int] = field(default_factory=list)
    received: list[int] = field(default_factory=list)
    rows: dict[str, list[Array | None]] = field(default_factory=lambda: {signal: [] for signal in SIGNALS})


def read_ros_bag(path: Path, topic: str = "") -> Log:
    """Return the log of the joints that a bag's joint states tell of; torques are its efforts [N·m].

    Times are the messages' own stamps, else when they were received, from the first one on; where others have stamps,
    messages without are left out. Joints whose position or effort is not given (NaN, or zero throughout) are left out,
    which the log's notes say. Where several publishers share a topic, the others' joints are brought to the times of
    the one that tells of most.

    Args:
        path: file or folder.
        topic: of the joint states; empty: `/joint_states`, or the only one.

    Raises:
        LogError: the package is missing, no bag, no or several such topics, no effort, or several runs in one bag.
    """
    source = f"{path}#{topic}" if topic else str(path)
    groups = list(_read(path, topic, source).values())
    notes: list[str] = []
    parts = []
    for group in groups:
        part = _part(group, source, notes)
        if part is not None:
            parts.append(part)
    if not parts:
        raise LogError(f"{source}: its joint states hold no effort, which is the torque that is needed")
    most = max(parts, key=lambda pair: (len(pair[0].joints), len(pair[0])))
    log, begin = most
    for other, start in (pair for pair in parts if pair is not most):
        both = _beside(log, other, (start - begin) * 1e-9)
        if len(both):
            log = both
        else:
            notes.append(f"{source}: left out {', '.join(other.joints)}: told of at other times than the others")
    return Log(
        time=log.time - log.time[0],
        joints=log.joints,
        position=log.position,
        velocity=log.velocity,
        torque=log.torque,
        source=source,
        notes=tuple(notes),
    )


def _read(path: Path, topic: str, source: str) -> dict[frozenset[str], _Group]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise LogError(f"{path}: ROS bags are read by the package rosbags: pip install 'twin-diagram[ros]'") from error
    groups: dict[frozenset[str], _Group] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            chosen = _topic(path, topic, reader.connections)
            connections = [c for c in reader.connections if c.topic == chosen and c.msgtype in JOINT_STATES]
            for connection, received, raw in reader.messages(connections=connections):
                _take(groups, reader.deserialize(raw, connection.msgtype), received, source)
    except LogError:
        raise
    except Exception as error:  # a damaged bag ends in all sorts of them
        reason = str(error).split("\n")[0] or type(error).__name__
        raise LogError(f"{path}: cannot be read as a ROS bag: {reason}") from error
    return groups


def _topic(path: Path, topic: str, connections: Iterable[Any]) -> str:
    """Return the topic to read."""
    everything = {connection.topic for connection in connections}
    states = sorted({c.topic for c in connections if c.msgtype in JOINT_STATES and c.msgcount})
    if topic:
        if topic in states:
            return topic
        raise LogError(f"{path}: no joint states on {topic!r}; there are some on {', '.join(states) or 'none'}")
    if not states:
        topics = ", ".join(sorted(everything)) or "none"
        raise LogError(f"{path}: holds no sensor_msgs/JointState; its topics are {topics}")
    if len(states) > 1 and USUAL not in states:
        raise LogError(f"{path}: holds joint states on {', '.join(states)}; name one, as {path.name}#{states[0]}")
    return USUAL if USUAL in states else states[0]


def _take(groups: dict[frozenset[str], _Group], message: Any, received: int, source: str) -> None:
    names = tuple(message.name)
    if not names:
        return
    group = groups.setdefault(frozenset(names), _Group(names))
    if len(group.joints) != len(set(names)) or len(names) != len(set(names)):
        raise LogError(f"{source}: a joint state names a joint twice: {', '.join(names)}")
    order = [names.index(joint) for joint in group.joints]
    for signal in SIGNALS:
        values = np.asarray(getattr(message, signal), dtype=float)
        if len(values) not in (0, len(names)):
            raise LogError(f"{source}: a joint state has {len(names)} names but {len(values)} of {signal}")
        group.rows[signal].append(values[order] if len(values) else None)
    stamp = message.header.stamp
    group.stamps.append(1_000_000_000 * int(stamp.sec) + int(stamp.nanosec))
    group.received.append(int(received))


def _part(group: _Group, source: str, notes: list[str]) -> tuple[Log, int] | None:
    """Return a group's log and when it begins [ns]; None where nothing of it is of use."""
    names = ", ".join(group.joints)
    columns = {signal: _stacked(rows) for signal, rows in group.rows.items()}
    position, effort = columns["position"], columns["effort"]
    if position is None or effort is None:
        notes.append(f"{source}: left out {names}: no {'position' if position is None else 'effort'}")
        return None
    lacking = np.any(np.isnan(position), axis=0) | np.any(np.isnan(effort), axis=0) | ~np.any(effort, axis=0)
    if np.any(lacking):
        left = ", ".join(joint for joint, lacks in zip(group.joints, lacking, strict=True) if lacks)
        notes.append(f"{source}: left out {left}: position or effort is not given (NaN, or zero throughout)")
    kept = np.flatnonzero(~lacking)
    if not len(kept):
        return None
    stamps = np.array(group.stamps if any(group.stamps) else group.received, dtype=np.int64)
    # Beside a real clock's stamps zero is none; a simulation's clock begins there.
    stamped = np.flatnonzero((stamps > 0) | (np.max(stamps) < REAL))
    order = stamped[in_order(stamps[stamped], source, lambda k: f"message {stamped[k] + 1} of {names}")]
    velocity = columns["velocity"]
    if velocity is not None:  # of a joint that lacks one at times, none counts
        velocity = np.where(np.any(np.isnan(velocity), axis=0), np.nan, velocity)
    begin = int(stamps[order[0]])
    log = Log(
        time=seconds(stamps[order], begin),
        joints=tuple(group.joints[k] for k in kept),
        position=position[np.ix_(order, kept)],
        velocity=None if velocity is None else velocity[np.ix_(order, kept)],
        torque=effort[np.ix_(order, kept)],
        source=source,
    )
    return log, begin


def _stacked(rows: Sequence[Array | None]) -> Array | None:
    present = [row for row in rows if row is not None]
    return np.stack(present) if len(present) == len(rows) else None


def _beside(log: Log, other: Log, later: float) -> Log:
    """Return both logs at the first one's times, where both are.

    `later` is the second's begin after the first's [s].
    """
    times = other.time + later
    log = log.between(float(times[0]), float(times[-1]))

    def both(own: Array | None, theirs: Array | None) -> Array:
        own = np.full((len(log), len(log.joints)), np.nan) if own is None else own
        theirs = np.full((len(times), len(other.joints)), np.nan) if theirs is None else theirs
        return np.column_stack([own, *(np.interp(log.time, times, column) for column in theirs.T)])

    position, velocity, torque = (both(getattr(log, x), getattr(other, x)) for x in ("position", "velocity", "torque"))
    return Log(log.time, (*log.joints, *other.joints), position, velocity, torque, source=log.source)
