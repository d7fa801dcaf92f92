"""Hides known physical effects in simulated arms and scores how well `twin-diagram gap` finds them.

The truth is made in MuJoCo by `sims/benchmarks/gap_truth`, which shares no code with `twin_diagram`. The workflow under
test sees
a case folder alone: `model.urdf` (or the folder `model/` of a corrected model), `fit.csv` and `holdout.csv`, under
neutral names. What is true goes to a file outside that folder, which only the scorer opens, and only afterwards.

    # out/case/, out/case.truth.json
    python sims/benchmarks/gap_benchmark.py generate --kind single --seed 3 --out out/case
    python sims/benchmarks/gap_benchmark.py generate --kind single --effect payload --seed 3 --out out/case
    # results.jsonl; goes on after a stop
    python sims/benchmarks/gap_benchmark.py run --suite training --out out/gap_benchmark
    python sims/benchmarks/gap_benchmark.py run --suite final --out out/gap_benchmark --only single --limit 20
    python sims/benchmarks/gap_benchmark.py sizes --seeds 0 100             # sizes and separations alone
    python sims/benchmarks/gap_benchmark.py ablate --suite final            # simpler methods, a tenth of it
    python sims/benchmarks/gap_benchmark.py report --out out/gap_benchmark  # table.txt, report.html

Kinds: clean, single, several (one name on two to four joints), pair, triple, onset, dirty (the model has friction on
all joints already), outside (families that the catalogue lacks), resting (one effect in an arm that picks and places
under a stiff, noisy controller, logged at 100 Hz to 1 kHz). Of `single`, seed modulo 20 is the effect. Seeds below
10000 are for training; the final figures come from seeds from 10000 on.

`separation` in a truth file is the distance, in units of the log's noise below 20 Hz, from the true torque to the
nearest other explanation (`gap_truth/separation.py`); of several effects it is the least of theirs. Rivals with more
free numbers than the truth count as well, unless they hold it as a special case, so it errs on the low side.

How the scorer counts (`gap_scoring/verdicts.py`, `held_out.py`):
- An effect that ended within the fit log is absent from the held-out one, one that began goes on.
- `exact` asks for every name with exactly its joints and links, and no other; a rotor's inertia named beside an
  elasticity or a backlash is let pass.
- Beside the onset errors stand those of an estimator that knows all but the onset (`gap_truth/onsets.py`), in the same
  cases.
- Parameter errors leave out angles of rest, phases, curves, and the ten numbers of a link, of which a motion shows
  combinations only.
- What is left of a gap is √Σ(after² − floor²)/floor² over √Σ(before² − floor²)/floor², joints summed. The floor is
  the given model's residual less the true torque that it lacks. Cases whose gap is below two floors are left out.
- Results of other code than this, told by a digest of the package's source, are not counted.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

import result_lines  # noqa: E402
from gap_scoring import ablations, held_out, page, table, verdicts  # noqa: E402
from gap_truth import cases, onsets, separation  # noqa: E402

Truth = dict[str, Any]
Thing = TypeVar("Thing")
Found = TypeVar("Found")

SUITES: dict[str, dict[str, tuple[int, int]]] = {
    "fast": {"clean": (5, 1), "single": (5, 1)},
    "training": {
        "single": (0, 100),
        "clean": (0, 100),
        "dirty": (0, 20),
        "several": (0, 22),
        "pair": (0, 20),
        "triple": (0, 10),
        "onset": (0, 21),
        "outside": (0, 27),
    },
    "resting": {"resting": (0, 30)},
    "final": {
        "single": (10000, 200),
        "dirty": (10000, 60),
        "several": (10000, 44),
        "pair": (10000, 60),
        "triple": (10000, 20),
        "onset": (10000, 42),
        "outside": (10000, 54),
        "clean": (10000, 600),
    },
}
"""First seed and number of seeds per kind."""

SHORT = 8.0
"""Length of the logs of the suite `fast` [s]."""

LONGEST = 3600.0
"""A run of the workflow is given up after this [s]."""

RENEWED = 40
"""Cases after which a process makes way for a fresh one."""


def generate(
    kind: str, seed: int, folder: Path, effect: str | None = None, duration: float | None = None
) -> tuple[cases.Case, Truth]:
    """Writes a case folder, without its truth; answers that."""
    case = cases.make_case(kind, seed, effect, duration)
    cases.write_case(case, folder)
    truth = cases.describe(case)
    parts = separation.separations(case)
    truth["parts"] = [separation.as_dict(part, case) for part in parts]
    for effect_said, errors in zip(truth["effects"], onsets.oracle_errors(case), strict=True):
        effect_said["oracle_onset_errors"] = errors
    truth["separation"] = min((part.separation for part in parts), default=0.0)
    return case, truth


def sizes(kinds: Iterable[str], seeds: Iterable[int], folder: Path) -> str:
    """How far apart cases are, and how well the truth's own columns tell them, without running any workflow."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "sizes.jsonl"
    records = result_lines.read(path)
    done = {(r["kind"], r["seed"]) for r in records}
    for seed in seeds:
        for kind in kinds:
            if (kind, seed) in done:
                continue
            case = cases.make_case(kind, seed)
            values = {thing.name: thing.values for thing in case.hidden}
            for part in separation.separations(case):
                record = {"kind": kind, "seed": seed, **separation.as_dict(part, case), "values": values[part.name]}
                records.append(record)
                result_lines.append(path, record)
    return table.sizes(records)


def plan(suite: str, only: str | None = None) -> Iterator[tuple[str, int]]:
    """Kinds and seeds of a suite, one kind after the other in turn, so that a part of it is a fair sample."""
    wanted = {kind: span for kind, span in SUITES[suite].items() if only in (None, kind)}
    order = [((k + 0.5) / count, kind, first + k) for kind, (first, count) in wanted.items() for k in range(count)]
    for _, kind, seed in sorted(order):
        yield kind, seed


def run_workflow(folder: Path, out: Path) -> tuple[float, float]:
    """Runs the command as any user would, on what is in a case folder; answers its wall-clock and processor seconds.

    Raises:
        RuntimeError: it failed.
    """
    command = [sys.executable, "-m", "twin_diagram", "gap", "--model", str(cases.model_path(folder))]
    command += ["--fit", str(folder / "fit.csv"), "--holdout", str(folder / "holdout.csv"), "--out", str(out)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(SIMS.parents[1]), os.environ.get("PYTHONPATH")]))
    begin, used = time.perf_counter(), _children()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LONGEST)
    if done.returncode:
        raise RuntimeError(f"exit {done.returncode}: {done.stderr.strip()[-600:]}")
    return time.perf_counter() - begin, _children() - used


def _children() -> float:
    """Processor seconds of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def score(case: cases.Case, truth: Truth, folder: Path, out: Path) -> dict[str, Any]:
    """Opens the truth: what the workflow wrote to `out`, against it."""
    found = json.loads((out / "gap.json").read_text(encoding="utf-8"))
    result = verdicts.judge(found, truth)
    with tempfile.TemporaryDirectory() as scratch:
        result["held_out"] = held_out.measure(
            cases.model_path(folder),
            out / "model",
            folder / "holdout.csv",
            list(case.chain.joints),
            _at_samples(case),
            Path(scratch),
        )
    result["held_out"]["claimed"] = _claimed(found, result["held_out"])
    return result


def _at_samples(case: cases.Case) -> np.ndarray:
    """(N, n) torque that the given model truly lacks, at the held-out log's samples [N·m]."""
    setting, missing = separation.signature(case, case.holdout)
    return np.stack([np.interp(case.holdout.time, setting.time, column) for column in missing.T], axis=1)


def _claimed(found: dict[str, Any], measured: dict[str, Any]) -> float | None:
    """Largest relative difference between the gap that a report claims and the one worked out anew."""
    claimed = found.get("gap", {}).get("torque_rms", {}).get("holdout")
    if not claimed or not {"before", "after"} <= set(claimed):
        return None
    differences = [
        abs(claimed[when][joint] / value - 1.0)
        for when in ("before", "after")
        for joint, value in zip(measured["joints"], measured[when], strict=True)
    ]
    return max(differences)


def one_case(
    kind: str, seed: int, keep: Path | None = None, effect: str | None = None, duration: float | None = None
) -> dict[str, Any]:
    """Generates, runs and scores a case; a failure is a result too."""
    record: dict[str, Any] = {"kind": kind, "seed": seed, "version": _version()}
    with tempfile.TemporaryDirectory() as scratch:
        folder, out = Path(scratch) / "case", Path(scratch) / "out"
        case, truth = generate(kind, seed, folder, effect, duration)
        record |= {key: truth[key] for key in ("separation", "parts", "dirty", "period")}
        record |= {"arm": case.chain.kind, "truth_names": [effect["name"] for effect in truth["effects"]]}
        try:
            record["seconds"], record["processor"] = run_workflow(folder, out)
            record |= score(case, truth, folder, out)
        except (RuntimeError, OSError, ValueError, KeyError, subprocess.TimeoutExpired) as error:
            record["error"] = f"{type(error).__name__}: {error}"
        if keep is not None:
            target = keep / f"{kind}_{seed}"
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(scratch, target)
            (keep / f"{kind}_{seed}.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return record


def run(
    wanted: Iterable[tuple[str, int]], folder: Path, keep: bool = False, duration: float | None = None, jobs: int = 1
) -> list[dict[str, Any]]:
    """All cases that have no result yet, some at a time; answers all results."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.jsonl"
    results = result_lines.read(path)
    done = {(r["kind"], r["seed"]) for r in results}
    wanted = [case for case in wanted if case not in done]
    work = partial(_run_one, keep=folder / "cases" if keep else None, duration=duration)
    for count, record in enumerate(_dealt(work, wanted, jobs), 1):
        result_lines.append(path, record)
        results.append(record)
        print(f"{count}/{len(wanted)} {_said(record)}", flush=True)
    return results


def _run_one(case: tuple[str, int], keep: Path | None, duration: float | None) -> dict[str, Any]:
    return one_case(*case, keep, duration=duration)


def _dealt(work: Callable[[Thing], Found], things: Sequence[Thing], jobs: int) -> Iterator[Found]:
    """What work makes of things, as it comes, with one process or several."""
    if jobs == 1:
        yield from map(work, things)
        return
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # for those that are started here
    with get_context("spawn").Pool(jobs, maxtasksperchild=RENEWED) as pool:
        yield from pool.imap_unordered(work, things)


def _said(record: dict[str, Any]) -> str:
    head = f"{record['kind']} {record['seed']} {record['arm']} {'+'.join(record['truth_names']) or '–'}"
    head += f" separation {record['separation']:.3g}: "
    if "error" in record:
        return head + record["error"].splitlines()[0][:160]
    claims = ", ".join(
        f"{c['name']}({' '.join(c['joints'] + c['links'])}) {c['confidence']:.3f}" for c in record["claims"]
    )
    left = record["held_out"]["left"] if record["held_out"]["visible"] else None
    verdict = record["verdict"] + (" with remainder" if record["remainder"] else "")
    gap = "" if left is None else f", gap left {100 * left:.0f} %"
    return head + f"{'right' if record['exact'] else 'WRONG'}: {verdict} {claims}{gap}, {record['seconds']:.0f} s"


def ablate(suite: str, folder: Path, limit: int | None = None, jobs: int = 1) -> str:
    """Simpler methods on every tenth case of a suite; goes on where it stopped."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "ablations.jsonl"
    records = result_lines.read(path)
    done = {(r["method"], r["kind"], r["seed"]) for r in records}
    absent = {name: ablations.missing_method(name) for name in ablations.METHODS}
    open_ones = [
        (kind, seed, [name for name, why in absent.items() if not why and (name, kind, seed) not in done])
        for kind, seed in tenth(suite)[:limit]
    ]
    for found in _dealt(_ablate_one, [case for case in open_ones if case[2]], jobs):
        for record in found:
            result_lines.append(path, record)
            said = f"{record['method']} {record['kind']} {record['seed']} separation {record['separation']:.3g}"
            print(f"{said}: {'right' if record['exact'] else 'WRONG'}, {len(record['claims'])} names", flush=True)
        records += found
    chosen = set(tenth(suite))
    results = [r for r in result_lines.read(folder / "results.jsonl") if (r["kind"], r["seed"]) in chosen]
    text = table.ablations(records, results)
    text += "".join(f"\nleft out: {name}: {why}" for name, why in absent.items() if why)
    (folder / "ablations.txt").write_text(text + "\n", encoding="utf-8")
    return text


def _ablate_one(case: tuple[str, int, list[str]]) -> list[dict[str, Any]]:
    """Results of some methods on a case."""
    kind, seed, methods = case
    result = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "case"
        made, truth = generate(kind, seed, folder)
        before, floor = ablations.floors(folder, _at_samples(made))
        for name in methods:
            found, after, used = ablations.run_method(name, folder, made.chain.n)
            record = {"method": name, "kind": kind, "seed": seed, "separation": truth["separation"]}
            record |= {key: verdicts.judge(found, truth)[key] for key in ("verdict", "exact", "hits", "claims")}
            result.append(record | {"processor": used, **held_out.left_over(before, after, floor)})
    return result


def tenth(suite: str) -> list[tuple[str, int]]:
    """A fixed tenth of a suite."""
    return list(plan(suite))[::10]


def write_report(folder: Path) -> str:
    """The table and the page of a folder's results."""
    results = result_lines.read(folder / "results.jsonl")
    if not results:
        return f"{folder}: no results yet"
    ablated = result_lines.read(folder / "ablations.jsonl")
    text = table.report(results)
    if ablated:
        chosen = {(r["kind"], r["seed"]) for r in ablated}
        text += "\n\n" + table.ablations(ablated, [r for r in results if (r["kind"], r["seed"]) in chosen])
    (folder / "table.txt").write_text(text + "\n", encoding="utf-8")
    (folder / "report.html").write_text(page.page(results, ablated), encoding="utf-8")
    return text


def _version() -> str:
    import twin_diagram

    return str(twin_diagram.__version__)


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("generate", help="write one case, and its truth beside it")
    make.add_argument("--kind", choices=cases.KINDS, required=True)
    make.add_argument("--seed", type=int, required=True)
    make.add_argument("--effect", help="a name of the catalogue or of a family beyond it; default: the seed says")
    make.add_argument("--out", type=Path, required=True)
    go = commands.add_parser("run", help="run and score the cases of a suite that have no result yet")
    go.add_argument("--suite", choices=SUITES, default="training")
    go.add_argument("--only", choices=cases.KINDS, help="one kind alone")
    go.add_argument("--limit", type=int, help="at most so many cases of the suite")
    go.add_argument("--keep", action="store_true", help="keep the cases, the outputs and the truth in OUT/cases")
    go.add_argument("--jobs", type=int, default=1, help="cases at a time")
    go.add_argument("--out", type=Path, default=Path("out/gap_benchmark"))
    far = commands.add_parser("sizes", help="table of sizes and separations; runs no workflow")
    far.add_argument("--kind", choices=cases.KINDS, action="append")
    far.add_argument("--seeds", type=int, nargs=2, default=(0, 100), metavar=("FIRST", "LAST"))
    far.add_argument("--out", type=Path, default=Path("out/gap_benchmark"))
    less = commands.add_parser("ablate", help="simpler methods on every tenth case of a suite")
    less.add_argument("--suite", choices=SUITES, default="final")
    less.add_argument("--limit", type=int)
    less.add_argument("--jobs", type=int, default=1, help="cases at a time")
    less.add_argument("--out", type=Path, default=Path("out/gap_benchmark"))
    say = commands.add_parser("report", help="table and plot of the results that there are")
    say.add_argument("--out", type=Path, default=Path("out/gap_benchmark"))
    given = parser.parse_args(arguments)
    if given.command == "generate":
        _, truth = generate(given.kind, given.seed, given.out, given.effect)
        text = json.dumps(truth, indent=1, default=float) + "\n"
        given.out.with_name(f"{given.out.name}.truth.json").write_text(text, encoding="utf-8")
        return 0
    if given.command == "sizes":
        print(sizes(given.kind or ["single", "outside"], range(*given.seeds), given.out))
        return 0
    if given.command == "ablate":
        print(ablate(given.suite, given.out, given.limit, given.jobs))
        return 0
    if given.command == "run":
        duration = SHORT if given.suite == "fast" else None
        run(list(plan(given.suite, given.only))[: given.limit], given.out, given.keep, duration, given.jobs)
    print(write_report(given.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
