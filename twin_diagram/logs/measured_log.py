"""What a measured log holds, in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin_diagram.errors import LogError
from twin_diagram.signals.arrays import Array

SIGNALS = {
    "position_measured": "position",
    "velocity_estimated": "velocity",
    "torque_measured": "torque",
    "torque_commanded": "torque_commanded",
    "position_commanded": "position_commanded",
}
"""The log format's signals, and the attributes of `Log` that hold them."""
SPARE = ("velocity_estimated", "position_commanded")
"""Signals that a log need not have, or of some joints alone."""


@dataclass(frozen=True)
class Log:
    """Joint signals of one run; arrays are read-only, (N, n) in the order of `joints`, revolute joints in rad.

    Attributes:
        time: (N,) [s].
        joints: names.
        position: measured, motor side over the gear ratio [rad].
        velocity: as the drive estimates it [rad/s]; NaN throughout of a joint that it is not logged of, None where it
            is of none.
        torque: measured motor torque × gear ratio [N·m]; None where it is not logged.
        torque_commanded: [N·m]; None where it is not logged.
        position_commanded: [rad]; likewise.
        source: what to call it in messages.
        identity: `fingerprint` of the log that it was made from; empty: of its own.
        notes: what its reader found worth saying.
        numbered: whether its joints are only numbered, in a model's order: any model's names fit.
        currents: whether its torques are the motors' currents [A], which `TorqueConstants` makes torques of.
        link_side: whether its reader knows that torques were measured behind the gears.
    """

    time: Array
    joints: tuple[str, ...]
    position: Array
    velocity: Array | None = None
    torque: Array | None = None
    torque_commanded: Array | None = None
    position_commanded: Array | None = None
    source: str = "log"
    identity: str = ""
    notes: tuple[str, ...] = ()
    numbered: bool = False
    currents: bool = False
    link_side: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "time", _frozen(self.time))
        if self.time.ndim != 1:
            raise LogError(f"{self.source}: time is {self.time.ndim}-dimensional, it must be a list of numbers")
        shape = (len(self.time), len(self.joints))
        for signal, name in SIGNALS.items():
            values = getattr(self, name)
            if values is None:
                continue
            values = _frozen(values)
            if values.shape != shape:
                raise LogError(f"{self.source}: {signal} is {values.shape}, it must be {shape} (samples, joints)")
            if signal in SPARE and np.all(np.isnan(values)):
                object.__setattr__(self, name, None)
                continue
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def motor_torque(self) -> Array:
        """The motors' torque (N, n): measured, or commanded where it is not measured [N·m].

        Raises:
            LogError: neither is logged, or currents are.
        """
        if self.currents:
            raise LogError(
                f"{self.source}: holds currents; --torque-constants, or torque_constant in the map of --columns, tells "
                "each joint's torque over current [N·m/A, motor constant times gear ratio], which nobody can guess"
            )
        torque = self.torque if self.torque is not None else self.torque_commanded
        if torque is None:
            raise LogError(
                f"{self.source}: has neither torque_measured nor torque_commanded; one is required (currents become "
                "torques by --columns, which takes each joint's torque_constant)"
            )
        return torque

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def columns(self) -> dict[str, Array]:
        """Return its columns by the names of the log format: `time`, then `<signal>.<joint>`."""
        result = {"time": self.time}
        for signal, name in SIGNALS.items():
            values = getattr(self, name)
            if values is not None:
                there = ~np.all(np.isnan(values), axis=0)
                result |= {f"{signal}.{joint}": values[:, k] for k, joint in enumerate(self.joints) if there[k]}
        return result

    def lacking(self, signal: str) -> tuple[str, ...]:
        """Return the joints that a signal is not logged of, where it is of others."""
        values = getattr(self, SIGNALS[signal])
        if values is None:
            return ()
        none = np.all(np.isnan(values), axis=0)
        return tuple(joint for joint, lacks in zip(self.joints, none, strict=True) if lacks)

    def select(self, joints: Sequence[str]) -> Log:
        """Return the same log with these joints alone, in this order; joints that are only numbered get these names.

        Raises:
            LogError: it lacks one, or numbers another count of joints.
        """
        if self.numbered:
            return self.named(joints)
        for joint in joints:
            if joint not in self.joints:
                raise LogError(f"{self.source}: joint {joint!r} is missing; it holds {', '.join(self.joints)}")
        order = [self.joints.index(joint) for joint in joints]
        return self._map(lambda values: values[:, order], joints=tuple(joints))

    def named(self, joints: Sequence[str]) -> Log:
        """Return the same log with names for joints that are only numbered.

        Raises:
            LogError: these are more or fewer.
        """
        if len(joints) != len(self.joints):
            raise LogError(
                f"{self.source}: tells of {len(self.joints)} joints without naming them; "
                f"the model's arm has {len(joints)}: {', '.join(joints)}"
            )
        return replace(self, joints=tuple(joints), numbered=False)

    def between(self, start: float, end: float) -> Log:
        """Return the samples with start ≤ time ≤ end [s]."""
        kept = (self.time >= start) & (self.time <= end)
        return self._map(lambda values: values[kept], time=self.time[kept])

    def _map(self, change: Callable[[Array], Array], **others: Any) -> Log:
        signals: dict[str, Any] = {
            name: change(values) for name in SIGNALS.values() if (values := getattr(self, name)) is not None
        }
        return replace(self, **signals, **others)


def _frozen(values: Any) -> Array:
    """Return the values as an array that nobody writes to; itself where it is one already."""
    if isinstance(values, np.ndarray) and values.dtype == float and values.base is None and not values.flags.writeable:
        return values
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array
