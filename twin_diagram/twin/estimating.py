"""Wires the filter and the drift monitor, which hear each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.model.model import Model
from twin_diagram.twin.fused_sensors import Fused
from twin_diagram.twin.given_files import named
from twin_diagram.twin.own_systems import connect_ports


def add_estimation(
    builder: DiagramBuilder, twin: scenario.Twin, model: Model, fused: list[Fused]
) -> tuple[AdaptiveEkf, DriftMonitor]:
    """Add what knows the arm's state, and what watches whether that knows it well; each hears the other.

    Args:
        builder: of the twin.
        twin: what it is told.
        model: the arm's physics.
        fused: the filter's further sensors.
    """
    home = np.array(twin.home) if twin.home else None
    tuning = replace(twin.filter, sensors=[sensor.spec for sensor in fused])
    ekf = builder.AddNamedSystem("adaptive_ekf", named("twin.filter", lambda: AdaptiveEkf(model, tuning, home)))
    drift = builder.AddNamedSystem("drift_monitor", DriftMonitor(model, twin.drift, tuning))
    connect_ports(
        builder, ekf, drift, "arm_state", "parameters", "innovation", "nis", *(["sensor_tracks"] if fused else [])
    )
    connect_ports(builder, drift, ekf, "alarm")
    return ekf, drift
