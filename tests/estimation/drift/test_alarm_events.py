"""Alarms as records: order, names and figures."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.estimation.drift.alarm_events import append_lines, events
from twin_diagram.estimation.drift.likelihood_ratio import AlarmShape
from twin_diagram.estimation.drift.state import DriftState, Evidence
from twin_diagram.signals.layouts import AlarmKind


def monitor(sensors: tuple[str, ...] = ()) -> Any:
    state = DriftState(2, 0, 3, 4, 0, 0, 0)
    state.log[:3] = [[7.0, AlarmKind.ROLLOUT, 1.25], [0.0, AlarmKind.INNOVATION, 2.0], [3.0, AlarmKind.SENSOR, 1.5]]
    state.evidence[0, [Evidence.SHAPE, Evidence.JOINT, Evidence.SENSOR]] = AlarmShape.TREND, 1.0, -1.0
    state.evidence[1, [Evidence.SHAPE, Evidence.JOINT, Evidence.SENSOR]] = AlarmShape.STEP, 0.0, -1.0
    state.evidence[2, [Evidence.SHAPE, Evidence.JOINT, Evidence.SENSOR]] = AlarmShape.SPIKE, -1.0, 0.0
    state.evidence[0, [Evidence.TORQUE, Evidence.NIS]] = -2.5, 4.0
    state.evidence[0, len(Evidence) :] = 5.125, -1.0
    return SimpleNamespace(log=state.log, evidence=state.evidence, sensors=sensors)


def test_oldest_first_with_names() -> None:
    first, second, third = events(monitor(("imu",)), ["shoulder", "elbow"])
    assert [record["time"] for record in (first, second, third)] == [0.0, 3.0, 7.0]
    assert [record["joint"] for record in (first, second, third)] == ["shoulder", None, "elbow"]
    assert [record["sensor"] for record in (first, second, third)] == [None, "imu", None]
    assert [record["kind"] for record in (first, second, third)] == ["innovation", "sensor", "rollout"]
    assert [record["shape"] for record in (first, second, third)] == ["step", "spike", "trend"]
    assert third["statistic"] == 1.25
    evidence = third["evidence"]
    assert evidence["torque"] == -2.5 and evidence["nis"] == 4.0
    assert evidence["joints"] == pytest.approx([5.12, -1.0], abs=0.011)
    assert set(evidence) == {"above", "nis", "change", "rollout", "sum", "hand", "torque", "joints"}


def test_without_names_there_are_indices() -> None:
    first, second, third = events(monitor())
    assert (first["joint"], second["joint"], third["joint"]) == (0, None, 1)
    assert (first["sensor"], second["sensor"]) == (None, 0)


def test_lines_are_appended(tmp_path) -> None:
    path = tmp_path / "new" / "events.jsonl"
    append_lines(path, [])
    assert not path.exists()
    append_lines(path, events(monitor()))
    append_lines(path, [{"a": 1}])
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert len(rows) == 4 and rows[0]["time"] == 0.0 and rows[-1] == {"a": 1}
    with pytest.raises(ValueError, match="JSON"):
        append_lines(path, [{"a": np.inf}])
