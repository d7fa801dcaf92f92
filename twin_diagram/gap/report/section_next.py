"""The report on what changes in the model, and what to measure next."""

from __future__ import annotations

import difflib
from html import escape

import yaml

from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.experiments.advice import asked
from twin_diagram.gap.experiments.trajectories import Experiment
from twin_diagram.gap.findings import Separation
from twin_diagram.gap.report import charts, words
from twin_diagram.gap.report.subject import Subject
from twin_diagram.model.model import Model

MOST_DIFF = 120
"""Lines of the model's difference that are shown."""


TOSS_UP = 4.0
"""Distance below which data do not tell two explanations apart."""

UNTOLD = 1.0
"""Distance below which the other explanation suits these runs as well: one deviation of their noise."""


def difference(subject: Subject) -> str:
    """Return the effects of both models, as a difference of two texts."""
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
        '<section id="difference"><h2>What changes in the model</h2><p class="lead">The robot’s description '
        "stays as it "
        "is. Beside it, <code>model/effects.yaml</code> states what is added; the folder <code>model/</code> "
        "loads wherever "
        f"the description did.</p><pre>{''.join(shown)}{more}</pre></section>"
    )


def effects_text(model: Model) -> list[str]:
    """Return the effects of a model as lines of YAML, those that the description itself states left out."""
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
        return ["effects:"]
    text = yaml.safe_dump({"effects": entries}, sort_keys=False, width=110, default_flow_style=None, allow_unicode=True)
    return text.splitlines()


def onward(subject: Subject) -> str:
    """Return near pairs, and the motions that would part them."""
    near = subject.verdict.separation
    given = subject.given
    rows = "".join(_near(pair, asked(pair, given.joints, given.prismatic)) for pair in near[:8])
    pairs = (
        "<p>What the data could hardly tell apart, and what would. A distance below 4 is a toss-up, above 8 is "
        "clear.</p>"
        '<div class="scroll"><table><tr><th>named</th><th>could '
        'be</th><th class="n">distance</th><th>experiment</th></tr>'
        f"{rows}</table></div>"
        if near
        else ""
    )
    files = "".join(_experiment(experiment, name) for experiment, name in subject.experiments)
    if files:
        files = (
            "<p>Each experiment is a file that a controller can follow: <code>time</code> in seconds and "
            f"<code>position_commanded.&lt;joint&gt;</code> in {_unit(given)}. The motions stay within the positions, "
            "speeds and accelerations of the runs above; the way between two poses may be new, so look before you run "
            "them.</p>" + files
        )
    if not pairs and not files:
        near_none = "no other explanation comes near what was found" if subject.verdict.findings else _nothing(subject)
        pairs = f"<p>Nothing in particular: {near_none}.</p>"
    again = (
        "<p>After new runs, give them together with the old ones: "
        "<code>twin-diagram gap --model … --fit old.csv --fit new.csv --holdout another.csv --out …</code></p>"
    )
    return f'<section id="next"><h2>What to measure next</h2>{pairs}{files}{again}</section>'


def _nothing(subject: Subject) -> str:
    if subject.verdict.verdict == "none":
        return "these runs ask for no effect that the model lacks; other motions or loads might"
    return "nothing has a name yet that an experiment could put to the test"


def _unit(model: Model) -> str:
    if not model.prismatic:
        return "radians"
    return "metres" if model.prismatic.issuperset(model.joints) else "radians, or metres where the joint is prismatic"


def _near(pair: Separation, experiment: str) -> str:
    (named, _, at), (other, _, there) = (claim.partition(" on ") for claim in (pair.a, pair.b))
    # The wider law is never worse; that it is not named says that what it has more was not worth its price.
    within = at == there and named in record_of(other).wider_than and pair.distance < TOSS_UP
    note = "holds the named law within it; what it has more is too small to show here; " if within else ""
    if pair.distance < UNTOLD and not within:
        note = "suits these runs as well: how usual each is decided, not the data; "
    return (
        f"<tr><td>{escape(_say(pair.a))}</td><td>{escape(_say(pair.b))}</td>"
        f'<td class="n">{pair.distance:.1f}</td><td>{escape(note + experiment)}</td></tr>'
    )


def _say(claim: str) -> str:
    """Return `coulomb_friction on joint_2` for people."""
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
