"""The twin and the closed loop: the only place where systems meet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.twin.closed_loop import ClosedLoop, connect, make_closed_loop
    from twin_diagram.twin.twin import TwinDiagram, make_twin

__all__ = [
    "ClosedLoop",
    "TwinDiagram",
    "connect",
    "make_closed_loop",
    "make_twin",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
