"""Both scenes on LCM, for Drake's viewer Meldis (`python -m pydrake.visualization.meldis`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pydrake.geometry import DrakeVisualizer, DrakeVisualizerParams, Role
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import DiagramBuilder, OutputPort

FRAME_RATE: Final = 30.0
"""Messages per second."""
REAL_CHANNELS: Final = ("DRAKE_VIEWER_LOAD_ROBOT", "DRAKE_VIEWER_DRAW")
"""Those on which Meldis shows what it draws by default."""
TWIN_CHANNELS: Final = ("DRAKE_VIEWER_LOAD_ROBOT_ILLUSTRATION", "DRAKE_VIEWER_DRAW_ILLUSTRATION")
"""Meldis shows the scene that was loaded last on each channel, so the twin's goes out on channels of its own."""


@dataclass(frozen=True)
class MeldisScenes:
    """The publishers of a Diagram; `real` is None where no station knows the real scene."""

    real: DrakeVisualizer | None
    twin: DrakeVisualizer


def add_meldis(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    twin_query: OutputPort,
    real_query: OutputPort | None = None,
    rate: float = FRAME_RATE,
) -> MeldisScenes:
    """Add a publisher for each scene.

    Args:
        builder: of the Diagram that holds both.
        lcm: Meldis listens on Drake's default URL; a test uses `memq://`.
        twin_query: query port of the twin's SceneGraph; published on `TWIN_CHANNELS`.
        real_query: query port of the simulated station's SceneGraph, where there is one; published on `REAL_CHANNELS`.
        rate: messages per second.
    """

    def add(name: str, query: OutputPort, suffix: bool) -> DrakeVisualizer:
        params = DrakeVisualizerParams(
            role=Role.kIllustration, publish_period=1.0 / rate, use_role_channel_suffix=suffix
        )
        visualizer = DrakeVisualizer.AddToBuilder(builder, query, lcm, params)
        visualizer.set_name(name)
        return visualizer

    real = None if real_query is None else add("real_meldis", real_query, False)
    return MeldisScenes(real, add("twin_meldis", twin_query, True))
