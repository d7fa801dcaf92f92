"""Effects of users: from a file that is named, from an installed package, and absent."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from twin_diagram import cli
from twin_diagram.errors import ModelError
from twin_diagram.model.effects import REGISTRY, make, spec_of, users_modules
from twin_diagram.model.effects.serialisation import users_effects
from twin_diagram.model.effects.users_modules import import_again, import_file, load_installed
from twin_diagram.scenario import EffectSpec

DRAG = EffectSpec("quadratic_drag", ["elbow"], [], {"drag": [2.0]})


@pytest.fixture
def drag(tmp_path: Path) -> Iterator[Path]:
    """What CONTRIBUTING.md shows, in a file."""
    text = (Path(__file__).parents[3] / "CONTRIBUTING.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    file = tmp_path / "my_drag.py"
    file.write_text(block)
    yield file
    REGISTRY.pop("quadratic_drag", None)
    sys.modules.pop("my_drag", None)
    load_installed.cache_clear()


def test_a_file_that_is_named_brings_its_effect_and_the_model_notes_its_module(drag: Path) -> None:
    with pytest.raises(ModelError, match="no effect is called 'quadratic_drag'"):
        make(DRAG)
    assert import_file(drag) == "my_drag" == import_file(str(drag))
    made = make(DRAG)
    assert spec_of(made).module == "my_drag"
    assert spec_of(make(EffectSpec("coulomb_friction", ["elbow"], [], {"torque": [2.0]}))).module == ""


def test_its_absence_is_one_clear_line_and_no_file_is_imported_by_itself(drag: Path) -> None:
    noted = EffectSpec(DRAG.name, DRAG.joints, [], DRAG.parameters, module="my_drag")
    with pytest.raises(ModelError, match=r"--import my_drag\.py") as caught:
        make(noted)
    assert "'my_drag'" in str(caught.value) and "\n" not in str(caught.value)
    assert "my_drag" not in sys.modules


def test_what_cannot_be_imported_is_refused_and_leaves_nothing(tmp_path: Path, drag: Path) -> None:
    with pytest.raises(ModelError, match="is no Python file"):
        import_file(tmp_path / "none.py")
    with pytest.raises(ModelError, match="is no Python file"):
        import_file(tmp_path)
    broken = tmp_path / "my_broken.py"
    broken.write_text("import nothing_of_that_name\n")
    with pytest.raises(ModelError, match="ModuleNotFoundError: No module named 'nothing_of_that_name'"):
        import_file(broken)
    assert "my_broken" not in sys.modules
    taken = tmp_path / "json.py"
    taken.write_text("")
    with pytest.raises(ModelError, match="another module is called 'json'"):
        import_file(taken)


def test_a_helping_process_is_told_what_to_import(drag: Path) -> None:
    import_file(drag)
    assert users_effects() == {"my_drag": str(drag)}
    REGISTRY.pop("quadratic_drag")
    del sys.modules["my_drag"]
    assert users_effects() == {}
    import_again({"my_drag": str(drag)})
    assert spec_of(make(DRAG)).module == "my_drag"
    with pytest.raises(ModelError, match=r"effects of no\.such_thing: ModuleNotFoundError"):
        import_again({"no.such_thing": "there.py"})


def test_what_a_script_defines_is_told_to_lie_in_a_file_of_its_own() -> None:
    noted = EffectSpec(DRAG.name, DRAG.joints, [], DRAG.parameters, module="__main__")
    with pytest.raises(ModelError, match="put its class into a file of its own"):
        make(noted)


def test_an_installed_package_offers_its_effects(drag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(drag.parent))
    point = EntryPoint("drag", "my_drag", users_modules.GROUP)
    monkeypatch.setattr(users_modules, "entry_points", lambda group: [point] if group == users_modules.GROUP else [])
    load_installed.cache_clear()
    assert make(DRAG).name == "quadratic_drag"
    assert load_installed() == ("my_drag",)
    load_installed.cache_clear()
    monkeypatch.setattr(users_modules, "entry_points", lambda group: [EntryPoint("x", "no_such_thing", group)])
    with pytest.raises(ModelError, match="installed no_such_thing: ModuleNotFoundError"):
        load_installed()


def test_the_command_imports_before_it_works(drag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rest = ["--model", "arms/panda.urdf", "--log", "none.csv", "--out", "p.csv"]
    assert cli.main(["predict", *rest, "--import", str(drag)]) == 2
    assert "none.csv: no such log file" in capsys.readouterr().err
    assert "quadratic_drag" in REGISTRY
    assert cli.main(["predict", *rest, "--import", "none.py"]) == 2
    assert "--import none.py: is no Python file" in capsys.readouterr().err
