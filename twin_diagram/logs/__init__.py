"""Measured logs: read, check, resample, write."""

from __future__ import annotations

from twin_diagram.logs.checking import LogWarning, check
from twin_diagram.logs.csv_tables import read_columns
from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.joint_limits import JointLimits
from twin_diagram.logs.measured_log import SIGNALS, Log
from twin_diagram.logs.reading import log_from_columns, read_log
from twin_diagram.logs.resampling import is_regular, resample, uniform
from twin_diagram.logs.unwrapping import unwrapped
from twin_diagram.logs.writing import write_columns, write_log

__all__ = [
    "SIGNALS",
    "JointLimits",
    "Log",
    "LogWarning",
    "check",
    "fingerprint",
    "is_regular",
    "log_from_columns",
    "read_columns",
    "read_log",
    "resample",
    "uniform",
    "unwrapped",
    "write_columns",
    "write_log",
]
