"""What a run of learning keeps: a state that is whole or not there, and refusals of one line."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from twin_diagram.runs.learning.gallery import write_gallery
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


def test_the_gallery_is_one_file_that_shows_what_failed(tmp_path: Path) -> None:
    record, state = filled(tmp_path / "run")
    state.learned[0].state = "finished"
    cloud = record.library / "object_01"
    cloud.mkdir(parents=True)
    points = np.random.default_rng(0).normal(size=(50, 3))
    np.savez(
        cloud / "cloud.npz",
        points=points,
        normals=points / np.linalg.norm(points, axis=1)[:, None],
        colours=np.full((50, 3), 0.5),
    )
    state.learned[0].grasps = 2
    state.learned[0].figures |= {
        "mass_std": 0.001,
        "centre_std": [0.0005, 0.0006, 0.0007],
        "moments": [1e-4, 2e-4, 3e-4],
        "moments_std": [1e-6, 2e-6, 6.3e-5],
        "by": {"mass": "measured", "centre": "measured", "inertia": "from shape alone"},
        "not weighed": "its log is empty",
        "pictures": 70,
        "slips": [[12, 0.004, 0.1]],
        "notes": ["shown in 2 grasps only: out of reach"],
    }
    state.learned.append(Learned("reported_01", "reported", "too wide <for> the fingers"))
    state.learned.append(Learned("object_02", "failed", "it was lost", "no frames"))
    write_gallery(record, state)
    page = (record.folder / "gallery.html").read_text()
    assert "1 of 3 finished, 1 reported, 1 failed" in page and "too wide &lt;for&gt; the fingers" in page
    assert "500 ± 2 g" in page and "± 0.98, ± 1.2, ± 1.4 mm" in page and "100 ± 2, 200 ± 3.9, 300 ± 120 kg·mm²" in page
    assert '<td class="guess">100 ± 2' in page, "what was not measured stands out"
    assert page.count("--again") == 1 and "--again object_02" in page, "what has a second try is told how"
    state.learned[0].figures["centre"] = [0.0021, -0.014, 0.0]
    write_gallery(record, state)
    told = "2.1 ± 0.98, -14 ± 1.2, 0 ± 1.4 mm off the middle of its box, measured"
    assert told in (record.folder / "gallery.html").read_text()
    assert "its log is empty" in page and "out of reach" in page and "it was lost; no frames" in page
    assert "70 pictures in 2 grasps; slipped by 4 mm and 6°" in page
    assert page.count("<canvas") == 1 and "http" not in page.replace("http-equiv", "")
    (drawn,) = json.loads(page.split('id="data">')[1].split("</script>")[0])["object_01"]
    facing = np.frombuffer(base64.b64decode(drawn["normals"]), np.int8).reshape(-1, 3)
    np.testing.assert_allclose(facing / 127.0, points / np.linalg.norm(points, axis=1, keepdims=True), atol=0.005)
    spread = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)
    assert np.median(spread[:, 1]) < drawn["disc"] < spread[:, 10].max(), "discs close the gaps between points"
