"""A run of learning that a signal or a kill ends: what is held is set down in time, and the run goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin_diagram

pytestmark = pytest.mark.slow


def begin(out: Path, *more: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(Path(twin_diagram.__file__).parents[1])}
    command = [sys.executable, "-m", "twin_diagram", "learn", "bin_picking", "--out", str(out), *more]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment)


def until(process: subprocess.Popen[str], words: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return
    pytest.fail(f"it ended before {words!r}: status {process.wait()}")


def events(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]


def test_a_signal_has_what_is_held_set_down_and_the_run_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    process = begin(out)
    until(process, "display ·")
    time.sleep(4.0)
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30.0)
    assert process.returncode == 130 and time.monotonic() - begun < 10.0
    last = events(out)[-1]
    assert last["stage"] == "stop"
    if last["outcome"] != "it was set down where it was taken":
        assert last["outcome"].startswith("it is held: "), "on a busy machine there is no time"
    # Killed in the midst of the next try: nothing is half-written, and what lay in the bin lies there.
    process = begin(out, "--resume")
    until(process, "pick ·")
    time.sleep(np.random.default_rng(0).uniform(0.0, 5.0))
    process.kill()
    process.communicate()
    assert (out / "state.npz").is_file() and not list(out.glob(".*"))
    process = begin(out, "--resume")
    until(process, "display ·")  # it was found in its bin, and taken
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30.0)
    assert process.returncode == 143
