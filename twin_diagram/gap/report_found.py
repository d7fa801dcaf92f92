"""The report on what was found, where, and how sure it is."""

from __future__ import annotations

from html import escape

from twin_diagram.gap import report_charts as charts
from twin_diagram.gap import report_words as words
from twin_diagram.gap.finding import Estimate, Finding
from twin_diagram.gap.named import sentence_of
from twin_diagram.gap.report_subject import Subject


def found(subject: Subject) -> str:
    """The effects, each with its sentence, parameters and probability."""
    verdict = subject.verdict
    if verdict.verdict == "none":
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
            + "".join(_finding(finding, len(subject.shown.fit) > 1) for finding in verdict.findings)
        )
    if verdict.remainder:
        body += (
            '<p class="note">Structure is left beside what was named. The names above stand, but something else is '
            "there that the catalogue does not hold; the blue dots in the pictures show it.</p>"
        )
    return f'<section id="found"><h2>What was found</h2>{body}</section>'


def _finding(finding: Finding, several: bool) -> str:
    sentence = sentence_of(finding)
    when = words.duration(finding, several)
    when = f", {when}" if when and " from " not in sentence else ""
    per_joint = any(not isinstance(value, Estimate) for value in finding.parameters.values())
    rows = []
    for key, value in finding.parameters.items():
        each = [("", value)] if isinstance(value, Estimate) else list(value.items())
        for joint, estimate in each:
            place = f"<td>{escape(joint)}</td>" if per_joint else ""
            rows.append(f"<tr><td>{escape(words.parameter(key))}</td>{place}<td>{_estimate(estimate)}</td></tr>")
    others = ""
    if finding.alternatives:
        said = ", ".join(
            words.lower_first(words.claim(other.name, other.joints, other.links))
            + f" ({words.percent(other.probability)})"
            for other in finding.alternatives
        )
        others = f'<p class="alternatives">It could also be: {escape(said)}.</p>'
    sure = charts.ring(finding.confidence, words.percent(finding.confidence))
    return (
        f'<div class="effect"><div><h3>{escape(words.title(finding.name))}'
        f"{_on(words.places(finding.joints, finding.links))}</h3>"
        f'<p class="sentence">{escape(words.upper_first(sentence))}{escape(when)}.</p>'
        f'<p class="what">{escape(words.explanation(finding.name))}</p>'
        f'<div class="scroll"><table><tr><th>parameter</th>{"<th>joint</th>" if per_joint else ""}'
        f"<th>value ± standard error</th></tr>"
        f"{''.join(rows)}</table></div>{others}</div>"
        f'<div class="sure">{sure}<br>{escape(words.sureness(finding.confidence))}</div></div>'
    )


def _on(place: str) -> str:
    return f" on {escape(place)}" if place else ""


def _estimate(estimate: Estimate) -> str:
    value = estimate.value
    if isinstance(value, list) and estimate.unit == "rad, N·m" and len(value) > 4:
        half = len(value) // 2
        pairs = "".join(
            f'<tr><td class="n">{words.number(a)}</td><td class="n">{words.number(t)}</td></tr>'
            for a, t in zip(value[:half], value[half:], strict=True)
        )
        return (
            f"a curve through {half} points<details><summary>points</summary><table>"
            f'<tr><th class="n">angle [rad]</th><th class="n">torque [N·m]</th></tr>{pairs}</table></details>'
        )
    return escape(words.with_error(estimate))


def where(subject: Subject) -> str:
    """Joints and conditions under which the residual appears."""
    places = [place for place in subject.verdict.where if place.share > 0.005][:8]
    if not places:
        return ""
    several = len(subject.shown.fit) > 1
    rows = "".join(
        f"<tr><td>{escape(place.joint)}</td><td>{charts.share_bar(place.share)} {words.percent(place.share)}</td>"
        f"<td>{escape(place.condition)}</td><td>{place.time[0]:.2f} to {place.time[1]:.2f} s"
        f"{f' of log {place.log + 1}' if several else ''}</td></tr>"
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
