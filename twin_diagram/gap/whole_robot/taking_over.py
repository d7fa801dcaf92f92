"""Whether what a whole robot lacks at once is the better answer than the few effects that a search has named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Place, Verdict
from twin_diagram.gap.residuals import whitening
from twin_diagram.gap.residuals.log_noise import roughness
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.verdict.locating import locate
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.held_by_friction import told_by_rests
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual_rms
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    better: float = 0.1
    """Fall of the residual's logarithm, mean over joints, beyond what the search has named."""

    much: float = 0.35
    """The same where it has named nothing: a law that no one knows bends a little to links and frictions, too."""

    above: float = 1.5
    """Noise floors above which what is left counts as a remainder."""

    many: float = 1.5
    """Links and joints named, over the number of joints, from which on a robot lacks many things at once."""

    most: float = 2.0
    """The same where what is left is noise, which a search for a few names would reach, too."""

    unexplained: float = 0.2
    """Share of a joint's residual that is left where it is not explained."""

    aloof: float = 3.0
    """Times what is usually left by which a joint stands out."""

    incoherent: float = 0.25
    """Share of a joint's samples that are independent from which on what is left is noise: beside all that was in nine
    logs it was 0.28 to 0.5, of drifts, drag and cables that no law has 0.05 to 0.07."""

    same: float = 1.1
    """Times what is expected of a corrected model that it may leave of a log and still be the same."""

    noise: float = 1.25
    """Times the noise floor up to which a residual is no gap: noise itself differs from run to run."""

    known: float = 1.7
    """The same of one joint where nothing much better is seen: friction's laws are rough. Of 42 logs of other motion of
    14 arms that had not changed (`gap_whole_robots.py`, training seeds from 101) one was above, at 2.3."""


TUNING = Tuning()


def taken_over(
    records: Records, logs: Sequence[Log], verdict: Verdict, corrected: Model, whole: WholeRobot | None, floor: Array
) -> tuple[Verdict, Model, WholeRobot | None]:
    """Return verdict and corrected model, of the whole robot where that is the better answer, and what was found of it.

    It is asked only where a search has left structure: a robot that lacks a few things is explained by their names.

    Args:
        records: prepared with the given model.
        logs: of the fit, as the given model explains them.
        verdict: of the search.
        corrected: the given model with what the search has named.
        whole: what was found of the robot as a whole.
        floor: (n,) noise that the torques themselves show [N·m].
    """
    if verdict.verdict == "none" or (verdict.verdict == "named" and not verdict.remainder):
        return verdict, corrected, None
    if whole is None or not outdoes(whole, logs, corrected, named=bool(verdict.findings), floor=floor):
        return verdict, corrected, None
    return as_named(records, verdict, whole), whole.model, whole


def as_named(records: Records, verdict: Verdict, whole: WholeRobot, recorded: Array | None = None) -> Verdict:
    """Return the verdict that names what was found of the robot as a whole.

    Args:
        records: of the fit.
        verdict: whose noise floor holds.
        whole: what was found.
        recorded: (n,) what the given model is known to leave anyway [N·m]; None: nothing is known of it.
    """
    floor = verdict.noise_floor if recorded is None else np.maximum(verdict.noise_floor, recorded)
    remainder = bool(np.any(whole.fitted > TUNING.above * floor))
    where = verdict.where or places(records, whole)
    named = replace(verdict, verdict="named", remainder=remainder, findings=whole.findings, recorded=recorded)
    return replace(named, separation=whole.separation, where=where)


def told_of_rests(whole: WholeRobot, logs: Sequence[Log], floor: Array) -> list[str]:
    """Return what is said of joints that leave more than noise only while dry friction may hold them.

    Args:
        whole: what was found.
        logs: of the fit.
        floor: (n,) of noise [N·m].
    """
    sums, most = whole.problem.sums, TUNING.above * floor
    left = replace(sums, weights=np.ones_like(sums.weights)).left(whole.problem.difference(whole.coordinates))
    at_rest = (np.sqrt(np.mean(left**2, axis=0)) > most) & (whole.fitted <= most)
    if not np.any(at_rest) or not np.any(shown := at_rest & (np.exp(size_of(whole.model, logs)) > most)):
        return []
    joints = ", ".join(sums.records.model.joints[k] for k in np.flatnonzero(shown))
    return [f"{joints}: more than noise is left only at rest or turning back, where dry friction may hold it"]


def places(records: Records, whole: WholeRobot) -> tuple[Place, ...]:
    """Return where the given model's residual is, noise being what the robot as a whole leaves."""
    terms = Terms(records, given_load(records), slow_speed(records))
    explained = records.reduce(
        lambda r: whole.model.for_run(r.mark).inverse_dynamics(r.q, r.v, r.a, time=r.time) - r.given
    )
    return locate(records, terms, whitening.estimate(records.residual - explained, records.lengths))


def suffices(whole: WholeRobot, noise: Array) -> bool:
    """Return whether nothing need be searched for beside what was found of the robot as a whole.

    That is where it lacks many things at once and no joint stands out by what is left, but for what dry friction may
    hold: no name tells that.

    Args:
        whole: what was found.
        noise: (n,) floor [N·m].
    """
    n = len(whole.left)
    poor = whole.left > TUNING.unexplained * whole.before
    above = whole.left / noise  # a large joint's noise is large, too
    aloof = poor & (whole.left > TUNING.aloof * np.median(whole.left)) & (above > TUNING.aloof * np.median(above))
    if np.any(aloof):
        aloof &= ~told_by_rests(whole.problem)
    rough = 2 * np.sum(whole.left > TUNING.above * noise) >= n
    many = whole.terms() >= (TUNING.many if rough or 2 * whole.links() >= n else TUNING.most) * n
    return bool(many and not np.any(aloof))


def tells_of_change(whole: WholeRobot | None, given: Model, logs: Sequence[Log], beyond: Array) -> bool:
    """Return whether what was found beyond a model that was corrected before tells much of what is left.

    That is of all joints together, or of those that leave more than is expected: one may have changed alone.

    Args:
        whole: what was found.
        given: the corrected model.
        logs: of the fit.
        beyond: (n,) times the expected that it leaves, see `beyond_expected`.
    """
    if whole is None:
        return False
    each, news = gained_each(whole, logs, given), beyond > TUNING.known
    return bool(np.mean(each) > TUNING.much or (np.any(news) and np.mean(each[news]) > TUNING.much))


def no_news(given: Model, logs: Sequence[Log], whole: WholeRobot | None, beyond: Array, expected: Array) -> bool:
    """Return whether a corrected model leaves no more than can be expected of it, and nothing much better is seen.

    Args:
        given: the corrected model.
        logs: of the fit.
        whole: what was found beyond it.
        beyond: (n,) times the expected that it leaves, see `beyond_expected`.
        expected: (n,) times what was recorded that is expected of the logs' motion.
    """
    if np.all(beyond <= TUNING.same):
        return True
    if np.any(beyond > TUNING.known):
        return False
    return whole is None or gained(whole, logs, given) - float(np.mean(np.log(expected))) < TUNING.much


def is_noise(given: Model, logs: Sequence[Log], floor: Array) -> bool:
    """Return whether the given model leaves no more of the fit logs than noise (n,) does [N·m]."""
    return bool(np.all(np.exp(size_of(given, logs)) <= TUNING.noise * floor))


def unsearched(records: Records) -> Verdict:
    """Return the verdict where nothing could be searched for: unknown, with the noise that torques themselves show."""
    below = [
        roughness(record.torque, 1.0 / record.rate)
        * np.sqrt(min(1.0, 2.0 * DIFFERENTIATION.residual_cutoff / record.rate))
        for record in records.records
    ]
    return Verdict("unknown", False, (), (), (), np.maximum(np.max(below, axis=0), 1e-9))


def outdoes(whole: WholeRobot, logs: Sequence[Log], corrected: Model, *, named: bool, floor: Array) -> bool:
    """Return whether what was found of the robot as a whole leaves clearly less on motion that it has not seen.

    Few things are held to more than many: they must leave nothing but noise, or they may be pieces of what no law
    describes.

    Args:
        whole: what was found of the robot as a whole.
        logs: of the fit.
        corrected: its rival, which has seen all motion.
        named: whether the rival names anything.
        floor: (n,) noise that the torques themselves show [N·m].
    """
    n = len(whole.left)
    few = whole.terms() < n or 2 * whole.places() < n
    noise = (whole.left <= TUNING.above * floor) | (whole.problem.share > TUNING.incoherent)
    if few and not np.all(noise):
        return False
    return gained(whole, logs, corrected) > (TUNING.better if named else TUNING.much)


def gained(whole: WholeRobot, logs: Sequence[Log], rival: Model) -> float:
    """Return the mean over joints of what is `gained_each`."""
    return float(np.mean(gained_each(whole, logs, rival)))


def gained_each(whole: WholeRobot, logs: Sequence[Log], rival: Model) -> Array:
    """Return (n,) fall of the residual's logarithm on motion that no fit of the robot as a whole has seen."""
    unseen = np.log(np.maximum(whole.left, 1e-12) / np.maximum(whole.fitted, 1e-12))
    return np.asarray(size_of(rival, logs) - size_of(whole.model, logs) - unseen)


def size_of(model: Model, logs: Sequence[Log]) -> Array:
    """Return (n,) logarithm of what a model leaves of some logs."""
    squares = np.mean([torque_residual_rms(model, log) ** 2 for log in logs], axis=0)
    return np.asarray(0.5 * np.log(np.maximum(squares, 1e-24)))
