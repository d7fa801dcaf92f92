"""What a run of learning keeps: a state that is whole or not there, and refusals of one line."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from twin_diagram.runs.learning.record import Learned, LearningError, LearningRecord, RunState, plain
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import copy_scenario


def begun(folder: Path, scenario: Scenario | None = None) -> tuple[LearningRecord, RunState]:
    record = LearningRecord(folder, scenario or Scenario())
    return record, record.begin()


def filled(folder: Path) -> tuple[LearningRecord, RunState]:
    record, state = begun(folder)
    state.learned = [Learned("object_01", figures=plain({"mass": 0.5, "size": np.array([0.1, 0.2, 0.3])}))]
    state.world, state.sim_time = {"positions": np.arange(5.0)}, 12.5
    record.fresh("object_01")
    record.save(state)
    return record, state


def test_a_state_comes_back_as_it_was_saved(tmp_path: Path) -> None:
    _, state = filled(tmp_path / "run")
    back = LearningRecord(tmp_path / "run", Scenario()).resume()
    assert back.learned == state.learned and back.sim_time == 12.5 and not back.finished
    assert (back.world["positions"] == np.arange(5.0)).all()


def test_what_a_killed_run_left_half_done_goes_and_what_is_finished_stays(tmp_path: Path) -> None:
    record, _ = filled(tmp_path / "run")
    record.event(object="object_01", stage="pick")
    with (record.folder / "events.jsonl").open("a") as file:
        file.write('{"object": "object_02", "sta')
    record.fresh("object_02")
    (record.library / ".object_02.ab_c0123").mkdir(parents=True)
    (record.library / "object_01").mkdir()
    (record.folder / ".state.npz.77.part").write_text("half")
    again = LearningRecord(record.folder, Scenario())
    again.resume()
    assert sorted(path.name for path in (record.folder / "objects").iterdir()) == ["object_01"]
    assert [path.name for path in record.library.iterdir()] == ["object_01"]
    assert not list(record.folder.glob(".*"))
    events = [json.loads(line) for line in (record.folder / "events.jsonl").read_text().splitlines()]
    assert [event["stage"] for event in events] == ["pick"]


def test_resuming_touches_nothing_that_others_keep_in_the_folder(tmp_path: Path) -> None:
    record, _ = filled(tmp_path / "run")
    foreign = {".git/config", ".env", ".vimrc.personal/x", ".notes.77.part", "objects/.git/config", "library/.env"}
    foreign |= {"objects/mug/model.sdf", "objects/object_drawing", "library/.mug.12345678/x", "library/.git/config"}
    foreign |= {"objects/.object_01.12345678/x", ".git.12345678/x"}
    for name in foreign:
        (record.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (record.folder / name).write_text("theirs")
    (record.folder / ".swung.npz.77.part").write_text("half")
    LearningRecord(record.folder, Scenario()).resume()
    left = {str(path.relative_to(record.folder)) for path in record.folder.rglob("*") if path.is_file()}
    assert left == foreign | {"state.npz", "scenario.yaml"}


def test_a_run_goes_on_whose_scenario_was_written_before_there_were_all_of_todays_fields(tmp_path: Path) -> None:
    record, _ = filled(tmp_path / "run")
    kept = record.folder / "scenario.yaml"
    whole = yaml.safe_load(kept.read_text())
    del whole["replay"]["torque_constants"], whole["twin"]["camera"]
    kept.write_text(yaml.dump(whole))
    assert len(LearningRecord(record.folder, Scenario()).resume().learned) == 1
    for text, why in (
        (kept.read_text().replace("seed: 0", "seed: 5"), "'seed: 5' there, 'seed: 0' here"),
        ("nobody_knows: 1", "nobody_knows"),
        ("a: [", "scenario.yaml is none"),
    ):
        kept.write_text(text)
        with pytest.raises(LearningError, match=why) as error:
            LearningRecord(record.folder, Scenario()).resume()
        assert "\n" not in str(error.value)


def test_refusals_are_one_line_and_write_nothing(tmp_path: Path) -> None:
    filled(tmp_path / "run")
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "events.jsonl").write_text("{}\n")
    # Another bin's empty hand: its gains and biases are those of another arm.
    begun(tmp_path / "swung")
    (tmp_path / "swung" / "swung.npz").write_bytes(b"")
    other = copy_scenario(Scenario())
    other.seed = 77
    # A scenario with its author's comments, and a library of somebody's assets.
    theirs = {"own": "scenario.yaml", "page": "gallery.html", "assets": "library/object_01/model.sdf"}
    for folder, name in theirs.items():
        (tmp_path / folder / name).parent.mkdir(parents=True)
        (tmp_path / folder / name).write_text("# theirs\n")
    for call, words in (
        (LearningRecord(tmp_path / "run", other).resume, r"another scenario \('seed: 0' there, 'seed: 77' here\)"),
        (LearningRecord(tmp_path / "none", Scenario()).resume, "no run to go on with"),
        (lambda: LearningRecord(tmp_path / "none", Scenario()).alone(new=False).__enter__(), "no run to go on with"),
        (LearningRecord(tmp_path / "run", Scenario()).begin, "--resume goes on"),
        (LearningRecord(tmp_path / "run" / "state.npz" / "x", Scenario()).begin, "--out"),
        (LearningRecord(tmp_path / "theirs", Scenario()).begin, "events.jsonl is of something else"),
        (LearningRecord(tmp_path / "swung", Scenario()).begin, "swung.npz is of something else"),
        (LearningRecord(tmp_path / "own", Scenario()).begin, "scenario.yaml is of something else"),
        (LearningRecord(tmp_path / "page", Scenario()).begin, "gallery.html is of something else"),
        (LearningRecord(tmp_path / "assets", Scenario()).begin, "library/object_01 is of something else"),
        (lambda: filled(tmp_path / "more")[1].named("object_09"), "object_01"),
    ):
        with pytest.raises(LearningError, match=words) as error:
            call()
        assert "\n" not in str(error.value)
    assert not (tmp_path / "none").exists()
    assert [path.name for path in (tmp_path / "theirs").iterdir()] == ["events.jsonl"]
    assert all((tmp_path / folder / name).read_text() == "# theirs\n" for folder, name in theirs.items())


@pytest.mark.parametrize(
    "damage",
    [
        lambda whole: b"",
        lambda whole: b"no archive",
        lambda whole: whole[:-40],
        lambda whole: whole.replace("finished".encode("utf-32-le"), "finishes".encode("utf-32-le")),
        lambda whole: packed(other=np.zeros(2)),
        lambda whole: packed(told=np.array("[]")),
        lambda whole: packed(told=np.array('{"learned": [{"nme": 1}]}')),
        lambda whole: packed(told=np.array("{")),
    ],
)
def test_a_damaged_state_is_told_in_a_line(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    record, _ = filled(tmp_path / "run")
    record.fresh("object_02")
    file = record.folder / "state.npz"
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(LearningError, match=r"^--resume: .*state\.npz cannot be read: ") as error:
        record.resume()
    assert "\n" not in str(error.value) and record.of("object_02").is_dir()


def packed(**arrays: np.ndarray) -> bytes:
    data = io.BytesIO()
    np.savez(data, **arrays)  # type: ignore[arg-type]
    return data.getvalue()


def test_a_disk_without_room_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin_diagram.runs.learning.record.SPARE", 10**18)
    with pytest.raises(LearningError, match="MB are free"):
        begun(tmp_path / "run")
