"""The whole workflow on files: reads logs, locates, names, adds, shows, and writes what it found.

from twin_diagram.gap.workflow import run_gap
gap = run_gap("ur5e.urdf", ["a.csv"], "c.csv", out="out/gap", say=print)
gap.verdict, gap.corrected, gap.answer      # what was found; a Model; the contents of gap.json
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from twin_diagram.errors import LogError, TwinError, expect_path
from twin_diagram.gap.correction.held_out_evidence import confirmed
from twin_diagram.gap.experiments import advice as texts
from twin_diagram.gap.experiments.trajectories import Experiment, design, visited
from twin_diagram.gap.findings import Verdict
from twin_diagram.gap.report import gap_json, page
from twin_diagram.gap.report.comparison import Shown, show, told_of_held_out
from twin_diagram.gap.report.subject import Subject, called
from twin_diagram.gap.residuals import torque_sense
from twin_diagram.gap.residuals.motors_off import without_brakes
from twin_diagram.gap.residuals.prepared_logs import TUNING as PREPARED_LOGS
from twin_diagram.gap.residuals.prepared_logs import moves, usable
from twin_diagram.gap.residuals.torque_rails import told_of_rails
from twin_diagram.gap.verdict.deciding import TUNING as DECIDING
from twin_diagram.gap.verdict.probabilities import less_sure
from twin_diagram.gap.whole_robot.contacts import placed
from twin_diagram.gap.whole_robot.few_or_whole import Explanation, explained, nameless, standing_after
from twin_diagram.gap.whole_robot.made_ready import made_ready
from twin_diagram.logs import Log, LogWarning, fingerprint, read_log, write_columns
from twin_diagram.logs.dejittering import dejittered
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.downsampling import downsampled
from twin_diagram.logs.parting import chosen, longest, parted
from twin_diagram.logs.spikes import unspiked
from twin_diagram.logs.torque_constants import TorqueConstants
from twin_diagram.model.description import corrected_folder
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import as_explained, load_model_for
from twin_diagram.runtime import written_files
from twin_diagram.runtime.output_place import why_not
from twin_diagram.runtime.stages import Stages
from twin_diagram.runtime.threads import one_thread
from twin_diagram.runtime.version import __version__
from twin_diagram.scenario import resources
from twin_diagram.signals.stretches import stretches

Say = Callable[[str], None]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    most_experiments: int = 4
    """Files that are written."""


TUNING = Tuning()

STAGES = MappingProxyType(
    {
        "reading the logs": 0.0,
        "fitting the whole robot": 0.003,
        "looking at the residual": 0.13,
        "searching for a name": 0.14,
        "searching again with the noise that is left": 0.32,
        "refining what was found": 0.6,
        "weighing its rivals": 0.62,
        "adding what was named": 0.85,
        "refining by torques": 0.85,
        "refining by simulated motion": 0.87,
        "refining by torques, all that is left counted alike": 0.89,
        "residual torque before and after": 0.9,
        "rollouts of the held-out run before and after": 0.905,
        "writing the report": 0.93,
    }
)
"""Share of a search that is done when each of its stages begins: measured on logs of a KR300, a Panda, an LWR4+ and a
small arm, which differ by a factor of two."""

FOR_THE_UNKNOWN = (texts.SPEEDS, texts.SLOW, texts.LONG)
"""Experiments that show most of an effect that has no name yet."""

PARTS = ("model", "candidate_model", "experiments", "gap.json", "report.html")
"""What is written; what else is in the folder, and in those folders, is left alone."""
FILES = "gap_files.txt"
"""Tells what was written; see `written_files`."""


@dataclass(frozen=True)
class Gap:
    """What was found.

    Attributes:
        verdict: names, places, near pairs.
        given: the given model.
        corrected: the corrected one; the same object where nothing is named.
        shown: the gap before and after.
        answer: the contents of gap.json.
        notes: what the reader of the logs should know.
        experiments: to run next, with the names of their files.
        seconds: that it took.
        candidate: where nothing is named: the best partial explanation, not established; None: there is none.
        standing: of the corrected model.
    """

    verdict: Verdict
    given: Model
    corrected: Model
    shown: Shown
    answer: dict[str, Any]
    notes: tuple[str, ...]
    experiments: tuple[tuple[Experiment, str], ...]
    seconds: float
    candidate: Model | None = None
    standing: corrected_folder.CorrectedStanding = field(default_factory=corrected_folder.CorrectedStanding)


@one_thread()
def run_gap(
    model: str | Path,
    fit: str | Path | Sequence[str | Path],
    holdout: str | Path,
    out: str | Path | None = None,
    say: Say | None = None,
    packages: Mapping[str, str | Path] | None = None,
    columns: str | Path | None = None,
    torque_side: str | None = None,
    constants: TorqueConstants | None = None,
    joints: Sequence[str] = (),
) -> Gap:
    """Find what a model lacks, add it, and show the gap shrink.

    Args:
        model: a URDF, SDF or MJCF file, or the folder of a corrected model.
        fit: measured logs to find it in, or a single one.
        holdout: a measured log that is used for nothing but the proof.
        out: folder for gap.json, model/, experiments/ and report.html; None: nothing is written.
        say: told what is done, and how long it takes.
        packages: local folders for `package://` names.
        columns: what foreign logs' columns mean, see `read_log`.
        torque_side: of the gears that torques were measured on: `motor`, or `link`, where no rotor shows;
            None: as the folder of a corrected model says, else `motor`.
        constants: of the motors, where the logs hold currents.
        joints: of one arm, in order, of a robot that has more; empty: all.

    Raises:
        TwinError: model, logs or folder cannot be used; nothing is written.
    """
    say, begin = Stages(STAGES, say or (lambda text: None)), time.perf_counter()
    if out is not None and (why := why_not(out, folder=True)):
        raise TwinError(f"--out {out}: {why}")
    say("reading the logs")
    given, logs, held, notes = _read(model, fit, holdout, packages, columns, torque_side, constants, joints)
    notes += torque_sense.checked(given, logs)
    logs, held, records, spans = made_ready(given, logs, held, notes)
    standing = corrected_folder.standing_of(resources.resolve(str(model), packages))
    if not standing.established:
        notes.append(f"{model}: is a partial explanation that was not established")
    found = explained(given, logs, held, records, notes, say, standing)
    found = replace(found, verdict=placed(found.verdict, given.joints, spans, fresh=not standing.remainder))
    verdict, corrected, shown = _proved(found, given, logs, held, notes, say)
    candidate = _partial(verdict, found, notes)
    gap = Gap(
        verdict=verdict,
        given=given,
        corrected=corrected,
        shown=shown,
        answer=gap_json.contents(verdict, shown),
        notes=tuple(notes),
        experiments=_experiments(given, verdict, shown, logs),
        seconds=time.perf_counter() - begin,
        candidate=candidate,
        standing=standing_after(standing, found, corrected, shown.fit_rms()[1]),
    )
    if out is not None:
        say("writing the report")
        write(gap, Path(out), called(resources.resolve(str(model), packages)))
    return gap


def _proved(
    found: Explanation, given: Model, logs: Sequence[Log], held: Log, notes: list[str], say: Say
) -> tuple[Verdict, Model, Shown]:
    """Return verdict, corrected model and what they do on the held-out run, with what that says; `notes` grow."""
    verdict, corrected = found.verdict, found.corrected
    shown = show(given, corrected, logs, held, verdict.noise_floor, say=say)
    agrees = partial(accepted, verdict, shown, partial(confirmed, given, corrected, held))
    if found.whole is None and corrected is not given and not agrees():
        notes.append("what was named did not shrink the gap on the held-out run on all joints, and was dropped")
        verdict, corrected, shown = nameless(verdict), given, shown.uncorrected()
    if verdict.verdict != "unknown":
        verdict = replace(verdict, unexplained=shown.unexplained())
    notes += told_of_held_out(shown, verdict.unexplained)
    if corrected is not given and not shown.is_exercised():
        notes.append(
            "the held-out run does nothing in which the two models differ, so it proves nothing: hold out a run that "
            "moves more like those that were fitted"
        )
        verdict = _less_sure(verdict)
    return verdict, corrected, shown


def _partial(verdict: Verdict, found: Explanation, notes: list[str]) -> Model | None:
    """Return the best partial explanation where nothing is named; `notes` grow by what is said of it."""
    if verdict.verdict != "unknown" or found.partial is None or not found.partial.closes() > 0.0:
        return None
    notes.append(
        f"candidate_model/ is the best partial explanation, and not established: of motion that its fit has not "
        f"seen it closes {found.partial.closes():.0%} of the residual torque"
    )
    return found.partial.model


def _less_sure(verdict: Verdict) -> Verdict:
    """Return the verdict with the confidence of findings that nothing confirms."""
    return replace(verdict, findings=tuple(less_sure(finding, DECIDING.less_sure) for finding in verdict.findings))


def accepted(verdict: Verdict, shown: Shown, confirmed: Callable[[], bool] = lambda: False) -> bool:
    """Return whether the held-out run agrees: its gap shrinks, and no joint's grows.

    What is over by then, or what it never exercises, cannot show there; what is too fast to show is looked for above.

    Args:
        verdict: with what was named.
        shown: the gap, below the residual's cutoff.
        confirmed: whether the run is likelier with the correction above it, too; asked where there is no gap below.
    """
    if all(finding.end is not None for finding in verdict.findings):
        return True
    if shown.worsens():
        return not shown.is_exercised()
    return shown.shrinks() or not shown.is_exercised() or (not np.any(shown.has_gap()) and confirmed())


def write(gap: Gap, out: Path, title: str) -> None:
    """Write everything, whole or not at all, for what was written there before; what else is in `out` stays."""
    try:
        with written_files.folder(out, FILES, _unlisted(out)) as aside:
            gap.corrected.save(aside / "model", gap.standing)
            if gap.candidate is not None:
                gap.candidate.save(aside / "candidate_model", corrected_folder.CorrectedStanding(established=False))
            for experiment, file in gap.experiments:
                write_columns(experiment.columns(), aside / file)
            (aside / "gap.json").write_text(gap_json.text(gap.answer), encoding="utf-8")
            (aside / "report.html").write_text(page.page(_subject(gap, title)), encoding="utf-8")
    except OSError as error:
        raise TwinError(f"{out.absolute()}: cannot be written: {error.strerror}") from error


def _subject(gap: Gap, title: str) -> Subject:
    return Subject(
        verdict=gap.verdict,
        shown=gap.shown,
        given=gap.given,
        corrected=gap.corrected,
        name=title,
        experiments=gap.experiments,
        notes=gap.notes,
        seconds=gap.seconds,
        version=__version__,
    )


def _unlisted(out: Path) -> list[str]:
    """Return what versions that left no list may have written: all in the folders that they called their own."""
    if not (out / "gap.json").is_file():
        return []
    return [path for path in written_files.files_of(out) if path.split("/")[0] in PARTS]


def _read(
    model: str | Path,
    fit: str | Path | Sequence[str | Path],
    holdout: str | Path,
    packages: Mapping[str, str | Path] | None,
    columns: str | Path | None = None,
    torque_side: str | None = None,
    constants: TorqueConstants | None = None,
    joints: Sequence[str] = (),
) -> tuple[Model, list[Log], Log, list[str]]:
    expect_path(model, "model", "a URDF, SDF or MJCF file, or of a corrected model's folder")
    fit = [fit] if isinstance(fit, (str, Path)) else fit
    if not fit:
        raise LogError("no log to fit: give at least one with --fit")
    resources.resolve(str(model), packages)  # what is not there is told before a log is read
    given, first, warnings = load_model_for(read_log(fit[0], columns), model, packages, torque_side, constants, joints)
    logs = _stretches(given, first, warnings)
    for path in fit[1:]:  # one at a time: each may be as large as all that is kept of them
        own, more = as_explained(given, read_log(path, columns), constants)
        warnings += more
        logs += _stretches(given, own, warnings)
    own, more = as_explained(given, read_log(holdout, columns), constants)
    warnings += more
    kept = longest(_stretches(given, own, warnings, PREPARED_LOGS.shortest_held, "; the longest is held out"))
    for log in logs:
        usable(log)
    usable(kept, PREPARED_LOGS.shortest_held)
    if not any(moves(log) for log in logs):
        raise LogError(
            f"{logs[0].source}: no joint moves beyond its encoder's noise: give a log in which the arm moves"
        )
    notes = [warning.message for warning in warnings] + told_of_weightless(given)
    if given.arm.link_side:
        notes.append(
            "torques were measured behind the gears: friction is what is left of it there, and rotors do not show"
        )
    if fingerprint(kept) in map(fingerprint, logs):
        notes.append(f"{kept.source}: is also a fitted run, so it proves nothing; hold out another one")
    return given, logs, kept, notes


def told_of_weightless(given: Model) -> list[str]:
    """Return what is said of links that a description leaves without mass, with all that is welded to them."""
    links = [link for link, inertia in zip(given.tree.link, given.tree.inertia, strict=True) if inertia[0] <= 0.0]
    if not links:
        return []
    return [
        f"{', '.join(links)}: described without any mass; where there is some, give an <inertial>: none is looked for "
        "there, and what is named near it may stand for it"
    ]


def _stretches(
    given: Model, log: Log, warnings: list[LogWarning], shortest: float = PREPARED_LOGS.shortest, more: str = ""
) -> list[Log]:
    """Return a log as it is fitted, in as many stretches as silence leaves; `warnings` grow where there is some.

    Args:
        given: the given model.
        log: checked.
        warnings: of all logs.
        shortest: that a stretch must have left after its ends are cut [s].
        more: what is done with them.
    """
    warnings += told_of_rails(log)
    log = _driven(given, log, warnings)
    parts = parted(dejittered(log), shortest + 2.0 * DIFFERENTIATION.residual_cut)
    if len(parts) > 1 or len(parts[0]) < len(log):
        spans = ", ".join(f"{part.time[0]:.3f} to {part.time[-1]:.3f} s" for part in parts)
        message = f"{log.source}: what lies between longer gaps is taken as logs of their own: {spans}{more}"
        warnings.append(LogWarning("parted", message))
    result = []
    for part in parts:  # beside a gap, what an arm does looks like a leap
        whole, garbled = unspiked(part)
        warnings += garbled
        result.append(downsampled(whole))
    return result


def _driven(given: Model, log: Log, warnings: list[LogWarning]) -> Log:
    """Return a log without what its brakes held while the motors were off; `warnings` grow where there is some."""
    kept = without_brakes(given, log)
    if np.all(kept) or not np.any(kept):
        return log
    spans = ", ".join(f"{log.time[a]:.3f} to {log.time[b - 1]:.3f} s" for a, b in stretches(~kept))
    message = f"{log.source}: the motors give nothing and the arm stands still, so brakes hold it: left out: {spans}"
    warnings.append(LogWarning("motors_off", message))
    return chosen(log, kept)


def _experiments(
    given: Model, verdict: Verdict, shown: Shown, logs: Sequence[Log]
) -> tuple[tuple[Experiment, str], ...]:
    """Return those that the near pairs ask for; where nothing has a name, those that show most of an unknown effect."""
    wanted = dict.fromkeys((near.experiment, _joints_in(near.a, given)) for near in verdict.separation)
    if verdict.verdict == "unknown" or verdict.remainder:
        before, _ = shown.holdout_rms()
        worst = tuple(given.joints[k] for k in np.argsort(-before / shown.noise_floor)[:2])
        wanted |= dict.fromkeys((text, worst) for text in FOR_THE_UNKNOWN)
    seen = visited(given, logs)
    result: list[tuple[Experiment, str]] = []
    for text, joints in wanted:
        experiment = design(text, seen, joints)
        if experiment is not None and len(result) < TUNING.most_experiments:
            result.append((experiment, f"experiments/{len(result) + 1}_{experiment.slug}.csv"))
    return tuple(result)


def _joints_in(claim: str, given: Model) -> tuple[str, ...]:
    places = claim.partition(" on ")[2].split(", ")
    return tuple(joint for joint in given.joints if joint in places)
