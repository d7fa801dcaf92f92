"""Keeps the twin's SceneGraph in step with what holds its slots, between two steps of a simulator.

A leaf's event cannot reach another system's Context. Whoever steps a Simulator calls `TwinDiagram.keep_scene` between
steps, as `run_scenario` does, or has the Simulator call
`TwinDiagram.scene_monitor`. The planner does not need this: its ports tell it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, Diagram, EventStatus

from twin_diagram.scene.slot_geometry import follow
from twin_diagram.scene.twin_scene import TwinScene
from twin_diagram.signals.things import THING_SIZE, things_of


def keep_scene(twin: Diagram, scene: TwinScene, context: Context) -> bool:
    """Give the SceneGraph the geometry of further instances and unknown things as they are now.

    Args:
        twin: as `make_twin` builds it.
        scene: the twin's.
        context: of `twin`.

    Returns:
        Whether anything changed.
    """
    further = np.asarray(twin.GetOutputPort("further_tracks").Eval(context))
    rows = np.zeros(THING_SIZE * len(scene.slots.things))
    if twin.HasOutputPort("things"):
        rows = np.asarray(twin.GetOutputPort("things").Eval(context))
    own = twin.GetMutableSubsystemContext(scene.scene_graph, context)
    return follow(scene.scene_graph, own, scene.slots, further, things_of(rows), scene.shapes_of)


def scene_monitor(twin: Diagram, scene: TwinScene) -> Callable[[Context], EventStatus]:
    """Return what keeps the scene after each step, for `Simulator.set_monitor` of any Diagram around the twin."""

    def monitor(context: Context) -> EventStatus:
        keep_scene(twin, scene, twin.GetMyMutableContextFromRoot(context))
        return EventStatus.DidNothing()

    return monitor
