"""What cannot be learned in is refused at the start, in one line that names the field."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.runs.learning import start
from twin_diagram.runs.learning.command import add_learn_command
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.record import Learned, LearningError, LearningRecord, RunState
from twin_diagram.runs.learning.shape_worker import FRAMES
from twin_diagram.runs.learning.start import check_cell, learn, learn_again
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import load_scenario


def changed(*overrides: str) -> Scenario:
    return load_scenario("bin_picking", overrides)


def test_the_scenario_that_comes_along_can_be() -> None:
    learning = check_cell(changed())
    assert learning.bin_camera == "bin" and learning.tries == 3


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: check_cell(changed("twin.learning=null")), "twin.learning: is missing"),
        (lambda: check_cell(changed("twin.cameras.bin.X_WC.translation=[0.4, 0.9, 0.9]")), "not see the bin"),
        (lambda: check_cell(changed("twin.cameras.scan.X_WC.rpy=[0.0, 0.0, 0.0]")), "not see the platform"),
        (
            lambda: check_cell(changed("twin.learning.scan_camera=other")),
            "scan_camera.*none of twin.cameras: bin, scan",
        ),
        (lambda: check_cell(changed("twin.learning.from_bin=[[1, 1, 1], [0, 0, 0]]")), "twin.learning.from_bin"),
        (
            lambda: check_cell(changed("twin.arm={model: arms/iiwa7.urdf, tool_frame: iiwa_link_ee}")),
            r"twin.arm.model: arms/iiwa7.urdf has no gripper",
        ),
        (lambda: check_cell(changed("twin.arm.tool_frame=other")), "twin.arm.tool_frame: .*no frame 'other'"),
        (lambda: check_cell(changed("station=lcm")), "station: 'lcm'.*simulated"),
        (lambda: check_cell(changed("station=replay")), "station: 'replay'.*simulated"),
        (lambda: check_cell(changed("twin.learning.tries=0")), "twin.learning.tries"),
    ],
)
def test_refusals(make: Callable[[], object], words: str) -> None:
    with pytest.raises(ScenarioError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


def test_a_place_to_show_things_at_that_is_not_reached_is_refused() -> None:
    """Each object was taken, and let fall unlearned into the other bin."""
    scenario = changed()
    mover = Mover(scenario.twin, {}, np.ones(7), 0)
    home = np.array(scenario.twin.home)
    for place, reached in (([0.58, 0.0, 0.45], True), ([2.0, 0.0, 0.45], False), ([0.52, 0.0, 0.02], False)):
        learning = check_cell(changed(f"twin.learning.display={place}"))
        tools: Any = SimpleNamespace(mover=mover, learning=learning, home=home)
        if reached:
            start.check_display(tools)
            continue
        with pytest.raises(ScenarioError, match=r"twin.learning.display: \[.*do not get there") as error:
            start.check_display(tools)
        assert "\n" not in str(error.value)


def test_the_command_ends_with_2_and_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "twin_diagram", "learn", "tabletop", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stderr.startswith("error: twin.learning") and done.stderr.count("\n") == 1
    assert not out.exists()


def test_a_folder_in_which_another_process_is_at_work_is_left_alone(tmp_path: Path) -> None:
    scenario = changed()
    record = LearningRecord(tmp_path / "run", scenario)
    calls: list[Callable[[], object]] = [
        lambda: learn(scenario, record.folder, resume=True),
        lambda: learn_again(scenario, record.folder, "object_01"),
    ]
    with record.alone(new=True):
        with (
            pytest.raises(LearningError, match="another process is at work"),
            LearningRecord(record.folder, scenario).alone(new=True),
        ):
            pass
        record.save(record.begin())
        record.fresh("object_01")  # in hand: no state knows it yet
        for call in calls:
            with pytest.raises(LearningError, match=r"another process is at work.*wait") as error:
                call()
            assert "\n" not in str(error.value)
        assert record.of("object_01").is_dir()
    with pytest.raises(LearningError, match="no such object"):  # its end frees the folder
        learn_again(scenario, record.folder, "object_01")


def test_a_new_run_holds_its_folder_until_it_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, ran = changed(), []

    class Looker:
        def __init__(self, tools: object, record: LearningRecord, state: RunState, say: object) -> None:
            self.record, self.state = record, state

        def run(self) -> None:
            self.record.save(self.state)
            with pytest.raises(LearningError, match="another process"):
                learn(scenario, self.record.folder, resume=True)
            ran.append(True)

    monkeypatch.setattr(start, "tools_of", lambda *_: SimpleNamespace(cell=SimpleNamespace(observer=None)))
    monkeypatch.setattr(start, "check_display", lambda tools: None)
    monkeypatch.setattr(start, "Learner", Looker)
    for resume in (False, True):
        learn(scenario, tmp_path / "run", resume=resume)
    assert len(ran) == 2


def test_a_disk_that_fills_up_on_the_way_is_told_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Writer:
        def __init__(self, tools: object, record: LearningRecord, state: RunState, say: object) -> None:
            self.record, self.state = record, state

        def run(self) -> None:
            self.record.save(self.state)
            (self.record.folder / "events.jsonl").symlink_to("/dev/full")
            self.record.event(stage="camera")

    monkeypatch.setattr(start, "tools_of", lambda *_: SimpleNamespace(cell=SimpleNamespace(observer=None)))
    monkeypatch.setattr(start, "check_display", lambda tools: None)
    monkeypatch.setattr(start, "Learner", Writer)
    with pytest.raises(LearningError, match=r"--out .*/run: No space left on device; .*--resume goes on") as error:
        learn(changed(), tmp_path / "run")
    assert "\n" not in str(error.value) and (tmp_path / "run" / "state.npz").is_file()


@pytest.mark.parametrize("fault", ["", "shape", "asset"])
def test_again_keeps_what_was_told_and_an_asset_that_cannot_be_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    scenario = changed()
    record = LearningRecord(tmp_path / "run", scenario)
    state = record.begin()
    state.learned = [Learned("object_01", "finished", "it was lost; it was found and put away")]
    (record.fresh("object_01") / FRAMES).mkdir()
    record.save(state)

    def make_shape(folder: Path) -> None:
        if fault == "shape":
            raise ValueError("no surface")

    def finish(record: LearningRecord, one: Learned, model: object) -> None:
        if fault:
            one.state, one.no_asset = "failed", "no body"

    monkeypatch.setattr(start, "make_shape", make_shape)
    monkeypatch.setattr(start, "finish", finish)
    if fault:
        with pytest.raises(LearningError, match=r"--again object_01: .*no (body; the asset.*stays|surface)") as error:
            learn_again(scenario, record.folder, "object_01", lambda text: None)
        assert "\n" not in str(error.value)
    else:
        learn_again(scenario, record.folder, "object_01", lambda text: None)
    (one,) = record.resume().learned
    assert (one.state, one.told) == ("finished", "it was lost; it was found and put away")


def test_again_and_resume_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    add_learn_command(parser.add_subparsers())
    with pytest.raises(SystemExit) as end:
        parser.parse_args(["learn", "bin_picking", "--out", "run", "--resume", "--again", "object_01"])
    assert end.value.code == 2 and "not allowed with" in capsys.readouterr().err
