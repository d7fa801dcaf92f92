"""Whether something can be written is found out at once, and by trying."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from twin_diagram.runtime import output_place
from twin_diagram.runtime.output_place import why_not


@pytest.mark.parametrize("folder", [True, False])
def test_room_is_found_and_left_as_it_was(folder: bool, tmp_path: Path) -> None:
    assert why_not(tmp_path / "a" / "b" / "c", folder=folder) is None
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_may_be_written_over(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert why_not(tmp_path, folder=True) is None and why_not(tmp_path / "file", folder=False) is None


def test_what_is_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "lost").symlink_to(tmp_path / "nowhere")
    assert why_not(tmp_path / "file", folder=True) == "there is a file of that name"
    assert why_not(tmp_path, folder=False) == "there is a folder of that name"
    for below in ("file/x", "file/x/y", "lost/x"):
        for folder in (True, False):
            assert "is no folder that can be written to" in str(why_not(tmp_path / below, folder=folder)), below
    assert "is no folder" in str(why_not(tmp_path / "lost", folder=True))
    assert "File name too long" in str(why_not(tmp_path / ("x" * 300) / "y", folder=True))


@pytest.mark.parametrize("folder", [True, False])
def test_it_is_tried(folder: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the very folder: whoever may do everything is told by the disk alone."""
    tried = []

    def full(*, dir: Path, **_: object) -> None:
        tried.append(dir)
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(output_place.tempfile, "NamedTemporaryFile", full)
    (tmp_path / "there").mkdir()
    assert why_not(tmp_path / "there", folder=True) == "cannot be written: Read-only file system"
    assert why_not(tmp_path / "there" / "x", folder=folder) == "cannot be written: Read-only file system"
    assert tried == [tmp_path / "there"] * 2
