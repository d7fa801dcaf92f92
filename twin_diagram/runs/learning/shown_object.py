"""What handling knows of one object: what came of its pick, and all that was seen and felt of it since."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_diagram.estimation.weighing import Excitation
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.felt_weight import Centre
from twin_diagram.runs.learning.following import Followed, cover
from twin_diagram.runs.learning.picking import Taken
from twin_diagram.runs.learning.seen_map import SeenMap
from twin_diagram.signals.arrays import Array


@dataclass
class Picked:
    """What came of a pick: what is held and the thing as it lay, or why it is not, and the tool's pose that failed.

    `others`: what else the picture shows.
    """

    thing: SeenThing
    taken: Taken | None = None
    why: str = ""
    failed: Array | None = None
    others: list[SeenThing] = field(default_factory=list)


@dataclass
class ShownObject:
    """All pictures of an object, followed, and how it is held now.

    Attributes:
        followed: pictures, poses, cloud.
        X_ST: (4, 4) of the tool in S, of each grasp.
        openings: between the pads in each grasp [m].
        seen: how well its surface was seen; None: it was not shown yet.
        seen_shares: of its surface, after each grasp.
        R_WT: (3, 3) the tool's axes in which it stands as it lay in the bin, held as it is now.
        mass_at_rest: what it seemed to weigh before it was swung [kg]; None: nobody asked.
        centre: where its weight pulls; None: nobody felt.
        swung: how it was swung; None: it was not.
        beside: (3,) middles in W of what lay on the table when it was taken: other things [m].
        notes: what went otherwise than it should.
    """

    followed: Followed = field(default_factory=Followed)
    X_ST: list[Array] = field(default_factory=list)
    openings: list[float] = field(default_factory=list)
    seen: SeenMap | None = None
    seen_shares: list[float] = field(default_factory=list)
    R_WT: Array = field(default_factory=lambda: np.eye(3))
    mass_at_rest: float | None = None
    centre: Centre | None = None
    swung: Excitation | None = None
    beside: list[Array] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def in_tool(self, edge: float = 0.01) -> Array:
        """Return the object's cells (N, 3) of an edge [m] in the tool's frame as it is held now [m]."""
        X_TS = np.linalg.inv(self.X_ST[-1])
        return np.asarray(cover(self.followed, edge) @ X_TS[:3, :3].T + X_TS[:3, 3])
