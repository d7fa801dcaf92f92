"""System libraries are loaded or named before anything heavy starts."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from twin_diagram import native
from twin_diagram.errors import TwinError

CHECKOUT = Path(__file__).resolve().parents[1]

HIDING = """
import ctypes
_load = ctypes.CDLL.__init__
def hide(self, name, *args, **kwargs):
    if str(name).startswith({prefixes!r}):
        raise OSError(f"{{name}}: cannot open shared object file")
    _load(self, name, *args, **kwargs)
ctypes.CDLL.__init__ = hide
"""


@pytest.fixture
def hidden(monkeypatch: pytest.MonkeyPatch):
    """Hides libraries from ctypes: call it with the starts of their names."""
    original = ctypes.CDLL

    def hide(*prefixes: str) -> None:
        def load(name: str, *args: object, **kwargs: object) -> ctypes.CDLL:
            if str(name).startswith(prefixes):
                raise OSError(f"{name}: cannot open shared object file")
            return original(name, *args, **kwargs)

        monkeypatch.setattr(ctypes, "CDLL", load)
        monkeypatch.setattr(native, "_loaded", {})

    return hide


def python(code: str, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=CHECKOUT,
        env={**os.environ, **env},
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_missing_egl_is_named_with_its_package(hidden) -> None:
    hidden("libEGL")
    with pytest.raises(TwinError, match=r"libEGL\.so\.1 is missing: install the package libegl1 ") as caught:
        native.require_egl()
    assert isinstance(caught.value, native.NativeLibraryError)
    assert caught.value.libraries == ("libEGL.so.1",)
    assert "\n" not in str(caught.value)


def test_several_missing_are_named_at_once(hidden, capsys: pytest.CaptureFixture[str]) -> None:
    hidden("lib")
    assert native.main() == 1
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    for library, package in native.PACKAGES.items():
        if library != "libusb-1.0.so.0":  # a wheel brings it
            assert library in line and package in line


def test_an_error_does_not_stick(hidden, monkeypatch: pytest.MonkeyPatch) -> None:
    hidden("libEGL")
    with pytest.raises(native.NativeLibraryError):
        native.require_egl()
    monkeypatch.setattr(ctypes, "CDLL", lambda *args, **kwargs: object())
    native.require_egl()
    native.require_egl()


def test_libusb_comes_from_the_wheel_where_the_system_has_none(hidden) -> None:
    hidden("libusb")  # the system's is looked for by name, the wheel's by path
    native.load_libusb()
    native.load_libusb()
    assert "libusb_package" in native._loaded["libusb-1.0.so.0"]._name


def test_libusb_nowhere(hidden, monkeypatch: pytest.MonkeyPatch) -> None:
    hidden("libusb")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(native.NativeLibraryError, match=r"libusb-1\.0-0"):
        native.load_libusb()


def test_open3d_names_what_it_links(hidden) -> None:
    hidden("libX11")
    with pytest.raises(native.NativeLibraryError, match="libx11-6"):
        native.import_open3d()


def test_open3d_imports_in_a_fresh_process(egl: None) -> None:
    done = python("from twin_diagram.native import import_open3d as o; print(o().__version__, o() is o())")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "True"


def test_open3d_comes_in_by_one_door() -> None:
    """Which loads libusb first; `test_open3d_imports_in_a_fresh_process` goes through it."""
    beside = []
    for path in sorted([*(CHECKOUT / "twin_diagram").rglob("*.py"), *(CHECKOUT / "sims").rglob("*.py")]):
        if path.name != "native.py" and re.search(
            r"^\s*(import|from) open3d|import_module\(.open3d", path.read_text(), re.MULTILINE
        ):
            beside.append(str(path))
    assert not beside, "import_open3d() is the door"


def test_libusb_is_loaded_for_open3d_alone() -> None:
    done = python("import twin_diagram.native as n; print(n._loaded)")
    assert done.stdout == "{}\n", done.stderr


def test_open3d_that_is_not_installed(egl: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(native.MissingPackageError, match="pip install open3d "), native.missing_packages_named():
        native.import_open3d()


@pytest.mark.parametrize("module", ["twin_diagram", "twin_diagram.native", "twin_diagram.cli"])
def test_importing_is_light(module: str) -> None:
    heavy = {"numpy", "pydrake", "open3d", "cv2", "scipy", "matplotlib"}
    done = python(f"import {module}, sys; print(*sorted({heavy!r} & set(sys.modules)))")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


@pytest.mark.parametrize("target", ["demo", "test"])
def test_make_names_the_package_first_and_starts_nothing(target: str, tmp_path: Path) -> None:
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    tree = tmp_path / "a folder"
    shutil.copytree(CHECKOUT / ".make", tree / ".make")
    (tree / "twin_diagram" / "runtime").mkdir(parents=True)
    modules = ("__init__", "errors", "native", "runtime/__init__", "runtime/faces", "runtime/version")
    for name in ("Makefile", "pyproject.toml", *(f"twin_diagram/{module}.py" for module in modules)):
        shutil.copy(CHECKOUT / name, tree / name)
    blind = tree / "blind"
    blind.mkdir()
    (blind / "sitecustomize.py").write_text(HIDING.format(prefixes=("libEGL",)))
    interpreter = tree / "interpreter"
    interpreter.write_text(f'#!/bin/sh\nPYTHONPATH="{blind}" exec "{sys.executable}" "$@"\n')
    interpreter.chmod(0o755)
    done = subprocess.run(
        ["make", target, f"PYTHON={interpreter}"],
        cwd=tree,
        env={k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS"))},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode != 0
    assert "libegl1" in done.stdout.splitlines()[0]
    assert not (tree / ".venv").exists()


def choose(*arguments: str, path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["/bin/sh", str(CHECKOUT / ".make" / "python.sh"), *arguments],
        env={"PATH": str(path)},
        capture_output=True,
        text=True,
        timeout=60,
    )


def fake(folder: Path, name: str, script: str) -> None:
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod(0o755)


def test_interpreter_none(tmp_path: Path) -> None:
    done = choose(path=tmp_path)
    assert done.returncode == 1
    assert "no CPython 3.10, 3.11 or 3.12 on the PATH" in done.stderr
    assert done.stderr.count("\n") == 1


def test_interpreter_given_that_does_not_fit(tmp_path: Path) -> None:
    fake(tmp_path, "python3.9", 'case "$2" in *platform*) echo CPython 3.9.18;; *) exit 1;; esac')
    done = choose("python3.9", path=tmp_path)
    assert done.returncode == 1
    assert "PYTHON=python3.9 is CPython 3.9.18" in done.stderr
    assert done.stderr.count("\n") == 1


def test_interpreter_with_venv_is_preferred(tmp_path: Path) -> None:
    fake(tmp_path, "python3.12", 'case "$2" in *ensurepip*) exit 1;; esac')  # Debian without python3.12-venv
    assert choose(path=tmp_path).stdout == "python3.12\n"
    fake(tmp_path, "python3.11", f'exec "{sys.executable}" "$@"')
    assert choose(path=tmp_path).stdout == "python3.11\n"


def test_interpreter_without_venv_names_the_package(tmp_path: Path) -> None:
    fake(tmp_path, "bare", f'case "$2" in *venv*) exit 1;; esac\nexec "{sys.executable}" "$@"')
    done = subprocess.run(
        ["/bin/sh", str(CHECKOUT / ".make" / "install.sh"), str(tmp_path / "bare"), "test"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    minor = f"{sys.version_info[0]}.{sys.version_info[1]}"
    assert f"install the package python{minor}-venv" in done.stderr
    assert not (tmp_path / ".venv").exists()


@pytest.mark.parametrize(
    "argv",
    [
        ["replay", "gone"],
        ["replay", "gone.csv"],
        ["replay", "bare.csv"],
        ["run", "tabletop", "--set", "twin.gone=1"],
        ["run", "tabletop", "--log", "log.txt"],
    ],
)
def test_what_is_plainly_wrong_is_said_before_seconds_of_importing(argv: list[str], tmp_path: Path) -> None:
    (tmp_path / "bare.csv").write_text("time\n")
    code = f"import os, sys; os.chdir({str(tmp_path)!r}); from twin_diagram.cli import main; "
    code += f"print(main({argv!r}), *sorted({{'numba', 'cv2', 'open3d', 'matplotlib'}} & set(sys.modules)))"
    done = python(code)
    assert done.stdout.split() == ["2"], (done.stdout, done.stderr)
