"""Finds, or puts where it is told to be, the frame of an arm's description that reaches goals."""

from __future__ import annotations

from collections.abc import Iterable

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Frame, FrameIndex, ModelInstanceIndex, RigidBody

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.scenario.poses import pose


def tool_frame(
    plant: MultibodyPlant, instances: Iterable[ModelInstanceIndex], spec: scenario.ArmModel, last_link: RigidBody
) -> FrameIndex:
    """Return the frame that is named, or one that is put into the plant where it lies in that one as told.

    Args:
        plant: not finalized.
        instances: of the arm.
        spec: its `tool_frame` and `X_FG` count.
        last_link: whose own frame it is where none is named.

    Raises:
        ModelError: no such frame; the message lists those that there are.
    """
    named = _named(plant, tuple(instances), spec, last_link)
    X_FG = pose(spec.X_FG)
    if X_FG.IsExactlyIdentity():
        return named.index()
    return plant.AddFrame(FixedOffsetFrame(f"{named.name()}_G", named, X_FG, last_link.model_instance())).index()


def _named(
    plant: MultibodyPlant, instances: tuple[ModelInstanceIndex, ...], spec: scenario.ArmModel, last_link: RigidBody
) -> Frame:
    if not spec.tool_frame:
        return last_link.body_frame()
    for instance in instances:
        if plant.HasFrameNamed(spec.tool_frame, instance):
            return plant.GetFrameByName(spec.tool_frame, instance)
    names = sorted(plant.get_frame(index).name() for instance in instances for index in plant.GetFrameIndices(instance))
    said = (
        f"the model has no frame {spec.tool_frame!r}; '' takes the last link's own; its frames are {', '.join(names)}"
    )
    raise ModelError(f"tool_frame: {said}")
