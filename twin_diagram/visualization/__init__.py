"""What a run looks like: meshcat and its recordings, Meldis, the Diagram as a picture, plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.visualization.diagram_svg.svg import write_diagram_svg
    from twin_diagram.visualization.meldis import MeldisScenes
    from twin_diagram.visualization.meshcat import MeshcatScenes
    from twin_diagram.visualization.plots import write_plots

__all__ = [
    "MeldisScenes",
    "MeshcatScenes",
    "write_diagram_svg",
    "write_plots",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
