"""Runs scenarios and recordings, and writes what they leave behind."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, System

from twin_diagram import visualization
from twin_diagram.estimation.filter.parameter_status import standings
from twin_diagram.runs.brake_watch import BrakeWatch
from twin_diagram.runs.camera_score import camera_told
from twin_diagram.runs.goal_watch import GoalWatch, explained
from twin_diagram.runs.growth_watch import GrowthWatch
from twin_diagram.runs.health_watch import HealthWatch
from twin_diagram.runs.helping_processes import helping_processes
from twin_diagram.runs.object_watch import ObjectWatch
from twin_diagram.runs.outputs import Keeping, Looking, Mending, Say
from twin_diagram.runs.places import places_for
from twin_diagram.runs.preview_watch import PreviewWatch
from twin_diagram.runs.replayed import replay_scenario
from twin_diagram.runs.run_folder import RunFolder
from twin_diagram.runs.score import alarms, summarize, table
from twin_diagram.runs.search_watch import SearchWatch
from twin_diagram.runs.task_score import TaskScore
from twin_diagram.runs.trial import TUNING as TRIAL
from twin_diagram.runs.trial import Trial, run_trial
from twin_diagram.runtime import stopping
from twin_diagram.runtime.progress import Progress
from twin_diagram.runtime.threads import one_thread
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import check_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.twin import TwinDiagram


@contextmanager
def _one_image_thread() -> Iterator[None]:
    """Hold OpenCV: images are small, a second thread costs more than it gives, and p90 suffers."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


@one_thread()
@_one_image_thread()
def run_scenario(
    scenario: Scenario,
    *,
    out: str | Path | None = None,
    record: str | Path | None = None,
    log: str | Path | None = None,
    show: bool = False,
    meldis: bool = False,
    pictures: bool = True,
    quiet: bool = False,
    spare_cores: bool = True,
    say: Say = print,
    **own: Any,
) -> dict[str, Any]:
    """Run a scenario's station and the twin in closed loop.

    Args:
        scenario: with any station; only a simulated one can be scored.
        out: folder for ``summary.json``, ``events.jsonl``, what was healed and grown, pictures (docs/quick_start.md).
        record: folder for a recording that `replay_log` runs again.
        log: the measured log, .csv or .npz.
        show: opens meshcat and runs no faster than real time.
        meldis: publishes both scenes for Meldis and runs no faster than real time.
        pictures: whether `out` gets more than the summary.
        quiet: shows no progress.
        spare_cores: whether processes of its own may work on other cores; the figures are the same.
        say: takes lines of text.
        own: `station`, `controller`, `perception`: Systems of one's own, and `segmenter`: see `make_closed_loop`.

    Returns:
        The summary; for a station without truth, what the twin believes at the end.

    Raises:
        TwinError: something that it names is not there or does not fit.
        KeyboardInterrupt: once all files are closed; the summary says ``stopped``, and there are no pictures.
    """
    check_scenario(scenario)
    out, record, log = places_for(out, record, log)
    leave = RunFolder(out)
    look = _looking(scenario, out is not None and pictures, show, meldis)
    with ExitStack() as stack:
        stack.push(partial(_note_stop, leave))
        keep, mend = Keeping(scenario, record, log, stack), Mending(scenario, leave, say)
        loop = make_closed_loop(scenario, _hanging(keep, mend, look), **own)
        simulator, growth = _simulator(loop), GrowthWatch(scenario, loop.twin, leave, say)
        if look is not None:
            look.start(simulator, show or meldis, say)
        simulator.Initialize()
        leave.clear()
        stack.enter_context(helping_processes(loop, spare_cores))
        healer = stack.enter_context(mend.healer(loop.twin))
        with growth:
            stop, trial, summary = _simulate(loop, simulator, quiet, healer.poll, growth, leave, say)
        if stop is not None:
            keep.cut(simulator.get_context().get_time())
    if out is not None:
        _write(leave, out, loop, summary, trial, look if pictures and stop is None else None, say)
    if stop is not None:
        raise stop
    return summary


def _looking(scenario: Scenario, page: bool, show: bool, meldis: bool) -> Looking | None:
    """Return what is looked through; a page keeps the frames of the run."""
    wanted = show or page or meldis
    return Looking(show or page, meldis, scenario.duration if page else None) if wanted else None


def _simulator(loop: ClosedLoop) -> Simulator:
    """Return what runs a loop; on a real bus no faster than the clock on the wall."""
    simulator, scenario = Simulator(loop.diagram), loop.scenario
    if scenario.station == "lcm" and scenario.lcm.url.partition("://")[0] not in ("memq", "file"):
        simulator.set_target_realtime_rate(1.0)
    return simulator


def _hanging(*hung: Keeping | Mending | Looking | None) -> Callable[[DiagramBuilder, System, TwinDiagram], None]:
    """Return what hangs all of these on a loop that is being built."""

    def add(builder: DiagramBuilder, station: System, twin: TwinDiagram) -> None:
        for each in hung:
            if each is not None:
                each.add(builder, station, twin)

    return add


def _note_stop(leave: RunFolder, kind: type[BaseException] | None, *error: object) -> None:
    if kind is not None and issubclass(kind, KeyboardInterrupt):
        leave.stopped_early()


def _simulate(
    loop: ClosedLoop,
    simulator: Simulator,
    quiet: bool,
    between: Callable[[Context], None],
    growth: GrowthWatch,
    leave: RunFolder,
    say: Say,
) -> tuple[KeyboardInterrupt | None, Trial | None, dict[str, Any]]:
    """Run to the end and say how it went; only a run of the simulated station can be scored, and is a trial.

    Returns:
        What ended it before its time, the trial, the summary.
    """
    duration, health = loop.scenario.duration, HealthWatch(loop.twin, say)
    progress = Progress(duration, quiet)
    searches, goals = SearchWatch(loop.twin, leave.event), GoalWatch(loop.twin, leave.event)
    objects, brakes = ObjectWatch(loop.twin, leave.event, goals.why), BrakeWatch(loop.twin, leave.event)
    previews = PreviewWatch(loop.twin)
    score = TaskScore(loop) if loop.twin.runner is not None and loop.scenario.station == "sim" else None

    def each(context: Context) -> None:
        between(context)
        growth.poll(context)
        health.poll(context)
        goals.poll(context)
        objects.poll(context)
        brakes.poll(context)
        previews.poll(context)
        searches.poll(context)
        if score is not None:
            score.poll(context)

    def told(so_far: dict[str, Any]) -> dict[str, Any]:
        context = simulator.get_context()
        lacks = health.told(context) + searches.told() + goals.health()
        besides = {"things": objects.told(context), "health": lacks} | brakes.told(context) | growth.told()
        task = objects.task_told(context)
        if score is not None:
            task["task"] |= score.told(context)
        goal = explained(so_far, goals.why(context.get_time()))
        return so_far | camera_told(loop, context) | besides | previews.told() | task | goal

    if loop.scenario.station == "sim":
        trial = run_trial(loop, simulator, duration, progress, each)
        summary = told(summary_of(loop, trial, trial.timing())) | _stopped(trial.stop)
        progress.done()
        say(table(summary))
        return trial.stop, trial, summary
    stop = _advance(simulator, duration, progress, each)
    summary = told(beliefs(loop, simulator.get_context())) | _stopped(stop)
    progress.done()
    say(json.dumps(summary, indent=2))
    return stop, None, summary


def _stopped(stop: KeyboardInterrupt | None) -> dict[str, Any]:
    return {} if stop is None else {"stopped": True}


@one_thread()
def replay_log(
    log: str | Path,
    *,
    model: str | None = None,
    overrides: Iterable[str] = (),
    columns: str | Path | None = None,
    joints: Sequence[str] = (),
    constants: Sequence[str] = (),
    out: str | Path | None = None,
    show: bool = False,
    meldis: bool = False,
    say: Say = print,
) -> dict[str, Any]:
    """Run the twin on a recording (a folder of `run_scenario`) or on a bare measured log.

    Args:
        log: the folder, or a measured log: .csv, .npz, a ROS bag or an LCM log.
        model: the arm's description, needed for a bare log.
        overrides: ``dotted.field=value`` each.
        columns: what a bare foreign log's columns mean, see `read_log`.
        joints: of one arm, in order, of a bare log's robot that has more; empty: all.
        constants: of the motors, where a bare log holds currents: as `--torque-constants` takes them.
        out: as in `run_scenario`.
        show: as in `run_scenario`.
        meldis: as in `run_scenario`.
        say: takes lines of text.

    Raises:
        TwinError: no such log, or it cannot be used.
    """
    scenario = replay_scenario(log, model, overrides, columns, joints, constants)
    return run_scenario(scenario, out=out, show=show, meldis=meldis, say=say)


def beliefs(loop: ClosedLoop, context: Context) -> dict[str, Any]:
    """Return what the twin believes now: time, joints (None before the first message), payload, objects, alarms."""
    twin = loop.twin.diagram
    own = twin.GetMyContextFromRoot(context)

    def value(port: str) -> Array:
        return np.array(twin.GetOutputPort(port).Eval(own))

    n = len(loop.model.joints)
    parameters, covariance = value("parameters"), value("covariance")
    belief = loop.twin.ekf.belief(twin.GetSubsystemContext(loop.twin.ekf, own))
    filter_, whole = loop.twin.ekf.ekf, covariance.reshape(2 * n + parameters.size, -1)
    learnt = standings(
        filter_.parameters,
        parameters,
        whole[2 * n :, 2 * n :],
        loop.model.joints,
        filter_.params.rule,
        alarm=bool(value("alarm")[0] > 0.5),
        freed=belief.freed,
    )
    # Before the first message the state is what the twin was told, which nobody should take for an estimate.
    joints = dict(zip(loop.model.joints, value("arm_state")[:n].round(6).tolist(), strict=True))
    tracks = [Track.unpack(row) for row in value("tracks").reshape(-1, TRACK_SIZE)]
    return {
        "time_s": context.get_time(),
        "joints": joints if belief.valid else None,
        "parameters": {
            name: {"value": found.value, "std": found.std, "status": found.status.value}
            for name, found in zip(loop.twin.parameter_names, learnt, strict=True)
        },
        "objects": {
            name: {
                "status": track.status.name.lower(),
                "pose": track.pose.round(6).tolist(),
                "position_std_mm": round(1e3 * float(np.sqrt(np.trace(track.covariance[3:, 3:]))), 3),
            }
            for name, track in zip(loop.twin.library, tracks, strict=True)
            if track.status != ObjectStatus.UNSEEN
        },
        "alarms": alarms(value("alarm_log")),
    }


def _advance(
    simulator: Simulator, duration: float, progress: Progress, between: Callable[[Context], None]
) -> KeyboardInterrupt | None:
    """Run to `duration`; returns what ended it before."""
    try:
        with stopping.steps():
            # As often as a simulated run is looked at, so that a replay mends its model when the run did.
            for tick in range(1, int(np.ceil(duration / TRIAL.sample_period)) + 1):
                simulator.AdvanceTo(min(TRIAL.sample_period * tick, duration))
                between(simulator.get_mutable_context())
                progress(simulator.get_context().get_time())
                stopping.check()
    except KeyboardInterrupt as stop:
        return stop
    return None


def summary_of(loop: ClosedLoop, trial: Trial, timing: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of ``summary.json``."""
    scenario = loop.scenario
    duration = scenario.duration if trial.stop is None else float(trial.record.time[-1])
    # What it carries at the end, as the estimate beside it.
    payloads = [
        effect.parameters["mass"][0] if (effect.onset or 0.0) < duration <= (effect.end or math.inf) else 0.0
        for effect in scenario.world.arm.effects
        if effect.name == "payload"
    ]
    return summarize(
        trial.record,
        seed=scenario.seed,
        duration=duration,
        payload_true=sum(payloads) if payloads else None,
        position_tolerance=scenario.twin.task.position_tolerance,
        rotation_tolerance=scenario.twin.task.rotation_tolerance,
        timing=timing,
    )


def _write(
    leave: RunFolder,
    out: Path,
    loop: ClosedLoop,
    summary: dict[str, Any],
    trial: Trial | None,
    look: Looking | None,
    say: Say,
) -> None:
    leave.summary(summary)
    if look is not None and look.scenes is not None:
        leave.note("replay.html", "diagram.svg")
        look.scenes.write_replay(out / "replay.html")
        visualization.write_diagram_svg(loop.diagram, out / "diagram.svg")
        if trial is not None:
            leave.note(*(path.name for path in visualization.write_plots(trial.record, summary, out)))
    say(f"wrote {out}/")
