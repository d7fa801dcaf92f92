"""Files and folders are written whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from twin_diagram.runtime import atomic_file


def tree(path: Path) -> dict[str, str]:
    return {str(p.relative_to(path)): p.read_text() for p in sorted(path.rglob("*")) if p.is_file()}


def test_a_folder_takes_the_place_of_an_old_one(tmp_path: Path) -> None:
    place = tmp_path / "new" / "out"
    for text in ("first", "second"):
        with atomic_file.folder(place) as aside:
            (aside / text).write_text(text)
        assert tree(tmp_path) == {f"new/out/{text}": text}


def test_only_its_parts_are_replaced_where_they_are_named(tmp_path: Path) -> None:
    for name in ("own", "old", "kept"):
        (tmp_path / name).write_text(name)
    with atomic_file.folder(tmp_path, ("own", "old", "never")) as aside:
        assert aside.parent == tmp_path
        (aside / "own").write_text("changed")
    assert tree(tmp_path) == {"kept": "kept", "own": "changed"}


def test_a_full_disk_is_told_with_the_files_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system names none."""

    def full(path: Path, content: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left") as caught:
        atomic_file.write(tmp_path / "summary.json", "x")
    assert caught.value.filename == str(tmp_path / "summary.json")


def test_what_is_cut_off_is_known_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str | None] = []
    with monkeypatch.context() as patch:
        patch.setattr("os.replace", lambda part, _: seen.append(atomic_file.unfinished(part)))
        atomic_file.write(tmp_path / "a.b", "x")
    assert seen == ["a.b"] and atomic_file.unfinished(atomic_file.make_aside(tmp_path / "a.b")) == "a.b"
    (tmp_path / ".git").mkdir()
    (tmp_path / ".env").write_text("x")
    (tmp_path / ".a.12345678").symlink_to(tmp_path / ".git")
    assert [atomic_file.unfinished(tmp_path / name) for name in (".git", ".env", ".a.12345678")] == [None] * 3


@pytest.mark.parametrize("parts", [(), ("a",)])
def test_a_failure_leaves_what_was_there(tmp_path: Path, parts: tuple[str, ...]) -> None:
    place = tmp_path / "out"
    place.mkdir()
    (place / "a").write_text("old")
    with pytest.raises(RuntimeError), atomic_file.folder(place, parts) as aside:
        (aside / "a").write_text("half")
        raise RuntimeError
    assert tree(tmp_path) == {"out/a": "old"}
    with pytest.raises(IsADirectoryError):
        atomic_file.write(place, "a file where there is a folder")
    assert tree(tmp_path) == {"out/a": "old"}


def test_a_failure_leaves_no_folder_that_was_made_for_it(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(RuntimeError), atomic_file.folder(tmp_path / "there" / "new" / "newer" / "out"):
        raise RuntimeError
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_full_disk_is_told_with_the_folder(tmp_path: Path) -> None:
    """Of a file that is open the system names none."""
    with pytest.raises(OSError, match="No space left") as caught, atomic_file.folder(tmp_path / "out"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert caught.value.filename == str(tmp_path / "out")
