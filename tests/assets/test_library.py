"""A library's assets by the command: listed, checked, removed; corrupt ones are named, and nobody else's file goes."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.assets.building.made_meshes import write_coloured
from twin_diagram import cli
from twin_diagram.assets import Asset
from twin_diagram.assets.building import build_from_mesh
from twin_diagram.assets.library import check, entries
from twin_diagram.assets.same_thing import same_things
from twin_diagram.errors import AssetError
from twin_diagram.scenario.resources import models_dir


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    return build_from_mesh(write_coloured(folder / "src"), "box", folder / "lib", mass=0.5).folder


@pytest.fixture
def library(made: Path, tmp_path: Path) -> Path:
    """One built asset, one shipped, a half-written one, and a folder that is none."""
    shutil.copytree(made, tmp_path / "box")
    shutil.copytree(models_dir() / "objects" / "can", tmp_path / "can")
    (tmp_path / ".box.half").mkdir()
    (tmp_path / ".box.half" / "asset.yaml").write_text("name: half\n")
    (tmp_path / "notes").mkdir()
    return tmp_path


def said(capfd: pytest.CaptureFixture[str], *argv: str | Path) -> tuple[int, str, str]:
    status = cli.main(["assets", *map(str, argv)])
    return (status, *capfd.readouterr())


def test_list_and_check(library: Path, capfd: pytest.CaptureFixture[str]) -> None:
    status, out, err = said(capfd, "list", "--library", library)
    assert status == 0 and err == ""
    assert out.splitlines()[0] == "box: 100 × 60 × 40 mm, 0.5 kg, in 1 convex pieces"
    assert out.splitlines()[1].startswith("can: ") and len(out.splitlines()) == 2
    assert said(capfd, "check", "--library", library) == (0, "box: whole\ncan: whole\n", "")
    assert said(capfd, "check", "--library", library, "can") == (0, "can: whole\n", "")


def test_shipped_assets_are_whole() -> None:
    found = entries(models_dir() / "objects")
    assert len(found) >= 7 and not [entry for entry in found if entry.wrong]


def test_an_asset_that_was_copied_is_told(library: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Both were claimed at 0.98, whichever came first."""
    shutil.copytree(library / "box", library / "box_again")
    status, out, err = said(capfd, "check", "--library", library)
    assert status == 0 and out.count("whole") == 3
    assert err.count("\n") == 1 and "box and box_again are the same thing" in err
    shipped = entries(models_dir() / "objects")
    assert not same_things({one.name: one.asset for one in shipped if one.asset is not None})
    (asset,) = (one.asset for one in entries(library) if one.name == "box")
    assert asset is not None
    larger, other = replace(asset, points_O=1.02 * asset.points_O), replace(asset, colours=0.9 * asset.colours)
    assert not same_things({"box": asset, "larger": larger, "other": other})


def truncated(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-20])


def cut_within_its_list(file: Path) -> None:
    text = file.read_text()
    at = text.index("model.sdf:")
    assert text.index("files:") < at
    file.write_text(text[:at].rstrip() + "\n")


def edited(old: str, new: str) -> Callable[[Path], None]:
    def edit(file: Path) -> None:
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))

    return edit


def in_millimetres(file: Path) -> None:
    said = re.search(r"size: \[(.*)\]", file.read_text())
    assert said is not None
    edited(said[1], ", ".join(str(1000 * float(number)) for number in said[1].split(",")))(file)


@pytest.mark.parametrize(
    ("file", "spoil", "words"),
    [
        ("visual.obj", truncated, ["visual.obj", "not as it was written"]),
        ("visual.png", truncated, ["visual.png"]),
        ("cloud.npz", truncated, ["cloud.npz"]),
        ("pieces/piece0.obj", Path.unlink, ["piece0.obj", "missing"]),
        ("model.sdf", edited("<mass>0.5", "<mass>0.6"), ["model.sdf"]),
        ("asset.yaml", edited("mass: 0.5", "mass: -1.0"), ["asset.yaml", "-1"]),
        ("asset.yaml", lambda file: in_millimetres(file), ["cloud.npz", "metres"]),
        ("asset.yaml", edited("version: 1", "version: 7"), ["version 7"]),
        ("asset.yaml", edited("name: box", "nmae: box"), ["asset.yaml", "nmae"]),
        ("asset.yaml", truncated, ["box"]),
        ("asset.yaml", cut_within_its_list, ["asset.yaml", "lacks model.sdf", "cut off"]),
        ("asset.yaml", lambda file: file.write_bytes(b"\xff\xfe\x00"), ["asset.yaml"]),
    ],
)
def test_corrupt_ones_are_named_and_skipped(
    library: Path,
    file: str,
    spoil: Callable[[Path], None],
    words: list[str],
    capfd: pytest.CaptureFixture[str],
) -> None:
    spoil(library / "box" / file)
    status, out, err = said(capfd, "list", "--library", library)
    assert status == 0 and out.startswith("can: ") and out.count("\n") == 1
    assert err.startswith("warning: box is corrupt") and err.count("\n") == 1 and all(word in err for word in words), (
        err
    )
    status, out, err = said(capfd, "check", "--library", library)
    assert status == 2 and out == "can: whole\n"
    assert err.startswith("error: box is corrupt") and err.count("\n") == 1 and all(word in err for word in words)
    # What is corrupt can be removed or written anew.
    assert said(capfd, "remove", "box", "--library", library)[0] == 0
    assert not (library / "box").exists()


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("model.sdf", "<mass>0.35</mass>", "<mass>0.3</mass>", ["0.3 kg", "0.35"]),
        ("model.sdf", "<ixx>", "<ixx>9", ["model.sdf"]),
        ("model.sdf", "<sdf", "<sfd", ["model.sdf"]),
        ("model.sdf", 'name="object"', 'name="thing"', ["object"]),
        ("model.sdf", "</model>", '<link name="lid"/></model>', ["one link", "object, lid"]),
        ("asset.yaml", "rpy: [0.0, ", "rpy: [", ["asset.yaml", "rpy", "[0.0, 0.0]"]),
        ("asset.yaml", "translation: [0.0, ", "translation: [.nan, ", ["asset.yaml", "translation", "nan"]),
        ("visual.obj", "vt 0.", "vt nan 0.", ["visual.obj", "texture coordinate"]),
        ("visual.obj", "vn 0 0 -1", "vn 0 0 inf", ["visual.obj", "normal"]),
    ],
)
def test_assets_by_hand_are_checked_without_a_list(
    library: Path, file: str, old: str, new: str, words: list[str]
) -> None:
    edited(old, new)(library / "can" / file)
    with pytest.raises(AssetError) as error:
        check(library / "can")
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("mass: 0.4 kg", ["asset.yaml: mass: ", "0.4 kg"]),
        ("obj_id: three", ["asset.yaml: obj_id: ", "three"]),
        ("obj_id: -3", ["obj_id", "-3"]),
        ("unseen: 7", ["unseen", "from 0 to 1", "7"]),
        ("mass_std: -1", ["mass_std", "-1"]),
        ("centre_std: [0.1, 0.1]", ["centre_std", "3 finite", "[0.1, 0.1]"]),
        ("inertia: [1, 1, 1]", ["inertia", "6 finite"]),
        ("inertia: [0.01, 0.01, 0.01, 0, 0, 0]", ["model.sdf", "inertia", "0.01"]),
    ],
)
def test_what_is_told_by_hand_is_checked(library: Path, line: str, words: list[str]) -> None:
    file = library / "box" / "asset.yaml"
    told = {**yaml.safe_load(file.read_text()), **yaml.safe_load(line)}
    file.write_text(yaml.safe_dump(told))
    with pytest.raises(AssetError) as error:
        check(library / "box")
    assert all(word in str(error.value) for word in words), error.value


def test_a_list_leads_nowhere_else(library: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside") / "visual.obj"
    outside.write_bytes((library / "box" / "visual.obj").read_bytes())
    (library / "box" / "visual.obj").unlink()
    (library / "box" / "visual.obj").symlink_to(outside)
    with pytest.raises(AssetError, match=r"visual\.obj: missing"):
        check(library / "box")


def test_remove_takes_its_own_files_and_no_other(library: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (library / "box" / "pieces" / "mine.txt").write_text("precious")
    status, out, _ = said(capfd, "remove", "box", "--library", library)
    assert status == 0 and out.endswith("removed, except for pieces/mine.txt\n")
    assert [p.name for p in (library / "box").rglob("*")] == ["pieces", "mine.txt"]
    assert said(capfd, "remove", "can", "--library", library)[0] == 0
    assert not (library / "can").exists()
    assert said(capfd, "list", "--library", library) == (0, "", f"note: {library} holds no asset\n")
    for way in ("list", "check"):
        missing = library / "missing"
        assert said(capfd, way, "--library", missing) == (2, "", f"error: --library {missing}: no such folder\n")


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["list"], ["gone", "no such folder"]),
        (["check"], ["gone", "no such folder"]),
        (["check", "box"], ["gone", "no such folder"]),
        (["remove", "box"], ["gone", "no such folder"]),
    ],
)
def test_a_library_that_is_not_there(
    argv: list[str], words: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    status, out, err = said(capfd, *argv, "--library", tmp_path / "gone")
    assert (status, out, err.count("\n")) == (2, "", 1) and all(word in err for word in words)


@pytest.mark.parametrize("name", ["cup", "notes", "../can", ".box.half", "linked", ""])
@pytest.mark.parametrize("way", ["remove", "check"])
def test_names_that_are_none(way: str, name: str, library: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (library / "linked").symlink_to(library / "can")
    before = sorted(library.rglob("*"))
    status, out, err = said(capfd, way, name, "--library", library)
    assert (status, out, err.count("\n")) == (2, "", 1) and (name in err)
    assert sorted(library.rglob("*")) == before


def test_pieces_may_be_files_of_ones_own(library: Path) -> None:
    file = library / "can" / "asset.yaml"
    (library / "can" / "half.obj").write_text("v 0 0 0\nv 0.01 0 0\nv 0 0.01 0\nv 0 0 0.01\nf 1 3 2\nf 1 2 4\n")
    file.write_text(file.read_text() + "pieces: [half.obj]\n")
    asset = Asset.load(library / "can")
    assert len(asset.convex_pieces) == 2
    np.testing.assert_allclose(asset.convex_pieces[1][3], [0, 0, 0.01])
    file.write_text(file.read_text().replace("half", "whole"))
    with pytest.raises(AssetError, match=r"whole\.obj: no such convex piece"):
        Asset.load(library / "can")
