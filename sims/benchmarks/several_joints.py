"""Hides several effects on several joints each, and scores what `twin-diagram gap` names, and what it says once more.

Friction of both kinds on most of an arm, and mixtures of it with other effects (`gap_truth/several_joints.py`), each at
least `APART` of the noise from every other explanation; seeds that are nearer are passed over. The workflow runs
twice: on the given model, and on its own result with the same runs, where nothing should be left.

    python sims/benchmarks/several_joints.py run --first 0 --count 20 --out out/several_joints     # training
    python sims/benchmarks/several_joints.py run --first 1000 --count 50 --out out/several_joints  # the count
    python sims/benchmarks/several_joints.py report --first 1000 --out out/several_joints

`results.jsonl` holds a line per seed; a run goes on where it stopped. `right` is every name on exactly its joints,
`wrong` any other set of names; the rest is `unknown`. `above` counts effects beside which the file holds a more
probable alternative, `over` those whose probabilities add up to more than 1, `guess` names in the headline that the
report calls a guess.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

import gap_benchmark  # noqa: E402
import result_lines  # noqa: E402
from gap_scoring import verdicts  # noqa: E402
from gap_truth import several_joints  # noqa: E402

APART = 8.0
"""Least distance of every effect on every joint from any other explanation [standard deviations of the noise]."""

LENGTH = 12.0
"""Of each run [s]."""

GUESS = 0.4
"""Probabilities below this are guesses."""

Record = dict[str, Any]


def one_seed(seed: int, keep: Path | None) -> Record:
    """Draws a case; where it is far enough apart, runs it twice and scores it."""
    record: Record = {"seed": seed, "mixture": several_joints.MIXTURES[seed % 5]}
    with tempfile.TemporaryDirectory() as scratch:
        folder, first, second = (Path(scratch) / name for name in ("case", "first", "second"))
        case, truth = gap_benchmark.generate("joints", seed, folder, duration=LENGTH)
        record |= {"arm": case.chain.kind, "separation": truth["separation"]}
        record["truth"] = {effect["name"]: effect["joints"] for effect in truth["effects"]}
        if truth["separation"] >= APART:
            try:
                record["seconds"], record["processor"] = gap_benchmark.run_workflow(folder, first)
                record |= scored(json.loads((first / "gap.json").read_text(encoding="utf-8")), truth)
                if record["verdict"] == "named":
                    record["again"] = again(folder, first, second)
            except (RuntimeError, OSError, ValueError, KeyError, subprocess.TimeoutExpired) as error:
                record["error"] = f"{type(error).__name__}: {error}"
        if keep is not None:
            shutil.rmtree(keep / str(seed), ignore_errors=True)
            shutil.copytree(scratch, keep / str(seed))
            (keep / f"{seed}.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return record


def again(folder: Path, first: Path, second: Path) -> Record:
    """What the workflow says of its own result on the same runs."""
    corrected = folder.with_name("corrected")
    shutil.copytree(first / "model", corrected / "model")
    for log in ("fit.csv", "holdout.csv"):
        shutil.copy(folder / log, corrected)
    gap_benchmark.run_workflow(corrected, second)
    found = json.loads((second / "gap.json").read_text(encoding="utf-8"))
    names = {effect["name"]: effect["joints"] for effect in found["effects"]}
    return {"verdict": found["verdict"], "remainder": found["remainder"], "claims": names}


def scored(found: Record, truth: Record) -> Record:
    """What a `gap.json` says, against the truth and against the rules of its own figures."""
    judged = verdicts.judge(found, truth)
    effects = found["effects"]
    others = [[other["probability"] for other in effect["alternatives"]] for effect in effects]
    return {
        "verdict": found["verdict"],
        "remainder": judged["remainder"],
        "set": "right" if judged["exact"] else "wrong" if effects else "unknown",
        "claims": {claim["name"]: [claim["joints"], claim["confidence"]] for claim in judged["claims"]},
        "above": sum(max(o, default=0.0) > e["confidence"] for e, o in zip(effects, others, strict=True)),
        "over": sum(e["confidence"] + sum(o) > 1.0 + 1e-6 for e, o in zip(effects, others, strict=True)),
        "guess": sum(effect["confidence"] < GUESS for effect in effects),
        "z": [[p["name"], p["joint"], p["z"]] for p in judged["parameters"]],
        "faults": judged["faults"],
    }


def run(seeds: range, count: int, out: Path, keep: bool) -> list[Record]:
    """Seeds without a result, until so many are far enough apart."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "results.jsonl"
    done = {record["seed"]: record for record in result_lines.read(path)}
    results: list[Record] = []
    for seed in seeds:
        if len(apart(results)) == count:
            break
        if seed not in done:
            done[seed] = one_seed(seed, out / "cases" if keep else None)
            result_lines.append(path, done[seed])
            print(said(done[seed]), flush=True)
        results.append(done[seed])
    return results


def apart(results: list[Record]) -> list[Record]:
    """Those that count."""
    return [record for record in results if record["separation"] >= APART]


def said(record: Record) -> str:
    """One result on a line."""
    head = f"{record['seed']:5d} {record['arm']:7s} {record['mixture']:20s} separation {record['separation']:5.1f}"
    if record["separation"] < APART:
        return f"{head}  too near, not counted"
    if "error" in record:
        return f"{head}  {record['error'].splitlines()[0][:120]}"
    far = max((abs(z) for *_, z in record["z"]), default=0.0)
    then = record.get("again", {}).get("verdict", "–")
    claims = "; ".join(
        f"{name} ({' '.join(j.removeprefix('joint_') for j in joints)}) {sure:.2f}"
        for name, (joints, sure) in record["claims"].items()
    )
    wanted = "; ".join(
        f"{name} ({' '.join(j.removeprefix('joint_') for j in joints)})" for name, joints in record["truth"].items()
    )
    wrong = "" if record["set"] == "right" else f"  of {wanted}"
    rest = " remainder" if record["remainder"] else ""
    return f"{head}  {record['set']:7s}{rest} then {then:7s} farthest {far:4.1f}  {claims}{wrong}"


def table(results: list[Record]) -> str:
    """The count."""
    counted = apart(results)
    good = [record for record in counted if "error" not in record]
    lines = [said(record) for record in counted]
    sets = [record["set"] for record in good]
    lines.append(
        f"\n{len(counted)} cases at least {APART:g} apart ({len(results) - len(counted)} drawn ones were nearer): "
        f"right {sets.count('right')}, wrong {sets.count('wrong')}, unknown {sets.count('unknown')}, "
        f"failed {len(counted) - len(good)}"
    )
    second = [record["again"]["verdict"] for record in good if "again" in record]
    if second:
        lines.append(f"second run: none {second.count('none')} of {len(second)}")
    z = np.abs([z for record in good for *_, z in record["z"]])
    if len(z):
        shares = ", ".join(f"{np.mean(z > k):.3f} beyond {k}" for k in (1, 2, 3, 4))
        lines.append(f"parameters: {len(z)}, of which {shares}; farthest {np.max(z):.1f} standard errors")
    broken = {key: sum(record[key] for record in good) for key in ("above", "over", "guess")}
    broken["faults"] = sum(len(record["faults"]) for record in good)
    lines.append(", ".join(f"{key} {value}" for key, value in broken.items()))
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=("run", "report"))
    parser.add_argument("--first", type=int, default=1000, help="first seed; below 1000 they are for training")
    parser.add_argument("--count", type=int, default=50, help="cases that are far enough apart")
    parser.add_argument("--keep", action="store_true", help="keep cases and outputs in OUT/cases")
    parser.add_argument("--out", type=Path, default=Path("out/several_joints"))
    given = parser.parse_args(arguments)
    if given.command == "run":
        results = run(range(given.first, given.first + 10 * given.count), given.count, given.out, given.keep)
    else:
        done = {record["seed"]: record for record in result_lines.read(given.out / "results.jsonl")}
        results = [done[seed] for seed in sorted(done) if seed >= given.first][: 10 * given.count]
    print(table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
