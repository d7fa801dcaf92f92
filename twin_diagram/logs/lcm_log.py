"""Reads LCM logs of arms that tell of themselves in Drake's messages.

An LCM log is a row of events: a sync word, the event's number and time [µs], the lengths of channel name and message,
and these two (LCM's `eventlog.c`). Which message it is, its first eight bytes say.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from twin_diagram.errors import LogError
from twin_diagram.logs.lcm_arm_status import READERS, Status
from twin_diagram.logs.measured_log import Log
from twin_diagram.logs.message_stamps import in_order, seconds

SYNC = b"\xed\xa1\xda\x01"
"""Each event begins with it."""

_HEADER = struct.Struct(">4sqqII")
"""Of an event: `SYNC`, its number, its time [µs], the lengths of its channel's name and of its data."""
_FINGERPRINTS = {kind._get_packed_fingerprint(): (kind, read) for kind, read in READERS.items()}  # type: ignore[attr-defined]


def is_lcm_log(path: Path) -> bool:
    """Return whether a file begins as LCM logs do."""
    with path.open("rb") as file:
        return file.read(4) == SYNC


def read_lcm_log(path: Path, channel: str = "") -> Log:
    """Return the log of one arm; its joints are numbered, for the messages do not name them.

    Times are the sender's, from the first message on; torques are those of the arm's sensors.

    Args:
        path: file.
        channel: on which the arm tells of itself; empty: the only one.

    Raises:
        LogError: no LCM log, no or several arms, damaged messages, or joints that change in number.
    """
    source = f"{path}#{channel}" if channel else str(path)
    found: dict[str, list[tuple[int, Status]]] = {}
    others: set[str] = set()
    for number, name, message in events(path):
        known = _FINGERPRINTS.get(message[:8])
        if known is None or (channel and name != channel):
            others.add(name)
            continue
        kind, read = known
        try:
            status = read(kind.decode(message))  # type: ignore[attr-defined]
        except (struct.error, ValueError, IndexError) as error:
            raise LogError(f"{path}: event {number} on {name}: the message is damaged") from error
        if len(status.position):  # drivers send empty ones before the arm is there
            found.setdefault(name, []).append((number, status))
    if not found:
        wanted = f"on channel {channel!r}" if channel else "(lcmt_iiwa_status, lcmt_panda_status)"
        raise LogError(
            f"{path}: holds no arm's status {wanted}; its channels are {', '.join(sorted(others)) or 'none'}"
        )
    if len(found) > 1:
        names = sorted(found)
        raise LogError(f"{path}: holds several arms: {', '.join(names)}; name one, as {path.name}#{names[0]}")
    [(name, messages)] = found.items()
    return _log(source, name, messages)


def _log(source: str, channel: str, messages: list[tuple[int, Status]]) -> Log:
    n = len(messages[0][1].position)
    for number, status in messages:
        sizes = (len(status.position), len(status.velocity), len(status.torque))
        if set(sizes) != {n}:
            raise LogError(f"{source}: event {number} on {channel}: tells of {sizes} joints, those before of {n}")
    stamps = 1000 * np.array([status.utime for _, status in messages], dtype=np.int64)
    kept = in_order(stamps, source, lambda k: f"event {messages[k][0]} on {channel}")
    parts = [messages[k][1] for k in kept]
    commanded = [status.commanded for status in parts]
    return Log(
        time=seconds(stamps[kept], int(stamps[kept[0]])),
        joints=tuple(f"#{k + 1}" for k in range(n)),
        position=np.stack([status.position for status in parts]),
        velocity=np.stack([status.velocity for status in parts]),
        torque=np.stack([status.torque for status in parts]),
        position_commanded=np.stack(commanded) if all(len(values) == n for values in commanded) else None,
        source=source,
        numbered=True,
        link_side=True,
    )


def events(path: Path) -> Iterator[tuple[int, str, bytes]]:
    """Yield the number, channel and message of each event; what was cut off at the end is left out.

    Raises:
        LogError: an event does not begin where the one before it ends.
    """
    data = memoryview(path.read_bytes())
    start = 0
    while start + _HEADER.size <= len(data):
        sync, number, _, name, message = _HEADER.unpack_from(data, start)
        if sync != SYNC:
            where = "does not begin as LCM logs do" if start == 0 else f"is damaged at byte {start}"
            raise LogError(f"{path}: {where}")
        begin = start + _HEADER.size
        start = begin + name + message
        if start > len(data):
            return
        yield number, bytes(data[begin : begin + name]).decode(errors="replace"), bytes(data[begin + name : start])
    if len(data) < _HEADER.size:
        raise LogError(f"{path}: does not begin as LCM logs do")
