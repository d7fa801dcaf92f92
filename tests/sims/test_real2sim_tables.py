"""A signal ends the benchmark of learning as it ends `twin-diagram learn`: what is held is set down, children end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import twin_diagram

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
RUN = """
import sys, time
sys.path.insert(0, {folder!r})
import real2sim_tables as tables
from twin_diagram.runtime import stopping

def learn(*given, **more):
    try:
        with stopping.steps():
            print("at work", file=sys.stderr, flush=True)
            while True:
                stopping.check()
                time.sleep(0.02)
    except stopping.Stopped:
        with stopping.closing(5.0):
            stopping.check()
            print("set down", file=sys.stderr, flush=True)
        raise

tables.learn = learn
sys.argv = ["real2sim_tables.py", "--first", "3", "--quick", "--plain", "--out", {out!r}]
sys.exit(tables.main())
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_lets_the_run_put_down_what_it_holds(tmp_path: Path, number: signal.Signals) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(twin_diagram.__file__).parents[1])}
    command = [sys.executable, "-c", RUN.format(folder=str(BENCHMARKS), out=str(tmp_path))]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stderr is not None and any("at work" in line for line in process.stderr)
    begun = time.monotonic()
    process.send_signal(number)
    told = process.communicate(timeout=30.0)[1]
    assert process.returncode == 128 + number and time.monotonic() - begun < 10.0
    assert told.splitlines() == ["set down", "stopped; the same command goes on"]
