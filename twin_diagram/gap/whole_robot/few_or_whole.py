"""What explains fit logs: a few names, the robot as a whole, or what is known of a model that was corrected before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.gap.correction.add_effects import add
from twin_diagram.gap.correction.held_out_onsets import with_held_onsets
from twin_diagram.gap.findings import Verdict
from twin_diagram.gap.naming import name
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.stiction import one_way, unmoved
from twin_diagram.gap.whole_robot import found_before, taking_over
from twin_diagram.gap.whole_robot.coarse_torque import in_coarse_steps
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.explain import explain
from twin_diagram.gap.whole_robot.late_torque import behind, one_late
from twin_diagram.gap.whole_robot.lost_dips import without_lost_dips
from twin_diagram.gap.whole_robot.placeholders import as_of_the_description, placeholders
from twin_diagram.gap.whole_robot.well_told import well_told
from twin_diagram.logs import Log
from twin_diagram.model.description import corrected_folder
from twin_diagram.model.effects.actuation import TorqueBias
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

Say = Callable[[str], None]

COARSE = (
    "most joints' torques are logged in steps as large as a good part of what they do, so only what makes left-out "
    "motion likelier has a name: log torques more finely"
)
"""What is said of a log whose torques are rounded to a few values."""

ONE_WAY = {CoulombFriction.name, StribeckFriction.name, TorqueBias.name}
"""Names that are one number on a joint that turns one way only."""


@dataclass(frozen=True)
class Explanation:
    """Verdict and corrected model.

    Attributes:
        verdict: of the search, or of the robot as a whole.
        corrected: the given model where nothing is named.
        whole: where it is of the robot as a whole: what was found of it.
        partial: what was found of the robot as a whole at all.
    """

    verdict: Verdict
    corrected: Model
    whole: WholeRobot | None
    partial: WholeRobot | None


def explained(
    given: Model,
    logs: Sequence[Log],
    held: Log,
    records: Records,
    notes: list[str],
    say: Say,
    standing: corrected_folder.CorrectedStanding,
) -> Explanation:
    """Return what is found, and say of joints that no run moves that nothing tells what holds them; `notes` grow.

    Arguments as of `looked_for`.
    """
    found = looked_for(given, logs, held, records, notes, say, standing)
    notes += told_of_one_way(found.verdict, records)
    still = unmoved(records)
    if not np.any(still) or found.verdict.recorded is not None:
        return found
    joints = ", ".join(joint for joint, one in zip(given.joints, still, strict=True) if one)
    notes.append(f"{joints}: never moves in the fitted runs, so friction may hold any torque there: nothing is named")
    left = np.exp(taking_over.size_of(found.corrected, logs))
    verdict = found.verdict
    if np.any((left > taking_over.TUNING.above * verdict.noise_floor)[still]):
        verdict = replace(verdict, remainder=True) if verdict.findings else nameless(verdict)
    return replace(found, verdict=verdict)


def looked_for(
    given: Model,
    logs: Sequence[Log],
    held: Log,
    records: Records,
    notes: list[str],
    say: Say,
    standing: corrected_folder.CorrectedStanding,
) -> Explanation:
    """Return what is found of the robot as a whole, or by the search for a few names; `notes` grow."""
    say("fitting the whole robot")
    spread = found_before.told_of(standing, given)
    try:
        whole = whole_robot(records, logs, known=bool(standing.remainder), told=found_before.prior_of(spread))
    except np.linalg.LinAlgError:  # a log in which next to nothing moves
        whole = None
    recorded = np.array([standing.remainder.get(joint, 0.0) for joint in given.joints])
    known = bool(np.all(recorded > 0.0))
    bare = taking_over.unsearched(records)
    enough = None
    if known:
        beyond, expected = found_before.beyond_expected(records, recorded, spread)
        if taking_over.no_news(given, logs, whole, beyond, expected):
            notes.append("what is left is what was left when this model was corrected")
            return Explanation(replace(bare, verdict="none", recorded=recorded), given, None, whole)
        enough = taking_over.tells_of_change(whole, given, logs, beyond)
    coarse = in_coarse_steps(logs)  # which a search for a few names takes for effects
    if coarse:
        notes.append(COARSE)
    suffices = coarse or (whole is not None and taking_over.suffices(whole, bare.noise_floor))
    if whole is not None and (suffices if enough is None else enough):
        notes += told_of_whole(whole, logs, bare.noise_floor)
        left = recorded if known else None
        return Explanation(taking_over.as_named(records, bare, whole, left), whole.model, whole, whole)
    try:
        named = name(given, logs, say, records)
    except np.linalg.LinAlgError:  # more that could explain the runs than samples to tell it by
        notes.append(why_none_alone(logs))
        named = bare
    if coarse and named.findings:
        named = nameless(named)
    verdict, corrected, more = _corrected(given, logs, held, named, records, say)
    plain = without_lost_dips(verdict, given.joints)
    if plain is not verdict:
        verdict, corrected, more = _corrected(given, logs, held, plain, records, say)
    told = well_told(verdict.findings)
    if told != verdict.findings:
        more.append("some of what would fit these runs is known no better than to a third of its size: it has no name")
        fewer = replace(verdict, findings=told, remainder=True) if told else nameless(verdict)
        if not told and whole is None and taking_over.is_noise(given, logs, verdict.noise_floor):
            fewer = replace(fewer, verdict="none")
        verdict, corrected, _ = _corrected(given, logs, held, fewer, records, say)
    over = taking_over.taken_over(records, logs, verdict, corrected, whole, bare.noise_floor)
    answer = Explanation(*over, whole)
    # Of a search that is not the answer nothing is said.
    notes += more if answer.whole is None else told_of_whole(answer.whole, logs, verdict.noise_floor)
    return answer


def why_none_alone(logs: Sequence[Log]) -> str:
    """Return why single effects cannot be told apart in some logs."""
    still = np.all([np.ptp(log.motor_torque, axis=0) == 0.0 for log in logs], axis=0)
    if np.any(still):
        joints = ", ".join(joint for joint, one in zip(logs[0].joints, still, strict=True) if one)
        return (
            f"the torque of {joints} never changes, whatever moves, so single effects cannot be told apart: log it; "
            "the robot was fitted as a whole"
        )
    return (
        "these runs are too short, or move too little, to tell single effects apart: ten seconds in which each joint "
        "moves to and fro do; the robot was fitted as a whole"
    )


def told_of_whole(whole: WholeRobot, logs: Sequence[Log], floor: Array) -> list[str]:
    """Return what is said of a robot as a whole beside its names; `floor` (n,) is that of noise [N·m]."""
    return (
        told_of_held(whole, logs)
        + told_of_lag(whole)
        + told_of_one_late(whole)
        + taking_over.told_of_rests(whole, logs, floor)
    )


def told_of_held(whole: WholeRobot, logs: Sequence[Log]) -> list[str]:
    """Return what is said of loads that are held for a part of the fitted runs, a line per load."""
    result, told = [], [candidate for candidate in whole.problem.sums.further if candidate.spans]
    for load in told:
        spans = []
        for onset, end in sorted(load.spans, key=lambda span: span[0] or (-1, 0.0)):
            log = (onset or end or (0, 0.0))[0]
            begin = "the begin" if onset is None else f"{onset[1]:.2f}"
            until = "to the end" if end is None else f"to {end[1]:.2f} s"
            spans.append(f"{begin} {until}" + (f" of {logs[log].source}" if len(logs) > 1 else ""))
        later = "it is taken to be there in later runs" if load.end is None else "it is taken to be gone in other runs"
        result.append(f"a load is held for a part of the fitted runs only: {', '.join(spans)}; {later}")
    return result


def told_of_one_way(verdict: Verdict, records: Records) -> list[str]:
    """Return what is said of named joints that slide one way only, where friction's level is no number of its own."""
    joints = [joint for joint, one in zip(records.model.joints, one_way(records), strict=True) if one]
    named = {joint for one in verdict.findings if one.name in ONE_WAY for joint in one.joints}
    if not named.intersection(joints):
        return []
    return [
        f"{', '.join(joint for joint in joints if joint in named)}: turns one way only in the fitted runs, where dry "
        "friction and an offset are one number: what is named as either may be the other, so fit a run in which it "
        "turns both ways"
    ]


def told_of_lag(whole: WholeRobot) -> list[str]:
    """Return what is said where all logged torques come after the motion that they belong to."""
    late = behind(whole.problem, whole.coordinates)
    if not late:
        return []
    return [
        f"the logged torques seem to come some {1e3 * late:.0f} ms after the motion that they belong to (a filter in "
        "the drives, or stamps of another clock): log them unfiltered, or shift them; names may stand for a part of it"
    ]


def told_of_one_late(whole: WholeRobot) -> list[str]:
    """Return what is said where the torque of one joint alone acts late, beside what was found."""
    late = one_late(whole.problem, whole.coordinates)
    if late is None:
        return []
    joint = whole.problem.sums.records.model.joints[late[0]]
    return [
        f"the logged torque of {joint} alone seems to act some {1e3 * late[1]:.0f} ms late, which the catalogue has no "
        f"name for: what is named on {joint} may stand for it"
    ]


def whole_robot(records: Records, logs: Sequence[Log], *, known: bool, told: Array | None = None) -> WholeRobot | None:
    """Return what is found of the robot as a whole, beginning without friction that is stated and not there.

    Args:
        records: prepared with the given model.
        logs: they were prepared of.
        known: see `explain`.
        told: see there.
    """
    too_much = None if known else placeholders(records, logs)
    if too_much is None:
        return explain(records, known=known, told=told)
    found = explain(too_much.records)
    stated = None if found is None else as_of_the_description(found, records, too_much.stated)
    return stated or explain(records)  # an arm that lacks nothing else has what is stated too much, all the same


def standing_after(
    before: corrected_folder.CorrectedStanding, explanation: Explanation, corrected: Model, left: Array
) -> corrected_folder.CorrectedStanding:
    """Return how the corrected model stands: with the remainder that a later run may find again.

    Args:
        before: of the given model.
        explanation: what was found.
        corrected: what is written of it.
        left: (n,) residual of the corrected model on the fit logs [N·m].
    """
    verdict, whole = explanation.verdict, explanation.whole
    if corrected is not explanation.corrected or verdict.verdict != "named":
        return before
    links = before.links
    if whole is not None:
        left = np.maximum(left, np.maximum(whole.fitted, whole.left))
        links = found_before.factor_of(whole)
    elif not verdict.remainder:
        return before
    remainder = dict(zip(corrected.joints, map(float, left), strict=True))
    return replace(before, established=True, remainder=remainder, links=links)


def _corrected(
    given: Model, logs: Sequence[Log], held: Log, verdict: Verdict, records: Records, say: Say
) -> tuple[Verdict, Model, list[str]]:
    """Return the verdict with refined parameters, the corrected model (the given one where none can be), and notes."""
    if not verdict.findings:
        return verdict, given, []
    say("adding what was named")
    notes: list[str] = []
    try:
        added = add(given, logs, verdict.findings, say, records)
        notes += added.notes
        # What cannot be added was no explanation.
        verdict = nameless(verdict) if added.model is given else replace(verdict, findings=added.findings)
        corrected, more = with_held_onsets(added.model, held, verdict.noise_floor)
    except ModelError as error:
        notes.append(f"what fits the runs best is not physical, so nothing is named: {error}")
        return nameless(verdict), given, notes
    return verdict, corrected, notes + more


def nameless(verdict: Verdict) -> Verdict:
    """Return the verdict without names."""
    return replace(verdict, verdict="unknown", remainder=False, findings=(), separation=())
