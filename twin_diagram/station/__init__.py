"""The robot's side of the loop: a simulated world, a recorded run or a real arm, all with the same ports."""

from __future__ import annotations

from twin_diagram.station.make import make_station

__all__ = ["make_station"]
