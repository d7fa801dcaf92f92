"""What is done with one object from its pick on: shown, weighed, put away; what is lost meanwhile is looked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from twin_diagram.errors import StationError
from twin_diagram.estimation.weighing import WeighingError
from twin_diagram.runs.learning import handling, picking, swinging
from twin_diagram.runs.learning.bin_view import save_picture
from twin_diagram.runs.learning.coverage import asks_for_more
from twin_diagram.runs.learning.display import NothingHeld
from twin_diagram.runs.learning.finishing import seen_so_far
from twin_diagram.runs.learning.looking_about import LyingAbout
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.picking import Taken
from twin_diagram.runs.learning.record import SWUNG, Learned, LearningRecord
from twin_diagram.runs.learning.seeking import Sought, as_lying, seek
from twin_diagram.runs.learning.setting_down import PutDown
from twin_diagram.runs.learning.shape_worker import FRAMES
from twin_diagram.runs.learning.shown_object import Picked, ShownObject
from twin_diagram.runs.learning.weighing import Slipping

Stage = Callable[[str, str], AbstractContextManager[dict[str, Any]]]
"""Tells of an object's stage, by both names, while its block runs; what the block puts in goes with it."""
SWINGS: Final = 3
"""Times that it is tried to swing an object: as it is held, in another grasp, and more gently."""
Queue = Callable[[str, Path], None]
"""Takes the name and the folder of an object whose shape is to be made."""


class OneObject:
    """One object that was picked.

    Attributes:
        one: what is known of it, for the run's state.
        shown: what was seen and felt of it.
        in_bin: whether it lies in the bin that is emptied, or would if it were set down where the fingers shut.
    """

    def __init__(
        self,
        tools: handling.Tools,
        record: LearningRecord,
        name: str,
        stage: Stage,
        queue: Queue,
        standing: Sequence[PutDown],
    ) -> None:
        """Begin with an empty folder.

        Args:
            tools: of the cell.
            record: files of the run.
            name: of the object.
            stage: tells of each stage.
            queue: takes it once its pictures are written.
            standing: what stands in the other bin.
        """
        self.one, self.shown, self.in_bin = Learned(name), ShownObject(), True
        self._tools, self._record, self._stage, self._queue, self._standing = tools, record, stage, queue, standing
        self._folder = record.fresh(name)

    def learn(self, picked: Picked) -> None:
        """Show, weigh and put away what was picked, and have its shape made."""
        try:
            self._show(picked)
            opening = self._weigh_and_put_away()
            self._swing_empty(opening)
        except (NoWay, NothingHeld, StationError) as why:  # of a camera that stopped the next look tells
            self.one.why = str(why)
            self._let_go()
            if not self.one.standing:
                self._seek(picked)
        self._write_frames()
        if not self.shown.followed.shown:
            self.one.state = "failed"

    def _show(self, picked: Picked) -> None:
        """Show it in all its grasps; raises as `handling.show_first` and `_show_again`."""
        with self._stage(self.one.name, "display") as told:
            self.shown = shown = handling.show_first(self._tools, picked)
            self.one.R_WS = (shown.R_WT @ shown.X_ST[-1][:3, :3].T).tolist()
            told.update(seen_so_far(shown))
        self._show_again()

    def _weigh_and_put_away(self) -> float:
        """Weigh it, once, and put it away; return how far the fingers were apart that held it [m].

        Raises:
            NoWay, NothingHeld, StationError: it is not in the other bin.
        """
        self._write_frames()
        tools, opening = self._tools, self._tools.cell.opening
        if tools.learning.weigh_seconds > 0.0 and not (self._folder / SWUNG).is_file():
            self.weigh()
        # Where it is believed to be in the hand now, for whoever knows where it truly is.
        X_WS = tools.mover.tool(tools.cell.q) @ np.linalg.inv(self.shown.X_ST[-1])
        self.one.figures["X_WS"] = X_WS.tolist()
        tools.cell.moment(self.one.name)
        self.one.standing = self._put_away().numbers()
        return opening

    def _swing_empty(self, opening: float) -> None:
        """Swing the empty hand as the object was swung, with the fingers so far apart [m], once in a run."""
        empty = self._record.folder / SWUNG
        if self.shown.swung is not None and not empty.is_file():
            with self._stage(self.one.name, "swing the empty hand"):
                swinging.weigh_empty(self._tools, self.shown, opening, empty)

    def _write_frames(self) -> None:
        """Write its pictures, where there are any, and have its shape made of them; once."""
        if self.shown.followed.shown and not (self._folder / FRAMES).is_dir():
            handling.write_frames(self._folder / FRAMES, self.shown, self._tools.gripper)
            self._queue(self.one.name, self._folder)

    def _show_again(self) -> None:
        """Show an object in its further grasps; one that cannot be set down goes on with what was seen of it.

        Raises:
            NothingHeld: it is no longer in the hand.
        """
        while asks_for_more(len(self.shown.X_ST), self.shown.seen_shares, self._tools.learning):
            if not self._once_more():
                return

    def _once_more(self, firm: bool = False) -> bool:
        """Show an object in another grasp; whether that was to be had; raises as `_show_again`."""
        self.in_bin, shown, cell = False, self.shown, self._tools.cell
        try:
            with self._stage(self.one.name, "display again") as told:
                told["outcome"] = "shown" if handling.show_again(self._tools, shown, firm) else "not taken again"
                told.update(seen_so_far(shown))
        except NoWay as why:
            if cell.opening < picking.TUNING.empty or not cell.shut:
                raise NothingHeld(f"it was set down, and then: {why}") from why
            shown.notes.append(f"shown in {len(shown.X_ST)} grasps only: {why}")
            return False
        if told["outcome"] != "shown":
            raise NothingHeld("; ".join(["it could not be taken from the platform again", *shown.notes[-1:]]))
        return True

    def _put_away(self) -> PutDown:
        """Put what is held into the other bin; where its grasp leaves no place there, in another one.

        Raises:
            NoWay: no place is reached in that either.
            NothingHeld: it was lost on its way through the platform.
        """
        self.in_bin = False
        try:
            with self._stage(self.one.name, "put away"):
                return handling.put_away(self._tools, self.shown, self._standing)
        except NoWay:
            if not self._once_more(firm=True):
                raise
        with self._stage(self.one.name, "put away"):
            return handling.put_away(self._tools, self.shown, self._standing)

    def weigh(self) -> None:
        """Swing what is held, in another grasp where this one hardly holds it; or else its shape alone tells of it.

        What turns between the fingers though no other grasp is to be had is swung more gently.
        """
        gentle, elsewhere = 1.0, True
        for _ in range(SWINGS):
            try:
                with self._stage(self.one.name, "weigh") as told:
                    told["mass"] = swinging.weigh_held(self._tools, self.shown, self._folder, gentle)
                    assert self.shown.swung is not None
                    told["use"] = self.shown.swung.use
                return
            except (NoWay, WeighingError) as why:
                self.shown.notes.append(f"not weighed: {why}")
                firmer = elsewhere and len(self.shown.X_ST) < self._tools.learning.most_grasps
                if isinstance(why, WeighingError) and firmer and self._once_more(firm=True):
                    elsewhere = False
                elif isinstance(why, Slipping):
                    gentle *= swinging.TUNING.gentler
                else:
                    return

    def _seek(self, picked: Picked) -> None:
        """Look for what was lost where the cameras see, and go on with it; what cannot be had is told with a picture.

        What lay on the table before is something else.
        """
        known = [other.middle for other in picked.others if other.beside]
        with self._stage(self.one.name, "seek") as told:
            try:
                found = seek(self._tools, self._standing, known, partial(self._go_on, picked))
            except NoWay as why:  # as in `_let_go`
                found = Sought(f"then the arm could not go home: {why}")
            told["outcome"] = found.told
        self.one.why += f"; {found.told}"
        if found.put is not None:
            self.one.standing = found.put.numbers()
        elif found.lying is not None:
            save_picture(self._record.folder / self.one.picture, found.lying.picture, found.lying.thing, found.told)

    def _go_on(self, picked: Picked, found: LyingAbout, taken: Taken) -> PutDown:
        """Go on with what was lost and is held again, as far as it is known, and put it away; return where.

        Raises:
            NoWay, NothingHeld, StationError: it is not in the other bin.
        """
        if not self.shown.followed.shown:  # it had not been shown yet
            self._show(Picked(found.thing, taken, others=picked.others))
        elif (self._folder / SWUNG).is_file() or not self._known_again(found, taken):
            held, self.in_bin = as_lying(found.thing, found.support, taken), False
            return handling.put_away(self._tools, held, self._standing)
        else:
            self._show_again()
        self._weigh_and_put_away()
        return PutDown.of_numbers(self.one.standing)

    def _known_again(self, found: LyingAbout, taken: Taken) -> bool:
        """Show what is held again, and was shown before it was lost; whether how it is held now is known."""
        with self._stage(self.one.name, "display again") as told:
            known = handling.show_found(self._tools, self.shown, found, taken)
            told["outcome"] = "shown" if known else "not known again"
            told.update(seen_so_far(self.shown))
        return known

    def _let_go(self) -> None:
        """Leave the hand empty and the arm at home after something went wrong; keep a picture of it."""
        one, cell, self.in_bin = self.one, self._tools.cell, False
        picture = cell.look(self._tools.learning.scan_camera)
        one.picture = f"objects/{one.name}/failed.png"
        save_picture(self._record.folder / one.picture, picture, None, one.why)
        try:
            fell = handling.let_go(self._tools)
            if fell is not None:
                one.standing = fell.numbers()
                one.why += "; it was let fall into the other bin"
        except NoWay as why:  # the next look into the bin tries the way home again, and ends the run if there is none
            one.why += f"; then the arm could not go home: {why}"
