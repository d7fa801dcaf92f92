"""sdist and wheel as ``python -m build`` makes them, installed in fresh environments and used from an empty folder.

Slow, and it asks the package index: `make wheels` and continuous integration run these, `make test` does not. The quick
ones at the end hold `.make/slim.txt` to pyproject.toml and say what a command tells where a package is missing.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import twin_diagram
from tests import gap_bench
from tests.estimation_bench import JOINTS, World, simulate
from tests.test_packaging import tomllib, tracked
from tests.test_readme import blocks
from twin_diagram import cli, native
from twin_diagram.logs import Log, read_log, write_log

CHECKOUT = Path(__file__).resolve().parent.parent
SLIM = CHECKOUT / ".make" / "slim.txt"
BIG = ("coacd", "collada", "cv2", "fast_simplification", "libusb_package", "open3d", "trimesh", "vhacdx")
"""What the slim installation does without, as it is imported."""


def ran(*argv: object, cwd: Path, status: int = 0) -> subprocess.CompletedProcess[str]:
    """Runs a program that sees nothing of this checkout or of its environment."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "PIP_TARGET", "PIP_USER", "VIRTUAL_ENV")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    done = subprocess.run([*map(str, argv)], cwd=cwd, env=env, capture_output=True, text=True, timeout=900)
    assert done.returncode == status, f"{argv}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def environment(folder: Path) -> Path:
    """Makes a fresh virtual environment; its interpreter."""
    ran(sys.executable, "-m", "venv", folder, cwd=folder.parent)
    return folder / "bin" / "python"


def install(python: Path, *what: object) -> None:
    ran(python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *what, cwd=python.parent)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sdist and the wheel, the one made of the other, from a copy of what the repository holds."""
    place = tmp_path_factory.mktemp("built")
    for name in tracked():
        (place / "source" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(CHECKOUT / name, place / "source" / name)
    python = environment(place / "venv")
    install(python, "build")
    ran(python, "-m", "build", "--outdir", place / "dist", cwd=place / "source")
    (sdist,), (wheel,) = (list((place / "dist").glob(f"*.{kind}")) for kind in ("tar.gz", "whl"))
    return sdist, wheel


@pytest.fixture(scope="module")
def slim(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment with the wheel and what `slim.txt` names, which has none of the rest."""
    python = environment(tmp_path_factory.mktemp("slim") / "venv")
    install(python, "-r", SLIM)
    install(python, "--no-deps", built[1])
    code = f"from importlib.util import find_spec as f; print([n for n in {BIG!r} if f(n)])"
    assert ran(python, "-c", code, cwd=python.parent).stdout == "[]\n"
    return python


@pytest.fixture(scope="module")
def full(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment with the wheel, beside the packages of this one."""
    python = environment(tmp_path_factory.mktemp("full") / "venv")
    install(python, "--no-deps", built[1])
    (site,) = (python.parent.parent / "lib").glob("python*/site-packages")
    # With their own `.pth` files, without which some are not found; an editable install of this package comes last.
    (site / "beside.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    where = ran(python, "-c", "import twin_diagram; print(twin_diagram.__file__)", cwd=python.parent).stdout
    assert Path(where.strip()).is_relative_to(site)
    return python


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


def command(python: Path) -> Path:
    return python.parent / "twin-diagram"


# Other interpreters.


def interpreter(version: str) -> str | None:
    """CPython of a version, on the PATH or of pyenv; None where there is none that runs."""
    named = [shutil.which(f"python{version}")]
    if shutil.which("pyenv"):
        prefix = subprocess.run(["pyenv", "prefix", version], capture_output=True, text=True, timeout=60)
        named.append(f"{prefix.stdout.strip()}/bin/python" if prefix.returncode == 0 else None)
    for python in filter(None, named):
        said = subprocess.run([python, "-V"], capture_output=True, text=True, timeout=60).stdout
        if said.startswith(f"Python {version}."):
            return python
    return None


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12"])
def test_other_interpreters(built: tuple[Path, Path], empty: Path, version: str) -> None:
    """With the packages that are the newest there: their Drake and NumPy are others than these."""
    if sys.version_info[:2] == tuple(map(int, version.split("."))):
        pytest.skip("is the interpreter of all other tests")
    other = interpreter(version)
    if other is None:
        pytest.skip(f"no CPython {version} on this machine")
    ran(other, "-m", "venv", empty / "venv", cwd=empty)
    python = empty / "venv" / "bin" / "python"
    install(python, built[1])
    ran(command(python), "init", "--arm", "arms/ur5e.urdf", "--out", "arm.yaml", cwd=empty)
    told = ("--duration", 1.5, "--set", "twin.camera=null", "--log", "log.csv", "--out", "out")
    assert "speed" in ran(command(python), "run", "arm.yaml", *told, cwd=empty).stdout
    gap_bench.arm(empty)
    fit, held = gap_bench.write_runs(empty, [gap_bench.dry(3.0)])
    ran(command(python), "predict", "--model", "arm.urdf", "--log", fit, "--out", "p.csv", cwd=empty)
    logs = ("--fit", fit, "--holdout", held)
    assert "friction" in ran(command(python), "gap", "--model", "arm.urdf", *logs, "--out", "gap", cwd=empty).stdout


# The slim installation.


@pytest.mark.slow
def test_slim_filter_and_monitor(slim: Path, empty: Path) -> None:
    """The README's own examples."""
    _, of_filter, of_monitor = blocks()
    assert "payload.mass" in ran(slim, "-c", of_filter, cwd=empty).stdout
    run = simulate(World.draw(5, period=4.0), 0.5)
    write_log(Log(run.time, JOINTS, run.q, velocity=run.v, torque=run.tau), empty / "run.csv")
    assert ran(slim, "-c", of_monitor, cwd=empty).stdout.splitlines()[-1] == "[]"


@pytest.mark.slow
def test_slim_systems_of_drake(slim: Path, empty: Path) -> None:
    code = """
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from twin_diagram import AdaptiveEkf, DriftMonitor, Filter
from twin_diagram.scenario import models_dir
plant = MultibodyPlant(0.0)
Parser(plant).AddModels(str(models_dir() / "arms" / "ur5e.urdf"))
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
plant.Finalize()
joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
print(AdaptiveEkf.of_plant(plant, joints, Filter()).num_input_ports() > 0, DriftMonitor.__name__)
"""
    assert ran(slim, "-c", code, cwd=empty).stdout.split() == ["True", "DriftMonitor"]


@pytest.mark.slow
def test_slim_gap_and_predict(slim: Path, empty: Path) -> None:
    fit, held = gap_bench.write_runs(empty, [gap_bench.dry(3.0)])
    logs = ("--fit", fit, "--holdout", held)
    ran(command(slim), "gap", "--model", empty / "arm.urdf", *logs, "--out", empty / "out", cwd=empty)
    found = json.loads((empty / "out" / "gap.json").read_text())
    assert found["verdict"] == "named"
    (effect,) = found["effects"]
    assert (effect["name"], effect["joints"]) == ("coulomb_friction", ["elbow"])
    assert effect["parameters"]["torque"]["elbow"]["value"] == pytest.approx(3.0, abs=0.05)
    model = ("--model", empty / "out" / "model")
    ran(command(slim), "predict", *model, "--log", held, "--out", empty / "p.csv", cwd=empty)
    lines = (empty / "p.csv").read_text().splitlines()
    assert len(lines) == 1 + len(read_log(held).time)


@pytest.mark.slow
@pytest.mark.parametrize(
    "argv",
    [["run", "tabletop"], ["replay", "folder"], ["init", "--arm", "A", "--out", "my.yaml"]],
    ids=lambda argv: argv[0],
)
def test_slim_says_what_a_command_lacks(slim: Path, empty: Path, argv: list[str]) -> None:
    gap_bench.arm(empty)
    argv = [str(empty / "arm.urdf") if part == "A" else part for part in argv]
    done = ran(command(slim), *argv, cwd=empty, status=2)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert re.match(r"error: .*opencv-python-headless.* not installed.*: pip install .*opencv-python-headless", line)
    assert [path.name for path in empty.iterdir()] == ["arm.urdf"]


# All of it.


@pytest.mark.slow
def test_full_commands_from_an_empty_folder(full: Path, empty: Path) -> None:
    told = ran(command(full), "--version", cwd=empty).stdout
    assert told == f"twin-diagram {twin_diagram.__version__}\n"
    assert "COMMAND" in ran(command(full), "--help", cwd=empty).stdout
    gap_bench.arm(empty)
    blind = ("--set", "twin.camera=null", "--duration", "1")
    ran(command(full), "init", "--arm", "arm.urdf", "--out", "my.yaml", cwd=empty)
    ran(command(full), "run", "my.yaml", *blind, "--log", "run.csv", "--out", "out", cwd=empty)
    said = ran(command(full), "predict", "--model", "arm.urdf", "--log", "run.csv", "--out", "p.csv", cwd=empty)
    assert "shoulder" in said.stdout
    lines = (empty / "p.csv").read_text().splitlines()
    assert len(lines) == 1 + len(read_log(empty / "run.csv").time)
    assert np.isfinite([float(x) for x in lines[-1].split(",")]).all()


@pytest.mark.slow
def test_full_scenarios_and_models_come_along(full: Path, empty: Path) -> None:
    blind = ("--set", "twin.camera=null", "--set", "twin.library={}", "--duration", "1")
    ran(command(full), "run", "tabletop", *blind, "--out", "out", cwd=empty)
    assert json.loads((empty / "out" / "summary.json").read_text())["health"] == []


@pytest.mark.slow
def test_sdist_holds_what_its_readme_links_to(built: tuple[Path, Path], empty: Path) -> None:
    shutil.unpack_archive(built[0], empty)
    (source,) = empty.iterdir()
    for link in re.findall(r"\]\(([^)#]+)", (source / "README.md").read_text()):
        assert link.startswith("https://") or (source / link).exists(), link


# Quick ones.


def requirements(lines: list[str]) -> dict[str, str]:
    found = (re.match(r"([\w-]+)(\S*)", line) for line in lines if line and not line.startswith("#"))
    return {match.group(1): match.group(2) for match in found if match}


def dependencies() -> dict[str, str]:
    return requirements(tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]["dependencies"])


def test_slim_is_a_part_of_the_dependencies() -> None:
    slim, every = requirements(SLIM.read_text().splitlines()), dependencies()
    assert slim.items() <= every.items(), "the bounds are pyproject's"
    assert every.keys() - slim.keys() == {native.DISTRIBUTIONS[name] for name in BIG}


def test_slim_parts_do_without_the_rest(tmp_path: Path) -> None:
    """`make test` sees it, too: the tests that install it are slow and run in CI alone. Some imports are made late."""
    _, of_filter, _ = blocks()
    code = f"""
import sys
class Lacking:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {BIG}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Lacking())
from twin_diagram import AdaptiveEkf, DriftMonitor, Filter, Monitor
from twin_diagram import load_scenario, run_gap
{of_filter}
"""
    env = {**os.environ, "PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert "payload.mass" in done.stdout


def test_every_dependency_can_be_named() -> None:
    assert set(native.DISTRIBUTIONS.values()) == dependencies().keys()


def test_several_missing_packages_are_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in BIG else object())
    native.require_packages("numpy", "pydrake")
    with pytest.raises(native.MissingPackageError) as caught:
        native.require_packages("cv2", "numpy", "trimesh")
    assert caught.value.packages == ("opencv-python-headless", "trimesh")
    assert "pip install opencv-python-headless trimesh (" in str(caught.value)
    assert "are not installed" in str(caught.value)


def test_an_import_that_fails_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lacking(arguments: object) -> int:
        raise ModuleNotFoundError("No module named 'vhacdx'", name="vhacdx")

    monkeypatch.setattr(cli, "_fields", lacking)
    assert cli.main(["fields"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: vhacdx is not installed, and this needs it: pip install vhacdx (")


@pytest.mark.parametrize("name", ["twin_diagram.nothing", "scipy.nothing", "foreign", None])
def test_other_imports_that_fail_stay_what_they_are(name: str | None) -> None:
    with pytest.raises(ModuleNotFoundError), native.missing_packages_named():
        raise ModuleNotFoundError("no", name=name)


@pytest.mark.parametrize("argv", [["run", "tabletop"], ["replay", "nothing"]])
def test_commands_look_before_they_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], argv: list[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "trimesh" else object())
    assert cli.main(argv) == 2
    assert capsys.readouterr().err.startswith("error: trimesh is not installed")
