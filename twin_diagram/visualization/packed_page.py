"""Makes a page of meshcat's smaller: its long messages are kept compressed, and all are taken in in their order.

Meshcat writes each of its messages into the page as it was sent, meshes as text, once for each scene that shows them:
a robot of 30 MB of meshes made a page of 130 MB, which a browser opens late or not at all. The page stays one file that
needs no network.
"""

from __future__ import annotations

import base64
import re
import zlib
from typing import Final

_MESSAGE: Final = re.compile(
    r'fetch\("data:application/octet-binary;base64,([A-Za-z0-9+/=]*)"\)\s*'
    r"\.then\(res => res\.arrayBuffer\(\)\)\s*"
    r"\.then\(buffer => viewer\.handle_command_bytearray\(new Uint8Array\(buffer\)\)\);"
)
"""As Drake's `Meshcat.StaticHtml` writes a message."""
_SMALL: Final = 2000
"""Shorter ones stay as they are: most messages tell one property in some hundred bytes, and would not get shorter."""
_TAKEN_IN: Final = """let takenIn = Promise.resolve();
const take = (data, packed) => { takenIn = takenIn
    .then(() => fetch("data:application/octet-binary;base64," + data))
    .then(res => packed ? new Response(res.body.pipeThrough(new DecompressionStream("deflate"))) : res)
    .then(res => res.arrayBuffer())
    .then(buffer => viewer.handle_command_bytearray(new Uint8Array(buffer)))
    .catch(error => console.error(error)); };
"""
"""Takes one message in after the other: of what comes compressed, none overtakes the one before; what cannot be
taken in keeps none after it out."""


def packed(page: str) -> str:
    """Return a page of `Meshcat.StaticHtml` with its long messages compressed; one of another kind as it is."""
    first = _MESSAGE.search(page)
    if first is None:
        return page
    return page[: first.start()] + _TAKEN_IN + _MESSAGE.sub(_taken, page[first.start() :])


def _taken(message: re.Match[str]) -> str:
    """Return what takes one message in."""
    data = message[1]
    if len(data) < _SMALL:
        return f'take("{data}", false);'
    short = base64.b64encode(zlib.compress(base64.b64decode(data), 6)).decode()
    return f'take("{short}", true);'
