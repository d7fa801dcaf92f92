"""Alarms as records with their evidence, one JSON object to a line."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin_diagram.estimation.drift.likelihood_ratio import AlarmShape
from twin_diagram.estimation.drift.monitor import Evidence, Monitor
from twin_diagram.signals.layouts import AlarmKind


def events(monitor: Monitor, joints: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return the alarms that a monitor remembers, oldest first.

    Args:
        monitor: it keeps the newest 32.
        joints: names for the joint that stands out; its index where there are none.

    Returns:
        Per alarm `time` [s], `kind`, `shape` (spike, step or trend), `joint` (or null), `sensor` that parts ways with
        the rest (or null), `statistic` (largest over its threshold) and `evidence`: `above` [s], `nis` (mean over its
        degrees of freedom), `change`, `rollout` (each over its threshold), `sum` (Page's, in standard deviations),
        `hand` (by how much the newest rollout missed it [m]), `torque` (that the joint gained [N·m]) and `joints`,
        each one's share in standard deviations.
    """
    found = []
    for index in np.argsort(monitor.log[:, 0], kind="stable"):
        time, kind, statistic = monitor.log[index]
        if time < 0.0:
            continue
        row = monitor.evidence[index]
        joint, sensor = int(row[Evidence.JOINT]), int(row[Evidence.SENSOR])
        found.append(
            {
                "time": round(float(time), 6),
                "kind": AlarmKind(int(kind)).name.lower(),
                "shape": AlarmShape(int(row[Evidence.SHAPE])).name.lower(),
                "joint": None if joint < 0 else joints[joint] if joints else joint,
                "sensor": None if sensor < 0 else monitor.sensors[sensor] if monitor.sensors else sensor,
                "statistic": round(float(statistic), 4),
                "evidence": {
                    **{
                        entry.name.lower(): round(float(row[entry]), 4)
                        for entry in Evidence
                        if entry not in (Evidence.SHAPE, Evidence.JOINT, Evidence.SENSOR)
                    },
                    "joints": [round(float(share), 2) for share in row[len(Evidence) :]],
                },
            }
        )
    return found


def append_lines(path: Path, records: Iterable[dict[str, Any]]) -> None:
    """Append records to a JSON Lines file, in one write."""
    text = "".join(json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n" for record in records)
    if text:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
