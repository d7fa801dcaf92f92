"""The measured runs, replayed: what the published model leaves of their torque, directly and through the EKF."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from twin_diagram.errors import TwinError
from twin_diagram.estimation import AdaptiveEkf
from twin_diagram.logs import Log, check, read_log
from twin_diagram.model import Model, torque_residual_rms
from twin_diagram.scenario import ArmModel, EffectSpec, Filter, ReplayStation, Scenario, Twin
from twin_diagram.signals.arrays import Array
from twin_diagram.station import make_station, ports

JOINTS = [f"joint_{k}" for k in range(1, 7)]
GEAR_RATIO = np.array([1798 / 7, 1872 / 7, 757 / 3, 221.0, 5032 / 21, 206793 / 1340])
ROTOR_INERTIA = np.array([0.00923, 0.0118, 0.0118, 0.00173, 0.00173, 0.00173])
"""On the motor's side [kg·m²]."""
EXPECTED = {"A": [3.12, 4.49, 9.00, 0.76, 2.17, 1.47], "B": [2.57, 6.00, 8.49, 0.68, 1.80, 1.02]}
"""Residual torque on the motor's side, RMS [N·m], worked out independently."""


def data_folder() -> Path:
    """The folder of the measured runs."""
    given = os.environ.get("TWIN_DIAGRAM_DATA")
    root = Path(given) if given else Path(__file__).resolve().parents[3] / "shared" / "data"
    folder = root / "kuka_kr300"
    if not folder.is_dir():
        raise TwinError(f"{folder}: no measured runs there; set TWIN_DIAGRAM_DATA to the folder that holds kuka_kr300")
    return folder


def kuka(folder: Path) -> ArmModel:
    """The arm: published links, and the rotors that its motors turn through the gears."""
    rotors = EffectSpec("reflected_inertia", JOINTS, [], {"inertia": list(ROTOR_INERTIA * GEAR_RATIO**2)})
    return ArmModel(model=str(folder / "kr300.urdf"), tool_frame="link_6", effects=[rotors])


def through_the_filter(arm: ArmModel, path: Path) -> Log:
    """The run as the EKF sees it: its state at each sample, and the measured torque."""
    log = read_log(path)
    model = Model.load(arm)
    # The unmodelled torque of this arm is that of a payload of 150 kg; the filter learns nothing here, it only follows.
    tuning = Filter(rate=1.0 / log.period, torque_std=1e4, velocity_std=1e-3, encoder_std=1e-6, parameters=[])
    scenario = Scenario(station="replay", replay=ReplayStation(str(path)), twin=Twin(arm=arm, camera=None))

    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(scenario))
    ekf = builder.AddSystem(AdaptiveEkf(model, tuning))
    for port, name in (
        (ports.POSITION_MEASURED, "position_measured"),
        (ports.VELOCITY_ESTIMATED, "velocity_estimated"),
        (ports.TORQUE_MEASURED, "torque_measured"),
        (ports.MEASUREMENT_TIME, "measurement_time"),
    ):
        builder.Connect(station.GetOutputPort(port), ekf.GetInputPort(name))
    states = LogVectorOutput(ekf.GetOutputPort("arm_state"), builder, log.period)
    diagram = builder.Build()

    simulator = Simulator(diagram)
    simulator.AdvanceTo(float(log.time[-1]))
    found = states.FindLog(simulator.get_context())
    n = len(model.joints)
    time, state = found.sample_times(), found.data().T
    started = np.any(state[:, :n] != 0.0, axis=1)
    time, state = time[started], state[started]
    torque = np.stack([np.interp(time, log.time, tau) for tau in log.motor_torque.T], axis=1)
    return Log(time, model.joints, state[:, :n], velocity=state[:, n:], torque=torque, source=f"EKF of {path.name}")


def residuals(run: str, folder: Path) -> dict[str, Array]:
    """Residual torque per joint on the motor's side, RMS [N·m]: `direct` from the log and `filtered` from the EKF."""
    arm = kuka(folder)
    model = Model.load(arm)
    path = folder / f"trajectory_{run}.csv"
    log = read_log(path)
    for warning in check(log, model.limits):
        print(f"warning: {warning.message}", file=sys.stderr)
    return {
        "direct": torque_residual_rms(model, log) / GEAR_RATIO,
        "filtered": torque_residual_rms(model, through_the_filter(arm, path)) / GEAR_RATIO,
    }
