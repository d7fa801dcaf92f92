"""Holds BLAS and OpenMP to one thread while the package computes: its matrices are small, more threads make it slower.

A variable that the user set wins, and what was found is left as it was.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from types import MappingProxyType
from typing import Final

from threadpoolctl import ThreadpoolController

FOR_ALL: Final = "OMP_NUM_THREADS"
"""The variable of OpenMP, which other pools go by where their own is not set."""

OWN: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "openblas": ("OPENBLAS_NUM_THREADS", "OPENBLAS_DEFAULT_NUM_THREADS", "GOTO_NUM_THREADS"),
        "mkl": ("MKL_NUM_THREADS",),
        "blis": ("BLIS_NUM_THREADS",),
    }
)
"""Variables of one kind of pool, by the names of threadpoolctl; the first of each is set here."""


@dataclass
class _Held:
    """How many callers hold this process's pools, and what undoes it: pools belong to the process, not to a caller."""

    by: int = 0
    undo: Callable[[], None] = lambda: None
    lock: Lock = field(default_factory=Lock)


_held: Final = _Held()


def free_pools(environment: Mapping[str, str]) -> list[str]:
    """Return the kinds of pools of which no variable speaks, by the names of threadpoolctl."""
    if environment.get(FOR_ALL):
        return []
    return ["openmp", *(kind for kind, names in OWN.items() if not any(map(environment.get, names)))]


def one_thread_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Return what to add to the environment of a process, so that its pools begin with one thread each.

    Args:
        environment: the process's own; what is set in it wins.
    """
    return {FOR_ALL if kind == "openmp" else OWN[kind][0]: "1" for kind in free_pools(environment)}


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold this process and those that it starts to one thread per pool; also a decorator.

    Libraries that are loaded meanwhile are held, too. In the end `os.environ` is as it was, and so are the pools; those
    that came meanwhile get a thread per core, as they would have had.
    """
    with _held.lock:
        if _held.by == 0:
            _held.undo = _hold()
        _held.by += 1
    try:
        yield
    finally:
        with _held.lock:
            _held.by -= 1
            if _held.by == 0:
                _held.undo()


def _hold() -> Callable[[], None]:
    """Set one thread in the pools and in the environment, by which libraries go when they are loaded."""
    added, kinds = one_thread_variables(os.environ), free_pools(os.environ)
    before: dict[str, int] = {}
    for pool in ThreadpoolController().select(internal_api=kinds).lib_controllers:
        before[pool.filepath] = pool.num_threads
        pool.set_num_threads(1)
    os.environ.update(added)

    def undo() -> None:
        for name in added:
            os.environ.pop(name, None)
        for pool in ThreadpoolController().select(internal_api=kinds).lib_controllers:
            pool.set_num_threads(before.get(pool.filepath, cores()))

    return undo


def cores() -> int:
    """Return how many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
