"""What holds for the project as a whole: the wheel, the layering of its modules, the wall, its scripts."""

from __future__ import annotations

import ast
import functools
import json
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

import twin_diagram

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

CHECKOUT = Path(__file__).resolve().parent.parent
PACKAGE = CHECKOUT / "twin_diagram"
MODULES = sorted(PACKAGE.rglob("*.py"))
SIMS = sorted((CHECKOUT / "sims").rglob("*.py"))
SCRIPTS = [path for path in SIMS if "__main__" in path.read_text()]


# The wheel.


def build(source: Path, target: str, into: Path) -> Path:
    """Builds with the backend itself, which needs no network."""
    before = set(into.iterdir())
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(into)],
        cwd=source,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = set(into.iterdir()) - before
    return built


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(CHECKOUT, "wheel", tmp_path_factory.mktemp("wheel"))


def contents(wheel: Path) -> dict[str, int]:
    with zipfile.ZipFile(wheel) as archive:
        return {info.filename: info.CRC for info in archive.infolist() if ".dist-info/" not in info.filename}


def test_wheel_holds_the_models_and_the_modules(wheel: Path) -> None:
    names = set(contents(wheel))
    for path in MODULES:
        assert f"twin_diagram/{path.relative_to(PACKAGE).as_posix()}" in names
    models = [path for path in tracked() if path.startswith("models/")]
    assert models
    for path in models:
        assert f"twin_diagram/_models/{path.removeprefix('models/')}" in names
    # Nothing runs when Python starts: no .pth.
    assert not [name for name in names if not name.startswith("twin_diagram/")]


def test_wheel_from_the_sdist_is_the_same(wheel: Path, tmp_path: Path) -> None:
    sdist = build(CHECKOUT, "sdist", tmp_path)
    with tarfile.open(sdist) as archive:
        if hasattr(tarfile, "data_filter"):
            archive.extraction_filter = tarfile.data_filter
        archive.extractall(tmp_path)
    (tmp_path / "again").mkdir()
    again = build(tmp_path / sdist.name.removesuffix(".tar.gz"), "wheel", tmp_path / "again")
    assert contents(again) == contents(wheel)


def test_wheel_finds_its_models_without_the_checkout(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = (
        "import twin_diagram.scenario.resources as r; print(r.models_dir()); print(r.resolve('arms/panda_hand.urdf'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines():
        assert Path(line).is_relative_to((tmp_path / "twin_diagram" / "_models").resolve())


def test_wheel_has_the_command_and_the_version(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        folder = f"twin_diagram-{twin_diagram.__version__}.dist-info"
        assert "twin-diagram = twin_diagram.cli:main" in archive.read(f"{folder}/entry_points.txt").decode()
        about = archive.read(f"{folder}/METADATA").decode()
    assert f"\nVersion: {twin_diagram.__version__}\n" in about
    assert "\nLicense-Expression: BSD-3-Clause\n" in about


def test_installed_version_is_this_one() -> None:
    try:
        assert metadata.version("twin-diagram") == twin_diagram.__version__
    except metadata.PackageNotFoundError:
        pytest.skip("twin_diagram is on the path, but not installed")


def test_changelog_has_the_version_or_work_in_progress() -> None:
    text = (CHECKOUT / "CHANGELOG.md").read_text()
    assert f"## [{twin_diagram.__version__}]" in text or "## [Unreleased]" in text


# The layers: a module imports from its own layer or from those below it.

LAYERS = (
    {"errors", "native", "signals", "runtime"},
    {"scenario"},
    {"logs", "assets"},
    {"model"},
    {"station", "perception", "estimation", "scene", "planning", "gap"},
    {"twin"},
    {"visualization"},
    {"runs"},
    {"cli", "__main__"},
    {"__init__"},  # the face of the whole, which shows names of all below
)
SYSTEMS = {"station", "perception", "estimation", "scene", "planning", "gap"}
"""These meet in `twin` alone: none imports another."""


@functools.cache  # several tests ask it of each module
def all_imports(path: Path) -> list[tuple[str, tuple[str, ...], bool]]:
    """Each module that a file imports, the names taken from it, and whether it is for type checking alone."""
    found = []
    pending: list[tuple[ast.AST, bool]] = [(ast.parse(path.read_text(), str(path)), False)]
    while pending:
        node, typing = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            pending += [(each, True) for each in node.body] + [(each, typing) for each in node.orelse]
        elif isinstance(node, ast.Import):
            found += [(alias.name, (), typing) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.append((node.module or "", tuple(alias.name for alias in node.names), typing))
        elif isinstance(node, ast.stmt | ast.ExceptHandler | ast.match_case | ast.Module):  # no expression imports
            pending += [(each, typing) for each in ast.iter_child_nodes(node)]
    return found


def imports(path: Path, with_types: bool = False) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Each module that a file imports and the names taken from it; those for type checking alone only where asked."""
    return ((name, taken) for name, taken, typing in all_imports(path) if with_types or not typing)


def own_parts(path: Path) -> set[str]:
    """The parts of this package that a file imports, for types alone too, by the name directly below `twin_diagram`."""
    parts = set()
    for module, names in imports(path, with_types=True):
        if module == "twin_diagram":
            parts.update(names)
        elif module.startswith("twin_diagram."):
            parts.add(module.split(".")[1])
    return parts - {"__version__"}


def part_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def modules_by_part() -> dict[str, list[Path]]:
    parts: dict[str, list[Path]] = {}
    for path in MODULES:
        parts.setdefault(part_of(path), []).append(path)
    return parts


def test_every_part_has_its_layer() -> None:
    strangers = set(modules_by_part()) - set().union(*LAYERS)
    assert not strangers, "give a new module its layer in LAYERS"


def test_imports_run_downward() -> None:
    rank = {name: index for index, layer in enumerate(LAYERS) for name in layer}
    wrong = []
    for part, paths in modules_by_part().items():
        for path in paths:
            for other in own_parts(path) - {part}:
                up = rank.get(other, 0) > rank.get(part, 0)
                if up or (part in SYSTEMS and other in SYSTEMS):
                    wrong.append(f"{path.relative_to(CHECKOUT)} imports {other}")
    assert not wrong


def test_no_circles() -> None:
    edges = {part: set().union(*map(own_parts, paths)) - {part} for part, paths in modules_by_part().items()}
    done: set[str] = set()

    def visit(part: str, trail: tuple[str, ...]) -> None:
        assert part not in trail, " → ".join((*trail, part))
        if part not in done:
            for other in edges.get(part, ()):
                visit(other, (*trail, part))
            done.add(part)

    for part in edges:
        visit(part, ())


# The wall: nothing in the twin can name the world.

TWIN = {"perception", "estimation", "scene", "planning"}
WORLD_TYPES = {"Scenario", "World", "WorldObject", "WayPoint", "CameraDefects", "ArmDefects"}


def forbidden(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Where a module names the world: attributes, variables, imports, and the names of ports and fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and (node.attr in {"world", "truth"} or node.attr in WORLD_TYPES):
            yield node.lineno, node.attr
        elif isinstance(node, ast.Name) and node.id in {"world", "truth", *WORLD_TYPES}:
            yield node.lineno, node.id
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("twin_diagram"):
            for alias in node.names:
                if alias.name in WORLD_TYPES:
                    yield node.lineno, alias.name
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if re.fullmatch(r"truth\..*|world|world[.:].*|.*label_image", node.value):
                yield node.lineno, node.value


@pytest.mark.parametrize("part", sorted(TWIN))
def test_the_twin_cannot_name_the_world(part: str) -> None:
    paths = modules_by_part().get(part, [])
    assert paths
    wrong = [
        f"{path.relative_to(CHECKOUT)}:{line}: {name}"
        for path in paths
        for line, name in forbidden(ast.parse(path.read_text()))
    ]
    assert not wrong


def test_the_wall_test_sees_what_it_should() -> None:
    for bad in (
        "from twin_diagram.scenario import World",
        "x = scenario.world.objects",
        "station.GetOutputPort('truth.object_poses')",
        "camera.GetOutputPort('label_image')",
        "def f(truth): return truth",
    ):
        assert list(forbidden(ast.parse(bad))), bad
    for good in ("plant.world_frame()", "'p in the world frame W'", "builder.GetOutputPort('object_poses')"):
        assert not list(forbidden(ast.parse(good))), good


# What is declared, and what is written into files.

DISTRIBUTIONS = {
    "PIL": "pillow",
    "collada": "pycollada",
    "cv2": "opencv-python-headless",
    "fast_simplification": "fast-simplification",
    "libusb_package": "libusb-package",
    "mpl_toolkits": "matplotlib",
    "pydrake": "drake",
    "yaml": "pyyaml",
}
LCM_TYPES = {"drake"}  # pydrake puts `drake`, the LCM messages, on the path


def declared(*extras: str) -> set[str]:
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
    lines = [*project["dependencies"], *(line for extra in extras for line in project["optional-dependencies"][extra])]
    return {re.match(r"[A-Za-z0-9_.-]+", line).group().lower() for line in lines}  # type: ignore[union-attr]


def third_party(paths: list[Path]) -> dict[str, str]:
    found = {}
    local = {
        "twin_diagram",
        "tests",
        "sims",
        *(path.stem for path in paths if path not in MODULES),  # the package imports its own by their whole names
        *(path.parent.name for path in SIMS),
        *(path.stem for path in SIMS),
    }
    known = local | LCM_TYPES | {*sys.stdlib_module_names, "tomllib"}
    for path in paths:
        for module, _ in imports(path, with_types=True):
            top = module.partition(".")[0]
            if top not in known:
                found[DISTRIBUTIONS.get(top, top).lower()] = str(path.relative_to(CHECKOUT))
    return found


def test_every_import_is_declared() -> None:
    def missing(paths: list[Path], *extras: str) -> dict[str, str]:
        known = declared(*extras)
        return {name: path for name, path in third_party(paths).items() if name not in known}

    # Read where it is installed; the error says so where it is not.
    optional = {"distributed", "mujoco", "onnxruntime", "rosbags"}
    assert not {k: v for k, v in missing(MODULES).items() if k not in optional}
    assert not missing(SIMS, "demo", "bench")
    assert not missing(sorted((CHECKOUT / "tests").rglob("*.py")), "test")


def loaded_by_name(path: Path) -> set[str]:
    """The modules that a file looks for or imports by a name in a string."""
    text = path.read_text()
    if "import_module" not in text and "find_spec" not in text:
        return set()
    calls = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call) and node.args)
    names = [(ast.unparse(call.func).rpartition(".")[2], call.args[0]) for call in calls]
    return {
        argument.value
        for function, argument in names
        if function in ("import_module", "find_spec") and isinstance(argument, ast.Constant)
    }


def test_every_dependency_is_imported() -> None:
    """By the package itself: what tests alone import is asked of nobody who installs it."""
    by_name = set().union(*map(loaded_by_name, MODULES))
    used = {*third_party(MODULES), *(DISTRIBUTIONS.get(name, name) for name in by_name)}
    assert not declared() - used


def tracked() -> list[str]:
    try:
        done = subprocess.run(["git", "ls-files", "-z"], cwd=CHECKOUT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout")
    return [name for name in done.stdout.split("\0") if name and (CHECKOUT / name).is_file()]


def test_no_machine_paths_and_no_index_hosts() -> None:
    hosts = ("pypi" + ".org", "python" + "hosted", "index" + "-url", "artifact" + "ory")
    roots = "|".join(("tm" + "p", "ro" + "ot", "ho" + "me", "work", "op" + "t", "Us" + "ers"))
    path = re.compile(rf"(?<![\w./~}}-])/(?:{roots})/\w")
    wrong = []
    for name in tracked():
        data = (CHECKOUT / name).read_bytes()
        if b"\0" in data[:8000]:
            continue
        for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
            if path.search(line) or any(host in line for host in hosts):
                wrong.append(f"{name}:{number}: {line.strip()[:100]}")
    assert not wrong


def test_modules_are_plainly_named() -> None:
    for path in MODULES:
        assert not re.search(r"utils|helpers|common|misc", path.name), path


# The scripts that a user runs and reads.


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_script_begins_by_saying_what_it_shows(script: Path) -> None:
    assert ast.get_docstring(ast.parse(script.read_text()))


ASK_EACH = """
import contextlib, io, json, runpy, sys
said = {}
for script in sys.argv[1:]:
    sys.argv[:] = [script, "--help"]
    sys.path.insert(0, script.rpartition("/")[0])
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            runpy.run_path(script, run_name="__main__")
        end = "went on instead of ending"
    except SystemExit as error:
        end = error.code
    except Exception as error:
        end = repr(error)
    del sys.path[0]
    said[script] = [end, printed.getvalue()]
print(json.dumps(said))
"""


@pytest.mark.long
def test_scripts_answer_a_call_for_help() -> None:
    """All in one process: they share what they import, which is most of the time that each takes alone."""
    done = subprocess.run(
        [sys.executable, "-c", ASK_EACH, *map(str, SCRIPTS)],
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert set(said) == set(map(str, SCRIPTS))
    for script, (end, printed) in said.items():
        assert end in (None, 0), f"{script}: {end}"
        assert "usage:" in printed, script
