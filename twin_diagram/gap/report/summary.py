"""One line for a robot that lacks many things at once: what is unusual, what every arm lacks, and what is left.

"payload 2.7 ± 0.2 kg; friction and rotors on all joints; little left"
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.findings import Estimate, Finding, Verdict
from twin_diagram.gap.report.numbers import with_error
from twin_diagram.model.effects.actuation import TorqueBias
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.link_inertia import InertialParameters


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    names: int = 3
    """From so many names on a sentence is too long."""

    places: int = 4
    """Joints and links from which on a robot lacks many things at once."""


TUNING = Tuning()


def is_whole_robot(verdict: Verdict) -> bool:
    """Return whether a verdict names many things at once, on many places."""
    places = {place for finding in verdict.findings for place in (*finding.joints, *finding.links)}
    usual = any(_group(finding) for finding in verdict.findings)
    return len(verdict.findings) >= TUNING.names and len(places) >= TUNING.places and usual


def summary(verdict: Verdict) -> str:
    """Return the verdict on one line."""
    count = len(verdict.noise_floor)
    sure = [finding for finding in verdict.findings if not finding.is_guess()]
    parts = list(dict.fromkeys(_unusual(f, count) + _held(f, sure) for f in sure if not _group(f)))
    groups: dict[str, set[str]] = {}
    for finding in sure:
        if word := _group(finding):
            groups.setdefault(word, set()).update(finding.joints, finding.links)
    alike: dict[str, list[str]] = {}
    for word, places in groups.items():
        on = _on(places, "link" if word == "inertia" else "joint", count)
        alike.setdefault(on, []).append(word)
    parts += [f"{_listed(words)} {on}" for on, words in alike.items()]
    if len(sure) < len(verdict.findings):
        parts.append("something more that can be guessed at only")
    little = "little left" if verdict.recorded is None else "no more left than when the model was corrected"
    if verdict.unexplained:
        parts.append(f"the held-out run is not explained {_on(set(verdict.unexplained), 'joint', count)}")
    if verdict.remainder or not verdict.unexplained:
        parts.append("structure left that has no name" if verdict.remainder else little)
    return "; ".join(parts)


def _group(finding: Finding) -> str:
    """Return the word for what every arm lacks; empty for what is unusual."""
    if finding.onset is not None or finding.end is not None:
        return ""
    record = record_of(finding.name)
    if finding.name == InertialParameters.name:
        return "inertia"
    if finding.name == TorqueBias.name:
        return "offsets"
    if record.of_rotor and record.usual:
        return "rotors"
    return "friction" if "friction" in finding.name and not record.coupled else ""


def _unusual(finding: Finding, count: int) -> str:
    title = record_of(finding.name).title
    words = (title[:1].lower() + title[1:]).removeprefix("a ").removeprefix("an ")
    first = next(iter(finding.parameters.values()))
    if isinstance(first, dict) and len(first) == 1:
        first = next(iter(first.values()))
    if isinstance(first, Estimate) and not isinstance(first.value, list):
        # Of a tilt, one angle alone would say nothing.
        alike = {k: x for k, x in finding.parameters.items() if isinstance(x, Estimate) and x.unit == first.unit}
        each = ", ".join(f"{key} {with_error(value)}" for key, value in alike.items())
        words = f"{words} ({each})" if len(alike) > 1 else f"{words} {with_error(first)}"
    return f"{words} {_on(set(finding.joints), 'joint', count)}" if finding.joints else words


def _held(finding: Finding, among: Sequence[Finding]) -> str:
    """Return when a load is held, if that is for a part of the logs only; the same may be held several times."""
    if finding.name != Payload.name:
        return ""
    again = sum(one.name == finding.name and one.parameters == finding.parameters for one in among)
    if again > 1:
        return f", held {again} times"
    if finding.onset is None:
        return f", until {finding.end.time:.2f} s" if finding.end is not None else ""
    if finding.end is None:
        return f", from {finding.onset.time:.2f} s on"
    return f", held from {finding.onset.time:.2f} to {finding.end.time:.2f} s"


def _on(places: set[str], kind: str, count: int) -> str:
    if len(places) == count:
        return f"on all {kind}s"
    return f"on {next(iter(places))}" if len(places) == 1 else f"on {len(places)} {kind}s"


def _listed(words: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
