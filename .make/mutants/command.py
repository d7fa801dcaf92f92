"""The command: draws, runs, remembers, and prints who survived."""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mutants.draw import Mutant, draw
from mutants.probes import is_compiled

if TYPE_CHECKING:
    from mutants.children import Job

ROOT = Path(__file__).resolve().parent.parent.parent
RECORD_LIMIT = 1800
"""Seconds for one file of tests, once."""
PATIENCE, GRACE = 3.0, 20.0
"""A mutant that computes this many times as long as its tests should, and so many seconds more, counts as killed."""

UNCOMPILED = 10.0
"""Faults in compiled functions are run uncompiled, which takes so many times as long."""


def arguments(given: Sequence[str] | None) -> argparse.Namespace:
    """Return what the command line says."""
    parser = argparse.ArgumentParser(prog="mutants", description="Put small faults into the maths, see who survives.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=300, help="how many mutants to draw")
    parser.add_argument("--jobs", type=int, default=1, help="how many run at a time")
    parser.add_argument("--only", default="", metavar="PLACE", help="one package or file: gap, gap/search.py")
    parser.add_argument("--budget", type=float, default=40.0, help="seconds of tests per mutant")
    parser.add_argument("--tests", type=int, default=60, help="most tests per mutant")
    parser.add_argument("--again", action="store_true", help="run survivors once more, after new tests")
    parser.add_argument("--list", action="store_true", help="print the drawn mutants and run nothing")
    parser.add_argument("--show", metavar="ID", help="print the diff of one mutant, and the tests that would run")
    parser.add_argument("--survivors", action="store_true", help="print the survivors so far with their surroundings")
    parser.add_argument("--root", type=Path, default=ROOT, help=argparse.SUPPRESS)
    parser.add_argument("--cold", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(given)
    if chosen.count < 1 or chosen.jobs < 1 or chosen.tests < 1 or chosen.budget <= 0.0:
        parser.error("--count, --jobs, --tests and --budget must be positive")
    chosen.root = chosen.root.resolve()
    chosen.out = chosen.root / "out" / "mutants"
    return chosen


class Results:
    """One line of JSON per mutant; the last line on a mutant counts."""

    def __init__(self, file: Path):
        self.file = file
        self.known: dict[str, dict[str, Any]] = {}
        for line in file.read_text().splitlines() if file.is_file() else ():
            if line.endswith("}"):  # a line that an end in its midst cut off is no result
                result = json.loads(line)
                self.known[result["id"]] = result

    def add(self, mutant: Mutant, verdict: str, by: str, seconds: float, tests: int) -> None:
        """Append a verdict."""
        result: dict[str, Any] = {"id": mutant.identity, "file": mutant.path, "line": mutant.site.line}
        result |= {"operator": mutant.change.operator, "before": mutant.site.before, "after": mutant.change.text}
        result |= {"verdict": verdict, "by": by, "tests": tests, "seconds": round(seconds, 2)}
        self.known[mutant.identity] = result
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with self.file.open("a") as out:
            out.write(json.dumps(result, ensure_ascii=False) + "\n")


def table(mutants: Sequence[Mutant], known: dict[str, dict[str, Any]]) -> str:
    """Return the closing table: what was drawn, killed and survived, by package."""
    verdicts: Counter[tuple[str, str]] = Counter()
    for mutant in mutants:
        result = known.get(mutant.identity)
        kind = "left" if result is None else "survived" if result["verdict"] == "survived" else "killed"
        for package in (mutant.package, "total"):
            verdicts[package, kind] += 1
            verdicts[package, "drawn"] += 1
    rows = [f"{'package':<14}{'drawn':>7}{'killed':>8}{'survived':>10}{'killed %':>10}"]
    for package in [*sorted({mutant.package for mutant in mutants}), "total"]:
        drawn, killed, survived = (verdicts[package, kind] for kind in ("drawn", "killed", "survived"))
        share = f"{100.0 * killed / (killed + survived):.0f} %" if killed + survived else "–"
        rows.append(f"{package:<14}{drawn:>7}{killed:>8}{survived:>10}{share:>10}")
    return "\n".join(rows) + (f"\n{verdicts['total', 'left']} have not run yet" if verdicts["total", "left"] else "")


def survivors(mutants: Sequence[Mutant], known: dict[str, dict[str, Any]], context: int | None = None) -> str:
    """Return the survivors, a line each or with lines of context."""
    texts = []
    for mutant in mutants:
        result = known.get(mutant.identity)
        if result is not None and result["verdict"] == "survived":
            note = f"{mutant.line()}   ({result['by'] or str(result['tests']) + ' tests passed'})"
            texts.append(note if context is None else f"{note}\n{mutant.diff(context)}\n")
    return "\n".join(texts)


def matching(failed: str, tests: Sequence[str]) -> list[str]:
    """Return the tests that a failure speaks of: one, those of a file, or all where it names none."""
    return [name for name in tests if name == failed or name.startswith(failed + "::")] or list(tests)


class Bench:
    """What judges mutants: the map of tests, the package's blocks, the results."""

    def __init__(self, given: argparse.Namespace, results: Results):
        from mutants.blocks import Package
        from mutants.choose import Map

        self.given, self.results = given, results
        self.package, self.map = Package(given.root), Map(given.root, given.out / "map")
        self.sound: set[str] = set()

    def record(self, file: str) -> Job:
        """Run one file of tests with probes and keep what it reached."""
        answer = yield {"kind": "record", "file": file, "limit": RECORD_LIMIT}
        if "tests" not in answer:
            print(f"mutants: {file} left out: {answer['failed']}\n{answer.get('log', '')}", flush=True)
            return
        self.map.keep(file, answer)
        print(f"  {file}: {len(answer['tests'])} tests, {answer['seconds']:.0f} s", flush=True)

    def judge(self, mutant: Mutant) -> Job:
        """Run the tests that reach a mutant; believe a failure only of tests that pass without it."""
        begin, blocks = time.monotonic(), self.package.blocks_of(mutant)
        while True:
            chosen = self.map.choose(mutant.path, blocks, self.given.budget, self.given.tests)
            if not chosen.tests:
                return self._say(mutant, "survived", "no test reaches it", begin, 0)
            limit = (GRACE + PATIENCE * chosen.seconds) * (UNCOMPILED if is_compiled(mutant.path) else 1.0)
            answer = yield {"kind": "run", "run": [list(chosen.tests), mutant.path, mutant.text], "limit": limit}
            failed = answer["failed"]
            if not failed:
                by = "" if answer["ran"] else "its tests were not found"
                return self._say(mutant, "survived", by, begin, len(chosen.tests))
            named = matching(failed, chosen.tests)
            if not self.sound.issuperset(named):
                check = yield {"kind": "run", "run": [named, "", ""], "limit": limit}
                if check["failed"]:
                    self._exclude(check["failed"], named)
                    continue
                self.sound.update(named)
            return self._say(mutant, "timeout" if answer.get("timeout") else "killed", failed, begin, len(chosen.tests))

    def _exclude(self, failed: str, named: list[str]) -> None:
        unsound = matching(failed, named)
        print(f"mutants: fails without a mutant, too, and is left out: {', '.join(unsound)}", flush=True)
        self.map.excluded.update(unsound)

    def _say(self, mutant: Mutant, verdict: str, by: str, begin: float, tests: int) -> None:
        seconds = time.monotonic() - begin
        self.results.add(mutant, verdict, by, seconds, tests)
        why = by or f"{tests} tests"
        print(f"{verdict:<9}{seconds:5.0f} s  {mutant.line()}   {why}", flush=True)


def run(given: argparse.Namespace, mutants: Sequence[Mutant], results: Results) -> None:
    """Judge the mutants that have no verdict yet."""
    known = results.known
    again = [m for m in mutants if m.identity in known and known[m.identity]["verdict"] == "survived" and given.again]
    waiting = [mutant for mutant in mutants if mutant.identity not in known] + again
    if not waiting:
        return
    from mutants.children import WARM, Children, warm_up

    warm_up(() if given.cold else WARM)
    bench, children = Bench(given, results), Children(given.root, given.jobs)
    left = bench.map.load()
    if left:
        print(f"mutants: {len(left)} files of tests run once to see what they reach; some minutes", flush=True)
        children.run(bench.record(file) for file in left)
    for name in bench.map.unsound():
        print(f"mutants: fails without a mutant and is left out: {name}", flush=True)
    print(f"mutants: {len(waiting)} to run", flush=True)
    children.run(bench.judge(mutant) for mutant in waiting)


def show(given: argparse.Namespace, mutant: Mutant) -> None:
    """Print a mutant's diff and the tests that would run."""
    print(mutant.diff(3))
    bench = Bench(given, Results(given.out / "none"))
    bench.map.load()
    chosen = bench.map.choose(mutant.path, bench.package.blocks_of(mutant), given.budget, given.tests)
    print(f"\n{len(chosen.tests)} tests, {chosen.seconds:.0f} s", *chosen.tests, sep="\n  ")


def main(given: Sequence[str] | None = None) -> int:
    """Run the command; return 0 unless it was called wrongly."""
    chosen = arguments(given)
    mutants = draw(chosen.root, chosen.seed, chosen.count, chosen.only)
    results = Results(chosen.out / f"{chosen.seed}.jsonl")
    if not mutants:
        print(f"mutants: no maths module at {chosen.only!r}; see .make/mutants/maths_modules.py")
        return 2
    if chosen.show:
        found = [mutant for mutant in mutants if mutant.identity == chosen.show]
        if not found:
            print(f"mutants: {chosen.show} is not among the {len(mutants)} that seed {chosen.seed} draws")
            return 2
        show(chosen, found[0])
    elif chosen.list:
        print("\n".join(mutant.line() for mutant in mutants))
    elif chosen.survivors:
        print(survivors(mutants, results.known, context=2))
    else:
        run(chosen, mutants, results)
        print("\nSurvivors:\n" + survivors(mutants, results.known), table(mutants, results.known), sep="\n\n")
    return 0
