"""An SDF that is read as a text is the model that its file is."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description import foreign
from twin_diagram.scenario import resources

SHIPPED = sorted(resources.models_dir().rglob("*.sdf"))
FOLDED = """<sdf version="1.9"><model name="outer"><include><uri>{uri}</uri></include></model></sdf>"""


def told(path: Path, *, by_drake: bool) -> tuple[list[str], np.ndarray]:
    """What a model says in words: names, shapes and their properties; and in numbers."""
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    reader = description.parser(plant)
    added = reader.AddModels(path) if by_drake else foreign.add_models(reader, path)
    plant.Finalize()
    words, numbers = [plant.GetModelInstanceName(instance) for instance in added], []
    for body in (plant.get_body(index) for instance in added for index in plant.GetBodyIndices(instance)):
        words.append(body.name())
        numbers.append(body.default_spatial_inertia().CopyToFullMatrix6().ravel())
    inspector = scene_graph.model_inspector()
    for shape in inspector.GetAllGeometryIds():
        words += [inspector.GetName(shape), repr(inspector.GetShape(shape))]
        words += [str(inspector.GetProperties(shape, role)) for role in (Role.kProximity, Role.kPerception)]
        numbers.append(inspector.GetPoseInFrame(shape).GetAsMatrix4().ravel())
    return words, np.concatenate(numbers)


def plain(word: str) -> str:
    """A word without what differs from run to run, and without a mesh's folder: hulls of what is touched are kept."""
    return re.sub(r"0x[0-9a-f]+|(?<=')/[^']*/", "", word)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_each_shipped_one_is_what_drake_makes_of_its_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = told(path, by_drake=False), told(path, by_drake=True)
    assert list(map(plain, ours[0])) == list(map(plain, theirs[0]))
    np.testing.assert_array_equal(ours[1], theirs[1])
    monkeypatch.setattr(Parser, "AddModels", None)
    told(path, by_drake=False)  # and its file is not read by SDFormat, which takes forty times as long


def test_a_folder_may_have_a_name_that_xml_writes_otherwise(tmp_path: Path) -> None:
    folder = tmp_path / 'cups & "saucers" <new>'
    shutil.copytree(resources.models_dir() / "objects" / "mug", folder)
    assert folder.name in "".join(told(folder / "model.sdf", by_drake=False)[0])


def test_one_that_names_another_is_read_where_it_is(tmp_path: Path) -> None:
    shutil.copytree(resources.models_dir() / "objects" / "mug", tmp_path, dirs_exist_ok=True)
    outer = tmp_path / "outer.sdf"
    outer.write_text(FOLDED.format(uri=(tmp_path / "model.sdf").as_uri()))
    np.testing.assert_array_equal(told(outer, by_drake=False)[1], told(outer, by_drake=True)[1])
