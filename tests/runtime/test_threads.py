"""BLAS and OpenMP: one thread while the package computes, what the user set beside it, and all as before afterwards."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import twin_diagram
from tests.small_loop import BLIND, small_scenario
from twin_diagram import cli
from twin_diagram.runs import run_scenario
from twin_diagram.runtime import child_process
from twin_diagram.runtime.threads import free_pools, one_thread, one_thread_variables

NAMES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENBLAS_DEFAULT_NUM_THREADS",
    "GOTO_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
)


def pools() -> dict[str, int]:
    """Threads by library."""
    return {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A user's process in which no variable is set and every pool has two threads."""
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    np.linalg.inv(np.eye(2))
    with threadpool_limits(2):
        assert set(pools().values()) == {2}
        yield


@pytest.mark.parametrize(
    ("given", "added"),
    [
        ({}, {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"}),
        ({"OMP_NUM_THREADS": "4"}, set()),  # what the other pools go by, too
        ({"OMP_NUM_THREADS": ""}, {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"}),
        ({"OPENBLAS_NUM_THREADS": "4"}, {"OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"}),
        ({"GOTO_NUM_THREADS": "4"}, {"OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"}),
        ({"MKL_NUM_THREADS": "4"}, {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "BLIS_NUM_THREADS"}),
    ],
)
def test_what_the_user_set_is_not_set_again(given: dict[str, str], added: set[str]) -> None:
    assert one_thread_variables(given) == dict.fromkeys(added, "1")
    assert len(free_pools(given)) == len(added)


def test_held_and_given_back(free: None) -> None:
    before, environment = pools(), dict(os.environ)
    with pytest.raises(KeyError), one_thread():
        assert set(pools().values()) == {1}
        assert os.environ["OMP_NUM_THREADS"] == os.environ["OPENBLAS_NUM_THREADS"] == "1"
        with one_thread():
            pass
        assert set(pools().values()) == {1}, "the one within gives nothing back"
        raise KeyError
    assert pools() == before and dict(os.environ) == environment


def test_two_at_a_time_give_back_what_the_first_found(free: None) -> None:
    before = pools()
    first, second = one_thread(), one_thread()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert set(pools().values()) == {1}
    second.__exit__(None, None, None)
    assert pools() == before


def test_a_variable_of_one_library_leaves_that_one_alone(free: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with one_thread():
        held = {pool["internal_api"]: pool["num_threads"] for pool in threadpool_info()}
    assert held["openblas"] == 2 and held.get("openmp", 1) == 1


def test_a_run_of_the_library_leaves_the_users_threads(free: None, tmp_path: Path) -> None:
    seen: list[set[int]] = []
    before, environment, pictures = pools(), dict(os.environ), cv2.getNumThreads()
    cv2.setNumThreads(2)
    say = lambda text: seen.append({*pools().values(), cv2.getNumThreads()})  # noqa: E731
    out = str(tmp_path / "out")  # a name will do
    run_scenario(small_scenario(*BLIND, "duration=0.05", objects=()), out=out, pictures=False, quiet=True, say=say)
    assert (tmp_path / "out" / "summary.json").is_file()
    assert seen and all(each == {1} for each in seen)
    assert cv2.getNumThreads() == 2
    cv2.setNumThreads(pictures)
    assert {path: pools()[path] for path in before} == before and dict(os.environ) == environment


def test_the_search_beside_a_run_takes_the_users_word(free: None, monkeypatch: pytest.MonkeyPatch) -> None:
    assert child_process.environment()["OPENBLAS_NUM_THREADS"] == "1"
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    environment = child_process.environment()
    assert environment["OMP_NUM_THREADS"] == "3" and "OPENBLAS_NUM_THREADS" not in environment


def test_a_command_in_a_process_of_ones_own_gives_back(free: None, capsys: pytest.CaptureFixture[str]) -> None:
    before, environment = pools(), dict(os.environ)
    assert cli.main(["predict", "--model", "no.urdf", "--log", "no.csv", "--out", "p.csv"]) == 2
    assert pools() == before and dict(os.environ) == environment


LATE = """
import json, os, sys
from threadpoolctl import threadpool_info
from twin_diagram.runtime.threads import one_thread
assert "numpy" not in sys.modules
found = []
def look():
    found.append([pool["num_threads"] for pool in threadpool_info()])
with one_thread():
    import numpy.linalg
    look()
look()
print(json.dumps([found, "OMP_NUM_THREADS" in os.environ, len(os.sched_getaffinity(0))]))
"""

COMMAND = """
import json, sys
from threadpoolctl import threadpool_info
from twin_diagram import cli
assert "numpy" not in sys.modules
def run(arguments):
    import numpy.linalg
    print(json.dumps([pool["num_threads"] for pool in threadpool_info()]))
    return 0
cli._predict = run
cli.main(["predict", "--model", "m", "--log", "l", "--out", "o"])
"""


def told(script: str, **variables: str) -> object:
    environment = {name: value for name, value in os.environ.items() if name not in NAMES}
    environment["PYTHONPATH"] = str(Path(twin_diagram.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-c", script], env={**environment, **variables}, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_library_that_comes_meanwhile_is_held_and_then_let_go() -> None:
    (held, after), left, cores = told(LATE)  # type: ignore[misc]
    assert held and set(held) == {1}
    assert set(after) == {cores} and not left


def test_a_command_begins_with_one_thread_and_takes_the_users_word() -> None:
    assert set(told(COMMAND)) == {1}  # type: ignore[call-overload]
    assert set(told(COMMAND, OPENBLAS_NUM_THREADS="2")) == {2}  # type: ignore[call-overload]
