"""State estimation: an adaptive EKF for any Drake arm, its sensor models, and a drift monitor.

Pure Python first (`Ekf`, `Monitor`); the LeafSystems `AdaptiveEkf` and `DriftMonitor` are thin shells around them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.estimation.drift.monitor import Monitor
    from twin_diagram.estimation.drift_system import DriftMonitor
    from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
    from twin_diagram.estimation.ekf_system import AdaptiveEkf
    from twin_diagram.estimation.filter.ekf import Ekf
    from twin_diagram.estimation.filter.parameter_status import Standing

__all__ = [
    "AdaptiveEkf",
    "ArmTerms",
    "DriftMonitor",
    "Ekf",
    "Monitor",
    "Standing",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
