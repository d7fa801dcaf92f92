"""CoACD's pieces beside V-HACD's: an asset is held more closely, or stays as it was, to the byte."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twin_diagram import cli
from twin_diagram.assets.asset import Asset
from twin_diagram.assets.building import improve
from twin_diagram.assets.building.from_mesh import build_from_mesh
from twin_diagram.assets.building.improve import improve_pieces, joined, volume_of
from twin_diagram.assets.library import entry
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

ARMS = ((0.12, 0.03, 0.04), (0.03, 0.12, 0.04))
"""Edges of the two boxes of which an angle is made [m]; it has 252 cm³."""


def box(low: Array, high: Array) -> Array:
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1)
    return corners.reshape(-1, 3)


TIGHT_CENTRE = np.array([(0.06 * 144 + 0.015 * 108) / 252, (0.015 * 144 + 0.075 * 108) / 252, 0.02])
"""Centre of mass of the angle [m]: 144 and 108 cm³, the corner counted once."""


TIGHT = [box(np.zeros(3), np.array(edges)) for edges in ARMS]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tmp_path = tmp_path_factory.mktemp("angle")
    outline = [(0, 0), (0.12, 0), (0.12, 0.03), (0.03, 0.03), (0.03, 0.12), (0, 0.12)]
    triangles = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    flat, n = np.array(outline), len(outline)
    vertices = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (0.0, 0.04)])
    caps = [(a, c, b) for a, b, c in triangles] + [(a + n, b + n, c + n) for a, b, c in triangles]
    sides = [(k, (k + 1) % n, n + k) for k in range(n)] + [((k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    trimesh.Trimesh(vertices, caps + sides, process=False).export(tmp_path / "angle.obj")
    build_from_mesh(tmp_path / "angle.obj", "angle", tmp_path / "library", mass=0.3)
    return tmp_path / "library"


@pytest.fixture
def library(built: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(built, tmp_path / "library"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_volume_of_pieces_that_overlap_counts_once() -> None:
    np.testing.assert_allclose(volume_of(TIGHT), 252e-6, rtol=0.01)
    np.testing.assert_allclose(volume_of(TIGHT[:1] * 2), 144e-6, rtol=1e-6)


def test_vertices_along_a_seam_are_joined() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 1, 0]])
    places, faces = joined(corners, np.array([[0, 1, 2], [3, 5, 4], [5, 6, 3]]))
    assert len(places) == 4
    assert len(faces) == 2  # a triangle of two places has none
    assert set(faces[0]) & set(faces[1]) == {k for k in range(4) if places[k].sum() == 1.0}


def test_closer_pieces_are_taken_and_all_else_stays(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = Asset.load(library / "angle")
    (library / "angle" / "notes.txt").write_text("mine")
    monkeypatch.setattr(improve, "taken_apart", lambda *given: [piece - TIGHT_CENTRE for piece in TIGHT])
    monkeypatch.setattr(improve, "volume_of", lambda pieces: 252e-6 if len(pieces) == 2 else 300e-6)
    was = contents(library / "angle")
    done = improve_pieces("angle", library)
    now, whole = contents(library / "angle"), entry(library, "angle")
    if len(before.convex_pieces) == 2:  # V-HACD found the two as well: nothing to gain
        assert not done.taken and now == was
        return
    assert done.taken and done.pieces == 2 and whole.wrong is None
    assert whole.asset is not None and len(whole.asset.convex_pieces) == 2
    changed = {path for path in now if now[path] != was.get(path)}
    assert changed <= {"asset.yaml", "model.sdf", "model.xml", "pieces/piece0.obj", "pieces/piece1.obj"}
    assert now["notes.txt"] == b"mine" and whole.asset.mass == before.mass


@pytest.mark.parametrize("found", [[], [np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])]])
def test_where_nothing_is_gained_nothing_is_written(
    library: Path, found: list[Array], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(improve, "taken_apart", lambda *given: [0.1 * piece for piece in found])
    was = contents(library)
    assert cli.main(["assets", "improve", "angle", "--library", str(library), "--limit", "5"]) == 0
    said = capsys.readouterr().out
    assert "left as it is" in said and ("within 5 s" in said) == (not found)
    assert contents(library) == was


def test_what_was_not_built_here_or_is_not_whole_is_refused(library: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shipped = Path(__file__).resolve().parents[3] / "models" / "objects"
    for name, folder, limit, said in (
        ("mug", shipped, "60", "was not made by `assets build`"),
        ("angle", library, "nan", "--limit nan"),
        ("angle", library, "-1", "--limit -1"),
        ("nothing", library, "60", "has no asset 'nothing'"),
    ):
        assert cli.main(["assets", "improve", name, "--library", str(folder), "--limit", limit]) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
        assert said in line
    (library / "angle" / "cloud.npz").write_bytes(b"")
    with pytest.raises(AssetError, match="corrupt"):
        improve_pieces("angle", library)


@pytest.mark.long
def test_coacd_holds_an_angle_as_closely_as_two_boxes(library: Path) -> None:
    done = improve_pieces("angle", library)
    after = done.after if done.taken else done.before
    assert after < 1.05 * 252e-6
    assert entry(library, "angle").wrong is None
