"""From images to poses: clouds, segments, registration, and the two systems that carry them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.perception.registration.array_registration import PoseFromArrays, register
    from twin_diagram.perception.registration.pose_system import IcpPoseEstimator
    from twin_diagram.perception.segmentation.segmentation_system import PerceptionSystem
    from twin_diagram.perception.segmentation.segments import Segments

__all__ = [
    "IcpPoseEstimator",
    "PerceptionSystem",
    "PoseFromArrays",
    "Segments",
    "register",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
