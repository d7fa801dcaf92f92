"""The robot's side of the loop: a simulated world, a recorded run or a real arm, all with the same ports.

`make_station(scenario)` builds the one that ``scenario.station`` names; `ports` names what all of them export.
`replay.recorder` turns a run into a recording that the replay station shows again to the bit; `lcm.fake_arm` is the
other end of the LCM bus.
"""

from __future__ import annotations

from twin_diagram.station.make_station import make_station

__all__ = ["make_station"]
