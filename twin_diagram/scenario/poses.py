"""A scenario's poses as Drake's."""

from __future__ import annotations

from typing import Any, cast

from pydrake.math import RigidTransform, RollPitchYaw

from twin_diagram.scenario.models import Pose


def pose(value: Pose) -> RigidTransform:
    """Return a scenario's pose as Drake's."""
    return RigidTransform(RollPitchYaw(*value.rpy), cast(Any, value.translation))
