"""Lists of what was written: they remove that, and nothing else, whatever somebody wrote into them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from twin_diagram.runtime import written_files

LIST = "list.txt"


def tree(folder: Path) -> set[str]:
    return set(written_files.files_of(folder))


def fill(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    return folder


def test_what_is_listed_goes_and_all_else_stays(tmp_path: Path) -> None:
    fill(tmp_path, "a", "b/c", "b/d/e", "f/g", "mine", "f/mine", "b/d/x/mine")
    written_files.note(tmp_path, LIST, ["a", "b/c"])
    written_files.note(tmp_path, LIST, ["b/d/e", "f/g", "never/written"])
    written_files.remove(tmp_path, LIST)
    assert tree(tmp_path) == {"mine", "f/mine", "b/d/x/mine"}
    written_files.remove(tmp_path, LIST)  # without a list there is nothing to remove
    assert tree(tmp_path) == {"mine", "f/mine", "b/d/x/mine"}


def test_folders_that_it_empties_go_and_others_stay(tmp_path: Path) -> None:
    fill(tmp_path, "a/b/c")
    (tmp_path / "a" / "empty").mkdir()
    (tmp_path / "other").mkdir()
    written_files.note(tmp_path, LIST, ["a/b/c", "other"])
    written_files.remove(tmp_path, LIST)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "empty", "other"]


@pytest.mark.parametrize(
    "line",
    [
        "../precious",
        "/precious",
        "{outside}/precious",
        "in/../../precious",
        "in//../../precious",
        "./in/../../precious",
        "link/precious",
        "link/../precious",
        "in/link/precious",
        "..",
        ".",
        "",
        "link",
        "in",
        "in\0/x",
        "x" * 5000,
    ],
)
def test_a_list_reaches_nothing_outside(line: str, tmp_path: Path) -> None:
    outside, folder = fill(tmp_path, "outside/precious", "precious"), tmp_path / "outside" / "folder"
    fill(folder, "in/mine")
    (folder / "link").symlink_to(outside / "outside", target_is_directory=True)
    (folder / "in" / "link").symlink_to(outside / "outside", target_is_directory=True)
    (folder / LIST).write_bytes(line.replace("{outside}", str(tmp_path / "outside")).encode() + b"\n")
    written_files.remove(folder, LIST)
    assert (tmp_path / "outside" / "precious").is_file() and (tmp_path / "precious").is_file()
    assert (folder / "in" / "mine").is_file()
    assert not (folder / LIST).exists()


def test_a_list_that_is_a_link_or_no_text_is_none(tmp_path: Path) -> None:
    folder = fill(tmp_path, "folder/mine", "elsewhere") / "folder"
    (tmp_path / "elsewhere").write_text("mine\n")
    (folder / LIST).symlink_to(tmp_path / "elsewhere")
    written_files.remove(folder, LIST)
    assert (folder / "mine").is_file() and (tmp_path / "elsewhere").is_file()
    (folder / LIST).unlink()
    (folder / LIST).write_bytes(b"\xff\xfe\n\x00\n[1, 2\n" + os.urandom(200))
    written_files.remove(folder, LIST)
    assert tree(folder) == {"mine"}


def test_what_versions_without_lists_wrote(tmp_path: Path) -> None:
    fill(tmp_path, "a", "b/c", "mine")
    written_files.remove(tmp_path, LIST, ["a", "b/c", "../b"])
    assert tree(tmp_path) == {"mine"}
    fill(tmp_path, "a", "b")
    written_files.note(tmp_path, LIST, ["b"])
    written_files.remove(tmp_path, LIST, ["a"])
    assert tree(tmp_path) == {"mine", "a"}, "a list says it all"


def test_moving_joins_folders_and_begins_with_what_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill(tmp_path, "new/a", "new/sub/b", "new/z", "old/a", "old/sub/mine")
    order: list[str] = []
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: order.append(Path(b).name) or replace(a, b))
    written_files.move(tmp_path / "new", tmp_path / "old", first="z")
    assert order[0] == "z"
    assert tree(tmp_path) == {"old/a", "old/sub/b", "old/sub/mine", "old/z"}
    assert (tmp_path / "old" / "a").read_text() == "new/a" and not (tmp_path / "new").exists()
