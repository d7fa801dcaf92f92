"""Both scenes in one meshcat, the real one solid, the twin's a ghost; live, and as a file that plays it back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer, MeshcatVisualizerParams, Role
from pydrake.systems.framework import DiagramBuilder, OutputPort

from twin_diagram.runtime import atomic_file
from twin_diagram.signals.arrays import Array
from twin_diagram.visualization.packed_page import packed

FRAME_RATE: Final = 30.0
"""Frames per second, live and recorded."""
REAL: Final = "real"
"""Where meshcat's tree holds the station's scene."""
TWIN: Final = "twin"
"""Where it holds the twin's."""


def open_meshcat(port: int | None = None) -> Meshcat:
    """Return a meshcat server that this machine alone can reach.

    Args:
        port: TCP port; None: the first free one from 7000.
    """
    return Meshcat(MeshcatParams(host="localhost", port=port, show_stats_plot=False))


@dataclass(frozen=True)
class MeshcatScenes:
    """The visualizers of a Diagram.

    Use: `ghost.make_ghost` (where there is a real scene), `add_meshcat`, build, and to keep the run `start_recording`,
    `Simulator.Initialize`, …, `write_replay`.

    Attributes:
        meshcat: the server.
        real: shows the real scene under `real/`; None where no station knows it.
        twin: shows the twin's under `twin/`.
    """

    meshcat: Meshcat
    real: MeshcatVisualizer | None
    twin: MeshcatVisualizer

    def set_view(self, p_WV: Sequence[float] | Array, p_WT: Sequence[float] | Array) -> None:
        """Look from p_WV [m] to p_WT [m] in front of a light, empty background."""
        self.meshcat.SetProperty("/Grid", "visible", False)
        self.meshcat.SetProperty("/Axes", "visible", False)
        self.meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
        self.meshcat.SetProperty("/Background", "bottom_color", [0.98, 0.98, 0.98])
        self.meshcat.SetCameraPose(cast(Any, np.array(p_WV, dtype=float)), cast(Any, np.array(p_WT, dtype=float)))

    def start_recording(self) -> None:
        """Keep each frame from now on."""
        self.meshcat.StartRecording(FRAME_RATE, False)

    def write_replay(self, path: str | Path) -> Path:
        """End the recording and write a page that plays it in any browser, without a network."""
        self.meshcat.StopRecording()
        self.meshcat.PublishRecording()
        return atomic_file.write(path, packed(self.meshcat.StaticHtml()))


def add_meshcat(
    builder: DiagramBuilder,
    meshcat: Meshcat,
    twin_query: OutputPort,
    real_query: OutputPort | None = None,
    rate: float = FRAME_RATE,
) -> MeshcatScenes:
    """Add a visualizer for each scene.

    Args:
        builder: of the Diagram that holds both.
        meshcat: see `open_meshcat`.
        twin_query: query port of the twin's SceneGraph.
        real_query: query port of the simulated station's SceneGraph (`truth.query_object`), where there is one.
        rate: frames per second.
    """

    def add(prefix: str, query: OutputPort) -> MeshcatVisualizer:
        params = MeshcatVisualizerParams(role=Role.kIllustration, prefix=prefix, publish_period=1.0 / rate)
        visualizer = MeshcatVisualizer.AddToBuilder(builder, query, meshcat, params)
        visualizer.set_name(f"{prefix}_meshcat")
        return visualizer

    return MeshcatScenes(meshcat, None if real_query is None else add(REAL, real_query), add(TWIN, twin_query))
