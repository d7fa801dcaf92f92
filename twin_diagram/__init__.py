"""A digital twin of a robot arm as one Drake Diagram, from camera to command.

Importing the package loads nothing heavy; its modules import Drake and what else they need where they need it. Open3D
comes in by `twin_diagram.native.import_open3d` alone, which loads libusb first where only a wheel brings it along.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces as _faces
from twin_diagram.runtime.version import __version__

if TYPE_CHECKING:
    from twin_diagram.errors import TwinError
    from twin_diagram.estimation import AdaptiveEkf, DriftMonitor, Ekf, Monitor
    from twin_diagram.gap import run_gap
    from twin_diagram.logs import Log, read_log, write_log
    from twin_diagram.model import Effect, Model, ParameterKind, register
    from twin_diagram.perception import IcpPoseEstimator, PerceptionSystem
    from twin_diagram.planning import Mpc
    from twin_diagram.runs import replay_log, run_scenario
    from twin_diagram.scenario import Filter, Scenario, load_scenario, save_scenario
    from twin_diagram.scene import SceneGraphUpdater
    from twin_diagram.station.make_station import make_station
    from twin_diagram.twin import make_closed_loop, make_twin

__all__ = [
    "AdaptiveEkf",
    "DriftMonitor",
    "Effect",
    "Ekf",
    "Filter",
    "IcpPoseEstimator",
    "Log",
    "Model",
    "Monitor",
    "Mpc",
    "ParameterKind",
    "PerceptionSystem",
    "Scenario",
    "SceneGraphUpdater",
    "TwinError",
    "__version__",
    "load_scenario",
    "make_closed_loop",
    "make_station",
    "make_twin",
    "read_log",
    "register",
    "replay_log",
    "run_gap",
    "run_scenario",
    "save_scenario",
    "write_log",
]

__getattr__, __dir__ = _faces.lazy_face(__name__)
