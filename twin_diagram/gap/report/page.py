"""The report: one HTML file that says what a model lacks, to people who have never seen this tool."""

from __future__ import annotations

from html import escape

import numpy as np

from twin_diagram.gap.report import numbers, words
from twin_diagram.gap.report.section_found import found, where
from twin_diagram.gap.report.section_gap import lost, pictures, sizes
from twin_diagram.gap.report.section_next import difference, onward
from twin_diagram.gap.report.style import STYLE
from twin_diagram.gap.report.subject import Subject
from twin_diagram.signals import units

LONG = 150
"""Letters from which on a headline is set smaller."""


def page(subject: Subject) -> str:
    """Return the whole file."""
    verdict = subject.verdict
    none = "no gap found" if verdict.recorded is None else "nothing new"
    badge = {"named": "effect found", "none": none, "unknown": "unknown effect"}[verdict.verdict]
    parts = [
        found(subject),
        where(subject),
        sizes(subject),
        pictures(subject),
        difference(subject),
        onward(subject),
        _how(subject),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(subject.title)}: {escape(subject.name)}</title><style>{STYLE}</style></head><body>"
        f'<header class="top"><div><p class="kicker"><span class="badge {verdict.verdict}">{badge}</span>'
        f"{escape(subject.title)} · model <b>{escape(subject.name)}</b> against {_runs_in_words(subject)}</p>"
        f"<h1{_size(words.headline(verdict))}</h1></div></header><main>{_tiles(subject)}"
        f"{''.join(parts)}<footer>Made by twin-diagram {escape(subject.version)} in {subject.seconds:.0f} s. "
        "This file needs no network. The same figures for programs are in gap.json beside it.</footer>"
        "</main></body></html>\n"
    )


def _size(headline: str) -> str:
    """Return a headline, smaller where it is long."""
    return f"{' class=long' if len(headline) > LONG else ''}>{escape(headline)}"


def _runs_in_words(subject: Subject) -> str:
    count = max(subject.files) + 1
    return f"{count} fitted run{'s' if count > 1 else ''} and one held out"


def _tiles(subject: Subject) -> str:
    shown, verdict = subject.shown, subject.verdict
    before, after = shown.holdout_rms()
    worst = int(np.argmax(before / shown.noise_floor))
    unit, what = shown.units(units.TORQUE)[worst], "force" if shown.joints[worst] in shown.prismatic else "torque"
    tiles = []
    if subject.changed:
        closed = words.percent(max(1.0 - shown.left_over(), 0.0))
        there = bool(np.any(shown.has_gap() | shown.worse()))
        tiles += [
            (closed, "of the gap above the noise is closed on the run that was held out")
            if there
            else (
                "no gap",
                "above the noise below 10 Hz on the run that was held out, with the given model or this one",
            ),
            (
                f"{numbers.number(before[worst])} → {numbers.number(after[worst])}|{unit}",
                f"residual {what} of {shown.joints[worst]}, held out; the noise is "
                f"{numbers.number(shown.noise_floor[worst])}",
            ),
        ]
    else:
        tiles.append(
            (
                f"{numbers.number(before[worst])}|{unit}",
                f"largest residual against its noise: {shown.joints[worst]}, held out; the noise is "
                f"{numbers.number(shown.noise_floor[worst])} {unit}",
            )
        )
    rolled = shown.holdout
    if rolled.rollout_before is not None and rolled.rollout_after is not None:
        # Angles and lengths have no common size.
        each, most = np.array(shown.units("mrad")), 1e3 * lost(subject)
        for kind in dict.fromkeys(each):
            own = each == kind
            a, b = (1e3 * float(np.linalg.norm(x[own])) for x in (rolled.rollout_before, rolled.rollout_after))
            far = float(np.max(most[own]))
            text = f"{_lost(a, far)} → {_lost(b, far)}|{kind}" if subject.changed else f"{_lost(a, far)}|{kind}"
            together = "all joints" if np.all(own) else words.listed([shown.joints[k] for k in np.flatnonzero(own)])
            together += " together" if np.sum(own) > 1 or np.all(own) else ""
            tiles.append((text, f"error of motions predicted 0.2 s ahead, {together}, held out"))
    if verdict.findings:
        least = min(finding.confidence for finding in verdict.findings)
        which = "the name is" if len(verdict.findings) == 1 else "the least certain name is"
        tiles.append((words.percent(least), f"probability that {which} right: {words.sureness(least)}"))
    return (
        '<div class="tiles">'
        + "".join(f'<div class="tile"><b>{_figure(a)}</b><span>{escape(b)}</span></div>' for a, b in tiles)
        + "</div>"
    )


def _lost(error: float, most: float) -> str:
    """Return an error; how far beyond `most` a model has lost the arm tells nothing."""
    return numbers.number(error) if error < most else f"> {numbers.number(most)}"


def _figure(text: str) -> str:
    """Return a number in large, its unit after a bar in small; where a tile is narrow, on a line of its own."""
    number, _, unit = text.partition("|")
    return f"<em>{escape(number)}</em>" + (f" <small>{escape(unit)}</small>" if unit else "")


def _how(subject: Subject) -> str:
    runs = [(run, "fitted") for run in subject.shown.fit] + [(subject.shown.holdout, "held out")]
    rows = "".join(
        f"<tr><td><code>{escape(run.source)}</code></td><td>{kind}</td>"
        f'<td class="n">{run.time[-1] - run.time[0]:.1f} s</td>'
        f'<td class="n">{1.0 / np.median(np.diff(run.time)):.0f} Hz</td></tr>'
        for run, kind in runs
    )
    notes = "".join(f"<li>{escape(note)}</li>" for note in subject.notes)
    notes = f"<h3>Remarks on the runs</h3><ul>{notes}</ul>" if notes else ""
    terms: tuple[tuple[str, str], ...] = (
        ("residual torque", "what the motors gave less what the model says that the measured motion takes"),
        ("held out", "a run that was used for nothing but these figures, so that it cannot be fitted by accident"),
        (
            "noise",
            "what is left of the torque sensor’s own scatter below 10 Hz, and no less than 0.05 % of the torque, which "
            "filters and sampling leave: a lower bound for every model",
        ),
        ("probability", "from how well all effects of the catalogue, at all places, explain the same runs"),
        ("distance", "between two explanations, each at its best, in standard deviations of the noise"),
        (
            "motion predicted ahead",
            "the model started at the measured state and driven by the measured torque for 0.2 s",
        ),
    )
    if subject.shown.prismatic:
        prismatic = words.listed([joint for joint in subject.shown.joints if joint in subject.shown.prismatic])
        terms = (*terms, ("torque and angle", f"of prismatic joints ({prismatic}): the force in N, the position in m"))
    glossary = "".join(f"<dt>{escape(a)}</dt><dd>{escape(b)}</dd>" for a, b in terms)
    return (
        '<section id="how"><h2>How this was worked out</h2><p class="lead">Motion and torque of each run are filtered '
        "alike, the given model’s torque is taken off, and what is left is explained with every effect of the "
        "catalogue on "
        "every joint and link where it can sit: alone and together. An effect is named where the evidence for it "
        "outweighs "
        "its freedom to fit noise, and kept where it shrinks the gap on the held-out run, or where that run cannot "
        "show it below 10 Hz.</p>"
        '<div class="scroll"><table><tr><th>run</th><th>used '
        'as</th><th class="n">length</th><th class="n">rate</th></tr>'
        f"{rows}</table></div>{notes}<details><summary>Words used here</summary><dl>{glossary}</dl></details></section>"
    )
