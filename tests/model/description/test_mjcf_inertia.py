"""What counts for inertia in an MJCF counts here, too: MuJoCo itself says what."""

from __future__ import annotations

import logging
from pathlib import Path

import mujoco
import numpy as np
import pytest

from twin_diagram.errors import ModelError
from twin_diagram.model import Model

ARM = """<mujoco model="arm"><compiler angle="radian" {compiler}/>{before}<worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="box" size=".05 .04 .2" pos="0 0 .2"/>
<body name="lower" pos="0 0 .4"><joint name="elbow" axis="0 1 0"/>{inside}<geom type="sphere" size=".06" pos=".1 0 .3"/>
</body></body></worldbody>{after}</mujoco>"""

STATED = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
FRAMED = """<frame pos="0 .1 0"><geom type="box" size=".05 .05 .05"/><frame euler="0 .5 0">
<geom type="box" size=".05 .05 .05" pos=".1 0 0"/></frame>
<body name="tip"><geom type="box" size=".02 .05 .05" pos=".1 0 0"/></body></frame>"""


def text(compiler: str = "", before: str = "", inside: str = "", after: str = "") -> str:
    return ARM.format(compiler=compiler, before=before, inside=inside, after=after)


@pytest.mark.parametrize(
    "arm",
    [
        text(compiler='inertiagrouprange="0 1"', inside='<geom type="box" size=".1 .1 .1" group="3"/>'),
        text(
            compiler='inertiagrouprange="4 4"',
            before='<default><geom group="4"/><default class="seen"><geom group="1"/></default></default>',
            inside='<geom class="seen" type="box" size=".1 .1 .1"/>',
        ),
        text(inside=STATED + FRAMED),
        text(inside=FRAMED),
        text(compiler='inertiafromgeom="true"', inside=STATED + FRAMED),
        text(inside='<geom type="box" size=".03" fromto="0 0 0 .1 .2 0"/>'),
        text(
            before='<default><geom type="ellipsoid" size=".04"/></default>',
            inside='<geom fromto=".1 0 0 .1 .2 .3"/>',
        ),
        text(before='<option><flag gravity="disable"/></option>'),
    ],
    ids=["group", "group of a class", "frame beside a mass", "frame", "from geoms", "box", "ellipsoid", "no gravity"],
)
def test_torques_are_those_of_mujoco(tmp_path: Path, arm: str) -> None:
    """The least of these was 0.3 N·m off."""
    path = tmp_path / "arm.xml"
    path.write_text(arm)
    theirs = mujoco.MjModel.from_xml_path(str(path))
    data, own = mujoco.MjData(theirs), Model.load(path)
    for q, v, a in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3, 2)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(theirs, data)
        assert own.inverse_dynamics(q, v, a) == pytest.approx(data.qfrc_inverse, abs=1e-6)


@pytest.mark.parametrize(
    ("arm", "said"),
    [
        (text(inside='<geom name="cup" type="box" size=".1 .1 .1" shellinertia="true"/>'), "'cup' is a shell"),
        (
            text(
                before='<asset><mesh name="cup" inertia="shell" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>',
                inside='<geom name="skin" type="mesh" mesh="cup"/>',
            ),
            "'skin' is a shell",
        ),
        (text(inside='<replicate count="3" offset="0 .05 0"><geom size=".02"/></replicate>'), "<replicate>"),
    ],
)
def test_what_drake_passes_over_is_refused_and_what_mujoco_saves_is_taken(tmp_path: Path, arm: str, said: str) -> None:
    path, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    path.write_text(arm)
    with pytest.raises(ModelError, match=f"arm.xml: .*{said}.*mj_saveLastXML"):
        Model.load(path)
    path.write_text(arm.replace('<compiler angle="radian"', '<compiler angle="radian" saveinertial="true"'))
    theirs = mujoco.MjModel.from_xml_path(str(path))
    mujoco.mj_saveLastXML(str(saved), theirs)
    data, own, still = mujoco.MjData(theirs), Model.load(saved), np.zeros(2)
    data.qpos[:] = 0.3, -0.4
    mujoco.mj_inverse(theirs, data)
    assert own.inverse_dynamics(data.qpos, still, still) == pytest.approx(data.qfrc_inverse, rel=1e-4)


@pytest.mark.parametrize(
    "arm", [text(compiler='inertiagrouprange="0 x"'), text(inside='<geom type="box" size=".1" fromto="0 0 0 1"/>')]
)
def test_numbers_that_are_none_are_said_in_a_line(tmp_path: Path, arm: str) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(arm)
    with pytest.raises(ModelError, match=r"arm\.xml: cannot be read: "):
        Model.load(path)


def test_of_what_drake_passes_over_what_changes_torques_is_said_first(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(text(before='<option timestep="0.001"/><statistic extent="1"/>', inside='<body gravcomp="1"/>'))
    with caplog.at_level(logging.WARNING, logger="twin_diagram"):
        Model.load(path)
    assert "'gravcomp'" in caplog.text
