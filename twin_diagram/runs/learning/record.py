"""What a run of learning remembers: events, a line a stage, and a state from which it goes on after any end."""

from __future__ import annotations

import io
import json
import re
import shutil
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np

from twin_diagram.errors import TwinError
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.one_at_work import one_at_work
from twin_diagram.runtime.output_place import why_not
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import dump_scenario, load_scenario
from twin_diagram.signals.arrays import Array

STATE: Final = "state.npz"
"""Where everything lay, and what is known of each object; written whole, or not at all."""
EVENTS: Final = "events.jsonl"
"""A line a stage."""
SCENARIO: Final = "scenario.yaml"
"""What the run is of: it goes on with that alone."""
GALLERY: Final = "gallery.html"
"""The page that shows all of it."""
SWUNG: Final = "swung.npz"
"""File of an object's torques, in its folder; of the empty hand's, in the run's."""
FILES: Final = (STATE, EVENTS, SCENARIO, GALLERY, SWUNG)
"""All that is written as a whole into the run's folder."""
LOCK: Final = "run.lock"
"""Held by the process that is at work in the folder; empty, and it stays."""
OBJECTS: Final = "objects"
"""Folder of each object's frames, torques and shape."""
LIBRARY: Final = "library"
"""Folder of the assets."""
OBJECT: Final = re.compile(r"object_[0-9]{2,}")
"""Names of objects: whatever else lies in those folders is somebody else's."""
SPARE: Final = 200_000_000
"""Bytes that must be free for a run's files: some 20 MB an object."""


class LearningError(TwinError):
    """A run of learning that cannot be, or cannot go on."""


@dataclass
class Learned:
    """What is known of one object.

    Attributes:
        name: of the asset.
        state: `handled` (in the other bin, its asset still to come), `finished`, `failed` (kept with its data) or
            `reported` (it could not be handled).
        why: what went wrong as it was handled, in words; "" where nothing did.
        no_asset: why it has none, in words; "" where nothing went wrong with that.
        grasps: in how many it was shown.
        figures: numbers for people and tables.
        standing: where it was set down, see `setting_down.PutDown`; empty: it was not.
        picture: file of a picture, below the run's folder; "": none.
        R_WS: (3, 3) by rows: axes of S, the frame of its pictures, in W when it lay in the bin.
        taken_again: as which object it was taken again, or one of its shape; "": it was not.
    """

    name: str
    state: str = "handled"
    why: str = ""
    no_asset: str = ""
    grasps: int = 0
    figures: dict[str, Any] = field(default_factory=dict)
    standing: list[float] = field(default_factory=list)
    picture: str = ""
    R_WS: list[list[float]] = field(default_factory=lambda: np.eye(3).tolist())
    taken_again: str = ""

    @property
    def told(self) -> str:
        """All that went wrong, in words."""
        again = f"it was taken again as {self.taken_again}" if self.taken_again else ""
        return "; ".join(filter(None, (self.why, self.no_asset, again)))


@dataclass
class RunState:
    """What a run goes on from.

    Attributes:
        learned: objects so far, in order.
        given_up: (3,) places in W of things that were reported, or failed too often, and still lie in the bin [m].
        failed_at: (3,) places in W from which things were taken that failed, since one was last put away [m].
        world: of `Cell.snapshot`.
        sim_time: simulated so far [s].
        finished: the bin is empty, or holds only what was reported.
        taken: things put away, or lost beside what was reported, since what was given up last had another chance.
    """

    learned: list[Learned] = field(default_factory=list)
    given_up: list[list[float]] = field(default_factory=list)
    failed_at: list[list[float]] = field(default_factory=list)
    world: dict[str, Array] = field(default_factory=dict)
    sim_time: float = 0.0
    finished: bool = False
    taken: int = 0

    def named(self, name: str) -> Learned:
        """Return what is known of an object.

        Raises:
            LearningError: no such object.
        """
        for one in self.learned:
            if one.name == name:
                return one
        told = ", ".join(one.name for one in self.learned) or "none"
        raise LearningError(f"--again {name!r}: no such object in this run; these are: {told}")


class LearningRecord:
    """The files of a run."""

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        """Name the folder; nothing is written yet."""
        self.folder, self._told = folder, dump_scenario(scenario)
        self._begun = time.monotonic()

    @property
    def library(self) -> Path:
        """Folder of the assets."""
        return self.folder / LIBRARY

    def of(self, name: str) -> Path:
        """Return the folder of an object's data."""
        return self.folder / OBJECTS / name

    @contextmanager
    def alone(self, *, new: bool) -> Iterator[None]:
        """Keep other processes out of the folder, which `begin` (`new`) or `resume` could use, until the block ends.

        Raises:
            LearningError: another process is at work in it, or it cannot be used.
        """
        if new:
            self.check_place()
            self.folder.mkdir(parents=True, exist_ok=True)
        else:
            self.check_kept()
        with one_at_work(self.folder / LOCK) as alone:
            if not alone:
                raise LearningError(
                    f"--out {self.folder}: another process is at work in it; wait for its end, or give another --out"
                )
            yield

    def begin(self) -> RunState:
        """Make the folder ready for a new run.

        Raises:
            LearningError: it cannot be written, has no room, or has another run in it.
        """
        self.check_place()
        atomic_file.write(self.folder / SCENARIO, self._told)
        (self.folder / EVENTS).unlink(missing_ok=True)
        return RunState()

    def check_place(self) -> None:
        """Refuse a folder that a new run cannot be in.

        Raises:
            LearningError: it cannot be written, has no room, or has another run in it.
        """
        if why := why_not(self.folder, folder=True):
            raise LearningError(f"--out {self.folder}: {why}")
        if (self.folder / STATE).exists():
            raise LearningError(f"--out {self.folder}: there is a run in it; --resume goes on with it")
        # Of a run that was killed before its first state events and scenario are there; no arm was swung by then.
        begun = (self.folder / SCENARIO).exists() and self._text() == self._told
        for name in (SWUNG, GALLERY) if begun else (SWUNG, GALLERY, EVENTS, SCENARIO):
            self._refuse(self.folder / name)
        for parent in (self.folder / OBJECTS, self.library):
            for path in sorted(parent.glob("*")):
                if OBJECT.fullmatch(path.name):
                    self._refuse(path)
        self._check_room()

    def _text(self) -> str:
        """Return the folder's scenario as it was written."""
        return (self.folder / SCENARIO).read_text(encoding="utf-8", errors="replace")

    def _other(self) -> str:
        """Return in words how the folder's scenario is another one than this run's; "": it is not.

        One that was written before there were all of today's fields has what these are by default.
        """
        if self._text() == self._told:
            return ""
        try:
            kept = dump_scenario(load_scenario(self.folder / SCENARIO))
        except TwinError as error:
            return f"its {SCENARIO} is none: {error}"
        lines = zip_longest(kept.splitlines(), self._told.splitlines(), fillvalue="nothing")
        return next((f"{there.strip()!r} there, {here.strip()!r} here" for there, here in lines if there != here), "")

    def _refuse(self, path: Path) -> None:
        """Refuse a folder in which something is that this run would write over."""
        if path.exists():
            name = path.relative_to(self.folder)
            raise LearningError(f"--out {self.folder}: its {name} is of something else; give another --out")

    def check_kept(self) -> None:
        """Refuse a folder without a run of this scenario that can go on.

        Raises:
            LearningError: there is none, it is another scenario's, or the folder cannot be written or has no room.
        """
        if not (self.folder / STATE).is_file():
            raise LearningError(f"--out {self.folder}: has no run to go on with")
        if why := why_not(self.folder, folder=True):
            raise LearningError(f"--out {self.folder}: {why}")
        self._check_room()
        if other := self._other():
            raise LearningError(
                f"--out {self.folder}: a run of another scenario ({other}); give its own {SCENARIO}, or another --out"
            )

    def resume(self) -> RunState:
        """Return the state that a run was left in.

        Raises:
            LearningError: there is none, it cannot be read, or it is another scenario's.
        """
        self.check_kept()
        try:
            state = self._read_state()
        except (BadZipFile, KeyError, TypeError, EOFError, ValueError, AttributeError, zlib.error) as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise LearningError(
                f"--resume: {self.folder / STATE} cannot be read: {why}; begin anew with another --out"
            ) from error
        self._tidy(state)
        return state

    def _read_state(self) -> RunState:
        with np.load(self.folder / STATE, allow_pickle=False) as data:
            told = json.loads(str(data["told"]))
            world = {key.removeprefix("world_"): data[key] for key in data.files if key.startswith("world_")}
        learned = [Learned(**one) for one in told["learned"]]
        rest = told["sim_time"], told["finished"], told.get("taken", 0)
        return RunState(learned, told["given_up"], told.get("failed_at", []), world, *rest)

    def save(self, state: RunState) -> None:
        """Write the state, whole; then of what was taken again the second asset alone is left."""
        told = {
            "learned": [asdict(one) for one in state.learned],
            **{"given_up": state.given_up, "failed_at": state.failed_at},
            **{"sim_time": state.sim_time, "finished": state.finished, "taken": state.taken},
        }
        data = io.BytesIO()
        arrays: dict[str, Any] = {f"world_{key}": value for key, value in state.world.items()}
        np.savez(data, told=np.array(json.dumps(told)), **arrays)
        atomic_file.write(self.folder / STATE, data.getvalue())
        for one in state.learned:
            if one.taken_again:
                shutil.rmtree(self.library / one.name, ignore_errors=True)

    def event(self, **what: Any) -> None:
        """Add a line to the events."""
        line = json.dumps({"wall": round(time.monotonic() - self._begun, 2), **what}, ensure_ascii=False)
        with (self.folder / EVENTS).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def unasked(self) -> int:
        """Return how many contacts the events hold that no step asked for, those before a resumption among them."""
        file = self.folder / EVENTS
        lines = file.read_text(encoding="utf-8", errors="ignore").splitlines() if file.is_file() else []
        return sum('"stage": "contact"' in line for line in lines)

    def fresh(self, name: str) -> Path:
        """Return an empty folder for an object's data."""
        folder = self.of(name)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def _check_room(self) -> None:
        above = next(way for way in (self.folder.absolute(), *self.folder.absolute().parents) if way.exists())
        free = shutil.disk_usage(above).free
        if free < SPARE:
            raise LearningError(
                f"--out {self.folder}: {free / 1e6:.0f} MB are free there, {SPARE / 1e6:.0f} are needed"
            )

    def _tidy(self, state: RunState) -> None:
        """Remove what a killed run left half done: files written aside, objects that no state knows, half a line."""
        known = {one.name for one in state.learned}
        # What others keep in these folders, hidden or not, is not touched: `--out` may be any folder.
        for parent in (self.folder, self.library):
            for path in sorted(parent.glob(".*")):
                name = atomic_file.unfinished(path)
                if name and path.is_dir() and parent == self.library and OBJECT.fullmatch(name):
                    shutil.rmtree(path, ignore_errors=True)
                elif name and path.is_file() and parent == self.folder and name in FILES:
                    path.unlink()
        for path in sorted((self.folder / OBJECTS).glob("*")):
            if OBJECT.fullmatch(path.name) and path.name not in known and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
        events = self.folder / EVENTS
        if events.is_file():
            text = events.read_text(encoding="utf-8", errors="ignore")
            if text and not text.endswith("\n"):
                atomic_file.write(events, text[: text.rfind("\n") + 1])


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures as JSON has them: arrays as lists, numbers rounded to six places that count."""

    def one(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return [one(item) for item in value.tolist()]
        if isinstance(value, (list, tuple)):
            return [one(item) for item in value]
        if isinstance(value, (float, np.floating)):
            return float(f"{float(value):.6g}")
        return value

    return {key: one(value) for key, value in values.items()}
