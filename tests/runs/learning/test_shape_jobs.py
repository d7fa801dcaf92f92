"""Reconstructions beside the picking: what fails or takes too long is told, and nothing outlives the run."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from twin_diagram.runs.learning import shape_jobs
from twin_diagram.runs.learning.shape_jobs import Done, ShapeJobs
from twin_diagram.runs.learning.shape_worker import SHAPE


def ended(jobs: ShapeJobs, count: int) -> list[Done]:
    found: list[Done] = []
    for _ in range(600):
        found += jobs.poll()
        if len(found) == count:
            return found
        time.sleep(0.1)
    raise AssertionError(f"{found} after a minute")


@pytest.mark.long
def test_frames_that_cannot_be_used_are_told_and_the_next_one_is_tried(tmp_path: Path) -> None:
    jobs = ShapeJobs()
    for name in ("object_01", "object_02"):
        (tmp_path / name).mkdir()
        jobs.add(name, tmp_path / name)
    assert jobs.pending == ["object_01", "object_02"]
    found = ended(jobs, 2)
    assert [done.name for done in found] == ["object_01", "object_02"] and not jobs.pending
    assert all(done.why and "transforms.json: no such file" in done.why for done in found)


def test_one_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    jobs = ShapeJobs(longest=0.05)
    jobs.add("object_01", tmp_path)
    (found,) = ended(jobs, 1)
    assert found.why == "the reconstruction took more than 0.05 s"


def test_one_that_has_ended_is_not_late_because_nobody_looked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shape_jobs, "WORKER", (sys.executable, "-c", ""))
    jobs = ShapeJobs(longest=0.05)
    jobs.add("object_01", tmp_path)
    jobs.poll()
    assert jobs._running is not None
    (tmp_path / SHAPE).write_text("a shape")
    jobs._running._process.wait()
    time.sleep(0.05)
    assert jobs.poll() == [Done("object_01", None)]


def test_closing_ends_what_runs(tmp_path: Path) -> None:
    jobs = ShapeJobs()
    jobs.add("object_01", tmp_path)
    jobs.poll()
    assert jobs._running is not None
    process = jobs._running._process
    jobs.close()
    assert process.poll() is not None and not jobs.pending
