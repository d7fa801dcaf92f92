"""The shipped assets against the procedures that made them: the same files come out again."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.assets import Asset
from twin_diagram.assets.mesh import read_obj, read_png
from twin_diagram.assets.procedural import write_bottle, write_can, write_mug
from twin_diagram.assets.procedural_hollow import write_angle, write_flask, write_ring
from twin_diagram.assets.retexture import retexture
from twin_diagram.errors import AssetError
from twin_diagram.scenario.resources import models_dir

OBJECTS = models_dir() / "objects"
SEEDS = {"can": 5, "mug": 8, "bottle": 9, "gelatin_box": 11, "mover": 2}


def numbers(text: str) -> list[float | str]:
    """Words of a file, numbers as such."""
    words: list[float | str] = []
    for word in text.replace("<", " <").replace(">", "> ").replace("/", " / ").split():
        try:
            words.append(float(word))
        except ValueError:
            words.append(word)
    return words


def assert_same_words(one: Path, two: Path) -> None:
    """Equal texts, up to the last digits of numbers."""
    first, second = numbers(one.read_text()), numbers(two.read_text())
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        if isinstance(a, float) and isinstance(b, float):
            assert a == pytest.approx(b, rel=1e-6, abs=2e-7)
        else:
            assert a == b


def assert_same_asset(one: Path, two: Path) -> None:
    for name in ("asset.yaml", "model.sdf", "visual.mtl"):
        assert_same_words(one / name, two / name)
    assert_same_look(one, two)


def assert_same_look(one: Path, two: Path) -> None:
    first, second = read_obj(one / "visual.obj"), read_obj(two / "visual.obj")
    np.testing.assert_array_equal(first.faces, second.faces)
    for attribute in ("vertices", "normals", "uv"):
        np.testing.assert_allclose(getattr(first, attribute), getattr(second, attribute), atol=2e-6)
    pictures = read_png(one / "visual.png"), read_png(two / "visual.png")
    assert pictures[0].shape == pictures[1].shape
    assert (pictures[0] != pictures[1]).any(axis=2).mean() < 1e-3  # texels between two patches may fall to either


@pytest.mark.parametrize("name", SEEDS)
def test_a_shipped_asset_can_be_made_again(tmp_path: Path, name: str) -> None:
    made = retexture(OBJECTS / name, tmp_path / "again", SEEDS[name])
    assert made == tmp_path / "again"
    assert_same_asset(OBJECTS / name, made)


@pytest.mark.long
def test_the_shipped_hollow_assets_can_be_made_again(tmp_path: Path) -> None:
    made = (
        write_angle(tmp_path, "angle", (0.08, 0.11), 0.045, 0.03, texture_seed=11),
        write_ring(tmp_path, "ring", (0.026, 0.045), 0.035, texture_seed=12),
        write_flask(tmp_path, "flask", (0.036, 0.016), 0.15, texture_seed=13),
    )
    for folder in made:
        assert_same_look(OBJECTS / folder.name, folder)
        first, second = Asset.load(OBJECTS / folder.name), Asset.load(folder)
        assert first.mass == second.mass
        np.testing.assert_allclose(first.points_O, second.points_O, atol=2e-6)
        for one, two in zip(first.convex_pieces, second.convex_pieces, strict=True):
            np.testing.assert_allclose(one, two, atol=2e-6)


def test_what_nobody_weighed_weighs_as_the_shipped_ones(tmp_path: Path) -> None:
    for name, made in (
        ("can", write_can(tmp_path / "can", "can", 0.034, 0.102)),
        ("bottle", write_bottle(tmp_path / "bottle", "bottle", 0.036, 0.2)),
        ("mug", write_mug(tmp_path / "mug", "mug", 0.042, 0.1)),
    ):
        shipped = (OBJECTS / name / "asset.yaml").read_text()
        assert f"\n{mass_of(made)}\n" in shipped


def mass_of(folder: Path) -> str:
    return next(line for line in (folder / "asset.yaml").read_text().splitlines() if line.startswith("mass:"))


def test_what_no_procedure_made_is_not_retextured(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"no asset\.yaml"):
        retexture(tmp_path, tmp_path / "new", 1)
    folder = tmp_path / "found"
    shutil.copytree(OBJECTS / "can", folder)
    text = (folder / "asset.yaml").read_text()
    (folder / "asset.yaml").write_text(text.replace("shape: can", "shape: teapot"))
    with pytest.raises(AssetError, match="'teapot' has no procedural texture; shapes: box, can, bottle, mug"):
        retexture(folder, tmp_path / "new", 1)
    assert not (tmp_path / "new").exists()
