"""What README and CONTRIBUTING say exists, does."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.estimation_bench import JOINTS, World, simulate
from twin_diagram.logs import Log, write_log

CHECKOUT = Path(__file__).resolve().parent.parent
README = (CHECKOUT / "README.md").read_text()
CONTRIBUTING = (CHECKOUT / "CONTRIBUTING.md").read_text()


def example() -> str:
    return blocks()[0]


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_example_imports_what_there_is() -> None:
    for node in ast.parse(example()).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            module = importlib.import_module(node.module)
            assert all(hasattr(module, alias.name) for alias in node.names)


@pytest.mark.slow
def test_example_runs(tmp_path: Path, egl: None) -> None:
    done = subprocess.run(
        [sys.executable, "-c", example()],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert "kg of" in done.stdout
    assert (tmp_path / "out" / "example" / "summary.json").is_file()


def test_example_of_the_filter_runs() -> None:
    first, second, _ = blocks()
    assert "Ekf" not in first
    done = subprocess.run(
        [sys.executable, "-c", second],
        cwd=CHECKOUT,
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "nan" not in done.stdout and "payload" in done.stdout


def test_example_of_the_monitor_runs(tmp_path: Path) -> None:
    run = simulate(World.draw(5, period=4.0), 0.5)
    write_log(Log(run.time, JOINTS, run.q, velocity=run.v, torque=run.tau), tmp_path / "run.csv")
    example = blocks()[2]
    assert "Monitor(terms)" in example
    done = subprocess.run(
        [sys.executable, "-c", example],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"


def test_it_stays_short_and_its_links_lead_somewhere() -> None:
    assert len(README.splitlines()) <= 200
    for page in [CHECKOUT / "README.md", *sorted((CHECKOUT / "docs").glob("*.md"))]:
        for link in re.findall(r"\]\(([^)#]+)", page.read_text()):
            assert link.startswith("https://") or (page.parent / link).exists(), f"{page.name}: {link}"


def test_commands_take_what_is_said_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    from twin_diagram.cli import main

    for command, options in re.findall(r"^\| `twin-diagram (\w+(?: build)?)([^`]*)`", README, re.MULTILINE):
        with pytest.raises(SystemExit) as caught:
            main([*command.split(), "--help"])
        assert caught.value.code == 0
        said = capsys.readouterr().out
        for option in re.findall(r"--\w+", options):
            assert option in said, f"{command} {option}"


@pytest.mark.parametrize("text", [README, CONTRIBUTING], ids=["README", "CONTRIBUTING"])
def test_make_targets_and_files_exist(text: str) -> None:
    makefile = (CHECKOUT / "Makefile").read_text()
    for target in set(re.findall(r"(?:`|^)make ([\w-]+)", text, re.MULTILINE)):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    for path in set(re.findall(r"`((?:twin_diagram|models|tests|sims|tools)/[\w./]*)`", text)):
        assert "NAME" in path or (CHECKOUT / path).exists(), path
