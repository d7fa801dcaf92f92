"""From images to poses: clouds, segments, registration, and the two systems that carry them."""

from __future__ import annotations

from twin_diagram.perception.pose_system import IcpPoseEstimator
from twin_diagram.perception.segmentation_system import Perception
from twin_diagram.perception.segments import Segments

__all__ = ["IcpPoseEstimator", "Perception", "Segments"]
