"""From images to poses: clouds, segments, registration, and the two systems that carry them."""

from __future__ import annotations

from twin_diagram.perception.registration.pose_system import IcpPoseEstimator
from twin_diagram.perception.segmentation.segmentation_system import PerceptionSystem
from twin_diagram.perception.segmentation.segments import Segments

__all__ = ["IcpPoseEstimator", "PerceptionSystem", "Segments"]
