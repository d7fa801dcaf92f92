"""Geometry of slots in the twin's SceneGraph: filled, shaped and freed in a Context, without building anything anew.

Further instances and unknown things have frames of a source of their own. What hangs on a frame is said by its
geometries' names (who holds the slot, and of which shape), so the Context itself tells what has to change, and
two Contexts never meet.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from pydrake.common import MemoryFile
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    Convex,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryId,
    GeometryInstance,
    IllustrationProperties,
    InMemoryMesh,
    PerceptionProperties,
    ProximityProperties,
    QueryObject,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
    SourceId,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, LeafSystem
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, Thing

THING_COLOUR: Final = Rgba(0.9, 0.55, 0.1, 0.45)
"""Of unknown things: nothing else in the picture is orange and clear."""
_SOURCE: Final = "slots"
"""Name of the frames' source in the SceneGraph."""
Shapes = Sequence[tuple[RigidTransform, Any, Role, Any]]
"""Where a shape sits in its frame, the shape, its role and its properties."""


@dataclass(frozen=True)
class SlotFrames:
    """Frames that slots' geometry hangs on.

    Attributes:
        source: theirs.
        further: of further instances, a frame each; posed by their tracks.
        things: of unknown things; at W, for their pieces are told there.
    """

    source: SourceId
    further: tuple[FrameId, ...]
    things: tuple[FrameId, ...]

    def poses(self, further: Array) -> FramePoseVector:
        """Return where the frames are.

        Args:
            further: (F · FURTHER_TRACK_SIZE) of further instances; those of free slots are at W's origin, and empty.
        """
        poses = FramePoseVector()
        for frame, row in zip(self.further, further.reshape(-1, FURTHER_TRACK_SIZE), strict=True):
            X_WO = RigidTransform()
            if row[0] > 0:
                turn, place = row[OWNER_SIZE + 2 : OWNER_SIZE + 6], row[OWNER_SIZE + 6 : OWNER_SIZE + 9]
                X_WO = RigidTransform(RotationMatrix(rotations.matrix(rotations.normalized(turn))), cast(Any, place))
            poses.set_value(frame, X_WO)
        for frame in self.things:
            poses.set_value(frame, RigidTransform())
        return poses


class SlotPoses(LeafSystem):
    """Poses the slots' frames.

    .. pydrake_system::

        name: SlotPoses
        input_ports:
        - further_tracks (optional)
        output_ports:
        - poses

    Ports:
        further_tracks: (F · FURTHER_TRACK_SIZE) of further instances; not connected: there are none.
        poses: (FramePoseVector) of the slots' frames.
    """

    def __init__(self, frames: SlotFrames) -> None:
        """Size the ports for the frames of slots."""
        super().__init__()
        self._frames: Final = frames
        self._size: Final = len(frames.further) * FURTHER_TRACK_SIZE
        self._further = self.DeclareVectorInputPort("further_tracks", self._size)
        self.DeclareAbstractOutputPort("poses", lambda: AbstractValue.Make(FramePoseVector()), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        known = self._further.HasValue(context)
        output.set_value(self._frames.poses(np.asarray(self._further.Eval(context)) if known else np.zeros(self._size)))


def add_slot_frames(scene_graph: SceneGraph, further: int, things: int) -> SlotFrames:
    """Add frames for slots to a SceneGraph that no Context was made of yet."""
    source = scene_graph.RegisterSource(_SOURCE)

    def frames(name: str, count: int) -> tuple[FrameId, ...]:
        return tuple(scene_graph.RegisterFrame(source, GeometryFrame(f"{name}{k}")) for k in range(count))

    return SlotFrames(source, frames("instance", further), frames("unknown", things))


def follow(
    scene_graph: SceneGraph,
    context: Context,
    frames: SlotFrames,
    further: Array,
    things: Sequence[Thing],
    shapes_of: Callable[[int], Shapes],
) -> bool:
    """Give a Context the geometry of what holds the slots now; what is right already is left alone.

    Args:
        scene_graph: with the frames.
        context: its own Context, which is changed.
        frames: of the slots.
        further: (F · FURTHER_TRACK_SIZE) of further instances.
        things: of the slots of unknown things.
        shapes_of: the shapes of one of the library's objects, by its number.

    Returns:
        Whether anything changed.
    """
    query = cast(QueryObject, scene_graph.get_query_output_port().Eval(context))
    inspector = query.inspector()
    wanted: list[tuple[FrameId, str, Callable[[], Shapes]]] = []
    for frame, row in zip(frames.further, further.reshape(-1, FURTHER_TRACK_SIZE), strict=True):
        there = row[0] > 0 and row[OWNER_SIZE] not in (ObjectStatus.UNSEEN, ObjectStatus.GONE)
        asset = int(row[1])
        wanted.append((frame, f"{int(row[0])}" if there else "", lambda asset=asset: shapes_of(asset)))  # type: ignore[misc]
    for frame, thing in zip(frames.things, things, strict=True):
        mark = zlib.crc32(b"".join(piece.tobytes() for piece in thing.pieces))
        name = f"{thing.identity}.{mark:08x}" if thing.stands else ""
        wanted.append((frame, name, lambda thing=thing: _shapes_of_thing(thing)))  # type: ignore[misc]
    todo = [
        (frame, name, make, list(inspector.GetGeometries(frame)))
        for frame, name, make in wanted
        if _mark(inspector, frame) != name
    ]
    for frame, name, make, there in todo:
        for geometry in there:
            scene_graph.RemoveGeometry(context, frames.source, cast(GeometryId, geometry))
        if name:
            _hang(scene_graph, context, frames.source, frame, name, make())
    return bool(todo)


def library_shapes(scene_graph: SceneGraph, frame: FrameId) -> list[tuple[RigidTransform, Any, Role, Any]]:
    """Return the shapes that hang on a frame of the model, in all their roles."""
    inspector = scene_graph.model_inspector()
    found: list[tuple[RigidTransform, Any, Role, Any]] = []
    for geometry in inspector.GetGeometries(frame):
        X_FG, shape = inspector.GetPoseInFrame(geometry), inspector.GetShape(geometry)
        for role, properties in (
            (Role.kIllustration, inspector.GetIllustrationProperties(geometry)),
            (Role.kProximity, inspector.GetProximityProperties(geometry)),
            (Role.kPerception, inspector.GetPerceptionProperties(geometry)),
        ):
            if properties is not None:
                found.append((X_FG, shape, role, properties))
    return found


def _mark(inspector: SceneGraphInspector, frame: FrameId) -> str:
    """Return the part before the slash of the names of what hangs on a frame; nothing where nothing does."""
    geometries = inspector.GetGeometries(frame)
    return inspector.GetName(geometries[0]).split("/")[0] if geometries else ""


def _hang(
    scene_graph: SceneGraph, context: Context, source: SourceId, frame: FrameId, name: str, shapes: Shapes
) -> None:
    for k, (X_FG, shape, role, properties) in enumerate(shapes):
        instance = GeometryInstance(X_FG, shape, f"{name}/{k}")
        if role == Role.kIllustration:
            instance.set_illustration_properties(cast(IllustrationProperties, properties))
        elif role == Role.kPerception:
            instance.set_perception_properties(cast(PerceptionProperties, properties))
        else:
            instance.set_proximity_properties(cast(ProximityProperties, properties))
        scene_graph.RegisterGeometry(context, source, frame, instance)


def _shapes_of_thing(thing: Thing) -> list[tuple[RigidTransform, Any, Role, Any]]:
    shown = IllustrationProperties()
    shown.AddProperty("phong", "diffuse", THING_COLOUR)
    found: list[tuple[RigidTransform, Any, Role, Any]] = []
    for corners in thing.pieces:
        hull = _convex(corners)
        if hull is not None:
            found += [(RigidTransform(), hull, Role.kIllustration, shown)]
            found += [(RigidTransform(), hull, Role.kProximity, ProximityProperties())]
    return found


def _convex(corners: Array) -> Convex | None:
    """Return the hull of corners (V, 3) as a shape that viewers show, too; None where it has no volume."""
    try:
        hull = ConvexHull(corners)
    except QhullError:
        return None
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
    for (a, b, c), plane in zip(hull.simplices, hull.equations, strict=True):
        normal = np.cross(corners[b] - corners[a], corners[c] - corners[a])
        b, c = (b, c) if normal @ plane[:3] > 0 else (c, b)
        lines.append(f"f {a + 1} {b + 1} {c + 1}")
    file = MemoryFile(contents="\n".join(lines) + "\n", extension=".obj", filename_hint="thing.obj")
    return Convex(mesh_data=InMemoryMesh(mesh_file=file))
