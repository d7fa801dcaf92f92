"""The packages' faces: what they show is there, is loaded when it is asked for, and is all that they show."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin_diagram.runtime import faces

CHECKOUT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(
    ".".join(path.parent.relative_to(CHECKOUT).parts)
    for path in (CHECKOUT / "twin_diagram").rglob("__init__.py")
    if "__all__" in path.read_text()
)
LAZY = [
    name for name in PACKAGES if "faces.lazy_face" in (CHECKOUT.joinpath(*name.split(".")) / "__init__.py").read_text()
]
ROOT = [
    "AdaptiveEkf",
    "DriftMonitor",
    "Effect",
    "Ekf",
    "Filter",
    "IcpPoseEstimator",
    "Log",
    "Model",
    "Monitor",
    "Mpc",
    "ParameterKind",
    "PerceptionSystem",
    "Scenario",
    "SceneGraphUpdater",
    "TwinError",
    "__version__",
    "load_scenario",
    "make_closed_loop",
    "make_station",
    "make_twin",
    "read_log",
    "register",
    "replay_log",
    "run_gap",
    "run_scenario",
    "save_scenario",
    "write_log",
]


def python(code: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_the_root_shows_what_is_agreed_and_no_helper() -> None:
    import twin_diagram

    assert dir(twin_diagram) == ROOT
    assert python("import twin_diagram; print(*dir(twin_diagram))") == ROOT


@pytest.mark.parametrize("package", PACKAGES)
def test_every_name_is_there(package: str) -> None:
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None, f"{package}.{name}"
        assert not isinstance(getattr(module, name), type(sys)) or package.startswith("twin_diagram.model.effects")


@pytest.mark.parametrize("package", LAZY)
def test_a_lazy_face_shows_its_names_alone(package: str) -> None:
    module = importlib.import_module(package)
    assert dir(module) == sorted(module.__all__)
    with pytest.raises(AttributeError, match=f"'{package}' has no attribute 'nothing'"):
        module.nothing  # noqa: B018


@pytest.mark.parametrize("package", LAZY)
def test_a_lazy_face_tells_each_name_to_type_checkers(package: str) -> None:
    module = importlib.import_module(package)
    homes = faces.imported_for_typing(Path(module.__file__ or "").read_text())
    assert set(homes) == set(module.__all__) - {"__version__"}
    for name, home in homes.items():
        assert getattr(module, name) is getattr(importlib.import_module(home), name)


@pytest.mark.parametrize("package", LAZY)
def test_no_name_of_a_lazy_face_is_a_module_below_it(package: str) -> None:
    folder = CHECKOUT.joinpath(*package.split("."))
    below = {path.stem for path in folder.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert not below & set(importlib.import_module(package).__all__)


def test_a_lazy_face_is_light() -> None:
    heavy = {"numpy", "pydrake", "open3d", "cv2", "scipy", "matplotlib"}
    code = f"import {', '.join(LAZY)}, sys; print(*sorted({heavy!r} & set(sys.modules)))"
    assert python(code) == []


def test_a_name_loads_what_it_needs_and_no_more() -> None:
    loaded = python("import sys; from twin_diagram import Ekf; print('open3d' in sys.modules, Ekf.__name__)")
    assert loaded == ["False", "Ekf"]


def test_a_star_import_brings_every_name() -> None:
    assert python("from twin_diagram.estimation import *; print(Ekf.__name__, Monitor.__name__)") == ["Ekf", "Monitor"]


def test_what_is_read_of_a_face() -> None:
    source = (
        "from typing import TYPE_CHECKING\nimport a\n"
        "if TYPE_CHECKING:\n    from p.q import X, Y\n    from p import Z\n__all__ = ['X']\n"
    )
    assert faces.imported_for_typing(source) == {"X": "p.q", "Y": "p.q", "Z": "p"}


def test_a_face_stands_above_its_modules() -> None:
    """Where one module of a package needs another, it imports it by its own name: a face would hide a circle."""
    wrong = []
    for path in sorted((CHECKOUT / "twin_diagram").rglob("*.py")):
        source = path.read_text()
        if path.name == "__init__.py" or "from twin_diagram import" not in source:
            continue
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and node.module == "twin_diagram":
                wrong += [f"{path}: {alias.name}" for alias in node.names if alias.name in set(ROOT) - {"__version__"}]
    assert not wrong
