"""Says while a run goes on what the twin lacks, once each, and at its end what it lacked."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

from pydrake.systems.framework import Context

from twin_diagram.scenario import Scenario
from twin_diagram.twin.health import Lack
from twin_diagram.twin.twin import TwinDiagram


class HealthWatch:
    """Looks at a twin's health between steps and says what is new, in a line each."""

    def __init__(self, twin: TwinDiagram, say: Callable[[str], None]) -> None:
        """`say` takes the lines."""
        self._twin, self._say = twin, say
        self._said: set[Lack] = set()

    def poll(self, context: Context) -> None:
        """Say what is lacking that was not said before; `context` is the whole Diagram's."""
        for lack, since in self._twin.health.standing(self._own(context)):
            if lack not in self._said:
                self._said.add(lack)
                self._say(f"{context.get_time():.2f} s: {lack.sentence(since)}")

    def told(self, context: Context) -> list[dict[str, Any]]:
        """Return what was lacking so far, as it stands in ``summary.json``; `context` is the whole Diagram's."""
        return self._twin.health.told(self._own(context))

    def _own(self, context: Context) -> Context:
        return self._twin.diagram.GetSubsystemContext(
            self._twin.health, self._twin.diagram.GetMyContextFromRoot(context)
        )


def unheard(summary: Mapping[str, Any]) -> bool:
    """Return whether no message of the arm ever came that the twin could use; a simulated run always has some."""
    return summary.get("joints", {}) is None


def said_unheard(scenario: Scenario, summary: Mapping[str, Any]) -> bool:
    """Return `unheard`, and say on stderr where messages should have come from, for whoever looks for the reason."""
    if not unheard(summary):
        return False
    where = f"from its {scenario.station} station"
    if scenario.station == "lcm":
        from twin_diagram.station.lcm.messages import PROTOCOLS

        channel = scenario.lcm.status_channel or PROTOCOLS[scenario.lcm.arm].status_channel
        url = scenario.lcm.url or "LCM's default address (LCM_DEFAULT_URL)"
        where = f"on {channel} at {url}; see lcm.arm, lcm.status_channel, lcm.url"
    print(f"the arm never spoke: nothing that can be used came {where}", file=sys.stderr)
    return True
