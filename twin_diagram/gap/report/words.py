"""What the report says in words: the verdict, effects for people who have never met them, numbers with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twin_diagram.gap.candidates.records import RECORDS, record_of
from twin_diagram.gap.correction.named_effects import amount_of
from twin_diagram.gap.findings import Finding, Moment, Verdict
from twin_diagram.gap.report import summary

ON_PRISMATIC = {"torque": "force", "angle": "position"}
"""What stands in the place of such words where a joint is prismatic."""


WORTH_SAYING = 0.005
"""Probabilities below this are in gap.json alone."""


def of_prismatic(text: str) -> str:
    """Return a text about revolute joints, as it is said of prismatic joints."""
    for turning, prismatic in ON_PRISMATIC.items():
        text = text.replace(turning, prismatic).replace(upper_first(turning), upper_first(prismatic))
    return text


def parameter(name: str, key: str, prismatic: bool = False, turning: bool = True) -> str:
    """Return a key of an effect's parameters for people, of prismatic joints, revolute ones, or both."""
    record = record_of(name)
    if prismatic and key in record.keys_on_prismatic:
        other = record.keys_on_prismatic[key]
        return f"{record.keys[key]}, or {other}" if turning else other
    text = record.keys.get(key, key.replace("_", " "))
    return text if turning else of_prismatic(text)


def title(name: str) -> str:
    """Return an effect's name as a headline."""
    return record_of(name).title


def explanation(name: str, prismatic: bool = False) -> str:
    """Return what an effect is, on revolute or prismatic joints.

    Of a user's own effect, what its class says of itself.
    """
    text = record_of(name).explanation
    return of_prismatic(text) if prismatic and name in RECORDS else text


def listed(items: Sequence[str]) -> str:
    """Return a, B and C."""
    items = list(items)
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"


def places(joints: Sequence[str], links: Sequence[str]) -> str:
    """Return where an effect sits, in words; empty where it sits on no part in particular."""
    return listed([*joints, *links])


def claim(name: str, joints: Sequence[str], links: Sequence[str]) -> str:
    """Return an effect and its place on one line, for alternatives."""
    where = places(joints, links)
    return f"{title(name)} on {where}" if where else title(name)


def headline(verdict: Verdict) -> str:
    """Return the verdict in one sentence."""
    if verdict.verdict == "none" and verdict.unexplained:
        joints = listed(verdict.unexplained)
        return f"The model explains the fitted runs, but not the held-out one, on {joints}: something differs there."
    if verdict.verdict == "none" and verdict.recorded is not None:
        return "Nothing new is missing: these runs leave no more than was left when this model was corrected."
    if verdict.verdict == "none":
        return "The model explains these runs. Nothing is missing that they could show."
    if verdict.verdict == "unknown":
        return "Something is missing from the model, and no effect of the catalogue explains it."
    if summary.is_whole_robot(verdict):
        return summary.summary(verdict)
    said = (("more", "lacks {}"), ("less", "has more than the arm of {}"), ("other", "has another amount of {}"))
    sure = [finding for finding in verdict.findings if not finding.is_guess()]
    clauses = [
        clause.format(listed(those))
        for amount, clause in said
        if (those := [_short(f) for f in sure if amount_of(f) == amount])
    ]
    text = " ".join(f"{'It' if k else 'The model'} {clause}." for k, clause in enumerate(clauses))
    if len(sure) < len(verdict.findings):
        more = "Something more is" if sure else "Something is"
        text = f"{text} {more} missing that these runs allow to guess at only.".strip()
    if verdict.remainder:
        text += " Something more is there that no effect of the catalogue explains."
    if verdict.unexplained:
        text += f" The held-out run is not explained on {listed(verdict.unexplained)}."
    return text


def _short(finding: Finding) -> str:
    """Return an effect and, where that is short, its place."""
    where = finding.joints if len(finding.joints) <= 3 else ()
    count = f" on {len(finding.joints)} joints" if len(finding.joints) > 3 else ""
    return lower_first(title(finding.name)) + (f" on {listed(where)}" if where else count)


def lower_first(words: str) -> str:
    """Return words as they stand within a sentence."""
    return words[:1].lower() + words[1:]


def upper_first(words: str) -> str:
    """Return words as they stand at its begin."""
    return words[:1].upper() + words[1:]


def sureness(confidence: float) -> str:
    """Return a probability in words."""
    for bound, word in ((0.99, "practically certain"), (0.9, "very likely"), (0.7, "likely"), (0.4, "uncertain")):
        if confidence >= bound:
            return word
    return "a guess"


def percent(share: float) -> str:
    """Return a share; not rounded up to certainty."""
    if not math.isfinite(share):
        return "–"
    if 0.99 < share < 1.0:
        return "> 99 %"
    if 0.0 < share < 0.01:
        return "< 1 %"
    return f"{100.0 * share:.0f} %"


def rest(finding: Finding) -> str:
    """Return where the probability went that neither a finding nor its alternatives have; empty where next to none."""
    parts = (
        (finding.rest.others, "other explanations, each less probable"),
        (finding.rest.nothing, "no effect in its place"),
        (finding.rest.unseen, "more joints of the same kind, on which this motion does not show it"),
        (finding.rest.nameless, "something that has no name in the catalogue"),
    )
    said = [f"{text} ({percent(share)})" for share, text in parts if share >= WORTH_SAYING]
    return f"The rest: {listed(said)}." if said else ""


def moment(when: Moment | None, several: bool) -> str:
    """Return a time, with its log where there are several."""
    if when is None:
        return ""
    error = f" ± {when.std:.2g}" if when.std > 0.0 else ""
    return f"{when.time:.3f}{error} s" + (f" of log {when.log + 1}" if several else "")


def duration(finding: Finding, several: bool) -> str:
    """Say from when to when an effect acts; empty where it always does."""
    begin, end = moment(finding.onset, several), moment(finding.end, several)
    if begin and end:
        return f"from {begin} until {end}"
    return f"from {begin} on" if begin else f"until {end}" if end else ""
