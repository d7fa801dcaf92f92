"""Published layouts of logs that robots' own software writes, for `column_map`.

Each cites where its column names are published. Where an arm gives nothing but currents, the preset asks for the torque
constants instead of assuming some.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final


@dataclass(frozen=True)
class Preset:
    """One published layout.

    Attributes:
        joints: how many the arm has.
        time: its column and unit.
        signals: by the log format's names, as in a map's file.
        source: where the names are published.
        side: `motor` or `link`: where its torques are measured.
    """

    joints: int
    time: Mapping[str, str]
    signals: Mapping[str, Mapping[str, Any]]
    source: str
    side: str


_FRANKA: Final = "q, dq [rad, rad/s] and tau_J [N·m], measured behind the gear"
"""What both of its layouts hold."""

PRESETS: Final[Mapping[str, Preset]] = {
    "libfranka": Preset(
        joints=7,
        time={"column": "time", "unit": "ms"},
        signals={
            "position_measured": {"column": "state.q[{i}]"},
            "velocity_estimated": {"column": "state.dq[{i}]"},
            "torque_measured": {"column": "state.tau_J[{i}]"},
        },
        source=f"libfranka, franka::logToCSV (src/log.cpp, later src/logging/robot_state_log.cpp): {_FRANKA}",
        side="link",
    ),
    "franka_ros": Preset(
        joints=7,
        time={"column": "%time", "unit": "ns"},
        signals={
            "position_measured": {"column": "field.q{i}"},
            "velocity_estimated": {"column": "field.dq{i}"},
            "torque_measured": {"column": "field.tau_J{i}"},
        },
        source=f"franka_msgs/FrankaState.msg, as `rostopic echo -p` prints it: {_FRANKA}",
        side="link",
    ),
    "ur_rtde": Preset(
        joints=6,
        time={"column": "timestamp"},
        signals={
            "position_measured": {"column": "actual_q_{i}"},
            "velocity_estimated": {"column": "actual_qd_{i}"},
            "torque_measured": {"column": "actual_current_{i}", "unit": "A"},
        },
        source="Universal Robots, Real-Time Data Exchange guide, output fields; columns as csv_writer.py of their "
        "RTDE_Python_Client_Library numbers them",
        side="motor",
    ),
    "ur_rtde_torque": Preset(
        joints=6,
        time={"column": "timestamp"},
        signals={
            "position_measured": {"column": "actual_q_{i}"},
            "velocity_estimated": {"column": "actual_qd_{i}"},
            "torque_measured": {"column": "actual_current_as_torque_{i}"},
        },
        source="the same guide, field actual_current_as_torque [N·m], from PolyScope 5.23",
        side="motor",
    ),
    "iiwa_fri": Preset(
        joints=7,
        time={"column": "time"},
        signals={
            "position_measured": {"column": "mp{i}", "first": 1},
            "torque_measured": {"column": "mt{i}", "first": 1, "sign": -1},
        },
        source="KUKA FRI through pyfri, collect_data (lbr-stack/pyfri, doc/examples.rst): measured position [rad] and "
        "torque [N·m], behind the gear, as FRI counts it: against the joint (Drake, manipulation/README.md)",
        side="link",
    ),
}
"""By the name that `--columns` takes."""
