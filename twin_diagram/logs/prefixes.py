"""Gives a log's joints the model's names, where one of both has a prefix before them all, as ROS puts there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin_diagram.logs.measured_log import Log


def under_names_of(joints: Sequence[str], log: Log) -> Log:
    """Return the log with a model's names of its joints and a note; itself where it is not a prefix that differs.

    Args:
        joints: the model's.
        log: as it was read.
    """
    if log.numbered or not joints or not {*joints}.isdisjoint(log.joints):
        return log
    before = [name.removesuffix(joints[0]) for name in log.joints if name.endswith(joints[0])]
    ways = [{prefix + joint: joint for joint in joints} for prefix in before]
    beyond = [joints[0].removesuffix(name) for name in log.joints if joints[0].endswith(name)]
    ways += [{joint.removeprefix(prefix): joint for joint in joints if joint.startswith(prefix)} for prefix in beyond]
    ways = [way for way in ways if len(way) == len(joints) and {*way} <= {*log.joints}]
    if len(ways) != 1:  # two arms of one kind: --joints or the log itself must say which
        return log
    (own,) = ways
    first = next(iter(own))
    note = f"{log.source}: its {first} and the like are taken for the model's {own[first]} and the like"
    return replace(log, joints=tuple(own.get(name, name) for name in log.joints), notes=(*log.notes, note))
