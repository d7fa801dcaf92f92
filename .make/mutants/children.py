"""A warm process that forks one child per task: what is slow to import is imported once."""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mutants import child
from mutants.maths_modules import PACKAGE

WARM = (
    *("numpy", "scipy.optimize", "scipy.spatial.transform", "scipy.signal", "scipy.stats", "matplotlib.pyplot", "yaml"),
    *("pydrake.all", "open3d", "mujoco", "cv2", "trimesh", "proxsuite", "rosbags.highlevel", "hypothesis"),
    *("PIL.Image", "psutil", "hypothesis.strategies"),
)
"""What tests and package import from elsewhere. Never the package itself: each child imports it with its own fault."""

Task = dict[str, Any]
Job = Generator[Task, dict[str, Any], None]
"""Yields tasks, gets each one's answer."""


def warm_up(names: Sequence[str] = WARM) -> None:
    """Import what is slow to import, and nothing of the package."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    os.environ.setdefault("MPLBACKEND", "Agg")
    for name in names:
        try:
            if name == "open3d":
                importlib.import_module(f"{PACKAGE}.native").load_libusb()
            importlib.import_module(name)
        except (ImportError, ValueError):  # a library that Open3D links may be missing, too
            print(f"mutants: {name} does not import; tests that need it do without")
    # Loading libusb for Open3D has taken some of the package.
    for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
        del sys.modules[name]
    gc.collect()
    gc.freeze()


@dataclass
class Running:
    """A child at work."""

    job: Job
    task: Task
    folder: Path
    begin: float = field(default_factory=time.monotonic)


class Children:
    """Runs jobs, a few at a time, each task in a child of its own."""

    def __init__(self, root: Path, jobs: int):
        self.root, self.jobs = root, jobs
        self._at_work: dict[int, Running] = {}
        self._base = Path()

    def run(self, jobs: Iterable[Job]) -> None:
        """Run all jobs to their ends."""
        waiting: Iterator[Job] = iter(jobs)
        self._base = Path(tempfile.mkdtemp(prefix="mutants-"))
        before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no child is left behind
        try:
            while True:
                while len(self._at_work) < self.jobs and (job := next(waiting, None)) is not None:
                    self._go_on(job, None)
                if not self._at_work:
                    return
                self._look()
                time.sleep(0.02)
        finally:
            for pid in list(self._at_work):
                self._end(pid)
            shutil.rmtree(self._base, ignore_errors=True)
            signal.signal(signal.SIGTERM, before)

    def _go_on(self, job: Job, answer: dict[str, Any] | None) -> None:
        try:
            task = next(job) if answer is None else job.send(answer)
        except StopIteration:
            return
        folder = Path(tempfile.mkdtemp(dir=self._base))
        pid = os.fork()
        if pid == 0:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            limit = int(task["limit"]) + 1
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            child.work(task, self.root, folder)
        self._at_work[pid] = Running(job, task, folder)

    def _look(self) -> None:
        for pid, running in list(self._at_work.items()):
            done, status = os.waitpid(pid, os.WNOHANG)
            seconds = time.monotonic() - running.begin
            # The limit is one of computing time; a machine that is busy otherwise gets three times as long.
            late = seconds > 3.0 * running.task["limit"] + 20.0
            if done or late:
                answer = self._answer(running, status, late and not done) | {"seconds": round(seconds, 2)}
                self._end(pid, gone=bool(done))
                self._go_on(running.job, answer)

    def _answer(self, running: Running, status: int, late: bool) -> dict[str, Any]:
        file = running.folder / "answer.json"
        if file.is_file():
            return dict(json.loads(file.read_text()))
        by = os.WTERMSIG(status) if not late and os.WIFSIGNALED(status) else 0
        if late or by in (signal.SIGXCPU, signal.SIGKILL):
            return {"failed": "time limit", "timeout": True}
        log = (running.folder / "log").read_text(errors="replace") if (running.folder / "log").is_file() else ""
        return {"failed": f"crash (signal {by})", "crash": True, "log": log[-2000:]}

    def _end(self, pid: int, gone: bool = False) -> None:
        running = self._at_work.pop(pid)
        try:
            os.killpg(pid, signal.SIGKILL)  # the child leads a group of its own, with whatever it has started
        except ProcessLookupError:
            if not gone:
                os.kill(pid, signal.SIGKILL)  # it had no time to lead one
        if not gone:
            os.waitpid(pid, 0)
        shutil.rmtree(running.folder, ignore_errors=True)
