"""Keeps a second process out of a folder that one is at work in."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def one_at_work(lock: Path) -> Iterator[bool]:
    """Answer whether no other process is within such a block; however it ends, the next one may begin.

    Args:
        lock: a file, made where there is none and left; its folder must exist.
    """
    with lock.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True
