"""The handbook in `docs/`: links, code and tutorials hold, and what is made of the code leaves nothing out."""

from __future__ import annotations

import ast
import importlib
import json
import os
import pkgutil
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import twin_diagram.scenario
from twin_diagram.cli import _parser
from twin_diagram.gap.candidates.records import records
from twin_diagram.model import Model
from twin_diagram.scenario import models_dir

CHECKOUT = Path(__file__).resolve().parent.parent
DOCS = CHECKOUT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))
NAMES = sorted(record.effect.name for record in records())


def name_of(page: Path) -> str:
    return page.relative_to(DOCS).as_posix()


@pytest.fixture(autouse=True)
def tool_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(CHECKOUT / ".make"))


def part(name: str) -> ModuleType:
    return importlib.import_module(f"handbook.{name}")


# Pages.


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere_and_code_compiles(page: Path) -> None:
    text = page.read_text()
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    for link in re.findall(r"\]\(([^)#\s]+)", prose):
        assert link.startswith("https://") or (page.parent / link).is_file(), link
    for tree in re.findall(r"^```\{toctree\}\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        for entry in tree.split("\n\n", 1)[1].split():
            assert (page.parent / f"{entry}.md").is_file(), entry
    for block in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom):
                module = importlib.import_module(str(node.module))
                assert all(hasattr(module, alias.name) for alias in node.names), ast.unparse(node)
    for path in re.findall(r"`((?:twin_diagram|models|tests|sims)/[\w./]*)`", text):
        assert (CHECKOUT / path).exists(), path
    for target in re.findall(r"`make ([\w-]+)", text):
        assert re.search(rf"^{target}:", (CHECKOUT / "Makefile").read_text(), re.MULTILINE), target


def test_every_page_is_reached_from_the_first() -> None:
    trees = re.findall(r"^```\{toctree\}\n(.*?)^```", (DOCS / "index.md").read_text(), re.MULTILINE | re.DOTALL)
    entries = [entry for tree in trees for entry in tree.split("\n\n", 1)[1].split()]
    assert sorted([*entries, "index"]) == sorted(name_of(page).removesuffix(".md") for page in PAGES)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_shown_are_commands(page: Path) -> None:
    for command, rest in re.findall(r"^twin-diagram (\w+)(.*)$", page.read_text(), re.MULTILINE):
        given = re.sub(r"\"[^\"]*\"|#.*", "", rest)
        said = _parser()._subparsers._group_actions[0].choices[command].format_help()
        for option in re.findall(r"--\w+", given):
            assert option in said, f"{command} {option}"


def test_own_controller_of_the_page_on_blocks_fits() -> None:
    """It runs as it stands: nothing is rendered, and nothing advances."""
    page = (DOCS / "blocks" / "index.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    namespace: dict[str, object] = {}
    exec(block, namespace)
    assert namespace["loop"].twin.diagram.HasOutputPort("arm.position_commanded")


# Made of the code.


def expanded(name: str) -> str:
    return str(part("made_parts").expand((DOCS / name).read_text()))


def test_a_part_that_there_is_not_is_named() -> None:
    with pytest.raises(ValueError, match="prots"):
        part("made_parts").expand("```{made}\nprots x\n```\n")
    with pytest.raises(ValueError, match="no ports"):
        part("made_parts").expand("```{made}\nports twin_diagram.model:Model\n```\n")


def test_every_effect_has_an_entry_with_equation_parameters_and_picture() -> None:
    page = expanded("effects.md")
    entries = dict(re.findall(r"^### (\w+)\n(.*?)(?=^##|\Z)", page, re.MULTILINE | re.DOTALL))
    assert sorted(entries) == NAMES == sorted(part("effect_pictures").SIGNATURES)
    for record in records():
        entry = entries[record.effect.name]
        assert "$$\n" in entry and f"pictures/effects/{record.effect.name}.svg" in entry and record.title in entry
        for key, kind in record.effect.kinds.items():
            assert re.search(rf"^\| `{key}` \| {re.escape(kind.unit)}", entry, re.MULTILINE), key


def test_bounds_and_defaults_are_told_as_they_are() -> None:
    page = expanded("effects.md")
    assert "| `damping` | N·m·s/rad | ≥ 0; less, where the description states some | must be given |  |" in page
    assert "| `gain` | 1 | 0.01 to 10 | must be given |  |" in page
    assert "| `com` | m (3) | any | 0 |  |" in page
    assert "| `torque` | N·m | any | must be given |  |" in page


def test_every_field_of_every_section_appears() -> None:
    page = expanded("scenario.md")
    sections = {
        value
        for info in pkgutil.iter_modules(twin_diagram.scenario.__path__)
        for value in vars(importlib.import_module(f"twin_diagram.scenario.{info.name}")).values()
        if isinstance(value, type) and is_dataclass(value) and "Fields, in a scenario" in (value.__doc__ or "")
    }
    assert len(sections) > 20
    for section in sections:
        for field in fields(section):
            assert re.search(rf"^\| `{field.name}` \|", page, re.MULTILINE), f"{section.__name__}.{field.name}"
    assert "## `twin.filter`" in page and "## `world.arm.effects`" in page
    assert re.search(r"^\| `rate` \| `float` \| `200.0` \| How often the filter takes a message", page, re.MULTILINE)


def test_every_command_and_option_is_documented() -> None:
    page = expanded("commands.md")
    said = subprocess.run(
        [sys.executable, "-m", "twin_diagram", "--help"], capture_output=True, text=True, timeout=60, cwd=CHECKOUT
    ).stdout
    commands = re.findall(r"^    (\w+) ", said, re.MULTILINE)
    assert {"run", "gap"} <= set(commands)
    for command in commands:
        section = page.split(f"## `twin-diagram {command}`")[1].split("\n## ")[0]
        options = _parser()._subparsers._group_actions[0].choices[command].format_help()
        for option in set(re.findall(r"^  (?:-h, )?(--\w+)", options, re.MULTILINE)) - {"--help"}:
            assert f"`{option}" in section, f"{command} {option}"
    assert "`--model MODEL` | URDF, SDF, MJCF or the folder of a corrected model (required) |" in page


def test_ports_are_those_of_the_systems() -> None:
    from twin_diagram.estimation import AdaptiveEkf
    from twin_diagram.scenario import Filter

    shown = part("made_parts").made("ports twin_diagram.estimation:AdaptiveEkf")
    model = Model.load(models_dir() / "arms" / "ur5e.urdf")
    system = AdaptiveEkf(model, Filter())
    inputs = [system.get_input_port(k).get_name() for k in range(system.num_input_ports())]
    assert re.findall(r"^\| input \| `(\w+)`", shown, re.MULTILINE) == inputs
    outputs = [system.get_output_port(k).get_name() for k in range(system.num_output_ports())]
    assert re.findall(r"^\| output \| `(\w+)`", shown, re.MULTILINE) == [*outputs, "sensor_tracks"]


@pytest.mark.parametrize("page", [p for p in PAGES if "{made}" in p.read_text()], ids=name_of)
def test_nothing_is_left_to_be_made_and_tables_keep_their_columns(page: Path) -> None:
    text = expanded(name_of(page))
    assert "{made}" not in text
    width = 0
    for line in text.splitlines():
        cells = len(re.findall(r"(?<!\\)\|", line)) if line.startswith("| ") else 0
        assert not cells or not width or cells == width, line
        width = cells


def test_glossary_holds_every_word() -> None:
    section = (CHECKOUT / "CONTRIBUTING.md").read_text().split("\n## Words\n")[1].split("\n## ")[0]
    page = expanded("glossary.md")
    for word in re.findall(r"^\| ([^|]+) \| (?!means here|---)", section, re.MULTILINE):
        assert f"\n{word}\n: " in page, word


# Signatures.


@pytest.fixture(scope="module")
def arm() -> Model:
    return Model.load(models_dir() / "arms" / "ur5e.urdf")


def test_signatures_follow_from_the_laws(arm: Model) -> None:
    signature = part("effect_pictures").signature
    right, up = signature(arm, "viscous_friction")
    np.testing.assert_allclose(up, 6.0 * right, atol=1e-9)
    right, up = signature(arm, "coulomb_friction")
    sliding = np.abs(right) > 0.05
    np.testing.assert_allclose(up[sliding], 5.0 * np.sign(right[sliding]), atol=1e-6)
    right, up = signature(arm, "reflected_inertia")
    np.testing.assert_allclose(up, 0.4 * right, atol=1e-9)
    right, up = signature(arm, "torque_constant")  # what is logged is right; 0.9 of it arrives
    np.testing.assert_allclose(up, 0.1 * right, atol=1e-9)
    right, up = signature(arm, "torque_saturation")
    np.testing.assert_allclose(up, right - np.clip(right, -12.0, 12.0), atol=1e-9)
    right, up = signature(arm, "actuator_fault")
    assert np.all(up[right < 2.0] == 0.0) and np.all(up[right >= 2.0] != 0.0)


@pytest.mark.parametrize("name", NAMES)
def test_each_signature_shows_something_and_is_drawn(arm: Model, name: str, tmp_path: Path) -> None:
    pictures = part("effect_pictures")
    right, up = pictures.signature(arm, name)
    assert np.all(np.isfinite([right, up])) and np.ptp(right) > 0.5 and np.abs(up).max() > 0.3
    pictures.draw(name, right, up, tmp_path / "one.svg")
    drawn = (tmp_path / "one.svg").read_text()
    assert pictures.SIGNATURES[name].label in drawn and "<image" not in drawn


# Tutorials.

PAGE = """# Title

Prose.

```python
x = 2
print('x', x * 1.5)
```

```text
x 3.0
```

More.

```python
y = x
```
"""


def test_a_page_is_a_notebook() -> None:
    tutorials = part("tutorials")
    made = json.loads(tutorials.notebook(PAGE))
    assert (made["nbformat"], made["nbformat_minor"]) == (4, 5)
    kinds = [cell["cell_type"] for cell in made["cells"]]
    assert kinds == ["markdown", "code", "markdown", "code"]
    assert made["cells"][1]["source"] == "x = 2\nprint('x', x * 1.5)"
    assert made["cells"][1]["outputs"][0]["text"] == "x 3.0\n" and made["cells"][3]["outputs"] == []
    assert len({cell["id"] for cell in made["cells"]}) == 4


def test_what_a_cell_prints_is_held_against_the_page(tmp_path: Path) -> None:
    check = part("tutorials").check
    assert check(PAGE, tmp_path) == []
    (wrong,) = check(PAGE.replace("x 3.0", "x 4.0"), tmp_path)
    assert wrong.startswith("cell 0: 'x 3.0' instead of 'x 4.0'")
    assert check(PAGE.replace("x 3.0", "x 3.1"), tmp_path) == []  # a tenth
    assert len(check(PAGE.replace("x 3.0", "y 3.0"), tmp_path)) == 1
    assert len(check(PAGE.replace("y = x", "print(x)"), tmp_path)) == 1
    assert len(check(PAGE.replace("x 3.0", "x −3.0"), tmp_path)) == 1


def test_pictures_come_below_the_cells_that_drew_them(tmp_path: Path) -> None:
    tutorials = part("tutorials")
    page = PAGE.replace("y = x", "import matplotlib.pyplot as plt\nplt.plot([1, x]);")
    assert tutorials.check(page, tmp_path, tmp_path) == []
    assert [path.name for path in tmp_path.glob("*.svg")] == ["cell_1.svg"]
    shown = tutorials.with_pictures(page, "here", {"cell_1.svg"})
    assert shown.endswith("```\n\n![drawn by the cell above](here/cell_1.svg)\n") and shown.count("![") == 1


@pytest.mark.slow  # `make docs` runs them, too
@pytest.mark.parametrize("page", TUTORIALS, ids=name_of)
def test_tutorials_print_what_they_say(page: Path, tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from handbook import tutorials\n"
    code += "sys.exit('\\n'.join(tutorials.check(Path(sys.argv[1]).read_text(), Path.cwd())) or 0)"
    path = f"{CHECKOUT}:{CHECKOUT / '.make'}"
    done = subprocess.run(
        [sys.executable, "-c", code, str(page)],
        cwd=tmp_path,  # as with an installed package, there is no checkout around
        env={**os.environ, "HOME": str(tmp_path), "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr


# Offline.


def test_what_a_browser_would_fetch_is_noticed(tmp_path: Path) -> None:
    from_outside = part("command").from_outside
    page = tmp_path / "page.html"
    page.write_text('<a href="https://drake.mit.edu">Drake</a><script src="_static/a.js"></script>')
    assert from_outside(tmp_path) == []
    for bad in (
        '<script async="async" src="https://cdn.example/mathjax.js"></script>',
        '<link rel="stylesheet" type="text/css" href="https://fonts.example/x.css">',
        '<link href="//fonts.example/x.css" rel="stylesheet">',
        '<img alt="x" src="http://example.org/x.png">',
        "<style>@import 'https://example.org/x.css';</style>",
        "<style>@font-face { src: url(https://example.org/x.woff2) }</style>",
    ):
        page.write_text(bad)
        assert len(from_outside(tmp_path)) == 1, bad


@pytest.mark.slow  # `make docs` does it, too
def test_the_handbook_is_built_without_a_warning_and_loads_nothing(tmp_path: Path) -> None:
    for needed in ("sphinx", "myst_parser", "furo", "latex2mathml"):
        pytest.importorskip(needed, reason="needs the extra `docs`")
    done = subprocess.run(
        [sys.executable, str(CHECKOUT / ".make" / "handbook"), "--no-tutorials", "--out", str(tmp_path)],
        cwd=CHECKOUT,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert "<math" in (tmp_path / "html" / "blocks" / "filter.html").read_text()
    assert list((tmp_path / "html").rglob("my_log.ipynb"))
