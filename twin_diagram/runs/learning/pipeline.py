"""Empties a bin and learns what lies in it, object by object, until nothing is left that can be taken."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin_diagram.errors import TwinError
from twin_diagram.runs.learning import handling
from twin_diagram.runs.learning.bin_view import SeenThing, narrowest, save_picture
from twin_diagram.runs.learning.camera_check import correct_cameras
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.choosing import SURE, Choice
from twin_diagram.runs.learning.dragging import drag_off, plan_drag
from twin_diagram.runs.learning.ending import end_early
from twin_diagram.runs.learning.finishing import figures_of, finish
from twin_diagram.runs.learning.gallery import write_gallery
from twin_diagram.runs.learning.nudging import nudge_off, plan_nudge
from twin_diagram.runs.learning.one_object import OneObject
from twin_diagram.runs.learning.record import Learned, LearningRecord, RunState, plain
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.runs.learning.shape_jobs import Done, ShapeJobs
from twin_diagram.runs.learning.shown_object import Picked
from twin_diagram.runs.learning.tipping import plan_tipping, tip_up
from twin_diagram.runs.learning.which_first import which_first
from twin_diagram.runtime import stopping
from twin_diagram.runtime.stopping import Stopped
from twin_diagram.signals.arrays import Array

Say = Callable[[str], None]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    usual: float = 180.0
    """What an object is taken to need before one is done [s of wall clock]."""

    poll: float = 0.5
    """Between two looks at reconstructions under way, when nothing else is left to do [s]."""

    rolling: int = 3
    """Times `learning.tries` that objects may fail in all before each is left where it lies; one put away: from 0."""

    settle: float = 1.5
    """Before the first picture: what lies in the bin comes to rest [s]."""


TUNING = Tuning()


class Learner:
    """One run over one bin."""

    def __init__(self, tools: handling.Tools, record: LearningRecord, state: RunState, say: Say) -> None:
        """Go on from a state.

        Args:
            tools: of the cell.
            record: files of the run.
            state: what was done so far.
            say: is told of each stage.
        """
        self.tools, self.record, self.state, self._say = tools, record, state, say
        self._jobs = ShapeJobs()
        self._begun, self._handled = time.monotonic(), 0
        self._left, self._tipped, self._pushed, self._dragged = 0, 0, 0, 0
        self._made: list[Done] = []
        self._held: OneObject | None = None

    def run(self) -> None:
        """Empty the bin, wait for reconstructions under way, and write the gallery."""
        try:
            self._start()
            while (found := self._next()) is not None:
                self._handle(*found)
                self._save()
                self._held = None
            if not self.state.finished:
                self.state.finished = True
                self.record.event(stage="bin", outcome="empty" if not self.state.given_up else "nothing left to take")
            self._wait()
            self._save()
        except Stopped:
            self._jobs.close()
            self._end_early()
            raise
        except TwinError as why:
            self.record.event(stage="stop", outcome=" ".join(str(why).split()))
            raise
        finally:
            self._jobs.close()

    def _end_early(self) -> None:
        """Set down what is held, or hold it; where it lies in its bin again the run goes on from there."""
        ending = end_early(self.tools)
        if ending.empty and (self._held is None or self._held.in_bin):
            self.state.world = self.tools.cell.snapshot()
            self.state.sim_time = self.tools.cell.time
            self.record.save(self.state)
        self.record.event(stage="stop", outcome=ending.told)
        self._say(f"stopped: {ending.told}")

    def _start(self) -> None:
        if self.state.world:
            self.tools.cell.restore(self.state.world)
            self.record.event(stage="resume", sim=self.tools.cell.time, objects=len(self.state.learned))
        else:
            self.tools.cell.wait(TUNING.settle)
        for camera in correct_cameras(self.tools.cell, self.tools.learning, self.tools.cameras, self.tools.faces):
            self.record.event(stage="camera", **camera)
        for one in self.state.learned:
            if one.state == "handled":
                self._jobs.add(one.name, self.record.of(one.name))
        self._save()

    def _save(self) -> None:
        self._collect()
        self.state.world = self.tools.cell.snapshot()
        self.state.sim_time = self.tools.cell.time
        self.record.save(self.state)
        write_gallery(self.record, self.state)

    def _next(self) -> tuple[Picture, SeenThing, Choice] | None:
        """Return a picture of the bin, what is to be taken next, and the choice of a grasp; None: nothing is left."""
        if self.state.finished:
            return None
        handling.keep_clear(self.tools, self._standing())  # a run that goes on begins over the last one put away
        picture, things = handling.look_into_bin(self.tools, self.state.given_up)
        if not things and self.state.given_up and self.state.taken:
            # What was in the way may be gone: what was given up has another chance.
            self.state.taken, self.state.given_up = 0, []
            self.state.learned = [one for one in self.state.learned if one.state != "reported"]
            picture, things = handling.look_into_bin(self.tools, [])
        self._left = len(things)
        return (picture, *which_first(self.tools, picture, things)) if things else None

    def _handle(self, picture: Picture, thing: SeenThing, known: Choice) -> None:
        """Try to take a thing, at first as was chosen, and do with it all that is to be done."""
        name = f"object_{1 + sum(one.state != 'reported' for one in self.state.learned):02d}"
        picked, failed = Picked(thing), list[Array]()
        if self._better_tipped(thing, known) and (
            self._tip(name, thing, picture) or (known.best() is None and self._push_off(name, thing, picture))
        ):
            return
        for attempt in range(self.tools.learning.tries):
            with self._stage(name, "pick") as told:
                picked = handling.pick(self.tools, thing, picture, attempt, failed, None if attempt else known)
                told["outcome"] = "taken" if picked.taken else picked.why
                failed += [] if picked.failed is None else [picked.failed]
            if picked.taken is not None or (attempt and picked.failed is None):
                break  # of what two searches leave no grasp a third one does hardly either
            picture, things = handling.look_into_bin(self.tools, self.state.given_up)
            thing = min(things, key=lambda one: float(np.linalg.norm(one.middle - thing.middle)), default=thing)
            if not things:
                return
            if narrowest(thing) > self.tools.gripper.opening_most and self._tip(name, thing, picture):
                return
        if picked.taken is None:
            if not any(way(name, thing, picture) for way in (self._tip, self._push_off, self._drag_off)):
                self._report(picture, thing, picked.why)
            return
        self._tipped, self._pushed, self._dragged = 0, 0, 0
        self._learn(name, picked)

    def _better_tipped(self, thing: SeenThing, known: Choice) -> bool:
        """Return whether a thing is wider than the hand, and no sure grasp of it is known.

        Of tries at raised edges of such things five of six held nothing, and some shoved what lies beside them.
        """
        unsure = all(known.one(kind) is None for kind in SURE)
        return unsure and narrowest(thing) > self.tools.gripper.opening_most

    def _tip(self, name: str, thing: SeenThing, picture: Picture) -> bool:
        """Tip up what lies flat and cannot be taken, a few times at most; whether that was tried."""
        plan = plan_tipping(self.tools, thing, picture) if self._tipped < self.tools.learning.tries else None
        if plan is None:
            return False
        with self._stage(name, "tip up"):
            tip_up(self.tools, plan)
        self._tipped += 1
        return True

    def _push_off(self, name: str, thing: SeenThing, picture: Picture) -> bool:
        """Push what cannot be taken off what it lies across, a few times at most; whether that was tried.

        What lies otherwise then may be tipped up anew.
        """
        plan = plan_nudge(self.tools, thing, picture) if self._pushed < self.tools.learning.tries else None
        if plan is None:
            return False
        with self._stage(name, "push off") as told:
            told["outcome"] = nudge_off(self.tools, plan)
        self._pushed += 1
        self._tipped = 0
        return True

    def _drag_off(self, name: str, thing: SeenThing, picture: Picture) -> bool:
        """Drag what cannot be taken off walls that it lies at, a few times at most; whether that was tried."""
        tried = self._dragged
        plan = plan_drag(self.tools, thing, picture, tried) if tried < self.tools.learning.tries else None
        if plan is None:
            return False
        with self._stage(name, "drag off") as told:
            told["outcome"] = drag_off(self.tools, plan)
        self._dragged += 1
        return True

    def _learn(self, name: str, picked: Picked) -> None:
        """Show, weigh and put away what was picked, and have its shape made."""
        self._held = held = OneObject(self.tools, self.record, name, self._stage, self._jobs.add, self._standing())
        held.learn(picked)
        one = held.one
        if one.standing:
            self.state.taken += 1
            self.state.failed_at = []
        elif not self._note_failure(one, picked.thing.middle):
            # It may have fallen elsewhere, and bars nothing any more.
            self.state.taken += any(other.state == "reported" for other in self.state.learned)
        self._handled += 1
        one.grasps = len(held.shown.X_ST)
        one.figures |= plain(figures_of(held.shown))
        self.state.learned.append(one)

    def _standing(self) -> list[PutDown]:
        """Return what stands in the other bin."""
        return [PutDown.of_numbers(one.standing) for one in self.state.learned if one.standing]

    def _note_failure(self, one: Learned, place: Array) -> bool:
        """Count a failure of what lay at a place (3,) in W; after `tries` of them it is left there; whether it is.

        What falls back into the bin may roll: after many failures in all each place is left at its first.
        """
        tries, failed = self.tools.learning.tries, self.state.failed_at
        failed.append(place.tolist())
        here = np.linalg.norm(np.array(failed) - place, axis=1) <= handling.TUNING.same_place
        left = bool(here.sum() >= tries or len(failed) >= TUNING.rolling * tries)
        if left:
            self.state.given_up.append(place.tolist())
            self.record.event(object=one.name, stage="give up", why=one.why)
            self._say(f"{one.name}: {one.why}; what lies there is left")
        return left

    def _report(self, picture: Picture, thing: SeenThing, why: str) -> None:
        """Note something that cannot be taken, with a picture."""
        number = 1 + sum(one.state == "reported" for one in self.state.learned)
        name, file = f"reported_{number:02d}", f"reported/{number:02d}.png"
        self._tipped, self._pushed, self._dragged = 0, 0, 0  # of what is looked at next
        save_picture(self.record.folder / file, picture, thing, why)
        self.state.learned.append(Learned(name, "reported", why, picture=file))
        self.state.given_up.append(thing.middle.tolist())
        self.record.event(object=name, stage="report", why=why, picture=file)
        self._say(f"{name}: {why}; left where it lies")

    def _collect(self) -> bool:
        """Write the assets of shapes that are made; whether there were any."""
        self._made += self._jobs.poll()
        known = {one.name for one in self.state.learned}
        ready, self._made = [d for d in self._made if d.name in known], [d for d in self._made if d.name not in known]
        for done in ready:
            one = self.state.named(done.name)
            if done.why is not None:
                one.state, one.no_asset = "failed", done.why
                self.record.event(object=one.name, stage="reconstruct", outcome=done.why)
                self._say(f"{one.name}: {done.why}")
                continue
            finish(self.record, one, self.tools.model, self.state.learned)
            self.record.event(
                object=one.name, stage="asset", outcome=one.state, **({"why": one.told} if one.told else {})
            )
            self._say(f"{one.name}: {one.state}, {one.told or self.record.library / one.name}")
        return bool(ready)

    def _wait(self) -> None:
        """Wait for reconstructions under way."""
        told = False
        while self._jobs.pending:
            if not told:
                self._say(f"nothing is left to take; waiting for {', '.join(self._jobs.pending)}")
                told = True
            self._collect()
            stopping.check()
            time.sleep(TUNING.poll)

    @contextmanager
    def _stage(self, name: str, stage: str) -> Iterator[dict[str, Any]]:
        """Tell of a stage: a line on the terminal, and one among the events when it is over."""
        cell, wall, sim = self.tools.cell, time.monotonic(), self.tools.cell.time
        self._say(f"{name}: {stage} · {sim:.0f} s simulated · about {self.remaining():.0f} s remain")
        told: dict[str, Any] = {"outcome": "done"}
        try:
            yield told
        except TwinError as why:
            told["outcome"] = str(why)
            raise
        except Stopped:
            told["outcome"] = "stopped"
            self._jobs.close()  # no asset is written now: that takes seconds, which are the arm's
            raise
        finally:
            took = {"sim": round(cell.time - sim, 3), "took": round(time.monotonic() - wall, 2)}
            self.record.event(object=name, stage=stage, at=round(cell.time, 3), **took, **plain(told))
            if self._collect():
                # A kill from here on has no asset made anew; the world is still that before the object in hand.
                self.record.save(self.state)

    def remaining(self) -> float:
        """Return how long the bin's objects will take, by those so far [s of wall clock]."""
        each = (time.monotonic() - self._begun) / self._handled if self._handled else TUNING.usual
        return each * self._left
