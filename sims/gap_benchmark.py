"""Hides known physical effects in simulated arms and scores how well `twin-diagram gap` finds them.

The truth is made in MuJoCo by `sims/gap_truth`, which shares no code with `twin_diagram`. The workflow under test sees
a case folder alone: `model.urdf` (or the folder `model/` of a corrected model), `fit.csv` and `holdout.csv`, under
neutral names. What is true goes to a file outside that folder, which only the scorer opens.

    python sims/gap_benchmark.py generate --kind single --seed 3 --out out/case    # out/case/, out/case.truth.json
    python sims/gap_benchmark.py generate --kind single --effect payload --seed 3 --out out/case

Kinds: clean, single, several (one name on two to four joints), pair, triple, onset, dirty (the model has friction on
all joints already), outside (families that the catalogue lacks). Of `single`, seed modulo 20 is the effect. Seeds below
10000 are for training; the final figures come from seeds from 10000 on.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from gap_truth import cases


def generate(kind: str, seed: int, folder: Path, effect: str | None = None) -> dict:
    """Writes a case folder, and its truth beside it; answers the truth."""
    case = cases.make_case(kind, seed, effect)
    cases.write_case(case, folder)
    truth = cases.describe(case)
    folder.with_name(f"{folder.name}.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return truth


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("generate", help="write one case")
    make.add_argument("--kind", choices=cases.KINDS, required=True)
    make.add_argument("--seed", type=int, required=True)
    make.add_argument("--effect")
    make.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    generate(given.kind, given.seed, given.out, given.effect)
    return 0


if __name__ == "__main__":
    sys.exit(main())
