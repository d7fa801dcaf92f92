"""What is hung on a closed loop that is being built: eyes (meshcat, Meldis), memory (recording, log) and mending."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from twin_diagram.errors import LogError
from twin_diagram.logs import log_from_columns, write_log
from twin_diagram.runs.run_folder import RunFolder
from twin_diagram.runtime import atomic_file
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import copy_scenario, dump_scenario
from twin_diagram.station import ports
from twin_diagram.station.replay.recorder import add_recorder, open_recording
from twin_diagram.station.replay.recording import RecordingWriter
from twin_diagram.station.replay.recording_folder import LOG, SCENARIO_FILE
from twin_diagram.twin.healing import Healer, Tape, sentence
from twin_diagram.twin.twin import TwinDiagram
from twin_diagram.visualization.arm_overlay import ArmOverlay
from twin_diagram.visualization.ghost import make_ghost
from twin_diagram.visualization.meldis import add_meldis
from twin_diagram.visualization.meshcat import FRAME_RATE, MeshcatScenes, add_meshcat, open_meshcat
from twin_diagram.visualization.scene_overlay import MeshcatOverlay
from twin_diagram.visualization.view import points_along, view_of_arm


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    most_frames: int = 300
    """Of a page. Each takes memory, in the run and in the browser; a longer run is shown with fewer per second."""

    spare: float = 5.0
    """The tape holds this much more than a search takes [s]."""


TUNING = Tuning()

Say = Callable[[str], None]


class Looking:
    """Shows the real scene and the twin's: in one meshcat, live or recorded, and to Meldis."""

    def __init__(self, meshcat: bool = True, meldis: bool = False, recorded: float | None = None) -> None:
        """Open what is looked through.

        Args:
            meshcat: opens a server that this machine alone reaches.
            meldis: publishes on Drake's default LCM URL.
            recorded: length of a run that is kept as a page [s]; None: no frame is kept.
        """
        self._recorded = recorded
        self._meshcat: Meshcat | None = open_meshcat() if meshcat else None
        self._lcm = DrakeLcm() if meldis else None
        self.scenes: MeshcatScenes | None = None

    def add(self, builder: DiagramBuilder, station: System, twin: TwinDiagram) -> None:
        """Add visualisers."""
        real = station.GetOutputPort(ports.QUERY_OBJECT) if station.HasOutputPort(ports.QUERY_OBJECT) else None
        if real is not None:
            make_ghost(twin.scene)
        query = twin.diagram.GetOutputPort("query_object")
        if self._lcm is not None:
            add_meldis(builder, self._lcm, query, real)
        if self._meshcat is not None:
            self._add_meshcat(self._meshcat, builder, twin, query, real)

    def _add_meshcat(
        self, meshcat: Meshcat, builder: DiagramBuilder, twin: TwinDiagram, query: OutputPort, real: OutputPort | None
    ) -> None:
        rate = FRAME_RATE if self._recorded is None else min(FRAME_RATE, TUNING.most_frames / self._recorded)
        self.scenes = add_meshcat(builder, meshcat, query, real, rate)
        self.scenes.set_view(*view_of_arm(points_along(twin.scene)))
        plan = twin.diagram.GetOutputPort("plan")
        overlay = MeshcatOverlay(meshcat, twin.scene, plan.size() // len(twin.model.joints), min(rate, 15.0))
        builder.AddNamedSystem("overlay", overlay)
        for name in ("plan", "tracks", "goal"):
            builder.Connect(twin.diagram.GetOutputPort(name), overlay.GetInputPort(name))
        size = twin.diagram.GetOutputPort("covariance").size()
        arm = builder.AddNamedSystem("arm_overlay", ArmOverlay(meshcat, twin.scene, size, min(rate, 15.0)))
        for name in ("arm_state", "covariance", "position_previewed", "preview_covariance"):
            builder.Connect(twin.diagram.GetOutputPort(name), arm.GetInputPort(name))
        if twin.runner is not None:
            builder.Connect(twin.diagram.GetOutputPort("task.hand"), arm.GetInputPort("hand"))

    def start(self, simulator: Simulator, live: bool, say: Say) -> None:
        """Begin to record, where a page is kept; live, run no faster than real time and say where to look."""
        if self.scenes is not None and self._recorded is not None:
            self.scenes.start_recording()
        if live:
            simulator.set_target_realtime_rate(1.0)
            if self._meshcat is not None:
                say(f"watch at {self._meshcat.web_url()}")
            if self._lcm is not None:
                say(
                    "watch in a Meldis that was there before (python -m pydrake.visualization.meldis -w): "
                    "DRAKE_VIEWER is what is real, Visual Geometry the twin's"
                )


class Keeping:
    """What is recorded of the station while it runs; dropped where the run fails."""

    def __init__(self, scenario: Scenario, record: Path | None, log: Path | None, stack: ExitStack) -> None:
        """`stack` closes what is opened.

        Raises:
            TwinError: a recording or a log cannot go where it is asked to.
        """
        self._writer: RecordingWriter | None = None
        self._scenario = scenario
        self._converter: _Converter | None = None
        if record is None and log is None:
            return
        if record is None:
            # A log alone is a recording without images, made aside.
            scenario = copy_scenario(scenario)
            scenario.twin.camera, scenario.twin.cameras = None, {}
            record = Path(stack.enter_context(TemporaryDirectory())) / "recording"
        self._scenario = scenario
        rows = None
        if log is not None:
            rows = stack.enter_context(TemporaryFile())
            self._converter = stack.enter_context(_Converter(record / LOG, rows, log))
        self._writer = stack.enter_context(open_recording(scenario, record, rows))
        self._writer.attach(SCENARIO_FILE, dump_scenario(scenario))

    def add(self, builder: DiagramBuilder, station: System, twin: TwinDiagram) -> None:
        """Add a recorder to a loop that is being built."""
        if self._writer is not None:
            add_recorder(builder, station, self._writer, twin.diagram.GetOutputPort(ports.POSITION_COMMANDED))

    def cut(self, duration: float) -> None:
        """Have what is kept end here: the user stopped the run after `duration` [s]."""
        if self._converter is not None:
            self._converter.cut = True
        if self._writer is not None:
            scenario = copy_scenario(self._scenario)
            scenario.duration = duration
            self._writer.attach(SCENARIO_FILE, dump_scenario(scenario))


class Mending:
    """What an alarm leads to: events in a file, and where the scenario asks for it, a model that is mended."""

    def __init__(self, scenario: Scenario, out: RunFolder, say: Say) -> None:
        """`out` gets ``events.jsonl`` and ``healing/``; `say` takes what alarms lead to."""
        self._scenario, self._out, self._say = scenario, out, say
        self._tape: Tape | None = None
        self._search: Path | None = None

    def add(self, builder: DiagramBuilder, station: System, twin: TwinDiagram) -> None:
        """Add a tape to a loop that is being built, where the twin is to mend its model."""
        healing = self._scenario.twin.healing
        if healing is None:
            return
        commanded = twin.diagram.GetOutputPort(ports.POSITION_COMMANDED)
        rate, seconds = self._scenario.twin.driver.rate, healing.seconds + TUNING.spare
        self._tape = Tape(builder, station, commanded, twin.model.joints, rate=rate, seconds=seconds)

    def healer(self, twin: TwinDiagram) -> Healer:
        """Return the healer of a loop that is built; to be polled between its steps, and closed."""
        folder = None if self._out.path is None else self._out.path / "healing"
        healing = self._scenario.twin.healing
        if healing is not None and healing.answer_after is None and self._scenario.station == "replay":
            # A recording does not wait; run faster than it was made it would be over before the search is.
            healing = replace(healing, answer_after=0.0)
        return Healer(twin, healing, self._journal, self._tape, folder, self._scenario.packages)

    def _journal(self, event: dict[str, Any]) -> None:
        if event["event"] != "alarm":  # those stand in the summary
            self._say(f"{event['time']:.2f} s: {sentence(event)}")
        self._out.event(event)
        self._search = Path(event["folder"]) if event.get("folder") else self._search
        if self._search is not None:
            self._out.note_all(self._search)  # once begun, and again when there is an answer


class _Converter(AbstractContextManager["_Converter"]):
    """Writes a recording's log as `log`, unless the run failed; from its rows, since text takes a minute per hour.

    Attributes:
        cut: whether the run was stopped, perhaps before there were enough messages to make a log.
    """

    def __init__(self, source: Path, rows: IO[bytes], log: Path) -> None:
        self._source, self._rows, self._log, self.cut = source, rows, log, False

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is not None:
            return
        with self._source.open(encoding="utf-8") as file:
            names = file.readline().rstrip("\n").split(",")
        self._rows.seek(0)
        table = np.frombuffer(self._rows.read()).reshape(-1, len(names))
        try:
            columns = {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(names)}
            log = log_from_columns(columns, str(self._source), lambda sample: f"line {sample + 2}")
        except LogError:
            if self.cut:
                return
            raise
        if self._log.suffix == ".csv" and list(log.columns()) == names:
            atomic_file.write(self._log, self._source.read_bytes())  # to the bit what `write_log` would write
        else:
            write_log(log, self._log)
