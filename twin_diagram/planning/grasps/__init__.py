"""Grasps for a gripper with two fingers: proposed, ranked, kept with the asset, shown.

From the bottom up: `gripper` says what a hand is like; `slab` lists what lies before many poses at once; `closing` says
how far a hand can be pushed and what its pads meet; `target` is the object; `cost` weighs, `judging` refuses;
`surface_frames` and `search` find candidates; `triangles` compares with a mesh; `proposal` puts these together.
`known_object`, `kept_grasps`, `page` and `command` are what `twin-diagram grasps` adds.

The sampling is that of ten Pas et al. as the thesis behind *Scalable Real2Sim* has it (its 4.1); of an object that is
known the whole cloud is taken, of one that is not what the camera saw, as in *SyncTwin*.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.planning.grasps.gripper import PANDA_HAND, WSG50, Gripper, GripperError, gripper_of
    from twin_diagram.planning.grasps.kept_grasps import grasps_of
    from twin_diagram.planning.grasps.known_object import KnownObject, read_known
    from twin_diagram.planning.grasps.proposal import (
        AntipodalProposer,
        GraspProposer,
        Grasps,
        Wanted,
        given_poses,
        propose,
        rank,
    )
    from twin_diagram.planning.grasps.surface_frames import estimated_normals
    from twin_diagram.planning.grasps.target import GraspError, GraspTarget, target_of

__all__ = [
    "PANDA_HAND",
    "WSG50",
    "AntipodalProposer",
    "GraspError",
    "GraspProposer",
    "GraspTarget",
    "Grasps",
    "Gripper",
    "GripperError",
    "KnownObject",
    "Wanted",
    "estimated_normals",
    "given_poses",
    "grasps_of",
    "gripper_of",
    "propose",
    "rank",
    "read_known",
    "target_of",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
