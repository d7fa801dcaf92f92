"""Chooses a station by the scenario's `station` field."""

from __future__ import annotations

from pydrake.systems.framework import Diagram

from twin_diagram.errors import StationError
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import check_scenario


def make_station(scenario: Scenario) -> Diagram:
    """Build the station that a scenario asks for.

    Args:
        scenario: ``station`` is ``sim``, ``replay`` or ``lcm``. Only ``sim`` reads ``world``.

    Returns:
        A Diagram with the ports of `twin_diagram.station.ports`.

    Raises:
        StationError: no such station, or it cannot be built from this scenario.
        ModelError, AssetError, ScenarioError: what it is to be built from is missing or malformed.
    """
    check_scenario(scenario)
    # Each station is imported where it is needed: a replay needs no renderer, a simulation no LCM.
    if scenario.station == "sim":
        from twin_diagram.station.sim.station import SimStation

        return SimStation(scenario)
    if scenario.station == "replay":
        from twin_diagram.station.replay.station import ReplayArmStation

        return ReplayArmStation(scenario)
    if scenario.station == "lcm":
        from twin_diagram.station.lcm.station import LcmArmStation

        return LcmArmStation(scenario)
    raise StationError(f"station: {scenario.station!r} is none of sim, replay, lcm")
