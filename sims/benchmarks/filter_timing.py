"""What the filter costs: one update, its Drake calls alone, a rollout of 100 ms, and how both grow with the joints.

    python sims/benchmarks/filter_timing.py

Times are this process's CPU time on one core. 6 joints are a UR5e, 7 a Panda, 12 and 18 are two and three UR5e in one
plant. With viscous friction per joint as parameters the 6 joints make 24 states: q, v, the torque unmodelled, θ.
Needs the `demo` extra.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from hrt_bench import timings


def main() -> None:
    """Prints the table."""
    argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    print("\n".join(timings.table(timings.measure())))


if __name__ == "__main__":
    main()
