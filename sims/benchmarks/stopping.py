"""Runs that are stopped and killed at random times: how long closing takes, and whether what is left replays.

SIGINT and SIGTERM by turns, then kill -9; each run records the tabletop with its camera. Prints a line for each.

    python sims/benchmarks/stopping.py --stops 6 --kills 20
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from twin_diagram.station.replay.reading import recorded_until
from twin_diagram.station.replay.recording_folder import place_of

TWIN = [sys.executable, "-m", "twin_diagram"]
RUN = [*TWIN, "run", "tabletop", "--duration", "600", "--record", "recording", "--log", "log.npz", "--out", "out"]


def ended(folder: Path, number: int, wait: float) -> tuple[int, float]:
    """Sends a signal to a run so long after its first message [s]; its exit status, and how long it took [s]."""
    process = subprocess.Popen(RUN, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    table = folder / "recording" / "unfinished" / "messages.csv"
    while process.poll() is None and not (table.is_file() and table.stat().st_size > 100):
        time.sleep(0.05)
    time.sleep(wait)
    begin = time.perf_counter()
    process.send_signal(number)
    return process.wait(), time.perf_counter() - begin


def replays(folder: Path) -> tuple[bool, float]:
    """Whether the command replays what a run left, and until when that goes [s]."""
    done = subprocess.run([*TWIN, "replay", "recording"], cwd=folder, capture_output=True)
    return done.returncode == 0, recorded_until(place_of(folder / "recording"))


def main() -> int:
    """Prints a line for each run; status 1 where one takes over 2 s to close or does not replay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=6, help="runs that are stopped (default: %(default)s)")
    parser.add_argument("--kills", type=int, default=20, help="runs that are killed (default: %(default)s)")
    arguments, draw, good = parser.parse_args(), random.Random(18), True
    numbers = [*[signal.SIGINT, signal.SIGTERM] * (arguments.stops // 2), *[signal.SIGKILL] * arguments.kills]
    for number in numbers:
        with TemporaryDirectory() as place:
            wait = draw.uniform(0.0, 8.0)
            status, took = ended(Path(place), number, wait)
            fine, until = replays(Path(place))
            good &= fine and (took < 2.0 or number == signal.SIGKILL)
            print(f"{number.name:<8} after {wait:4.1f} s: status {status:>3} in {took:4.2f} s", end="", flush=True)
            print(f", {'replays' if fine else 'does NOT replay'} to {until:.2f} s", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
