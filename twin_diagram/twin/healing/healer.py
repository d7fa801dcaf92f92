"""From an alarm to a corrected model in the running loop, one step at a time and each with an event.

    watching ──alarm──► gathering ──enough of the log since then──► searching ──verdict──► model swapped, or kept

All that it sees are the twin's own beliefs and what the station measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pydrake.systems.framework import Context

from twin_diagram.errors import TwinError
from twin_diagram.gap.candidates.records import sentence
from twin_diagram.model.effects import spec_of
from twin_diagram.model.model import Model
from twin_diagram.scenario import Healing
from twin_diagram.twin.healing.gap_process import GapProcess, SearchOutcome
from twin_diagram.twin.healing.measurement_tape import Tape
from twin_diagram.twin.twin import TwinDiagram

Journal = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    settle: float = 0.3
    """What changed at an alarm is left to settle for this long before the log is used [s]."""

    stronger: float = 2.0
    """An alarm this many times as strong is another one."""

    plain: float = 10.0
    """Beyond so many times its threshold an alarm is plain: that it goes on to grow is no news [thresholds]."""

    tick: float = 1e-6
    """Times that differ by less are the same [s]."""


TUNING = Tuning()


class Healer:
    """Watches the twin's alarms and mends its model.

    Attributes:
        model: the one in use.
        swaps: times at which a corrected one was taken over [s].
    """

    def __init__(
        self,
        twin: TwinDiagram,
        params: Healing | None,
        journal: Journal,
        tape: Tape | None = None,
        folder: Path | None = None,
        packages: Mapping[str, str | Path] | None = None,
    ) -> None:
        """Begin to watch.

        Args:
            twin: in the Diagram that runs.
            params: tuning; None: alarms are told of, nothing is mended.
            journal: takes the events, each a record that JSON can hold.
            tape: of the station, where something is to be mended.
            folder: where each search gets a folder of its own, numbered; None: they are temporary.
            packages: local folders for `package://` names.
        """
        self.model: Model = twin.measured_model
        self.swaps: list[float] = []
        self._twin, self._params, self._journal, self._tape = twin, params or Healing(), journal, tape
        self._temporary = TemporaryDirectory() if folder is None and tape is not None else None
        self._folder = Path(self._temporary.name) if self._temporary else folder
        self._packages = packages
        self._told = self._answered = -1.0
        self._alarm: dict[str, Any] | None = None
        self._begin = self._level = 0.0
        self._search: GapProcess | None = None
        self._started = self._now = 0.0
        self._searches = 0

    def poll(self, context: Context) -> None:
        """Do what is due; called between two steps of a simulator.

        Args:
            context: of the whole Diagram, which may be changed.
        """
        own = self._twin.diagram.GetMyMutableContextFromRoot(context)
        now = self._now = context.get_time()
        if self._tape is not None:
            self._tape.take(context)
        alarms = self._alarms(own)
        if self._tape is None:
            return
        if self._search is not None:
            self._look_after(own, now)
        elif self._alarm is not None:
            self._gather(alarms, now)
        elif self._searches < self._params.attempts:
            fresh = [record for record in alarms if record["time"] > self._answered]
            if fresh:
                self._alarm, self._begin, self._level = (
                    fresh[-1],
                    fresh[-1]["time"] + TUNING.settle,
                    fresh[-1]["statistic"],
                )

    def close(self) -> None:
        """End what runs."""
        if self._search is not None:
            self._search.stop()
            self._tell("gap_stopped", self._now, why="the run ended before the search did")
            self._search = None
        if self._temporary is not None:
            self._temporary.cleanup()

    def __enter__(self) -> Healer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # Details.

    def _tell(self, event: str, time: float, **figures: Any) -> None:
        self._journal({"event": event, "time": round(time, 6), **figures})

    def _alarms(self, own: Context) -> list[dict[str, Any]]:
        """Return all that are on record; those that are new are told of."""
        raised = float(self._twin.diagram.GetOutputPort("alarm").Eval(own)[2])
        if raised < 0.0:
            return []
        records = self._twin.alarms(own)
        for record in records:
            if record["time"] > self._told:
                self._tell("alarm", **record)
        # By the records' own times, which are rounded: one that was rounded up would be news at every look.
        self._told = max([self._told, *(record["time"] for record in records)])
        return records

    def _gather(self, alarms: list[dict[str, Any]], now: float) -> None:
        """Wait until the log since the alarm is long enough, and start the search.

        An alarm that grows, or is followed by a much stronger one, is about something that only happens now: the log
        before that would tell of two robots.
        """
        assert self._alarm is not None and self._tape is not None and self._folder is not None
        since = self._alarm["time"]
        # What looked like a step may have turned out to be a spike.
        current = next((record for record in alarms if record["time"] == since), self._alarm)
        level = max([current["statistic"], *(record["statistic"] for record in alarms if record["time"] > since)])
        if min(level, TUNING.plain) > TUNING.stronger * self._level:
            self._begin, self._level = now + TUNING.settle, level
        begin = self._begin
        if now < begin + self._params.seconds - TUNING.tick:
            return
        self._alarm, self._answered = None, since
        if current["shape"] == "spike" and not any(record["time"] > since for record in alarms):
            self._tell("alarm_passed", now, alarm=since, why="a spike: what caused it is over")
            return
        end = begin + self._params.seconds
        middle = begin + (1.0 - self._params.held_out) * self._params.seconds
        self._searches += 1
        # What somebody else put there stays as it is.
        folder = next(way for k in count(self._searches) if not (way := self._folder / str(k)).exists())
        try:
            fit, holdout = self._tape.cut(begin, middle), self._tape.cut(middle, end)
            self._search = GapProcess(self.model, fit, holdout, folder, self._packages, self._params.nice)
        except (TwinError, OSError) as error:
            self._tell("gap_failed", now, alarm=since, why=" ".join(str(error).split()))
            return
        self._started = now
        self._tell(
            "gap_started",
            now,
            alarm=since,
            joint=current["joint"],
            fit=[round(begin, 6), round(middle, 6)],
            holdout=[round(middle, 6), round(end, 6)],
            folder=None if self._temporary else str(folder),
        )

    def _look_after(self, own: Context, now: float) -> None:
        """Take the verdict when it is there."""
        search, due = self._search, self._params.answer_after
        assert search is not None
        patience = self._params.patience - search.age
        if due is not None and now < self._started + due - TUNING.tick:
            return
        outcome = search.poll() if due is None else search.wait(max(patience, 0.0))
        if outcome is None and patience > 0.0:
            return
        self._search = None
        self._answered = now
        if outcome is None:
            search.stop()
            self._tell("gap_stopped", now, why=f"no verdict within {self._params.patience:g} s")
        elif outcome.verdict == "failed":
            self._tell("gap_failed", now, why=outcome.why, seconds=round(outcome.seconds, 1))
        else:
            self._judge(own, now, outcome)

    def _judge(self, own: Context, now: float, outcome: SearchOutcome) -> None:
        answer = outcome.answer
        self._tell(
            "gap_verdict",
            now,
            verdict=outcome.verdict,
            remainder=answer["remainder"],
            effects=answer["effects"],
            gap=answer["gap"],
            seconds=round(outcome.seconds, 1),
        )
        if outcome.model is None:
            self._tell("model_kept", now, why=f"the verdict is {outcome.verdict}")
            return
        if not smaller(answer["gap"]):
            self._tell("model_kept", now, why="what was named explains the held-out run no better")
            return
        try:
            found = Model.load(outcome.model, self._packages)
            if [*map(spec_of, found.present)] == [*map(spec_of, self.model.present)]:
                self._tell("model_kept", now, why="what was named is over")
                return
            number = self._twin.add_model(found)
        except TwinError as error:
            self._tell("model_kept", now, why=f"the twin cannot use the corrected model: {error}")
            return
        before = self._twin.parameters(own)
        self._twin.use_model(own, number)
        self.model = found
        self.swaps.append(now)
        self._tell(
            "model_swapped",
            now,
            model=number,
            effects=[sentence(effect) for effect in found.present if not effect.given],
            parameters_before=before,
            parameters_after=self._twin.parameters(own),
        )


def smaller(gap: Mapping[str, Any]) -> bool:
    """Return whether a corrected model leaves less torque unexplained in the held-out run; `gap` as in gap.json."""
    held_out = gap["torque_rms"]["holdout"]
    before, after = (sum(value**2 for value in held_out[when].values()) for when in ("before", "after"))
    return bool(after < before)
