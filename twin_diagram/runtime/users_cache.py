"""Finds the folder in which the user's computer keeps what can be made anew."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path


def folder() -> Path:
    """Return the package's folder in the user's cache, which may not exist yet."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "twin_diagram"


@cache
def for_this_process() -> Path:
    """Return a folder that goes with this process, for where the user's cache cannot be written."""
    aside = tempfile.mkdtemp(prefix="twin_diagram.")
    atexit.register(shutil.rmtree, aside, ignore_errors=True)
    return Path(aside)
