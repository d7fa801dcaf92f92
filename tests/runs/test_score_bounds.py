"""The scorer's bounds, each met from both sides with the figures that its documentation gives."""

from __future__ import annotations

import numpy as np
import pytest

from tests.runs.test_score import TIME, N, T, poses, record, summary
from twin_diagram.runs.score import within
from twin_diagram.signals.layouts import ObjectStatus


@pytest.mark.parametrize(("share", "visible"), [(0.29, False), (0.3, True), (0.31, True)])
def test_an_object_is_in_sight_with_three_tenths_of_its_surface(share: float, visible: bool) -> None:
    box = summary(record(seen=np.full((T, 2), share)))["objects"]["box"]
    assert box["visible_share"] == float(visible)
    assert box["position_error_mm"]["median"] == (0.0 if visible else None)


@pytest.mark.parametrize(("late", "counts"), [(0.49, False), (0.5, True), (0.51, True)])
@pytest.mark.parametrize("found", [True, False])
def test_errors_count_half_a_second_after_the_first_sight(late: float, counts: bool, found: bool) -> None:
    """One frame is wrong, or misses the object: one of three that count."""
    time = np.array([0.0, 1.0, 1.0 + late, 1.8, 2.0])
    estimated, status = poses()[:5], np.full((5, 2), int(ObjectStatus.TRACKED))
    if found:
        estimated[2, 0, 4] += 0.01
    else:
        status[2, 0] = int(ObjectStatus.UNSEEN)
    seen = np.ones((5, 2))
    seen[0] = 0.0  # comes in sight at one second
    run = record(time=time, seen=seen, poses_true=poses()[:5], poses_estimated=estimated, status=status)
    error = summary(run)["objects"]["box"]["position_error_mm"]
    assert error["median"] == 0.0
    assert error["p95"] == (0.0 if not counts else 10.0 if found else None)


def test_a_goal_is_reached_up_to_its_tolerances() -> None:
    for error, angle, reached in ((0.25, 0.5, True), (0.2501, 0.5, False), (0.25, 0.5001, False)):
        run = record(goal_error=np.full(T, error), goal_angle=np.full(T, angle))
        assert summary(run, position_tolerance=0.25, rotation_tolerance=0.5)["goal"]["reached"] is reached


def test_bounds_are_kept_up_to_themselves() -> None:
    told = summary(record())
    entry = told["objects"]["box"]
    for kind in ("position_error_mm", "rotation_error_deg"):
        for median, kept in ((5.0, True), (5.01, False)):
            changed = {**entry, kind: {"median": median, "p95": median}}
            assert within({**told, "objects": {"box": changed}})["tracked"] is kept
    assert within({**told, "objects": {"box": {**entry, "visible_share": 0.001}}})["tracked"]
    for clearance, kept in ((0.0, False), (0.001, True), (None, False)):
        assert within({**told, "clearance_min_mm": clearance})["untouched"] is kept
    for estimated, kept in ((2.29, True), (2.31, False), (1.71, True), (1.69, False)):
        payload = {"mass_true": 2.0, "mass_estimated": estimated}
        assert within({**told, "payload": payload})["weighed"] is kept


def test_the_nearest_approach_and_all_contacts_are_told() -> None:
    result = summary(record(clearance=0.05 + 0.01 * np.cos(TIME), contacts=np.arange(T)))
    assert result["clearance_min_mm"] == pytest.approx(1e3 * (0.05 + 0.01 * np.cos(TIME).min()), abs=1e-4)
    assert result["contacts"] == T * (T - 1) // 2
    estimated = np.zeros((T, 2 * N))
    estimated[0, 0], estimated[1, N - 1] = -0.5, 0.25
    error = summary(record(arm_true=np.full((T, 2 * N), 0.25), arm_estimated=estimated + 0.25))["arm"][
        "joint_error_rad"
    ]
    assert error == {"rms": pytest.approx(np.sqrt(0.3125 / (T * N))), "max": pytest.approx(0.5)}
