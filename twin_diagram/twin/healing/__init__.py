"""The twin mends its model while it runs: an alarm leads to a gap, a gap to a corrected model, and that into the loop.

`Healer` is asked between two steps of a simulator; the search itself runs in a process of its own.
"""

from twin_diagram.twin.healing.event_sentences import sentence
from twin_diagram.twin.healing.gap_process import GapProcess, SearchOutcome
from twin_diagram.twin.healing.healer import Healer
from twin_diagram.twin.healing.measurement_tape import Tape

__all__ = ["GapProcess", "Healer", "SearchOutcome", "Tape", "sentence"]
