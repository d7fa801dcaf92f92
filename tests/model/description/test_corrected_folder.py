"""A corrected model's folder says how it stands, and is read so again."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gap.made import ARM
from twin_diagram.errors import ModelError
from twin_diagram.model.description.corrected_folder import STANDING_FILE, CorrectedStanding, standing_of
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel

REMAINDER = {joint: 0.1 + 0.01 * k for k, joint in enumerate(ARM.joints)}

LINKS = [[1e-5], [-0.25, 3.0]]


def test_what_is_known_comes_back(tmp_path: Path) -> None:
    ARM.save(tmp_path / "model", CorrectedStanding("motor", False, REMAINDER, LINKS))
    assert standing_of(tmp_path / "model") == CorrectedStanding("motor", False, REMAINDER, LINKS)


def test_where_there_is_nothing_to_say_nothing_is_written(tmp_path: Path) -> None:
    ARM.save(tmp_path / "model")
    assert sorted(path.name for path in (tmp_path / "model").iterdir()) == ["effects.yaml", "ur5e.urdf"]
    assert standing_of(tmp_path / "model") == CorrectedStanding() == standing_of(tmp_path / "none")


def test_the_torques_side_goes_along(tmp_path: Path) -> None:
    iiwa = ArmModel(model="arms/iiwa7.urdf", tool_frame="")
    Model.load(iiwa, torque_side="link").save(tmp_path / "model")
    again = Model.load(tmp_path / "model")
    assert again.arm.link_side and not again.tree.rotor.any()
    assert Model.load(tmp_path / "model", torque_side="motor").tree.rotor.all()
    assert not Model.load(iiwa).arm.link_side


@pytest.mark.parametrize(
    "text",
    ["[]", "remainder: {a: many}", "remainder: {a: .nan}", "remainder: [1]", "links: [[a]]", "links: [1]", "a: [",
     "links: [[.inf]]"],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / STANDING_FILE).write_text(text)
    with pytest.raises(ModelError, match=STANDING_FILE):
        standing_of(tmp_path)


@pytest.mark.parametrize("side", ["Link", "joint", "links", "''", "null", "[link]", "2"])
def test_a_side_that_is_none_is_refused(side: str, tmp_path: Path) -> None:
    Model.load(ArmModel(model="arms/iiwa7.urdf", tool_frame=""), torque_side="link").save(tmp_path / "model")
    file = tmp_path / "model" / STANDING_FILE
    file.write_text(file.read_text().replace("torque_side: link", f"torque_side: {side}"))
    with pytest.raises(ModelError, match=rf"{STANDING_FILE}: torque_side .*: it is one of motor, link") as error:
        Model.load(tmp_path / "model")
    assert side.strip("[]'").replace("null", "None") in str(error.value)
