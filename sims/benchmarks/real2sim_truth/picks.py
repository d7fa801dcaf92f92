"""Picks alone: what is lifted is brought before the camera, and then is gone; nothing is shown, weighed or learned."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform

from twin_diagram import Scenario
from twin_diagram.runs.learning.cell import RELEASE
from twin_diagram.runs.learning.contact_count import ContactCount, Watchers
from twin_diagram.runs.learning.display import TUNING as DISPLAY
from twin_diagram.runs.learning.display import tool_at
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.picking import go
from twin_diagram.runs.learning.pipeline import Learner
from twin_diagram.runs.learning.record import EVENTS, Learned, LearningRecord
from twin_diagram.runs.learning.shown_object import Picked
from twin_diagram.runs.learning.start import check_cell, tools_of
from twin_diagram.runtime import stopping
from twin_diagram.runtime.threads import one_thread

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    hand: float = 0.25
    """What is in the hand has its origin within this of the tips [m]: the longest thing, held by its end."""

    gone: float = 5.0
    """Where what was taken goes to [m]: out of every camera's sight, each thing as far from the next."""

    moved: float = 0.005
    """From which on a thing that nobody wanted was shoved [m]: five times what things in a heap move by themselves."""


TUNING = Tuning()


@dataclass
class TrueThings:
    """Where the true objects are; see `cell.Observer`. It takes away what was brought, and nothing else."""

    station: Any = None
    context: Any = None
    away: list[str] = field(default_factory=list)

    def moment(self, name: str, positions: Array) -> None:
        """Take nothing."""

    def ticked(self, station: Any, context: Any, doing: Any) -> None:
        """Note whom to ask."""
        self.station, self.context = station, context

    def places(self) -> dict[str, Array]:
        """Return the middles (3,) of those that are still there in W [m]."""
        world = self.station.world
        inner = world.plant.GetMyContextFromRoot(self.context)
        return {
            name: np.array(world.plant.EvalBodyPoseInWorld(inner, world.plant.get_body(body)).translation())
            for name, body in world.objects.items()
            if name not in self.away
        }

    def take_away(self, name: str) -> None:
        """Put an object where nothing is, and hold it there."""
        world = self.station.world
        inner, body = (
            world.plant.GetMyMutableContextFromRoot(self.context),
            world.plant.get_body(world.objects[name]),
        )
        self.away.append(name)
        world.plant.SetFreeBodyPose(inner, body, RigidTransform([0.0, 0.0, -TUNING.gone * len(self.away)]))
        body.Lock(inner)


class Picker(Learner):
    """Empties a bin pick by pick.

    Attributes:
        truth: of the world.
        rows: of each thing that was looked at: which true `thing` was brought ("": none), what was `told`, which others
            were `shoved`, by how much [m], and how many tries `failed`.
    """

    truth: TrueThings
    rows: list[dict[str, Any]]

    def _save(self) -> None:
        """Write nothing: a bin takes minutes, and is begun anew."""

    def _handle(self, picture: Any, thing: Any, known: Any) -> None:
        """Try to take a thing, and note what came of it in the true world."""
        before, tries, had, first = self.truth.places(), len(self.rows), len(self.state.learned), self._failures()
        super()._handle(picture, thing, known)
        if len(self.rows) == tries:
            reported = len(self.state.learned) > had and self.state.learned[-1].state == "reported"
            self.rows.append({"thing": "", "told": self.state.learned[-1].why if reported else "tipped up"})
        after = self.truth.places()
        off = {name: float(np.linalg.norm(after[name] - place)) for name, place in before.items() if name in after}
        shoved = {name: round(far, 3) for name, far in off.items() if far > TUNING.moved}
        self.rows[-1] |= {"shoved": shoved, "failed": self._failures() - first}

    def _failures(self) -> int:
        """Return how many tries have held nothing so far."""
        lines = (self.record.folder / EVENTS).read_text(encoding="utf-8").splitlines()
        return sum('"the fingers held nothing"' in line for line in lines)

    def _learn(self, name: str, picked: Picked) -> None:
        """Bring what was picked before the camera, and take it away."""
        tools, told = self.tools, ""
        for tilt in (*DISPLAY.tilts, *DISPLAY.more_tilts):
            with contextlib.suppress(NoWay):
                goals = tools.mover.goals(tool_at(tools.learning, tilt), tools.cell.commanded)
                go(tools.cell, tools.mover.timed(tools.mover.path(tools.cell.commanded, goals)))
                break
        else:
            told = "no way to the camera"
        tip = tools.mover.tool(tools.cell.q)[:3, 3]
        far = {one: float(np.linalg.norm(place - tip)) for one, place in self.truth.places().items()}
        held = [one for one, away in far.items() if away < TUNING.hand]
        self.rows.append({"thing": " ".join(sorted(held)), "told": told or ("" if held else "lost on its way")})
        with tools.cell.about(RELEASE, tip):
            for one in held:
                self.truth.take_away(one)
            tools.cell.restore(tools.cell.snapshot())  # at rest, and without what the solver knew of their contacts
            tools.cell.grip(1.0)
        tools.mover.hold(None)
        self.state.taken += 1
        self.state.learned.append(Learned(name, "failed"))


@one_thread()
def pick_bin(scenario: Scenario, out: Path, say: Any) -> dict[str, Any]:
    """Empty a drawn bin pick by pick.

    Args:
        scenario: of it.
        out: new folder of the run's events.
        say: is told of each stage.

    Returns:
        What became of it: `rows` as of `Picker`, how many tries `failed`, names of what was `left`, how many `contacts`
        no step asked for, and how long it took (`sim_s`).
    """
    learning, record = check_cell(scenario), LearningRecord(out, scenario)
    tools, truth = tools_of(scenario, learning), TrueThings()
    with record.alone(new=True):
        state = record.begin()
        tools.cell.observer = Watchers(ContactCount(partial(record.event, stage="contact")), truth)
        learner = Picker(tools, record, state, say)
        learner.truth, learner.rows = truth, []
        with stopping.steps():
            learner.run()
    return {
        "rows": learner.rows,
        "failed": sum(row["failed"] for row in learner.rows),
        "left": sorted(truth.places()),
        "contacts": record.unasked(),
        "sim_s": round(tools.cell.time, 1),
    }
