"""State estimation: an adaptive EKF for any Drake arm, its sensor models, and a drift monitor.

Pure Python first (`Ekf`, `Monitor`); the LeafSystems `AdaptiveEkf` and `DriftMonitor` are thin shells around them.
"""

from __future__ import annotations
