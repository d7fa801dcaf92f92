"""The experiments of the Hybrid Reality Twins outline on a UR5e in MuJoCo, ours beside theirs.

    # 2 seeds of each experiment, five minutes of false alarms
    python sims/benchmarks/hrt_tables.py run --quick
    python sims/benchmarks/hrt_tables.py run  # 20 seeds of each, 10 h for false alarms; goes on where it stopped
    python sims/benchmarks/hrt_tables.py report

Writes `OUT/results.jsonl`, one line per experiment and seed with a digest of the code, and `OUT/report.txt`. Lines of
another digest are not counted; a run that was broken off goes on where it stopped. `--jobs` processes, one thread each.
Needs the `demo` extra.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

SIMS = Path(__file__).resolve().parent
sys.path.insert(0, str(SIMS))

import result_lines  # noqa: E402
from hrt_bench import timings  # noqa: E402
from hrt_bench.experiments import EXPERIMENTS, Bench  # noqa: E402
from hrt_bench.report import report  # noqa: E402

TEST_SEEDS = range(1, 21)
"""Held back: nothing was tuned on them."""
LONG_SEEDS = range(101, 221)
"""Of five minutes each, for false alarms: ten hours."""
QUICK = 2


def digest() -> str:
    """Of all code that a result depends on: filter, truth and bench."""
    folders = [SIMS / "hrt_truth", SIMS / "hrt_bench", SIMS.parents[1] / "twin_diagram" / "estimation"]
    files = [SIMS / "filter_truth.py", *sorted(file for folder in folders for file in folder.rglob("*.py"))]
    return result_lines.digest(file for file in files if file.name != "report.py")


def jobs(quick: bool, only: list[str]) -> Iterator[tuple[str, int]]:
    """What is to be run: all experiments with one seed, then with the next; false alarms last."""
    names = [name for name in EXPERIMENTS if not only or name in only]
    for seed in TEST_SEEDS[: QUICK if quick else None]:
        yield from ((name, seed) for name in names if name != "false_alarms")
    if "false_alarms" in names:
        yield from (("false_alarms", seed) for seed in LONG_SEEDS[: 1 if quick else None])


def work(name: str, seed: int, trained: Path) -> dict[str, Any]:
    """One experiment with one seed, in a child process; what was trained once is read from there."""
    start = time.process_time()
    records = EXPERIMENTS[name](Bench(trained=trained), seed)
    return {
        "experiment": name,
        "seed": seed,
        "records": [finite(r) for r in records],
        "cpu_s": round(time.process_time() - start, 2),
    }


def finite(record: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no NaN."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in record.items()}


def read(path: Path, wanted: str | None) -> list[dict[str, Any]]:
    """Lines of one digest."""
    return [
        record
        for record in result_lines.read(path, of_any_code=True)
        if wanted is None or record.get("digest") == wanted
    ]


def run(out: Path, quick: bool, only: list[str], processes: int) -> None:
    """Runs what is missing."""
    code, path = digest(), out / "results.jsonl"
    out.mkdir(parents=True, exist_ok=True)
    done = {(r["experiment"], r["seed"]) for r in read(path, code)}
    missing = [job for job in jobs(quick, only) if job not in done]
    print(f"code {code}: {len(done)} results there, {len(missing)} to run", flush=True)
    with ProcessPoolExecutor(processes) as pool:
        for future in as_completed([pool.submit(work, *job, out / "trained" / code) for job in missing]):
            result = {**future.result(), "digest": code}
            result_lines.append(path, result)
            print(f"{result['experiment']} seed {result['seed']}: {result['cpu_s']} s CPU", flush=True)
    if (not only or "timings" in only) and ("timings", 0) not in done:
        found = {"experiment": "timings", "seed": 0, "records": timings.measure(), "digest": code}
        result_lines.append(path, found)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=["run", "report"])
    parser.add_argument("--quick", action="store_true", help="a few seeds of each, at most ten minutes on two cores")
    parser.add_argument("--only", action="append", default=[], choices=[*EXPERIMENTS, "timings"])
    parser.add_argument("--jobs", type=int, default=2, help="processes; each uses one thread")
    parser.add_argument("--out", type=Path, default=Path("out/hrt_tables"))
    parser.add_argument("--any-code", action="store_true", help="report on results of other versions of the code too")
    given = parser.parse_args()
    if given.command == "run":
        run(given.out, given.quick, given.only, given.jobs)
    code = None if given.any_code else digest()
    text = report(read(given.out / "results.jsonl", code), code)
    part = given.out / "report.part"
    part.write_text(text, encoding="utf-8")
    part.replace(given.out / "report.txt")
    print(text)


if __name__ == "__main__":
    main()
