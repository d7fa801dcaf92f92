"""How an arm comes to rest, and how it joins a plan again: commands as functions of time. Pure functions on arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    slowest: float = 1.0
    """A stop takes no longer than this, whatever torques allow [s]: an arm that cannot hold its weight stops, too."""

    rejoin_share: float = 0.25
    """Joining a plan again takes this share of the speed limits, and as much of the acceleration; the rest is the
    plan's own."""

    shortest: float = 0.1
    """No plan is joined in less [s]."""

    harder: float = 1.25
    """It may brake by this much harder than plans do: what a sound plan still does in time must not be stopped."""


TUNING = Tuning()

PEAK_RATE = 15.0 / 8.0
"""Greatest rate of the fifth-order step from 0 to 1 in unit time."""
PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Greatest second derivative of the same."""
PEAK_OF_RATE = 3.9403
"""Greatest second derivative of the quintic over unit time that begins at rate 1 and has nothing else at either end."""


def untold_limit(plans: Array, told: float | None) -> Array:
    """Return (n,) what joints are braked with at most where nobody tells, torques allowing [rad/s²].

    Args:
        plans: (n,) what motors leave to plans [rad/s²].
        told: what plans keep to besides [rad/s²], where there is such a limit.
    """
    return np.asarray(TUNING.harder * np.minimum(np.inf if told is None else told, plans))


def stopping_time(v: Array, acceleration: Array, mass: Array, bias: Array, effort: Array) -> float:
    """Return the shortest time [s] in which all joints come to rest together, evenly, within limits.

    While braking, joint i has the acceleration −v_i / T and needs the torque bias − M v / T.

    Args:
        v: (n,) speeds [rad/s].
        acceleration: (n,) limits [rad/s²].
        mass: (n, n) [kg·m²].
        bias: (n,) torque without acceleration [N·m].
        effort: (n,) limits [N·m]; a joint whose bias is beyond its own does not count, for no braking mends that.
    """
    needed = float(np.max(np.abs(v) / acceleration, initial=0.0))
    push = -(mass @ v)
    # The room on the side to which braking pushes: limit − bias where it pushes up, limit + bias where down.
    room = effort - np.sign(push) * bias
    can = (room > 0.0) & np.isfinite(room)
    needed = max(needed, float(np.max(np.abs(push[can]) / room[can], initial=0.0)))
    return min(needed, TUNING.slowest)


@dataclass(frozen=True)
class StraightStop:
    """A stop along a straight line in joint space.

    Attributes:
        start: when it begins [s].
        q0, v0: (n,) where, and how fast [rad, rad/s].
        time: how long it takes [s].
    """

    start: float
    q0: Array
    v0: Array
    time: float

    def at(self, now: float) -> Array:
        """Return (n,) the command at a time; at rest once it is over."""
        return self.q0 + self.v0 * travelled(now - self.start, 0.0, self.time)

    def rate(self, now: float) -> Array:
        """Return (n,) the command's rate at a time."""
        return self.v0 * pace(now - self.start, 0.0, self.time)


def travelled(t: float, delay: float, time: float) -> float:
    """Return for how long at full speed an arm would have gone as far, `t` after a decision to stop [s].

    Args:
        t: [s]; nothing is travelled before 0.
        delay: until it begins to slow down [s].
        time: that it then takes to be at rest [s].
    """
    t = max(t, 0.0)
    if t <= delay:
        return t
    braked = min(t - delay, time)
    return delay + (braked - braked * braked / (2.0 * time) if time > 0.0 else 0.0)


def pace(t: float, delay: float, time: float) -> float:
    """Return the share of its speed that an arm still has `t` after a decision to stop; see `travelled`."""
    if t <= delay:
        return 1.0
    return max(0.0, 1.0 - (t - delay) / time) if time > 0.0 else 0.0


@dataclass(frozen=True)
class Rejoin:
    """How far commands are from the plan's while the arm joins it again: a fifth-order fade to nothing.

    Attributes:
        start: when it begins [s].
        time: how long it takes [s].
        offset: (n,) command less plan at the start [rad].
        rate: (n,) the same of their rates [rad/s]: the arm stands, the plan may not.
    """

    start: float
    time: float
    offset: Array
    rate: Array

    @staticmethod
    def within(start: float, offset: Array, rate: Array, speed: Array, acceleration: Array) -> Rejoin:
        """Return the quickest that takes no more than its share of the limits (n,) [rad/s, rad/s²].

        Of speed, that counts for the offset alone: the rate is there already.
        """
        share = TUNING.rejoin_share
        by_speed = PEAK_RATE * np.abs(offset) / (share * speed)
        # Both parts together: PEAK_ACCELERATION |offset| / T² + PEAK_OF_RATE |rate| / T is the share.
        most, turn = share * acceleration, PEAK_OF_RATE * np.abs(rate)
        by_acceleration = (turn + np.sqrt(turn**2 + 4.0 * most * PEAK_ACCELERATION * np.abs(offset))) / (2.0 * most)
        time = max(TUNING.shortest, float(by_speed.max()), float(by_acceleration.max()))
        return Rejoin(start, time, offset, rate)

    def at(self, now: float) -> Array:
        """Return (n,) what to add to the plan's command at a time."""
        s = np.clip((now - self.start) / self.time, 0.0, 1.0)
        left = 1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        # A quintic with rate 1 at 0 and nothing else at either end.
        run = s * (1.0 - s) ** 3 * (1.0 + 3.0 * s)
        return self.offset * left + self.rate * (self.time * run)


def heading(command: Array, before: Array, rate: Array, passed: float, jump: float) -> tuple[Array, bool]:
    """Return a command (n,) held to where it was heading, and whether it had to be.

    Args:
        command: (n,) what is asked for [rad]; not a number: the heading alone counts.
        before: (n,) the command last looked at [rad].
        rate: (n,) its rate then [rad/s].
        passed: time since [s].
        jump: what it may be off the heading [rad].
    """
    ahead = before + rate * passed
    if not np.isfinite(command).all():
        return ahead, True
    held = np.minimum(np.maximum(command, ahead - jump), ahead + jump)
    return held, bool((held != command).any())
