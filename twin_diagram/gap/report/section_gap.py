"""The report on how large the gap was and is: bars, a table, pictures by condition."""

from __future__ import annotations

from html import escape

import numpy as np

from twin_diagram.gap.findings import Finding
from twin_diagram.gap.report import charts, numbers, words
from twin_diagram.gap.report.comparison import Comparison, Shown, above_noise
from twin_diagram.gap.report.pictures import residual_pictures
from twin_diagram.gap.report.subject import Subject
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array

LOST = np.pi
"""How far beyond half a turn, or beyond all of a slide's travel, a model has lost a joint tells nothing [rad]."""

MOST_PICTURES = 4
"""Joints that get pictures."""


def sizes(subject: Subject) -> str:
    """Return the root mean squares per joint, before and after."""
    shown, changed = subject.shown, subject.changed
    before, after = shown.holdout_rms()
    fit_before, fit_after = shown.fit_rms()
    efforts = shown.units(units.TORQUE)
    blocks = [
        (
            f"Residual {effort(shown)}, run that was held out",
            charts.bars(shown.joints, before, after, shown.noise_floor, efforts, changed),
        ),
        (
            f"Residual {effort(shown)}, fitted run{'s' if max(subject.files) else ''}",
            charts.bars(shown.joints, fit_before, fit_after, shown.noise_floor, efforts, changed),
        ),
    ]
    rolled = shown.holdout
    if rolled.rollout_before is not None and rolled.rollout_after is not None:
        blocks.append(
            (
                "Error of motions predicted 0.2 s ahead, held out",
                charts.bars(
                    shown.joints,
                    1e3 * rolled.rollout_before,
                    1e3 * rolled.rollout_after,
                    None,
                    shown.units("mrad"),
                    changed,
                    1e3 * lost(subject),
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
    if subject.verdict.verdict == "none":
        head = "What is left is noise" if subject.verdict.recorded is None else "What is left, as it was before"
    return (
        f'<section id="gap"><h2>{head}</h2><p class="lead">Root mean square of measured less predicted '
        f"{effort(shown)}, below 10 Hz, joint by joint; each joint has its own scale. What counts is the run that was "
        "held out: nothing was fitted to it.</p>"
        f'<p class="legend">{legend}</p><div class="charts">{inside}</div></section>'
    )


def effort(shown: Shown) -> str:
    """Return what the motors give, in words."""
    turning = set(shown.joints) - shown.prismatic
    return "torque and force" if turning and shown.prismatic else "force" if shown.prismatic else "torque"


def lost(subject: Subject) -> Array:
    """Return (n,) errors beyond which a model has lost a joint, and more tells nothing [rad or m].

    A slide's is all of its travel, as the description has it, or else as the held-out
    run has.
    """
    shown, given = subject.shown, subject.given
    described, seen = given.upper - given.lower, np.ptp(shown.holdout.position, axis=0)
    travel = np.where(np.isfinite(described), described, seen)
    return np.where([joint in shown.prismatic for joint in shown.joints], travel, LOST)


def _table(shown: Shown, before: Array, after: Array, changed: bool) -> str:
    gone = above_noise(after, shown.noise_floor) / np.maximum(above_noise(before, shown.noise_floor), 1e-300)
    there, efforts = shown.has_gap(), shown.units(units.TORQUE)
    rows = []
    for k, joint in enumerate(shown.joints):
        cells = [numbers.number(before[k])]
        if changed:
            cells.append(numbers.number(after[k]))
        cells.append(numbers.number(shown.noise_floor[k]))
        if changed:
            # A joint whose residual was noise from the begin has no gap of which a share could be left.
            cells.append("no gap" if not there[k] else words.percent(float(gone[k])))
        if len(set(efforts)) > 1:
            cells.append(efforts[k])
        rows.append(f"<tr><td>{escape(joint)}</td>" + "".join(f'<td class="n">{cell}</td>' for cell in cells) + "</tr>")
    mixed = len(set(efforts)) > 1
    given = "given" if mixed else f"given [{efforts[0]}]"
    heads = [given, "corrected", "noise", "gap left"] if changed else [given, "noise"]
    heads += ["unit"] if mixed else []
    return (
        "<table><tr><th>joint</th>"
        + "".join(f'<th class="n">{head}</th>' for head in heads)
        + f"</tr>{''.join(rows)}</table>"
    )


def pictured(subject: Subject) -> list[int]:
    """Return the columns of the joints that are worth pictures, most telling first."""
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


def pictures(subject: Subject) -> str:
    """Return the residual over time, speed, angle and acceleration, for the joints that have something to show."""
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
        '<p class="lead">Each dot is one moment. A model that explains the run leaves a flat cloud about zero that is '
        "as wide as the noise (grey). A shape in the cloud, or in the line through its middle, is the signature "
        "of what "
        f"is missing.{also}</p>"
        f"{''.join(figures)}</section>"
    )


def _figure(subject: Subject, run: Comparison, j: int, finding: Finding | None) -> str:
    onset, end = (None, None) if finding is None else (finding.onset, finding.end)
    prismatic = run.joints[j] in subject.shown.prismatic
    picture = residual_pictures(run, j, float(subject.shown.noise_floor[j]), subject.changed, onset, end, prismatic)
    which = "held-out run" if run.held_out else "fitted run"
    return f"<figure><figcaption>{escape(run.joints[j])} <span>· {which}</span></figcaption>{picture}</figure>"
