"""The report on what was found, where, and how sure it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape

from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.correction.named_effects import amount_of, sentence_of
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.report import charts, numbers, words
from twin_diagram.gap.report.subject import Subject


def found(subject: Subject) -> str:
    """Return the effects, each with its sentence, parameters and probability."""
    verdict = subject.verdict
    if verdict.verdict == "none" and verdict.recorded is not None:
        body = (
            '<p class="lead">These runs leave no more torque unexplained than was left when this model was corrected, '
            "so nothing new has a name. What is left may be more than noise: it had no name then, and has none now. "
            "This speaks of the motions in these runs alone.</p>"
        )
    elif verdict.verdict == "none":
        body = (
            '<p class="lead">The torque that the motors gave is what the model says that these motions take, but for '
            "noise: a test that is calibrated on clean runs finds no structure in what is left. This speaks of "
            "the motions "
            "in these runs alone. An effect that they did not wake (a joint that hardly moved, a speed that was never "
            "reached, a load that was never carried) would not show.</p>"
        )
    elif verdict.verdict == "unknown":
        body = (
            '<p class="lead">The difference between measurement and model has structure that noise does not '
            "have. No effect "
            "of the catalogue, nor a few of them together, explains enough of it to be named: a wrong name would "
            "do more "
            "harm than none. The model was left as it is. The pictures below show under which conditions the "
            "difference "
            "appears.</p>"
        )
    else:
        count = len(verdict.findings)
        lead = {1: "One effect", 2: "Two effects", 3: "Three effects"}.get(count, f"{count} effects")
        body = (
            f'<p class="lead">{lead}, named relative to the given model: what must be added to it to explain the '
            "measured torque.</p>"
            + "".join(
                _finding(_by_file(finding, subject.files), max(subject.files) > 0, subject.given.prismatic)
                for finding in verdict.findings
            )
        )
    if verdict.remainder:
        body += (
            '<p class="note">Structure is left beside what was named. The names above stand, but something else is '
            "there that the catalogue does not hold; the blue dots in the pictures show it.</p>"
        )
    return f'<section id="found"><h2>What was found</h2>{body}</section>'


def _by_file(finding: Finding, files: Sequence[int]) -> Finding:
    """Return a finding whose moments tell files as gap.json does, not the stretches that one is parted into."""
    onset, end = (when and replace(when, log=files[when.log]) for when in (finding.onset, finding.end))
    return replace(finding, onset=onset, end=end)


def _finding(finding: Finding, several: bool, prismatic: frozenset[str]) -> str:
    sentence = _of_links(finding) if len(finding.links) > 1 else sentence_of(finding, prismatic)
    only = bool(finding.joints) and prismatic.issuperset(finding.joints)
    when = words.duration(finding, several)
    when = f", {when}" if when and " from " not in sentence else ""
    others = ""
    possible = [other for other in finding.alternatives if other.probability >= words.WORTH_SAYING]
    if possible:
        said = ", ".join(
            words.lower_first(words.claim(other.name, other.joints, other.links))
            + f" ({words.percent(other.probability)})"
            for other in possible
        )
        others = f'<p class="alternatives">It could also be: {escape(said)}.{_whichever(finding)}</p>'
    if rest := words.rest(finding):
        others += f'<p class="alternatives">{escape(rest)}</p>'
    sure = charts.ring(finding.confidence, words.percent(finding.confidence))
    return (
        f'<div class="effect"><div><h3>{escape(words.title(finding.name))}'
        f"{_on(words.places(finding.joints, finding.links))}</h3>"
        f'<p class="sentence">{escape(words.upper_first(sentence))}{escape(when)}.</p>'
        f'<p class="what">{escape(words.explanation(finding.name, only) if amount_of(finding) == "more" else "")}</p>'
        f'<div class="scroll">{_parameters(finding, prismatic)}</div>{others}</div>'
        f'<div class="sure">{sure}<br>{escape(words.sureness(finding.confidence))}</div></div>'
    )


def _of_links(finding: Finding) -> str:
    """Return what is said of several links at once, whose numbers no motion tells one by one."""
    return (
        f"the inertia of {words.listed(finding.links)} is other than described; motion tells sums of these numbers "
        "better than each alone, so their errors go together"
    )


def _whichever(finding: Finding) -> str:
    """Return what is sure where only kinds and joints of dry friction compete.

    A run without slow reversals hardly tells them apart.
    """
    if not all(record_of(name).holds for name in (finding.name, *(other.name for other in finding.alternatives))):
        return ""
    return " In all of these there is dry friction; the doubt is of which kind it is, and on which joint."


def _parameters(finding: Finding, prismatic: frozenset[str]) -> str:
    """Return a line per joint or link where there are several, else one per parameter."""
    slide = [joint in prismatic for joint in finding.joints]
    kinds = {"prismatic": any(slide), "turning": not all(slide) or not slide}
    values = finding.parameters.items()
    per_joint = {key: value for key, value in values if not isinstance(value, Estimate)}
    places, kind = (finding.joints, "joint") if finding.joints else (finding.links, "link")
    if len(places) > 1 and len(per_joint) == len(finding.parameters):
        head = "".join(f"<th>{escape(words.parameter(finding.name, key, **kinds))}</th>" for key in per_joint)
        rows = "".join(
            f"<tr><td>{escape(place)}</td>"
            + "".join(f"<td>{_estimate(value[place]) if place in value else ''}</td>" for value in per_joint.values())
            + "</tr>"
            for place in places
            if any(place in value for value in per_joint.values())
        )
        return f"<table><tr><th>{kind}</th>{head}</tr>{rows}</table>"
    rows = ""
    for key, value in values:
        each = [("", value)] if isinstance(value, Estimate) else list(value.items())
        for joint, estimate in each:
            place = f"<td>{escape(joint)}</td>" if per_joint else ""
            said = escape(words.parameter(finding.name, key, **kinds))
            rows += f"<tr><td>{said}</td>{place}<td>{_estimate(estimate)}</td></tr>"
    joint = f"<th>{kind}</th>" if per_joint else ""
    return f"<table><tr><th>parameter</th>{joint}<th>value ± standard error</th></tr>{rows}</table>"


CURVES = {"rad, N·m": ("angle [rad]", "torque [N·m]"), "m, N": ("position [m]", "force [N]")}
"""A curve's unit → what its points hold."""


def _on(place: str) -> str:
    return f" on {escape(place)}" if place else ""


def _estimate(estimate: Estimate) -> str:
    value = estimate.value
    if isinstance(value, list) and estimate.unit in CURVES and len(value) > 4:
        along, effort = CURVES[estimate.unit]
        half = len(value) // 2
        pairs = "".join(
            f'<tr><td class="n">{numbers.number(a)}</td><td class="n">{numbers.number(t)}</td></tr>'
            for a, t in zip(value[:half], value[half:], strict=True)
        )
        return (
            f"a curve through {half} points<details><summary>points</summary><table>"
            f'<tr><th class="n">{along}</th><th class="n">{effort}</th></tr>{pairs}</table></details>'
        )
    return escape(numbers.with_error(estimate))


def where(subject: Subject) -> str:
    """Return the joints and conditions under which the residual appears."""
    places = [place for place in subject.verdict.where if place.share > 0.005][:8]
    if not places:
        return ""
    files = subject.files
    rows = "".join(
        f"<tr><td>{escape(place.joint)}</td><td>{charts.share_bar(place.share)} {words.percent(place.share)}</td>"
        f"<td>{escape(place.condition)}</td><td>{place.time[0]:.2f} to {place.time[1]:.2f} s"
        f"{f' of log {files[place.log] + 1}' if max(files) else ''}</td></tr>"
        for place in places
    )
    return (
        '<section id="where"><h2>Where model and measurement part ways</h2>'
        '<p class="lead">Shares of the residual above the noise, each joint in units of its own noise, and the '
        "condition "
        "under which it appears.</p>"
        '<div class="scroll"><table><tr><th>joint</th><th>share of the residual</th><th>appears</th><th>between</th>'
        f"</tr>{rows}</table></div></section>"
    )
