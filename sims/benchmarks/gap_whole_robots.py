"""Scores `twin-diagram gap` on arms in MuJoCo that lack everything at once, as real ones do.

    python sims/benchmarks/gap_whole_robots.py --first 0 --count 10 --quick    # runs of 5 to 12 s
    python sims/benchmarks/gap_whole_robots.py --first 0 --count 150           # 5 to 60 s; goes on where it stopped
    python sims/benchmarks/gap_whole_robots.py --second                        # each corrected model on both logs again
    python sims/benchmarks/gap_whole_robots.py --table                         # the figures alone

Arms have three to seven revolute joints, published or drawn. Links are off by 3 to 30 %, friction is only roughly the
catalogue's (sigmoid, |v|^0.7, asymmetric, load-dependent, hysteresis, drift of 10 %), rotors are unknown or wrong,
three joints in ten have gains off by 2 to 5 %, half an offset; torque is coloured and quantised, logs are of 100 Hz to
1 kHz, sines or moves between poses, the held-out run another motion. Every second arm has one unusual thing more, every
fifth is as described. Seeds below 100 000 are for training.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

import result_lines  # noqa: E402
from whole_robots import runs, scoring, table  # noqa: E402

LONGEST = 900.0
"""A run of `gap` is given up after this [s]."""


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="seed of the first arm (default: %(default)s)")
    parser.add_argument("--count", type=int, default=10, help="how many (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="runs of 5 to 12 s instead of 5 to 60")
    parser.add_argument("--second", action="store_true", help="run each corrected model on both logs again")
    parser.add_argument("--table", action="store_true", help="print the figures of what was run")
    parser.add_argument("--out", type=Path, default=Path("out/gap_whole_robots"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "results.jsonl"
    results = result_lines.read(path)
    done = {(r["seed"], r["quick"]) for r in results}
    for seed in range(given.first, given.first + (0 if given.table else given.count)):
        if (seed, given.quick) in done:
            continue
        results.append(one(seed, given.quick, given.second))
        result_lines.append(path, results[-1])
        print(said(results[-1]), flush=True)
    print(table.text(results))
    return 0


def one(seed: int, quick: bool, second: bool) -> dict[str, Any]:
    """Draws, runs and scores an arm; a failure is a result too."""
    result: dict[str, Any] = {"seed": seed, "quick": quick}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        robot = runs.make(seed, quick, folder)
        try:
            result["processor"] = gap(folder / "model.urdf", folder, folder / "gap")
            result |= scoring.score(robot, folder, folder / "gap")
            if (folder / "unloaded.csv").is_file():
                gap(folder / "model.urdf", folder, folder / "bare", "unloaded", "unloaded")
                gap(folder / "bare" / "model", folder, folder / "loaded")
                answer = json.loads((folder / "loaded" / "gap.json").read_text(encoding="utf-8"))
                result["loaded"] = [*scoring.payload(robot, answer), answer["verdict"]]
            if second:
                for what, logs in (("second", ("fit", "holdout")), ("later", ("holdout", "fit"))):
                    gap(folder / "gap" / "model", folder, folder / what, *logs)
                    result[what] = json.loads((folder / what / "gap.json").read_text(encoding="utf-8"))["verdict"]
        except (RuntimeError, OSError, ValueError, KeyError, subprocess.TimeoutExpired) as error:
            result["error"] = f"{type(error).__name__}: {str(error)[:300]}"
    return result


def gap(model: Path, folder: Path, out: Path, fit: str = "fit", holdout: str = "holdout") -> float:
    """Runs the command as any user would; answers its processor seconds."""
    command = [sys.executable, "-m", "twin_diagram", "gap", "--model", str(model), "--out", str(out)]
    command += ["--fit", str(folder / f"{fit}.csv"), "--holdout", str(folder / f"{holdout}.csv")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(SIMS.parents[1]), os.environ.get("PYTHONPATH")]))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LONGEST)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    return after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime


def said(result: dict[str, Any]) -> str:
    """One line of one arm."""
    if "error" in result:
        return f"{result['seed']}: {result['error']}"
    verdict = result["verdict"] + (" with remainder" if result["remainder"] else "")
    true = "as described" if result["as_described"] else ", ".join(result["unusual"]) or "usual"
    ratio = result["held_out"]["over_told"]
    return (
        f"{result['seed']} {result['setting'].get('arm', '')}: {true} -> {verdict}: {', '.join(result['names'])}; "
        f"held out {ratio:.2f} x told, {result['processor']:.0f} s"
    )


if __name__ == "__main__":
    sys.exit(main())
