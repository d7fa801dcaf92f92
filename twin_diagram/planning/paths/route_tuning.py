"""How routes are found and kept: the constants of `route`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RouteTuning:
    """How routes are found and kept."""

    resolution: float = 0.10
    """Between checked configurations on a straight line [rad]."""
    spare: float = 0.02
    """A new route keeps this much more than the margin [m] …"""
    blocked: float = 0.6
    """… and is given up where this share of the margin is not kept."""
    horizon: float = 2.0
    """An end must stay free for this long from now [s]."""
    checks: int = 1800
    """Of the global planner, in one search."""
    direct: int = 3
    """Goals to which a straight line is tried."""
    over: int = 2
    """Goals to which a way is tried that lifts the tool in the middle …"""
    lifts: tuple[float, ...] = (0.06, 0.12, 0.18, 0.24, 0.32)
    """… by this much [m]: things on a table are passed over …"""
    lift_steps: int = 3
    """… found in so many steps of Gauss and Newton: a rough height will do."""
    roomier: float = 1.0
    """A goal with nothing within the clearance is worth so much longer a way than one that touches something [s]."""
    swing: float = 0.5
    """A goal counts as farther by this share of the time that its joints take on average [1]: of two that are reached
    in the same time, one by a turn of the wrist, one by swinging the whole arm around, the first is gone to."""
    dwell: tuple[float, ...] = (0.0, 0.4, 0.8)
    """The global planner wants a configuration free at these times after the earliest arrival [s]."""
    near_future: float = 0.8
    """A route that is blocked later than this is followed as far as it goes, for want of a better one [s]."""
    way_point_reached: float = 0.05
    """A way point this near is passed [rad]: half a checked step."""
    risen: float = 2.0
    """What rests on something has been lifted off that from so many times this near the end of its rise on [1]: a lift
    of 6 cm takes 0.15 rad and more, mostly, …"""
    lacking: float = 0.3
    """… and no sooner than this share of the least lift is lacking [1]: of some arms a lift takes 0.08 rad."""
    way_point_near: float = 0.3
    """From this near a way point is dropped where the way beyond is just free [rad]: the motion rounds corners off."""
    line_acceleration: float = 0.8
    """Straight lines in space are set off along with this share of the acceleration …"""
    line_braking: float = 0.3
    """… and braked on with this share of that: the arm follows late, and would run past their end; up there is
    nothing to run into."""
    braking: float = 0.6
    """Other ways are braked on with this share of the acceleration, for the same reason."""
    station_reached: float = 0.01
    """A way point of a straight line this near is passed [rad]: a fifth of what lies between two."""
    refuge_tries: int = 48
    """Configurations that are tried as a refuge in one tick: as much time as a few checks of a route."""
