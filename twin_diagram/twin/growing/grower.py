"""From an unknown thing to an asset of the running twin, one step at a time and each with an event.

    unknown ──an image shows it──► followed, its new sides kept ──enough sides──► built beside the loop ──► in use

All that it sees are the twin's own images and beliefs. One grower is of one Context: what it keeps is not in the
Context, for pictures are no state; a Context of the same Diagram without one goes on as if there were none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context

from twin_diagram.assets.building.growth_file import free_name, write_partial
from twin_diagram.errors import ScenarioError, TwinError
from twin_diagram.perception.registration.view import View
from twin_diagram.perception.things.growing import GrowingThing, grown_on, shown
from twin_diagram.runtime.output_place import why_not
from twin_diagram.scenario import Growing
from twin_diagram.signals.layouts import NEVER
from twin_diagram.signals.things import things_of
from twin_diagram.twin.growing.build_process import BuildOutcome, BuildProcess
from twin_diagram.twin.twin import TwinDiagram

Journal = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    tick: float = 1e-6
    """Times that differ by less are the same [s]."""

    fresh: float = 0.3
    """A thing's place is told on where it was followed until so long ago [s]; else the asset is searched for."""

    forgotten: float = 60.0
    """What was seen of a thing that has gone is kept for so long [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class _Job:
    """A reconstruction under way: whose it is, where it runs, since when [s]."""

    identity: int
    process: BuildProcess
    began: float


class Grower:
    """Watches unknown things and makes assets of them.

    Attributes:
        growing: what is followed, by the thing's identity.
        grown: names of the assets that came into use, by the identity of what they were.
    """

    def __init__(
        self,
        twin: TwinDiagram,
        params: Growing,
        journal: Journal,
        folder: Path | None = None,
        *,
        waits: bool = True,
    ) -> None:
        """Begin to watch.

        Args:
            twin: in the Diagram that runs.
            params: tuning; `params.library` gets the assets.
            journal: takes the events, each a record that JSON can hold.
            folder: gets the assets where `params` names no library; None: they are temporary.
            waits: a simulation or a replay waits for an asset that is due; a real arm does not.

        Raises:
            ScenarioError: `params.library` cannot be written to.
            TwinError: the twin has no eyes, or no slots for what grows.
        """
        twin.added.check()
        place = Path(params.library).expanduser() if params.library else folder
        if place is not None and (why := why_not(place, folder=True)) is not None:
            raise ScenarioError("twin.growth.library", f"{place}: {why}")
        self._temporary = TemporaryDirectory()
        self.library = Path(self._temporary.name) / "library" if place is None else place
        self.growing: dict[int, GrowingThing] = {}
        self.grown: dict[int, str] = {}
        self._twin, self._params, self._journal, self._waits = twin, params, journal, waits
        self._job: _Job | None = None
        self._failures: dict[int, int] = {}
        self._image = NEVER
        self._now = 0.0
        self._jobs = 0

    def poll(self, context: Context) -> None:
        """Do what is due; called between two steps of a simulator.

        Args:
            context: of the whole Diagram, which may be changed.
        """
        own = self._twin.diagram.GetMyMutableContextFromRoot(context)
        self._now = context.get_time()
        self._look(own)
        if self._job is not None:
            self._look_after(own, self._job)
        if self._job is None:
            ready = [k for k, one in sorted(self.growing.items()) if one.growth.ready and self._may(k)]
            if ready:
                self._start(ready[0])

    def told(self) -> dict[str, Any]:
        """Return what grew, and what stays partial, for ``summary.json``."""
        partial = {
            f"unknown#{k}": {"pictures": len(one.growth), "seen": round(one.growth.seen, 3), "partial": True}
            for k, one in sorted(self.growing.items())
        }
        grown = {name: f"unknown#{k}" for k, name in sorted(self.grown.items())}
        return {"growth": {"library": str(self.library), "grown": grown, "partial": partial}}

    def close(self) -> None:
        """End what runs, and write what stays partial into the library: what was seen of it, and nothing else.

        Where the library cannot be written to any more, an event says so: a run does not lose its figures by that.
        """
        if self._job is not None:
            self._job.process.stop()
            self._tell("growth_stopped", self._job.identity, why="the run ended before the reconstruction did")
            self._job = None
        for identity, one in sorted(self.growing.items()):
            try:
                write_partial(self.library / f"unknown_{identity}.partial.npz", one.growth.partial())
            except OSError as error:
                why = f"what was seen of it could not be written: {' '.join(str(error).split())}"
                self._tell("growth_failed", identity, why=why)
        self._temporary.cleanup()

    def __enter__(self) -> Grower:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # Details.

    def _tell(self, event: str, identity: int, **figures: Any) -> None:
        self._journal({"event": event, "time": round(self._now, 6), "object": f"unknown#{identity}", **figures})

    def _may(self, identity: int) -> bool:
        return self._failures.get(identity, 0) < self._params.attempts

    def _look(self, own: Context) -> None:
        """Take in the newest image, where it shows unknown things."""
        time = self._twin.added.looked_at(self._twin.diagram, own)
        if time <= self._image:
            return
        self._image = time
        things = things_of(np.asarray(self._twin.diagram.GetOutputPort("things").Eval(own)))
        present = {thing.identity for thing in things if thing.stands}
        kept = (k for k, one in self.growing.items() if k in present or time - one.slot.seen < TUNING.forgotten)
        self.growing = {k: self.growing[k] for k in kept}
        things = [thing for thing in things if self._may(thing.identity) and thing.identity not in self.grown]
        if not any(thing.stands and thing.last_seen >= time for thing in things):
            return
        segments = self._twin.added.segments(self._twin.diagram, own)
        if abs(segments.time - time) > TUNING.tick:
            return  # a newer image has just come, which the next look takes in
        sight = self._twin.added.looked(self._twin.diagram, own)
        view = View(segments, sight.frame(segments), sight.params, sight.smallest)
        # What was given up is no longer followed, and takes no other thing's place.
        given_up = {k: one for k, one in self.growing.items() if not self._may(k)}
        followed = {k: one for k, one in self.growing.items() if self._may(k)}
        after = grown_on(followed, shown(things, segments, sight.known), view, self._params.things)
        self.growing = given_up | after

    def _start(self, identity: int) -> None:
        """Begin to build an asset of a thing."""
        growth = self.growing[identity].growth
        name = free_name(self.library, identity, {*self._twin.library, *self._twin.added.assets})
        self._jobs += 1
        folder = Path(self._temporary.name) / f"build_{self._jobs}"
        try:
            process = BuildProcess(growth, name, self.library, folder, self._params.nice)
        except OSError as error:
            self._fail(identity, " ".join(str(error).split()))
            return
        self._job = _Job(identity, process, self._now)
        self._tell("growth_started", identity, asset=name, pictures=len(growth), seen=round(growth.seen, 3))

    def _look_after(self, own: Context, job: _Job) -> None:
        """Take the asset when it is due and there."""
        if self._now < job.began + self._params.answer_after - TUNING.tick:
            return
        left = self._params.patience - job.process.age
        outcome = job.process.wait(max(left, 0.0)) if self._waits else job.process.poll()
        if outcome is None and left > 0.0:
            return
        self._job = None
        if outcome is None:
            job.process.stop()
            outcome = BuildOutcome(None, f"no asset within {self._params.patience:g} s", job.process.age)
        if outcome.answer is None:
            self._fail(job.identity, outcome.why)
            return
        try:
            self._use(own, job, outcome)
        except TwinError as error:
            self._failures[job.identity] = self._params.attempts  # there is an asset; another is of no more use
            self._fail(job.identity, " ".join(str(error).split()))

    def _use(self, own: Context, job: _Job, outcome: BuildOutcome) -> None:
        """Put an asset into use where its thing is."""
        answer, name = outcome.answer, job.process.name
        assert answer is not None
        number = self._twin.add_asset(Path(answer["folder"]))
        thing, X_WO = self.growing.pop(job.identity, None), None
        if thing is not None and self._image - thing.slot.seen < TUNING.fresh:
            R, p = thing.placed(np.array(answer["R_TO"]), np.array(answer["p_TO"]), self._now)
            X_WO = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)
        self._twin.use_asset(own, number, X_WO)
        self.grown[job.identity] = name
        size = [round(float(x), 4) for x in answer["size"]]
        self._tell("grown", job.identity, asset=name, number=number, folder=answer["folder"], size=size)

    def _fail(self, identity: int, why: str) -> None:
        self._failures[identity] = self._failures.get(identity, 0) + 1
        self._tell("growth_failed", identity, why=why)
