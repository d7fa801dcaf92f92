"""An MJCF need not say what its model is called."""

from __future__ import annotations

from pathlib import Path

from twin_diagram.model.description.unparsed import is_nameless
from twin_diagram.model.model import Model

ARM = """<mujoco{}><worldbody><body name="link"><joint name="lift" axis="0 1 0" range="-90 90"/>
<inertial pos="0 0 0.2" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""


def test_an_mjcf_without_a_name_is_an_arm(tmp_path: Path) -> None:
    nameless, named, other = tmp_path / "my arm.xml", tmp_path / "named.xml", tmp_path / "other.urdf"
    nameless.write_text(ARM.format(""))
    named.write_text(ARM.format(' model="arm"'))
    assert is_nameless(nameless) and not is_nameless(named) and not is_nameless(other)
    assert Model.load(str(nameless)).joints == Model.load(str(named)).joints == ("lift",)
    Model.load(str(nameless)).save(tmp_path / "kept")
    assert Model.load(str(tmp_path / "kept")).joints == ("lift",)
