"""A second run into a folder: what the first one wrote goes, all else stays, whatever the list says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.small_loop import BLIND, small_scenario
from twin_diagram.errors import TwinError
from twin_diagram.runs import run_scenario
from twin_diagram.runs.run_folder import EVENTS, FILES, SUMMARY, RunFolder
from twin_diagram.runtime import written_files

MINE = ("notes.txt", "replay.html.bak", "healing/mine.txt", "healing/1/deep/mine.txt", "plots/arm.png", "events.json")


def fill(folder: Path) -> None:
    for name in MINE:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("mine")


def there(folder: Path) -> set[str]:
    return set(written_files.files_of(folder))


@pytest.mark.long
def test_a_second_run_removes_what_the_first_one_wrote_and_nothing_else(tmp_path: Path) -> None:
    scenario = small_scenario(*BLIND, "duration=0.05", objects=())
    fill(tmp_path)
    run_scenario(scenario, out=tmp_path, quiet=True, say=lambda text: None)
    first = there(tmp_path) - set(MINE)
    assert {FILES, SUMMARY, "replay.html", "diagram.svg", "arm.png"} <= first
    assert first == {FILES, *written_files.listed(tmp_path, FILES)}
    run_scenario(scenario, out=tmp_path, quiet=True, say=lambda text: None, pictures=False)
    assert there(tmp_path) == {*MINE, FILES, SUMMARY}
    assert all((tmp_path / name).read_text() == "mine" for name in MINE)


def test_a_run_that_is_refused_leaves_the_one_before(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.summary({"a": 1})
    before = there(tmp_path)
    scenario = small_scenario(*BLIND, "duration=0.05", objects=())
    scenario.twin.arm.joints = ["elbow"]
    with pytest.raises(TwinError):
        run_scenario(scenario, out=tmp_path, quiet=True)
    assert there(tmp_path) == before


def test_searches_are_listed_with_all_their_files(tmp_path: Path) -> None:
    fill(tmp_path)
    folder = RunFolder(tmp_path)
    folder.clear()
    search = tmp_path / "healing" / "2"
    for name in ("fit.npz", "given/arm.urdf", "model/effects.yaml"):
        (search / name).parent.mkdir(parents=True, exist_ok=True)
        (search / name).write_text("ours")
    folder.note_all(search)
    RunFolder(tmp_path).clear()
    assert there(tmp_path) == set(MINE) and not search.exists()


def test_events_begin_anew(tmp_path: Path) -> None:
    (tmp_path / EVENTS).write_text("of an earlier run\n")
    folder = RunFolder(tmp_path)
    folder.clear()
    assert there(tmp_path) == {EVENTS}, "nobody says whose it is"
    for k in range(2):
        folder.event({"event": k})
    lines = (tmp_path / EVENTS).read_text().splitlines()
    assert [json.loads(line)["event"] for line in lines] == [0, 1]


def test_events_of_a_version_without_lists_go(tmp_path: Path) -> None:
    for name in (EVENTS, SUMMARY, "mine"):
        (tmp_path / name).write_text("{}")
    RunFolder(tmp_path).clear()
    assert there(tmp_path) == {SUMMARY, "mine"}


def test_a_hostile_list(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("")
    out = tmp_path / "out"
    out.mkdir()
    (out / FILES).write_text(f"../precious\n{tmp_path / 'precious'}\n")
    RunFolder(out).clear()
    assert (tmp_path / "precious").is_file()


def test_a_stop_before_anything_began_spoils_no_summary(tmp_path: Path) -> None:
    RunFolder(None).stopped_early()
    RunFolder(tmp_path).stopped_early()
    assert json.loads((tmp_path / SUMMARY).read_text()) == {"stopped": True}
    (tmp_path / SUMMARY).write_text("of before")
    RunFolder(tmp_path).stopped_early()
    assert (tmp_path / SUMMARY).read_text() == "of before"
