"""The report: one HTML file that says what a model lacks, to people who have never seen this tool."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
import numpy.typing as npt
import yaml

from twin_diagram.errors import ModelError
from twin_diagram.gap import report_charts as charts
from twin_diagram.gap import report_words as words
from twin_diagram.gap.finding import Estimate, Finding, Separation, Verdict
from twin_diagram.gap.named import effects_of
from twin_diagram.gap.report_pictures import residual_pictures
from twin_diagram.gap.report_style import STYLE
from twin_diagram.gap.show import Comparison, Shown, above_noise
from twin_diagram.gap.trajectories import Experiment
from twin_diagram.model import Model

Array = npt.NDArray[np.float64]

MOST_PICTURES = 4
"""Joints that get pictures."""

MOST_DIFF = 120
"""Lines of the model's difference that are shown."""


@dataclass(frozen=True)
class Subject:
    """What the report is about.

    Attributes:
        verdict: what was found.
        shown: the gap before and after.
        given: the given model.
        corrected: the corrected one; the same object where nothing was corrected.
        name: of the model, for people.
        experiments: with the names of their files, relative to the report.
        notes: warnings about the logs, and what else the reader should know.
        seconds: that it took.
        version: of this package.
    """

    verdict: Verdict
    shown: Shown
    given: Model
    corrected: Model
    name: str
    experiments: Sequence[tuple[Experiment, str]] = ()
    notes: Sequence[str] = ()
    seconds: float = 0.0
    version: str = ""
    title: str = field(default="Gap report")

    @property
    def changed(self) -> bool:
        """Whether there is a corrected model that differs."""
        return self.corrected is not self.given


def page(subject: Subject) -> str:
    """The whole file."""
    verdict = subject.verdict
    badge = {"named": "effect found", "none": "no gap found", "unknown": "unknown effect"}[verdict.verdict]
    parts = [
        _found(subject),
        _where(subject),
        _gap(subject),
        _pictures(subject),
        _difference(subject),
        _next(subject),
        _how(subject),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(subject.title)}: {escape(subject.name)}</title><style>{STYLE}</style></head><body>"
        f'<header class="top"><div><p class="kicker"><span class="badge {verdict.verdict}">{badge}</span>'
        f"{escape(subject.title)} · model <b>{escape(subject.name)}</b> against {_runs_in_words(subject)}</p>"
        f"<h1>{escape(words.headline(verdict))}</h1></div></header><main>{_tiles(subject)}"
        f"{''.join(parts)}<footer>Made by twin-diagram {escape(subject.version)} in {subject.seconds:.0f} s. "
        "This file needs no network. The same figures for programs are in gap.json beside it.</footer>"
        "</main></body></html>\n"
    )


def _runs_in_words(subject: Subject) -> str:
    count = len(subject.shown.fit)
    return f"{count} fitted run{'s' if count > 1 else ''} and one held out"


def _tiles(subject: Subject) -> str:
    shown, verdict = subject.shown, subject.verdict
    before, after = shown.holdout_rms()
    worst = int(np.argmax(before / shown.noise_floor))
    tiles = []
    if subject.changed:
        closed = 1.0 - shown.left_over()
        tiles += [
            (words.percent(max(closed, 0.0)), "of the gap above the noise is closed on the run that was held out"),
            (
                f"{words.number(before[worst])} → {words.number(after[worst])} N·m",
                f"residual torque of {shown.joints[worst]}, held out; the noise is "
                f"{words.number(shown.noise_floor[worst])}",
            ),
        ]
    else:
        tiles.append(
            (
                f"{words.number(before[worst])} N·m",
                f"largest residual against its noise: {shown.joints[worst]}, held out; the noise is "
                f"{words.number(shown.noise_floor[worst])} N·m",
            )
        )
    rolled = shown.holdout
    if rolled.rollout_before is not None and rolled.rollout_after is not None:
        a, b = (1e3 * float(np.linalg.norm(x)) for x in (rolled.rollout_before, rolled.rollout_after))
        text = f"{words.number(a)} → {words.number(b)} mrad" if subject.changed else f"{words.number(a)} mrad"
        tiles.append((text, "error of motions predicted 0.2 s ahead, all joints together, held out"))
    if verdict.findings:
        least = min(finding.confidence for finding in verdict.findings)
        which = "the name is" if len(verdict.findings) == 1 else "the least certain name is"
        tiles.append((words.percent(least), f"probability that {which} right: {words.sureness(least)}"))
    return (
        '<div class="tiles">'
        + "".join(f'<div class="tile"><b>{escape(a)}</b><span>{escape(b)}</span></div>' for a, b in tiles)
        + "</div>"
    )


def _found(subject: Subject) -> str:
    verdict = subject.verdict
    if verdict.verdict == "none":
        body = (
            '<p class="lead">The torque that the motors gave is what the model says that these motions take, but for noise: '
            "a test that is calibrated on clean runs finds no structure in what is left. This speaks of the motions in these "
            "runs alone. An effect that they did not wake (a joint that hardly moved, a speed that was never reached, a load "
            "that was never carried) would not show.</p>"
        )
    elif verdict.verdict == "unknown":
        body = (
            '<p class="lead">The difference between measurement and model has structure that noise does not have. No effect of '
            "the catalogue, nor a few of them together, explains enough of it to be named: a wrong name would do more harm "
            "than none. The model was left as it is. The pictures below show under which conditions the difference "
            "appears.</p>"
        )
    else:
        count = len(verdict.findings)
        lead = "One effect" if count == 1 else f"{count} effects"
        body = (
            f'<p class="lead">{lead}, named relative to the given model: what must be added to it to explain the measured '
            "torque.</p>" + "".join(_finding(finding, len(subject.shown.fit) > 1) for finding in verdict.findings)
        )
    if verdict.remainder:
        body += (
            '<p class="note">Structure is left beside what was named. The names above stand, but something else is there '
            "that the catalogue does not hold; the blue dots in the pictures show it.</p>"
        )
    return f'<section id="found"><h2>What was found</h2>{body}</section>'


def _finding(finding: Finding, several: bool) -> str:
    try:
        sentence = "; ".join(effect.sentence() for effect in effects_of(finding))
    except ModelError:
        sentence = words.claim(finding.name, finding.joints, finding.links)
    when = words.duration(finding, several)
    rows = []
    for key, value in finding.parameters.items():
        each = [("", value)] if isinstance(value, Estimate) else list(value.items())
        for joint, estimate in each:
            rows.append(
                f"<tr><td>{escape(key.replace('_', ' '))}</td><td>{escape(joint)}</td><td>{_estimate(estimate)}</td></tr>"
            )
    others = ""
    if finding.alternatives:
        said = ", ".join(
            f"{words.lower_first(words.claim(other.name, other.joints, other.links))} ({words.percent(other.probability)})"
            for other in finding.alternatives
        )
        others = f'<p class="alternatives">It could also be: {escape(said)}.</p>'
    sure = charts.ring(finding.confidence, words.percent(finding.confidence))
    return (
        f'<div class="effect"><div><h3>{escape(words.title(finding.name))}'
        f"{_on(words.places(finding.joints, finding.links))}</h3>"
        f'<p class="sentence">{escape(words.upper_first(sentence))}{escape(", " + when if when else "")}.</p>'
        f'<p class="what">{escape(words.explanation(finding.name))}</p>'
        f'<div class="scroll"><table><tr><th>parameter</th><th>joint</th><th>value ± standard error</th></tr>'
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


def _where(subject: Subject) -> str:
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
        '<p class="lead">Shares of the residual above the noise, each joint in units of its own noise, and the condition under '
        "which it appears.</p>"
        f'<div class="scroll"><table><tr><th>joint</th><th>share of the residual</th><th>appears</th><th>between</th></tr>'
        f"{rows}</table></div></section>"
    )


def _gap(subject: Subject) -> str:
    shown, changed = subject.shown, subject.changed
    before, after = shown.holdout_rms()
    fit_before, fit_after = shown.fit_rms()
    blocks = [
        (
            "Residual torque, run that was held out",
            charts.bars(shown.joints, before, after, shown.noise_floor, "N·m", changed),
        ),
        (
            f"Residual torque, fitted run{'s' if len(shown.fit) > 1 else ''}",
            charts.bars(shown.joints, fit_before, fit_after, shown.noise_floor, "N·m", changed),
        ),
    ]
    rolled = shown.holdout
    if rolled.rollout_before is not None and rolled.rollout_after is not None:
        blocks.append(
            (
                "Error of motions predicted 0.2 s ahead, held out",
                charts.bars(
                    shown.joints, 1e3 * rolled.rollout_before, 1e3 * rolled.rollout_after, None, "mrad", changed
                ),
            )
        )
    table = _table(shown, before, after, changed)
    inside = "".join(f"<div><h3>{escape(head)}</h3>{svg}</div>" for head, svg in blocks)
    inside += f'<div><h3>Held out, in figures</h3><div class="scroll">{table}</div></div>'
    legend = '<i class="before"></i>given model'
    legend += '<i class="after"></i>corrected model' if changed else ""
    legend += '<i class="dash"></i>noise: no model can do better'
    head = "How much the gap shrank" if changed else "How large the gap is"
    return (
        f'<section id="gap"><h2>{head}</h2><p class="lead">Root mean square of measured less predicted torque, below 10 Hz, joint '
        "by joint; each joint has its own scale. What counts is the run that was held out: nothing was fitted to it.</p>"
        f'<p class="legend">{legend}</p><div class="charts">{inside}</div></section>'
    )


def _table(shown: Shown, before: Array, after: Array, changed: bool) -> str:
    gone = above_noise(after, shown.noise_floor) / np.maximum(above_noise(before, shown.noise_floor), 1e-300)
    rows = []
    for k, joint in enumerate(shown.joints):
        cells = [words.number(before[k])]
        if changed:
            cells.append(words.number(after[k]))
        cells.append(words.number(shown.noise_floor[k]))
        if changed:
            # A joint whose residual was noise from the begin has no gap of which a share could be left.
            small = before[k] < 1.15 * shown.noise_floor[k]
            cells.append("no gap" if small else words.percent(float(gone[k])))
        rows.append(f"<tr><td>{escape(joint)}</td>" + "".join(f'<td class="n">{cell}</td>' for cell in cells) + "</tr>")
    heads = ["given [N·m]", "corrected", "noise", "gap left"] if changed else ["given [N·m]", "noise"]
    return (
        "<table><tr><th>joint</th>"
        + "".join(f'<th class="n">{head}</th>' for head in heads)
        + f"</tr>{''.join(rows)}</table>"
    )


def pictured(subject: Subject) -> list[int]:
    """Columns of the joints that are worth pictures, most telling first."""
    shown = subject.shown
    before, _ = shown.holdout_rms()
    ratio = before / shown.noise_floor
    named = {joint for finding in subject.verdict.findings for joint in finding.joints}
    order = sorted(range(len(shown.joints)), key=lambda k: (shown.joints[k] not in named, -ratio[k]))
    if named:
        wanted = [k for k in order if shown.joints[k] in named or ratio[k] > 1.5]
    else:
        wanted = [k for k in order if ratio[k] > 1.3] or order[:2]
    return wanted[:MOST_PICTURES]


def _pictures(subject: Subject) -> str:
    shown = subject.shown
    joints = pictured(subject)
    figures = []
    timed = [f for f in subject.verdict.findings if f.onset is not None or f.end is not None]
    for j in joints:
        own = [f for f in timed if shown.joints[j] in f.joints or not f.joints]
        if own:
            when = own[0].onset or own[0].end
            run = shown.fit[when.log if when is not None else 0]
            figures.append(_figure(subject, run, j, own[0]))
        figures.append(_figure(subject, shown.holdout, j, None))
    rest = [shown.joints[k] for k in range(len(shown.joints)) if k not in joints]
    also = f" The other joints ({escape(words.listed(rest))}) have less to show." if rest else ""
    return (
        '<section id="pictures"><h2>The residual, by what the joint is doing</h2>'
        '<p class="lead">Each dot is one moment. A model that explains the run leaves a flat cloud about zero that is as '
        f"wide as the noise (grey). A shape in the cloud is the signature of what is missing.{also}</p>"
        f"{''.join(figures)}</section>"
    )


def _figure(subject: Subject, run: Comparison, j: int, finding: Finding | None) -> str:
    onset, end = (None, None) if finding is None else (finding.onset, finding.end)
    picture = residual_pictures(run, j, float(subject.shown.noise_floor[j]), subject.changed, onset, end)
    which = "held-out run" if run.held_out else "fitted run"
    return f"<figure><figcaption>{escape(run.joints[j])} <span>· {which}</span></figcaption>{picture}</figure>"


def _difference(subject: Subject) -> str:
    if not subject.changed:
        return ""
    old, new = (effects_text(model) for model in (subject.given, subject.corrected))
    lines = list(difflib.unified_diff(old, new, lineterm="", n=2))[2:]
    kinds = {"+": "plus", "-": "minus"}
    shown = [
        f'<span class="{kinds.get(line[:1], "same")}">{escape(line) or " "}</span>'
        for line in lines[:MOST_DIFF]
        if not line.startswith("@@")
    ]
    more = f'<span class="same">… {len(lines) - MOST_DIFF} lines more</span>' if len(lines) > MOST_DIFF else ""
    return (
        '<section id="difference"><h2>What changes in the model</h2><p class="lead">The robot’s description stays as it is. '
        "Beside it, <code>model/effects.yaml</code> states what is added; the folder <code>model/</code> loads wherever the "
        f"description did.</p><pre>{''.join(shown)}{more}</pre></section>"
    )


def effects_text(model: Model) -> list[str]:
    """The effects of a model as lines of YAML, those that the description itself states left out."""
    entries = []
    for spec in model.spec.effects:
        entry: dict[str, object] = {"name": spec.name}
        if spec.joints:
            entry["joints"] = list(spec.joints)
        if spec.links:
            entry["links"] = list(spec.links)
        entry["parameters"] = {key: [float(f"{x:.6g}") for x in value] for key, value in spec.parameters.items()}
        for key in ("onset", "end"):
            if getattr(spec, key) is not None:
                entry[key] = float(getattr(spec, key))
        entries.append(entry)
    if not entries:
        return ["effects: []"]
    text = yaml.safe_dump({"effects": entries}, sort_keys=False, width=110, default_flow_style=None, allow_unicode=True)
    return text.splitlines()


def _next(subject: Subject) -> str:
    near = subject.verdict.separation
    rows = "".join(_near(pair) for pair in near[:8])
    pairs = (
        "<p>What the data could hardly tell apart, and what would. A distance below 4 is a toss-up, above 8 is clear.</p>"
        '<div class="scroll"><table><tr><th>named</th><th>could be</th><th class="n">distance</th><th>experiment</th></tr>'
        f"{rows}</table></div>"
        if near
        else ""
    )
    files = "".join(_experiment(experiment, name) for experiment, name in subject.experiments)
    if files:
        files = (
            "<p>Each experiment is a file that a controller can follow: <code>time</code> in seconds and "
            "<code>position_commanded.&lt;joint&gt;</code> in radians. The motions stay within the angles, speeds and "
            "accelerations of the runs above; the way between two poses may be new, so look before you run them.</p>"
            + files
        )
    if not pairs and not files:
        pairs = "<p>Nothing in particular: no other explanation comes near what was found.</p>"
    again = (
        "<p>After new runs, give them together with the old ones: "
        "<code>twin-diagram gap --model … --fit old.csv --fit new.csv --holdout another.csv --out …</code></p>"
    )
    return f'<section id="next"><h2>What to measure next</h2>{pairs}{files}{again}</section>'


def _near(pair: Separation) -> str:
    return (
        f"<tr><td>{escape(_say(pair.a))}</td><td>{escape(_say(pair.b))}</td>"
        f'<td class="n">{pair.distance:.1f}</td><td>{escape(pair.experiment)}</td></tr>'
    )


def _say(claim: str) -> str:
    """`coulomb_friction on joint_2` for people."""
    name, _, place = claim.partition(" on ")
    return f"{words.title(name)} on {place}" if place else words.title(name)


def _experiment(experiment: Experiment, name: str) -> str:
    seconds = float(experiment.time[-1])
    return (
        f'<div class="experiment"><div><h3>{escape(words.upper_first(experiment.title))}</h3>'
        f'<p class="why">{seconds:.0f} s · about {escape(words.listed(experiment.moved))} · '
        f'<a href="{escape(name)}"><code>{escape(name)}</code></a></p></div>'
        f"{charts.sparkline(experiment.time, experiment.position, experiment.joints, experiment.moved)}</div>"
    )


def _how(subject: Subject) -> str:
    runs = [(run, "fitted") for run in subject.shown.fit] + [(subject.shown.holdout, "held out")]
    rows = "".join(
        f"<tr><td><code>{escape(run.source)}</code></td><td>{kind}</td>"
        f'<td class="n">{run.time[-1] - run.time[0]:.1f} s</td><td class="n">{1.0 / np.median(np.diff(run.time)):.0f} Hz</td></tr>'
        for run, kind in runs
    )
    notes = "".join(f"<li>{escape(note)}</li>" for note in subject.notes)
    notes = f"<h3>Remarks on the runs</h3><ul>{notes}</ul>" if notes else ""
    terms = (
        ("residual torque", "what the motors gave less what the model says that the measured motion takes"),
        ("held out", "a run that was used for nothing but these figures, so that it cannot be fitted by accident"),
        ("noise", "what is left of the torque sensor’s own scatter below 10 Hz; a lower bound for every model"),
        ("probability", "from how well all effects of the catalogue, at all places, explain the same runs"),
        ("distance", "between two explanations, each at its best, in standard deviations of the noise"),
        (
            "motion predicted ahead",
            "the model started at the measured state and driven by the measured torque for 0.2 s",
        ),
    )
    glossary = "".join(f"<dt>{escape(a)}</dt><dd>{escape(b)}</dd>" for a, b in terms)
    return (
        '<section id="how"><h2>How this was worked out</h2><p class="lead">Motion and torque of each run are filtered alike, the '
        "given model’s torque is taken off, and what is left is explained with every effect of the catalogue on every joint "
        "and link where it can sit: alone and together. An effect is named where the evidence for it outweighs its freedom "
        "to fit noise, and kept where it shrinks the gap on the held-out run.</p>"
        f'<div class="scroll"><table><tr><th>run</th><th>used as</th><th class="n">length</th><th class="n">rate</th></tr>{rows}'
        f"</table></div>{notes}<details><summary>Words used here</summary><dl>{glossary}</dl></details></section>"
    )
