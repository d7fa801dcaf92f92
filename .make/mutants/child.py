"""What a forked child does: runs tests in its own process, with one fault or with probes, and writes the answer."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from mutants.maths_modules import PACKAGE
from mutants.probes import Finder, Reached, install, is_compiled, probed

PLAIN = ("-q", "-p", "no:cacheprovider", "--no-header", "-p", "_hypothesis_pytestplugin")
"""Of pytest's plugins hypothesis' alone, whose profile in `tests/conftest.py` repeats its examples."""


class FirstFailure:
    """Runs chosen tests in a given order and remembers the first that fails."""

    def __init__(self, chosen: Sequence[str]):
        self.order = {name: index for index, name in enumerate(chosen)}
        self.failed = ""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave the chosen ones."""
        chosen = [item for item in items if item.nodeid in self.order]
        items[:] = sorted(chosen, key=lambda item: self.order[item.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember the first failure."""
        if report.failed and not self.failed:
            self.failed = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file that no longer imports fails, too."""
        if report.failed and not self.failed:
            self.failed = report.nodeid


def run_tests(root: Path, chosen: Sequence[str], path: str, text: str) -> dict[str, Any]:
    """Run the chosen tests until one fails, with `text` in the place of the module at `path` where there is one."""
    if is_compiled(path):
        # What is kept of the compiled functions does not know of the fault.
        os.environ["NUMBA_DISABLE_JIT"] = "1"
    if path:
        install(Finder(root, PACKAGE, lambda *_: text, only=path))
    else:
        sys.path.insert(0, str(root))
    plugin = FirstFailure(chosen)
    files = list(dict.fromkeys(name.partition("::")[0] for name in chosen))
    code = pytest.main(["-x", *PLAIN, f"--rootdir={root}", *files], plugins=[plugin])
    if code not in (0, 5) and not plugin.failed:
        plugin.failed = f"pytest ended with {int(code)}"
    return {"failed": plugin.failed, "ran": code == 0}


class Stopwatch:
    """Measures what this process and its children compute: others may be busy on the same machine.

    Waiting counts for a third, so that a test that sleeps is not free.
    """

    def __init__(self) -> None:
        self._computed, self._begin = sum(os.times()[:4]), time.monotonic()

    def seconds(self) -> float:
        """Return the seconds since it was made."""
        return max(sum(os.times()[:4]) - self._computed, (time.monotonic() - self._begin) / 3.0)


class Recorder:
    """Writes down each test's outcome, seconds and reached blocks, and the seconds and blocks of shared fixtures."""

    def __init__(self) -> None:
        self.reached = Reached()
        self.tests: dict[str, dict[str, Any]] = {}
        self.shared: dict[str, dict[str, Any]] = {}
        self.collected: set[str] = set()
        self.since_start, self.ready = Stopwatch(), 0.0
        self._apart = 0.0

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Record one test."""
        if not self.tests:
            self.collected |= self.reached.blocks
            self.ready = self.since_start.seconds()
        self.reached.blocks.clear()
        self._apart, watch = 0.0, Stopwatch()
        self.tests[item.nodeid] = {"outcome": "passed"}
        result = yield
        seconds = max(watch.seconds() - self._apart, 0.0)
        known = item._fixtureinfo.name2fixturedefs.items()  # type: ignore[attr-defined]
        fixtures = [name for name, defs in known if any(one.scope != "function" for one in defs)]
        self.tests[item.nodeid] |= {
            "seconds": round(seconds, 4),
            "shared": sorted(set(fixtures)),
            "blocks": set(self.reached.blocks),
        }
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[Any]:
        """Record a fixture that several tests share, apart from the test that happens to be first."""
        if fixturedef.scope == "function":
            return (yield)
        watch = Stopwatch()
        with self.reached.apart() as entered:
            result = yield
        entry = self.shared.setdefault(fixturedef.argname, {"seconds": 0.0, "blocks": set()})
        entry["blocks"] |= entered
        seconds = watch.seconds()
        entry["seconds"] += seconds
        self._apart += seconds
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note what did not pass."""
        if report.outcome != "passed" or hasattr(report, "wasxfail"):
            self.tests[report.nodeid]["outcome"] = report.outcome if not hasattr(report, "wasxfail") else "xfail"

    def answer(self) -> dict[str, Any]:
        """Return all that was written down, with the blocks as bits of a number."""
        for test in self.tests.values():
            shared = [self.shared[name]["blocks"] for name in test["shared"] if name in self.shared]
            test["blocks"] = test.get("blocks", set()).union(self.collected, *shared)
        names = sorted(set[str]().union(*(test["blocks"] for test in self.tests.values())))
        bit = {name: 1 << index for index, name in enumerate(names)}
        for test in self.tests.values():
            test["blocks"] = hex(sum(bit[name] for name in test["blocks"]))
        seconds = {name: round(entry["seconds"], 3) for name, entry in self.shared.items()}
        return {"blocks": names, "tests": self.tests, "shared": seconds, "import": round(self.ready, 3)}


def record(root: Path, file: str) -> dict[str, Any]:
    """Run one file of tests with probes; the answer names the files that it depends on, too."""
    install(Finder(root, PACKAGE, probed))
    recorder = Recorder()
    recorder.reached.install()
    pytest.main([*PLAIN, f"--rootdir={root}", file], plugins=[recorder])
    local = set()
    for module in list(sys.modules.values()):
        place = getattr(module, "__file__", None)
        if place and Path(place).is_relative_to(root) and place.endswith(".py"):
            local.add(Path(place).relative_to(root).as_posix())
    mine = ("twin_diagram/", "tests/", "sims/")
    return recorder.answer() | {"needs": sorted({path for path in local if path.startswith(mine)} | {file})}


def work(task: dict[str, Any], root: Path, folder: Path) -> None:
    """Do a task in a child, write the answer and end without the farewells of native libraries."""
    code = 1
    try:
        os.setsid()
        os.chdir(root)
        log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        null = os.open(os.devnull, os.O_RDONLY)
        for target, source in ((0, null), (1, log), (2, log)):
            os.dup2(source, target)
        os.environ["TMPDIR"] = str(folder)
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        import tempfile

        tempfile.tempdir = None
        kind = task["kind"]
        answer = record(root, task["file"]) if kind == "record" else run_tests(root, *task["run"])
        (folder / "answer.part").write_text(json.dumps(answer))
        (folder / "answer.part").rename(folder / "answer.json")
        code = 0
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
