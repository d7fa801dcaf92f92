"""`twin-diagram grasps`, what it keeps with assets, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.planning.grasps.brute_force import box_triangles
from twin_diagram.assets import library
from twin_diagram.cli import main
from twin_diagram.planning.grasps import PANDA_HAND, WSG50, Grasps, grasps_of, read_known
from twin_diagram.planning.grasps.kept_grasps import as_json, from_json, place_of
from twin_diagram.planning.grasps.page import page

MODELS = Path(__file__).resolve().parents[3] / "models" / "objects"


def write_obj(path: Path, x: float, y: float, z: float) -> Path:
    corners = box_triangles(x, y, z).reshape(-1, 3)
    lines = [f"v {a} {b} {c}" for a, b, c in corners.tolist()]
    lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(corners) // 3)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def asset(tmp_path: Path) -> Path:
    return Path(shutil.copytree(MODELS / "sugar_box", tmp_path / "library" / "sugar_box"))


def same(a: Grasps, b: Grasps) -> bool:
    return json.dumps(as_json(a)) == json.dumps(as_json(b))


def test_a_mesh_gets_a_table_a_file_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, out = write_obj(tmp_path / "carton.obj", 0.05, 0.08, 0.16), tmp_path / "out"
    assert main(["grasps", str(mesh), "--count", "4", "--mass", "0.5", "--out", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("carton, panda_hand: 4 grasps")
    assert [line.split()[0] for line in lines[2:6]] == ["1", "2", "3", "4"]
    assert lines[-1] == f"see {out / 'grasps.html'}"
    said = json.loads((out / "grasps.json").read_text())
    assert said["mass"] == 0.5
    assert said["gripper"]["frame"] == "panda_tcp"
    assert [one["rank"] for one in said["grasps"]] == [1, 2, 3, 4]
    first = said["grasps"][0]
    assert first["width"] == pytest.approx(0.05, abs=1e-3)
    assert first["score"] == pytest.approx(sum(first["terms"].values()))
    assert np.linalg.norm(first["X_OG"]["rotation_wxyz"]) == pytest.approx(1.0)
    assert f"{first['score']:.3f}" == lines[2].split()[1]
    text = (out / "grasps.html").read_text()
    assert not re.search(r"(src|href)\s*=|https?:|url\(", text)  # nothing from anywhere else
    drawn = json.loads(re.search(r'id="data">(.*?)</script>', text).group(1))  # type: ignore[union-attr]
    assert len(drawn["grasps"]) == 4
    assert len(drawn["grasps"][0]["boxes"]) == 5
    assert np.abs(np.array(drawn["points"])).max(axis=0) == pytest.approx([0.025, 0.04, 0.08], abs=1e-3)
    assert sorted(path.name for path in out.iterdir()) == ["grasps.html", "grasps.json"]
    # As JSON, the same again to the letter.
    assert main(["grasps", str(mesh), "--count", "4", "--mass", "0.5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == said


def test_a_mesh_in_millimetres_with_its_unit_is_the_same(tmp_path: Path) -> None:
    in_m = read_known(write_obj(tmp_path / "a.obj", 0.05, 0.08, 0.16))
    in_mm = read_known(write_obj(tmp_path / "b.obj", 50.0, 80.0, 160.0), "mm")
    assert in_mm.triangles == pytest.approx(in_m.triangles)


def test_what_is_too_wide_is_an_empty_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, out = write_obj(tmp_path / "crate.obj", 0.3, 0.3, 0.3), tmp_path / "out"
    assert main(["grasps", str(mesh), "--out", str(out)]) == 0
    assert "no grasp: too wide (" in capsys.readouterr().out
    said = json.loads((out / "grasps.json").read_text())
    assert said["grasps"] == []
    assert said["no_grasp"].startswith("too wide")
    assert "No grasp: too wide" in (out / "grasps.html").read_text()


@pytest.mark.parametrize(
    ("content", "extra", "words"),
    [
        ("", [], "no triangles"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", [], "not finite"),
        ("v 0 0 0\nv 50 0 0\nv 0 80 0\nf 1 2 3\n", [], "with --unit mm it would be 80 mm"),
        ("v 0 0 0\nv .05 0 0\nv 0 .08 0\nf 1 2 3\n", ["--mass", "0.3"], "lie in a plane"),
        ("v 0 0 0\nv .05 0 0\nv .08 0 0\nf 1 2 3\n", [], "triangles"),
        ("v 0 0 0\nv .05 0 0\nv 0 .08 0\nf 1 2 3\n", ["--mass", "-1"], "--mass -1: must be positive"),
        ("v 0 0 0\nv .05 0 0\nv 0 .08 0\nf 1 2 3\n", ["--unit", "ft"], "--unit 'ft'"),
        ("v 0 0 0\nv .05 0 0\nv 0 .08 0\nf 1 2 3\n", ["--count", "0"], "count 0"),
        ("v 0 0 0\nv .05 0 0\nv 0 .08 0\nf 1 2 3\n", ["--seed", "-3"], "seed -3"),
        ("v 0 0 0\nv .05 0 0\nv 0 .08 0\nf 1 2 3\n", ["--gripper", "none"], "--gripper none"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, extra: list[str], words: str
) -> None:
    mesh, out = tmp_path / "mesh.obj", tmp_path / "out"
    mesh.write_text(content)
    assert main(["grasps", str(mesh), "--out", str(out), *extra]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert len(said.err.splitlines()) == 1
    assert words in said.err
    assert not out.exists()


def test_what_is_no_object_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], asset: Path) -> None:
    for source, extra, words in (
        (tmp_path / "nothing.obj", [], "no such mesh"),
        (tmp_path, [], "not an asset"),
        (asset, ["--unit", "mm"], "is of a mesh"),
    ):
        assert main(["grasps", str(source), *extra]) == 2
        assert words in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["grasps", str(asset), "--out", str(tmp_path / "file")]) == 2
    assert "--out" in capsys.readouterr().err


def test_grasps_are_kept_with_the_asset_until_anything_changes(asset: Path) -> None:
    file = place_of(asset, PANDA_HAND)
    first = grasps_of(read_known(asset), PANDA_HAND, count=3)
    kept = json.loads(file.read_text())
    assert same(from_json(kept), first)
    # What is kept is what is given: a mark in it comes back.
    kept["score"][0] = 0.125
    file.write_text(json.dumps(kept))
    assert grasps_of(read_known(asset), PANDA_HAND, count=3).score[0] == 0.125
    for change in ({"count": 2}, {"seed": 1}, {"table": True}):
        file.write_text(json.dumps(kept))
        assert grasps_of(read_known(asset), PANDA_HAND, **{"count": 3, **change}).score[0] != 0.125  # type: ignore[arg-type]
    file.write_text(json.dumps(kept))
    assert grasps_of(read_known(asset, mass=0.2), PANDA_HAND, count=3).score[0] != 0.125
    # Another gripper has a list of its own.
    file.write_text(json.dumps(kept))
    grasps_of(read_known(asset), WSG50, count=3)
    assert json.loads(file.read_text()) == kept
    for name in ("asset.yaml", "visual.obj", "model.sdf"):
        file.write_text(json.dumps(kept))
        before = (asset / name).read_text()
        (asset / name).write_text(before + ("<!-- -->" if name == "model.sdf" else "# \n"))
        assert grasps_of(read_known(asset), PANDA_HAND, count=3).score[0] != 0.125, name
        (asset / name).write_text(before)
    # Half of a file is none.
    file.write_text(json.dumps(kept)[:200])
    assert same(grasps_of(read_known(asset), PANDA_HAND, count=3), first)
    assert same(from_json(json.loads(file.read_text())), first)
    assert sorted(path.name for path in file.parent.iterdir()) == ["panda_hand.json", "wsg50.json"]


def test_kept_grasps_go_with_the_asset(asset: Path) -> None:
    grasps_of(read_known(asset), PANDA_HAND, count=1)
    assert library.remove(asset.parent, asset.name) == []
    assert not asset.exists()


def test_where_nothing_can_be_written_nothing_is_kept(asset: Path) -> None:
    (asset / "grasps").write_text("in the way")
    assert len(grasps_of(read_known(asset), PANDA_HAND, count=1)) == 1
    assert (asset / "grasps").read_text() == "in the way"
    grasps_of(read_known(MODELS / "sugar_box"), PANDA_HAND, count=1)
    assert not (MODELS / "sugar_box" / "grasps").exists()  # nothing is written into an installation


def test_an_assets_own_mass_and_centre_count() -> None:
    mug = read_known(MODELS / "mug")
    assert read_known("objects/mug").mass == mug.mass, "by its name, in whatever folder"
    assert mug.mass == 0.3
    assert mug.centre == pytest.approx([0.00394531774, 2.09387842e-05, -0.00695137336]), "that of its surface"
    assert read_known(MODELS / "mug", mass=0.7).mass == 0.7


def test_names_cannot_end_the_pages_script(asset: Path) -> None:
    from dataclasses import replace

    known = replace(read_known(asset), name="</script><b>")
    text = page(known, PANDA_HAND, grasps_of(known, PANDA_HAND, count=1))
    assert text.count("</script>") == 2
    assert "<b>" not in text
