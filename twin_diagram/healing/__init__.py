"""The twin mends its model while it runs: an alarm leads to a gap, a gap to a corrected model, and that into the loop.

`Healer` is asked between two steps of a simulator; the search itself runs in a process of its own.
"""

from twin_diagram.healing.healer import Healer
from twin_diagram.healing.process import GapProcess, Outcome
from twin_diagram.healing.tape import Tape
from twin_diagram.healing.words import sentence

__all__ = ["GapProcess", "Healer", "Outcome", "Tape", "sentence"]
