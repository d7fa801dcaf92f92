"""What Drake's parsers warn of is one line, and all of it for who asks."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from twin_diagram.model import Model
from twin_diagram.model.description.parser_warnings import in_one_line

ODD = """<mujoco model="it"><statistic extent="1"/><visual/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="tip"/>
</body></worldbody><sensor/><keyframe/></mujoco>"""


@pytest.mark.parametrize("every", [False, True])
def test_it_is_said_once_in_one_line_or_all_of_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, every: bool
) -> None:
    path = tmp_path / "it.xml"
    path.write_text(ODD)
    with caplog.at_level(logging.DEBUG if every else logging.WARNING, logger="twin_diagram"):
        Model.load(path)
        Model.load(path)
    own = [record.getMessage() for record in caplog.records if record.name == "twin_diagram"]
    drake = [record for record in caplog.records if record.name == "drake" and "site" in record.getMessage()]
    if every:
        assert not own and drake
    else:
        (line,) = own
        assert not drake and str(path) in line and "\n" not in line
        assert "warnings more" in line and "--verbose" in line and len(line) < len(str(path)) + 260


def test_what_is_said_of_paint_is_not_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    clear = (
        "warning: Warning: In vtkGLTFDocumentLoaderInternals.cxx, line 1402: vtkGLTFDocumentLoader (0x55c729f0c110): "
    )
    with caplog.at_level(logging.WARNING, logger="twin_diagram"):
        with in_one_line(tmp_path / "painted.urdf"):
            logging.getLogger("drake").warning(clear + "glTF extension KHR_materials_clearcoat is used in this model")
        assert not [record for record in caplog.records if record.name == "twin_diagram"]
        with in_one_line(tmp_path / "painted.urdf"):
            logging.getLogger("drake").warning(clear + "glTF extension KHR_materials_clearcoat is used in this model")
            logging.getLogger("drake").warning("it.urdf:3: warning: something else")
    (line,) = [record.getMessage() for record in caplog.records if record.name == "twin_diagram"]
    assert "something else" in line and "warnings more" not in line


def test_an_inertia_that_no_body_has_comes_first_and_without_drakes_build(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    odd = tmp_path / "odd.urdf"
    odd.write_text(
        """<robot name="odd"><link name="base"><inertial><mass value="0"/>
<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.03"/></inertial></link>
<link name="rod"><inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
</inertial></link><joint name="pin" type="revolute"><safety_controller k_velocity="1"/><parent link="base"/>
<child link="rod"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="5"/></joint></robot>"""
    )
    with caplog.at_level(logging.WARNING, logger="twin_diagram"):
        Model.load(odd)
    (line,) = [record.getMessage() for record in caplog.records if record.name == "twin_diagram"]
    assert "inertia: SetFromRotationalInertia(): condition 'mass > 0' failed" in line and "bazel" not in line
