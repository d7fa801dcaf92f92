"""How unknown things become assets while the twin runs."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass

from twin_diagram.scenario.field_table import document


@document
@dataclass
class Growing:
    """How unknown things that are seen from enough sides become assets, and come into use, while the twin runs."""

    library: str = ""
    """Folder that gets the assets; empty: ``grown/`` in the folder of the run, or a temporary one without."""
    answer_after: float = 10.0
    """An asset counts exactly this long after its pictures were enough: a simulation or replay waits for it, so that
    two runs are alike; a real arm does not, and it counts when it is there, but no sooner [s]."""
    things: int = 4
    """So many unknown things are followed at a time. One takes 20 to 50 ms of a core an image; half of that is a
    second segmentation, which all share."""
    attempts: int = 2
    """A thing of which so many reconstructions failed stays unknown."""
    patience: float = 300.0
    """A reconstruction that takes longer is stopped [s of the clock on the wall]."""
    nice: int = 5
    """How far the reconstruction stands back behind the loop: see the command `nice`."""
