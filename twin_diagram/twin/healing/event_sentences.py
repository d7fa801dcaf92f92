"""Events in words."""

from __future__ import annotations

from typing import Any


def sentence(event: dict[str, Any]) -> str:
    """Return an event as `Healer` tells it, for people: one line."""
    kind = event["event"]
    if kind == "alarm":
        what = event["joint"] or event["sensor"]
        where = f" on {what}" if what else ""
        return f"alarm: {event['kind']}, a {event['shape']}{where}, {event['statistic']:.1f} times its threshold"
    if kind == "gap_started":
        return f"looking for what the model lacks, in the log since {event['fit'][0]:.1f} s"
    if kind == "gap_verdict":
        return f"verdict: {event['verdict']}, after {event['seconds']:.0f} s in a process of its own"
    if kind == "model_swapped":
        return "the running twin goes on with: " + "; ".join(event["effects"])
    return f"{kind.replace('_', ' ')}: {event.get('why', '')}"
