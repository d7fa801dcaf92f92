"""`make mutants` itself: what it changes and leaves alone, how it draws, and that it tells killed from survived."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
TOOL = CHECKOUT / ".make"


@pytest.fixture(autouse=True)
def tool_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOL))


def part(name: str) -> Any:
    return importlib.import_module(f"mutants.{name}")


def faults(source: str) -> set[str]:
    sites = part("sites")
    return {sites.mutated(source, site, change) for site in sites.sites(source) for change in site.changes}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("GATE = 0.5", {"GATE = 1.0", "GATE = 0.25"}),
        ("y = x ** 2", {"y = x ** 3"}),
        ("y = 2 / x", {"y = 4 / x", "y = 1 / x"}),
        ("y = a < b", {"y = (a <= b)", "y = (a > b)"}),
        ("y = a == b", {"y = (a != b)"}),
        ("y = é + b", {"y = (é - b)", "y = (é)"}),
        ("y = a * b", {"y = (a)"}),
        ("y = -a", {"y = (a)"}),
        ("y += a", {"y -= a"}),
        ("f(a, b.c, 1)", {"f(b.c, a, 1)"}),
        ("y = np.minimum(a, b)", {"y = np.maximum(a, b)"}),
        ("y = ok.any()", {"y = ok.all()"}),
        ("y = a and b", {"y = (a or b)"}),
        ("y = not a", {"y = (a)"}),
    ],
)
def test_faults(source: str, expected: set[str]) -> None:
    assert faults(source) == expected


@pytest.mark.parametrize(
    "source",
    [
        '"""Says 0.5 < 1."""',
        "x: Literal[0.5] = y",
        "def f() -> Annotated[float, 0.5 < 1]: ...",
        "raise ValueError(0.5 + x)",
        "y = f'{2.0 * x}'",
        "def __repr__(self): return 2.0 * x",
        "def sentence(self): return 2.0 * x",
        "print(2.0 * x)",
        "if TYPE_CHECKING: y = 0.5",
        "assert y, 0.5 + x",
        "y = x[n / 2, -1]",
        "y = np.zeros((n / 2, 4))",
        "y = x.sum(axis=-1)",
        "y = 'a' + b + 'c'",
        "y = 1 if x else 7",
    ],
)
def test_what_is_left_alone(source: str) -> None:
    assert not faults(source)


@pytest.mark.long
def test_drawing_is_repeatable_and_even() -> None:
    draw = part("draw").draw
    mutants = draw(CHECKOUT, 5, 60)
    assert [m.identity for m in mutants] == [m.identity for m in draw(CHECKOUT, 5, 60)]
    assert {m.identity for m in mutants} != {m.identity for m in draw(CHECKOUT, 6, 60)}
    assert len({m.identity for m in mutants}) == 60
    counts = Counter(m.package for m in mutants).values()
    assert max(counts) - min(counts) <= 1
    package = mutants[0].package
    within = draw(CHECKOUT, 5, 4, only=package)
    assert [m.identity for m in within] == [m.identity for m in mutants if m.package == package][:4]
    for mutant in mutants:
        compile(mutant.text, mutant.path, "exec")
        assert mutant.text != mutant.source == (CHECKOUT / mutant.path).read_text()
        assert part("maths_modules").is_maths(mutant.path.removeprefix("twin_diagram/").removesuffix(".py"))


@pytest.mark.parametrize(
    ("module", "maths"),
    [
        ("gap/search", True),
        ("gap/search/greedy_search", True),
        ("gap/report_words", False),
        ("gap/report/words", False),
        ("looking/plots", False),
        ("visualization/diagram_svg/svg", False),
        ("logs/resampling", True),
        ("logs/dejittering", True),
        ("logs/reading", False),
        ("station/lidar", True),
        ("station/sim/lidar", True),
        ("station/lcm/messages", False),
        ("station/lcm_messages", False),
    ],
)
def test_what_counts_as_maths_before_and_after_the_move(module: str, maths: bool) -> None:
    assert part("maths_modules").is_maths(module) == maths


SUMS = '''"""Sums."""

GATE = 3.0


def within(x: float) -> bool:
    if x is None:
        return 0.5
    return x * 2 < GATE


def unnoticed(x: float) -> float:
    return x / 4.0
'''
TESTS = """
from twin_diagram.sums import unnoticed, within


def test_within():
    assert within(1.4) and not within(1.6)


def test_unnoticed():
    assert not unnoticed(0.0)
"""


@pytest.mark.long
def test_killed_and_survived_in_a_small_checkout(tmp_path: Path) -> None:
    files = {"twin_diagram/__init__.py": "", "twin_diagram/sums.py": SUMS, "tests/test_sums.py": TESTS}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    command = [sys.executable, str(TOOL / "mutants"), "--root", str(tmp_path), "--cold", "--count", "100"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    results = [json.loads(line) for line in (tmp_path / "out" / "mutants" / "1.jsonl").read_text().splitlines()]
    verdicts = {(result["line"], result["after"]): result for result in results}
    assert verdicts[3, "6.0"]["verdict"] == "killed"  # a constant, through the function that reads it
    assert verdicts[3, "6.0"]["by"] == "tests/test_sums.py::test_within"
    assert verdicts[9, "4"]["verdict"] == "killed"
    assert verdicts[9, "(x * 2 <= GATE)"]["verdict"] == "survived"
    assert verdicts[8, "1.0"]["by"] == "no test reaches it"
    assert verdicts[13, "8.0"]["verdict"] == "survived"
    assert f"total{len(results):>16}" in done.stdout
    assert (tmp_path / "twin_diagram" / "sums.py").read_text() == SUMS
    again = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert again.stdout in done.stdout, "all are known, and nothing runs again"


def test_wrong_use_is_said() -> None:
    for wrong in (["--count", "0"], ["--only", "nowhere"]):
        command = [sys.executable, str(TOOL / "mutants"), *wrong]
        assert subprocess.run(command, capture_output=True, timeout=60).returncode
