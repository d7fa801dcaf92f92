"""Learns objects by handling them: pick, display, reconstruct, weigh, write the asset; each stage usable alone.

From the bottom up: `cell` is the robot's side, `motion` plans; `bin_view` and `picking` take, `display` shows and
`following` tells where the camera was; `regrasping` and `setting_down` put it into other hands and places; `weighing`
swings it; `shape_worker` reconstructs in a child, `finishing` writes the asset. `handling` is what is done with one
object, `pipeline` all of them, `record` and `gallery` what stays, `start` and `command` how it begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.runs.learning.record import Learned, LearningError, RunState
    from twin_diagram.runs.learning.start import learn, learn_again

__all__ = [
    "Learned",
    "LearningError",
    "RunState",
    "learn",
    "learn_again",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
