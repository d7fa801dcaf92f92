"""The scorer on records whose figures are known beforehand."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin_diagram.runs.score import TUNING as SCORE
from twin_diagram.runs.score import RunRecord, alarms, rotation_angle, summarize, table, task_lines, within
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, AlarmKind, ObjectStatus

T, N = 301, 7
TIME = np.linspace(0.0, 5.0, T)
TRUTH = np.array([1.0, 0.0, 0.0, 0.0, 0.5, 0.1, 0.05])


def record(objects: dict[str, str | None] | None = None, **changes: Any) -> RunRecord:
    """A faultless run; `changes` replace what is named."""
    symmetric = {"box": None, "can": "z"} if objects is None else objects
    k = len(symmetric)
    values: dict[str, Any] = {
        "time": TIME,
        "seen": np.ones((T, k)),
        "poses_true": np.tile(TRUTH, (T, k, 1)),
        "poses_estimated": np.tile(TRUTH, (T, k, 1)),
        "status": np.full((T, k), int(ObjectStatus.TRACKED)),
        "arm_true": np.zeros((T, 2 * N)),
        "arm_estimated": np.zeros((T, 2 * N)),
        "mass": np.full(T, 0.8),
        "mass_std": np.full(T, 0.01),
        "clearance": np.full(T, 0.12),
        "contacts": np.zeros(T, dtype=np.int64),
        "goal_error": np.linspace(0.5, 0.002, T),
        "goal_angle": np.linspace(0.5, 0.02, T),
        "alarm_log": np.full((32, 3), NEVER),
        "objects": list(symmetric),
        "symmetric_axis": symmetric,
    }
    return RunRecord(**(values | changes))


def summary(run: RunRecord, **changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "seed": 3,
        "duration": 5.0,
        "payload_true": 0.8,
        "position_tolerance": 0.01,
        "rotation_tolerance": 0.1,
        "timing": {"real_time_factor": 1.25, "systems": {"Mpc": 0.25, "Station": 0.75}},
    }
    return summarize(run, **(values | changes))


def poses(wxyz: Array | None = None, p: Array | None = None, k: int = 2) -> Array:
    """(T, k, 7), all the same."""
    wxyz = TRUTH[:4] if wxyz is None else wxyz
    p = TRUTH[4:] if p is None else p
    return np.tile(np.concatenate([wxyz, p]), (T, k, 1))


def wxyz(rotation: Rotation) -> Array:
    return np.asarray(rotation.as_quat()[..., [3, 0, 1, 2]])


# Angles.


@given(st.integers(0, 2**31))
def test_rotation_angle_against_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = Rotation.random(5, rng), Rotation.random(5, rng)
    expected = (first.inv() * second).magnitude()
    signs = rng.choice([-1.0, 1.0], (5, 1))
    assert rotation_angle(wxyz(first), signs * wxyz(second)) == pytest.approx(expected, abs=1e-7)
    tilt = np.arccos(np.clip(np.sum(first.apply([0, 0, 1]) * second.apply([0, 0, 1]), axis=-1), -1, 1))
    assert rotation_angle(wxyz(first), signs * wxyz(second), "z") == pytest.approx(tilt, abs=1e-7)


@given(st.floats(1e-6, 3.0), st.integers(0, 2**31))
def test_a_small_turn_is_measured_as_well_as_a_large_one(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = Rotation.random(None, rng)
    axis = rng.normal(size=3)
    second = first * Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    assert rotation_angle(wxyz(first), wxyz(second)) == pytest.approx(angle, abs=1e-7)


@given(st.floats(-math.pi, math.pi), st.floats(0.0, 1.5), st.integers(0, 2**31))
def test_a_turn_about_the_axis_of_symmetry_is_free_and_its_tilt_is_not(turn: float, tilt: float, seed: int) -> None:
    first = Rotation.random(None, np.random.default_rng(seed))
    second = first * Rotation.from_euler("z", turn) * Rotation.from_euler("x", tilt)
    assert rotation_angle(wxyz(first), wxyz(second), "z") == pytest.approx(tilt, abs=1e-7)


@given(st.integers(0, 3), st.booleans(), st.floats(0.0, 0.7), st.integers(0, 2**31))
def test_turns_that_symmetries_tell_of_are_no_errors(quarters: int, over: bool, tilt: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = Rotation.random(3, rng)
    alike = Rotation.from_euler("z", 0.5 * np.pi * quarters) * Rotation.from_euler("x", np.pi * over)
    axis = rng.normal(size=3)
    second = first * alike * Rotation.from_rotvec(tilt * axis / np.linalg.norm(axis))
    assert rotation_angle(wxyz(first), wxyz(second), None, ((2, 4), (0, 2))) == pytest.approx(tilt, abs=1e-7)
    round_too = first * Rotation.from_euler("z", tilt) * alike * Rotation.from_euler("y", tilt)
    assert rotation_angle(wxyz(first), wxyz(round_too), "z", ((2, 4), (0, 2))) == pytest.approx(tilt, abs=1e-7)


def test_a_box_that_looks_the_same_after_half_a_turn_is_not_off_by_it() -> None:
    half = np.array([0.0, 0.0, 0.0, 1.0])
    run = record(poses_estimated=poses(half), symmetries={"box": ((2, 2),)})
    angle = rotation_angle(TRUTH[:4], half)
    off = [summary(one)["objects"]["box"]["rotation_error_deg"]["p95"] for one in (replace(run, symmetries={}), run)]
    assert off == [pytest.approx(np.degrees(angle)), pytest.approx(np.degrees(min(angle, np.pi - angle)))]


def test_rotation_angle_keeps_leading_axes() -> None:
    assert rotation_angle(np.tile(TRUTH[:4], (3, 4, 1)), np.tile(TRUTH[:4], (3, 4, 1))).shape == (3, 4)


# Objects.


def test_a_faultless_run() -> None:
    result = summary(record())
    for name, axis in (("box", None), ("can", "z")):
        assert result["objects"][name] == {
            "position_error_mm": {"median": 0.0, "p95": 0.0},
            "rotation_error_deg": {"median": 0.0, "p95": 0.0},
            "symmetric_axis": axis,
            "visible_share": 1.0,
        }
    assert result["arm"] == {
        "joint_error_rad": {"rms": 0.0, "max": 0.0},
        "joints": {f"joint {k}": {"rms": 0.0, "max": 0.0, "unit": "rad"} for k in range(1, N + 1)},
    }
    assert result["payload"] == {"mass_true": 0.8, "mass_estimated": 0.8, "mass_std": 0.01}
    assert result["goal"] == {"reached": True, "error_mm": 2.0}
    assert (result["seed"], result["duration_s"]) == (3, 5.0)
    assert (result["clearance_min_mm"], result["contacts"], result["alarms"]) == (120.0, 0, [])
    assert within(result) == {"tracked": True, "untouched": True, "reached": True, "weighed": True}


def test_position_error_is_the_distance_in_millimetres() -> None:
    result = summary(record(poses_estimated=poses(p=TRUTH[4:] + [0.003, 0.0, 0.004])))
    assert result["objects"]["box"]["position_error_mm"] == {"median": 5.0, "p95": 5.0}


def test_median_and_p95_are_of_the_frames_that_count() -> None:
    counted = TIME >= SCORE.settled
    error = np.where(counted, np.arange(T) * 1e-5, 1.0)
    estimated = poses()
    estimated[:, :, 4] += error[:, None]
    figures = summary(record(poses_estimated=estimated))["objects"]["box"]["position_error_mm"]
    expected = np.sort(1e3 * error[counted])
    assert figures["median"] == pytest.approx(np.median(expected), abs=0.011)
    assert figures["p95"] == pytest.approx(np.percentile(expected, 95), abs=0.011)


def test_a_can_turned_about_its_axis_is_no_error_and_a_box_is() -> None:
    turned = wxyz(Rotation.from_euler("z", 40, degrees=True))
    objects = summary(record(poses_estimated=poses(turned)))["objects"]
    assert objects["can"]["rotation_error_deg"]["median"] == pytest.approx(0.0, abs=1e-4)
    assert objects["box"]["rotation_error_deg"]["median"] == pytest.approx(40.0, abs=1e-4)


def test_a_can_that_leans_is_an_error() -> None:
    leaning = wxyz(Rotation.from_euler("zx", [40, 7], degrees=True))
    assert summary(record(poses_estimated=poses(leaning)))["objects"]["can"]["rotation_error_deg"][
        "median"
    ] == pytest.approx(7.0, abs=1e-4)


def test_a_quaternions_sign_means_nothing() -> None:
    result = summary(record(poses_estimated=poses(-TRUTH[:4])))
    assert result["objects"]["box"]["rotation_error_deg"]["median"] == 0.0


def test_hidden_frames_do_not_count() -> None:
    hidden = (TIME > 1.0) & (TIME < 4.0)
    seen = np.ones((T, 2))
    seen[hidden, 0] = SCORE.visible - 0.01
    estimated = poses()
    estimated[hidden, 0, 4] += 1.0
    result = summary(record(seen=seen, poses_estimated=estimated))
    assert result["objects"]["box"]["position_error_mm"] == {"median": 0.0, "p95": 0.0}
    assert result["objects"]["box"]["visible_share"] == pytest.approx(1 - hidden.mean(), abs=1e-4)
    estimated[:, 1, 4] += hidden  # the can is in sight all the while
    assert summary(record(seen=seen, poses_estimated=estimated))["objects"]["can"]["position_error_mm"]["median"] == 1e3


def test_an_object_that_never_shows_has_no_figures_and_breaks_no_bound() -> None:
    seen = np.ones((T, 2))
    seen[:, 0] = 0.0
    status = np.full((T, 2), int(ObjectStatus.TRACKED))
    status[:, 0] = int(ObjectStatus.UNSEEN)
    result = summary(record(seen=seen, status=status, poses_estimated=np.nan_to_num(poses())))
    assert result["objects"]["box"] == {
        "position_error_mm": {"median": None, "p95": None},
        "rotation_error_deg": {"median": None, "p95": None},
        "symmetric_axis": None,
        "visible_share": 0.0,
    }
    assert within(result)["tracked"]
    assert "–" in table(result)


def test_what_is_in_sight_and_never_found_is_lost_and_not_left_out() -> None:
    status = np.full((T, 2), int(ObjectStatus.TRACKED))
    status[:, 0] = int(ObjectStatus.UNSEEN)
    result = summary(record(status=status))
    assert result["objects"]["box"]["position_error_mm"] == {"median": None, "p95": None}
    assert result["objects"]["box"]["visible_share"] == 1.0
    assert not within(result)["tracked"]


@pytest.mark.parametrize(("share", "tracked"), [(0.4, True), (0.6, False)])
def test_what_is_missed_in_most_frames_is_lost(share: float, tracked: bool) -> None:
    status = np.full((T, 2), int(ObjectStatus.TRACKED))
    status[TIME < SCORE.settled + share * (TIME[-1] - SCORE.settled), 0] = int(ObjectStatus.UNSEEN)
    result = summary(record(status=status))
    assert within(result)["tracked"] is tracked
    assert result["objects"]["box"]["position_error_mm"]["p95"] is None


@pytest.mark.parametrize("status", [ObjectStatus.STALE, ObjectStatus.LOST, ObjectStatus.MOVING, ObjectStatus.HELD])
def test_a_wrong_pose_of_an_object_in_sight_counts_whatever_the_twin_calls_it(status: ObjectStatus) -> None:
    estimated = poses(p=TRUTH[4:] + [0.05, 0, 0])
    result = summary(record(poses_estimated=estimated, status=np.full((T, 2), int(status))))
    assert result["objects"]["box"]["position_error_mm"]["median"] == 50.0
    assert not within(result)["tracked"]


def test_the_first_half_second_in_sight_does_not_count() -> None:
    seen = np.ones((T, 2))
    seen[TIME < 2.0, 0] = 0.0
    estimated = poses()
    estimated[(TIME < 2.0 + SCORE.settled - 0.05), 0, 4] += 1.0
    status = np.full((T, 2), int(ObjectStatus.TRACKED))
    status[(TIME < 2.0 + SCORE.settled - 0.05), 0] = int(ObjectStatus.UNSEEN)
    result = summary(record(seen=seen, poses_estimated=estimated, status=status))
    assert result["objects"]["box"]["position_error_mm"] == {"median": 0.0, "p95": 0.0}


@pytest.mark.parametrize(
    ("millimetres", "degrees", "tracked"), [(4.9, 4.9, True), (5.1, 0.0, False), (0.0, 5.1, False)]
)
def test_the_bounds_of_tracking(millimetres: float, degrees: float, tracked: bool) -> None:
    estimated = poses(wxyz(Rotation.from_euler("x", degrees, degrees=True)), TRUTH[4:] + [1e-3 * millimetres, 0, 0])
    assert within(summary(record(poses_estimated=estimated)))["tracked"] is tracked


# Arm, payload, goal, contacts.


def test_joint_error_is_of_positions_alone() -> None:
    estimated = np.zeros((T, 2 * N))
    estimated[:, N:] = 5.0
    estimated[10, 2] = -0.02
    error = summary(record(arm_estimated=estimated))["arm"]["joint_error_rad"]
    assert error["max"] == pytest.approx(0.02)
    assert error["rms"] == pytest.approx(0.02 / math.sqrt(T * N))


def test_joints_are_told_by_name_and_a_prismatic_one_in_millimetres() -> None:
    estimated = np.zeros((T, 2 * N))
    estimated[:, 1], estimated[10, 2] = 3e-5, -0.02
    names = ["turn", "slide", "wrist", "a", "b", "c", "d"]
    result = summary(record(arm_estimated=estimated, joints=names, prismatic={"slide"}))
    assert list(result["arm"]["joints"]) == names
    assert result["arm"]["joints"]["slide"] == {
        "rms": pytest.approx(0.03), "max": pytest.approx(0.03), "unit": "mm"
    }  # fmt: skip
    assert result["arm"]["joints"]["wrist"] == {
        "rms": pytest.approx(0.02 / math.sqrt(T)), "max": pytest.approx(0.02), "unit": "rad"
    }  # fmt: skip
    # A length is no angle: what is said of all angles together leaves it out.
    assert result["arm"]["joint_error_rad"]["rms"] == pytest.approx(0.02 / math.sqrt(T * (N - 1)))
    rows = {line.split()[0]: line.split()[1:] for line in table(result).splitlines() if line.strip()}
    assert rows["slide"] == ["3.0e-02", "3.0e-02", "mm"]
    assert rows["wrist"] == ["1.2e-03", "2.0e-02", "rad"]


def test_an_arm_of_prismatic_joints_alone_has_no_error_in_radians() -> None:
    names = [f"slide{k}" for k in range(N)]
    result = summary(record(joints=names, prismatic=set(names)))
    assert result["arm"]["joint_error_rad"] == {"rms": None, "max": None}
    assert "rad rms" not in table(result)
    json.dumps(result, allow_nan=False)


def test_without_objects_the_table_begins_with_the_joints() -> None:
    """A head of a table of objects stood over nothing."""
    assert table(summary(record({}))).startswith("joint error")
    assert table(summary(record())).startswith("object ")


def test_the_table_tells_how_far_off_previews_were() -> None:
    result = summary(record())
    assert "preview" not in table(result)
    watched = {
        "ahead_s": 1.0,
        "tool_error_mm": {"median": 36.4, "p95": 301.2},
        "tool_moved_mm": {"median": 186.0, "p95": 484.1},
        "inside_95": 0.81,
    }
    line = next(line for line in table(result | {"preview": watched}).splitlines() if line.startswith("preview"))
    assert line.split(maxsplit=1)[1] == (
        "1 s ahead the tool is off by 36 mm (p95 301) and goes 186 mm (p95 484); 81% within the told 95 %"
    )


@pytest.mark.parametrize(
    ("true", "mass", "weighed"),
    [(1.0, 1.149, True), (1.0, 0.851, True), (1.0, 1.16, False), (1.0, 0.84, False), (None, 0.0, False)],
)
def test_the_payload_is_what_is_believed_at_the_end(true: float | None, mass: float, weighed: bool) -> None:
    run = record(mass=np.linspace(9.0, mass, T), mass_std=np.linspace(1.0, 0.02, T))
    result = summary(run, payload_true=true)
    assert result["payload"] == {"mass_true": true, "mass_estimated": mass, "mass_std": 0.02}
    assert within(result)["weighed"] is weighed


def test_a_twin_that_learns_no_payload() -> None:
    result = summary(record(mass=np.full(T, np.nan), mass_std=np.full(T, np.nan)))
    assert result["payload"] == {"mass_true": 0.8, "mass_estimated": None, "mass_std": None}
    assert not within(result)["weighed"]
    assert "payload" in table(result)
    json.dumps(result, allow_nan=False)


@pytest.mark.parametrize(("error", "angle", "reached"), [(0.009, 0.09, True), (0.011, 0.0, False), (0.0, 0.11, False)])
def test_the_goal_counts_at_the_end(error: float, angle: float, reached: bool) -> None:
    result = summary(record(goal_error=np.linspace(0.0, error, T), goal_angle=np.linspace(0.0, angle, T)))
    assert result["goal"] == {"reached": reached, "error_mm": round(1e3 * error, 3)}
    assert within(result)["reached"] is reached


def test_a_missed_goal_says_why_where_that_is_known() -> None:
    result = summary(record(goal_error=np.full(T, 0.6461), goal_angle=np.zeros(T)))
    assert "goal       missed, 646.1 mm off\n" in table(result)
    result["goal"] |= {"why": "at the goal the arm would come within 9 mm of cracker_box and keeps 10 mm"}
    assert (
        "goal       missed, 646.1 mm off: at the goal the arm would come within 9 mm of cracker_box and keeps 10 mm"
    ) in table(result).splitlines()


def test_without_a_goal_none_is_reached() -> None:
    nothing = np.full(T, np.nan)
    result = summary(record(goal_error=nothing, goal_angle=nothing))
    assert result["goal"] == {"reached": False, "error_mm": None}
    assert "goal" not in table(result)


def test_one_contact_is_a_contact() -> None:
    contacts = np.zeros(T, dtype=np.int64)
    contacts[17] = 2
    result = summary(record(contacts=contacts))
    assert result["contacts"] == 2
    assert not within(result)["untouched"]


def test_penetration_is_a_touch_even_where_no_contact_was_counted() -> None:
    clearance = np.full(T, 0.12)
    clearance[100] = -0.001
    result = summary(record(clearance=clearance))
    assert result["clearance_min_mm"] == -1.0
    assert not within(result)["untouched"]


# Alarms.


def test_alarms_come_in_order_of_time_and_empty_rows_do_not() -> None:
    ring = np.full((32, 3), NEVER)
    ring[0] = (7.25, AlarmKind.ROLLOUT, 2.0)
    ring[31] = (1.5, AlarmKind.INNOVATION, 3.0)
    ring[5] = (0.0, AlarmKind.INNOVATION, 3.0)
    expected = [
        {"time": 0.0, "kind": "innovation"},
        {"time": 1.5, "kind": "innovation"},
        {"time": 7.25, "kind": "rollout"},
    ]
    assert alarms(ring) == expected
    assert alarms(ring.ravel()) == expected
    assert summary(record(alarm_log=ring))["alarms"] == expected


# What is written.

KEYS = {"seed", "duration_s", "objects", "arm", "payload", "goal", "clearance_min_mm", "contacts", "alarms", "timing"}


def plain(value: Any) -> bool:
    """Only what JSON knows, with text for keys and no NumPy numbers."""
    if isinstance(value, dict):
        return all(type(key) is str and plain(sub) for key, sub in value.items())
    if isinstance(value, list):
        return all(map(plain, value))
    return value is None or type(value) in (bool, int, float, str)


def hostile() -> dict[str, RunRecord]:
    never = np.full((T, 2), int(ObjectStatus.UNSEEN))
    nothing = np.full(T, np.nan)
    return {
        "faultless": record(),
        "nothing found": record(status=never, poses_estimated=poses() * np.nan),
        "no objects": record(objects={}),
        "no goal, no payload": record(mass=nothing, mass_std=nothing, goal_error=nothing, goal_angle=nothing),
        "estimates that are no numbers": record(
            poses_estimated=poses() * np.nan, arm_estimated=np.full((T, 14), np.nan)
        ),
        "infinite clearance": record(clearance=np.full(T, np.inf)),
    }


@pytest.mark.parametrize("name", hostile())
def test_the_summary_is_json_that_any_reader_takes(name: str) -> None:
    result = summary(hostile()[name])
    assert set(result) == KEYS
    assert plain(result)
    text = json.dumps(result, allow_nan=False)
    assert json.loads(text) == result
    assert table(result)
    assert all(type(value) is bool for value in within(result).values())


def test_estimates_that_are_no_numbers_are_lost_objects() -> None:
    assert not within(summary(hostile()["estimates that are no numbers"]))["tracked"]


def test_the_table_says_what_the_summary_says() -> None:
    estimated = poses(wxyz(Rotation.from_euler("x", 2.5, degrees=True)), TRUTH[4:] + [0.00123, 0, 0])
    ring = np.full((32, 3), NEVER)
    ring[0] = (7.25, AlarmKind.ROLLOUT, 2.0)
    text = table(summary(record(poses_estimated=estimated, alarm_log=ring)))
    for words in ("box", "1.23", "2.50", "can", "(about z: free)", "100%", "0.800 ± 0.010 kg, true 0.800 kg",
                  "reached, 2.0 mm", "120 mm at the least, 0 contacts", "rollout at 7.25 s", "1.25 × real time",
                  "Mpc 25%"):  # fmt: skip
        assert words in text, words


def test_only_timing_depends_on_the_clock() -> None:
    first, second = summary(record()), summary(record(), timing={})
    assert {k: v for k, v in first.items() if k != "timing"} == {k: v for k, v in second.items() if k != "timing"}
    assert "speed" not in table(second)


def test_a_tasks_end_is_told_in_lines() -> None:
    """Where steps grip things, clearance says nothing; what each step came to, and what nobody asked for, does."""
    events = [
        {"time": 1.5, "step": 0, "kind": "pick", "object": "can", "what": "started"},
        {"time": 4.8, "step": 0, "kind": "pick", "object": "can", "what": "grasped"},
        {"time": 5.4, "step": 0, "kind": "pick", "object": "can", "what": "done"},
        {"time": 5.4, "step": 1, "kind": "place", "object": "can", "what": "started"},
    ]
    running = {"outcome": "running", "events": events, "collisions": {"point": 1, "surface": 2}}
    assert task_lines(running) == [
        "task       running (pick can done at 5.4 s, place can under way)",
        "contacts   3 that no step asks for",
    ]
    placed = {"can": {"off_mm": 7.06, "off_deg": 0.04}}
    failed = {"outcome": "failed", "why": "it fell", "events": [], "placed": placed}
    assert task_lines(failed) == ["task       failed: it fell (not begun)"], "where it stands, it stood"
    # A place step need not name what it puts down: that is what was grasped.
    for named in ({"object": "can"}, {}):
        put = [*events, {"time": 9.2, "step": 1, "kind": "place", "what": "released", **named}]
        assert task_lines({"outcome": "running", "events": put, "placed": placed})[1:] == [
            "placed     can 7.1 mm and 0.0° off its goal",
        ]
    whole = summary(record()) | {"task": running}
    assert "contacts   3 that" in table(whole) and "clearance" not in table(whole)
