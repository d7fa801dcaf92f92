"""Tells in one line what Drake's parsers warn of: of descriptions by other makers that is up to two hundred lines."""

from __future__ import annotations

import logging
import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PLACE = re.compile(r"^.*?:\d+: warning: ")
"""The file and its line, before what is said of them."""

_BUILD = re.compile(r"Failure at \S+ in (?=\w+\(\))")
"""Where in Drake's own build a check stands, before the check: a hundred letters that leave no room for it."""

_MOVES = re.compile(
    r"'(?:gravcomp|tendon|boundmass|boundinertia|density|viscosity)'|\b(?:rotational|central) inertia\b"
)
"""What other torques come of: in an MJCF, and a mass or inertia that no body can have."""

_PAINT = re.compile(r"\bvtk\w+ \(0x")
"""In what VTK says of a mesh's colours, with an address in memory: nothing moves by them."""

_told: set[Path] = set()
"""Files of which it was said: a description is read for each plant that it goes into."""


@contextmanager
def in_one_line(path: Path) -> Iterator[None]:
    """Gather the warnings of what is parsed within; all of them are said where `twin_diagram` logs what is to debug.

    Args:
        path: of the description.
    """
    drake, own = logging.getLogger("drake"), logging.getLogger("twin_diagram")
    heard: list[str] = []

    def gather(record: logging.LogRecord) -> bool:
        if own.isEnabledFor(logging.DEBUG):
            return True
        if record.levelno == logging.WARNING and not _PAINT.search(record.getMessage()):
            heard.append(_BUILD.sub("", _PLACE.sub("", record.getMessage(), count=1)))
        return record.levelno > logging.WARNING

    kept = list(drake.filters)
    drake.addFilter(gather)  # after those that are there: what they leave out is not counted
    try:
        yield
    finally:
        drake.filters[:] = kept
    if heard and path not in _told:
        _told.add(path)
        first = textwrap.shorten(
            min(heard, key=lambda said: _MOVES.search(said) is None).rstrip("."), 160, placeholder=" …"
        )
        others = f", and {len(heard) - 1} warnings more" if len(heard) > 1 else ""
        own.warning("%s: Drake: %s%s (twin-diagram --verbose tells all)", path, first, others)
