"""What a finished run is worth: estimates held against the simulated truth, afterwards.

With `trial`, `task_score`, `camera_score` and `true_clearance`, which read the truth for it, the only module outside
`station` that knows it; nothing of the twin imports any of them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.assets import symmetry
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ALARM_LOG_FIELDS, AlarmKind


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    visible: float = 0.3
    """An object counts as visible in a frame that shows this share of its camera-facing surface."""

    settled: float = 0.5
    """Errors count from this long after an object first came in sight [s]: the camera's first frames have to arrive."""

    weighed: float = 0.15
    """A payload counts as weighed to within this share of its mass."""


TUNING = Tuning()


@dataclass
class RunRecord:
    """What a run leaves behind for the scorer; the leading axis is time.

    Attributes:
        time: (T,) sample times [s].
        seen: (T, K) share of each object's camera-facing surface that the newest image shows.
        poses_true: (T, K, 7) X_WO, (qw, qx, qy, qz, px, py, pz).
        poses_estimated: (T, K, 7).
        status: (T, K) `ObjectStatus`.
        arm_true: (T, 2n) joint positions [rad, m] and speeds [rad/s, m/s].
        arm_estimated: (T, 2n).
        mass, mass_std: (T,) the learned payload [kg].
        clearance: (T,) true distance from the arm to anything else [m].
        contacts: (T,) number of contacts of the arm with anything else.
        goal_error: (T,) distance of the tool from its goal [m], NaN without one.
        goal_angle: (T,) the same for its orientation [rad].
        alarm_log: (32, 3) the drift monitor's ring at the end.
        symmetric_axis: by object, `z` where a turn about it is free.
        symmetries: by object, axis of O (0 to 2) and repetitions (0: any) of turns that do not count.
        joints: names of the n joints, in the order of `arm_true`; empty: they are numbered from 1.
        prismatic: which of them are.
    """

    time: Array
    seen: Array
    poses_true: Array
    poses_estimated: Array
    status: npt.NDArray[np.int64]
    arm_true: Array
    arm_estimated: Array
    mass: Array
    mass_std: Array
    clearance: Array
    contacts: npt.NDArray[np.int64]
    goal_error: Array
    goal_angle: Array
    alarm_log: Array
    objects: Sequence[str] = field(default_factory=list)
    symmetric_axis: Mapping[str, str | None] = field(default_factory=dict)
    symmetries: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    joints: Sequence[str] = ()
    prismatic: Collection[str] = ()

    def joint_names(self) -> list[str]:
        """Return the joints' names."""
        return list(self.joints) or [f"joint {k + 1}" for k in range(self.arm_true.shape[1] // 2)]

    def rotation_error(self, index: int) -> Array:
        """Return (T,) the angles between an object's true and estimated orientations, up to symmetries [rad]."""
        true, estimated = self.poses_true[:, index, :4], self.poses_estimated[:, index, :4]
        name = self.objects[index]
        return rotation_angle(true, estimated, self.symmetric_axis.get(name), self.symmetries.get(name, ()))


def rotation_angle(
    first: Array, second: Array, symmetric_axis: str | None = None, symmetries: tuple[tuple[int, int], ...] = ()
) -> Array:
    """Return the angle between orientations, up to symmetries.

    Args:
        first: (…, 4) unit quaternions (w, x, y, z).
        second: (…, 4) likewise.
        symmetric_axis: ``z`` counts only the tilt of the body's z axis.
        symmetries: further turns that do not count, as of `assets.symmetry.parsed`.

    Returns:
        (…,) angles [rad].
    """
    further = tuple(one for one in symmetries if symmetric_axis != "z" or one[0] != 2)
    if further:
        return symmetry.angles(first, second, (*further, (2, 0)) if symmetric_axis == "z" else further)
    if symmetric_axis == "z":
        dot = np.einsum("...i,...i", _z_axis(first), _z_axis(second))
        return np.arccos(np.clip(dot, -1.0, 1.0))
    dot = np.abs(np.einsum("...i,...i", first, second))
    return 2.0 * np.arccos(np.clip(dot, 0.0, 1.0))


def _z_axis(quaternion: Array) -> Array:
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def summarize(
    record: RunRecord,
    *,
    seed: int,
    duration: float,
    payload_true: float | None,
    position_tolerance: float,
    rotation_tolerance: float,
    timing: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the figures of ``summary.json``, every one computed from the record.

    Args:
        record: the samples.
        seed: of the run.
        duration: of the run [s].
        payload_true: mass that the tool truly carries [kg]; None: nobody knows.
        position_tolerance: within which a goal counts as reached [m].
        rotation_tolerance: likewise [rad].
        timing: what is told of computing time, as it is.
    """
    has_goal = bool(np.isfinite(record.goal_error[-1]))
    return {
        "seed": seed,
        "duration_s": duration,
        "objects": {name: _object_errors(record, index) for index, name in enumerate(record.objects)},
        "arm": _joint_errors(record),
        "payload": {
            "mass_true": payload_true,
            "mass_estimated": _number(record.mass[-1]),
            "mass_std": _number(record.mass_std[-1]),
        },
        "goal": {
            "reached": bool(
                has_goal and record.goal_error[-1] <= position_tolerance and record.goal_angle[-1] <= rotation_tolerance
            ),
            "error_mm": round(1e3 * float(record.goal_error[-1]), 3) if has_goal else None,
        },
        "clearance_min_mm": _finite(1e3 * float(np.min(record.clearance))),
        "contacts": int(record.contacts.sum()),
        "alarms": alarms(record.alarm_log),
        "timing": dict(timing),
    }


def _joint_errors(record: RunRecord) -> dict[str, Any]:
    """Return the errors of all turning joints together [rad], then of each joint in its own unit: rad, or mm."""
    names = record.joint_names()
    error = record.arm_estimated[:, : len(names)] - record.arm_true[:, : len(names)]
    turning = np.array([name not in record.prismatic for name in names])

    def rms_max(values: Array) -> dict[str, float | None]:
        if values.size == 0:
            return {"rms": None, "max": None}
        return {"rms": _number(np.sqrt(np.mean(values**2))), "max": _number(np.max(np.abs(values)))}

    each = {
        name: rms_max(error[:, k] if turns else 1e3 * error[:, k]) | {"unit": units.ANGLE if turns else "mm"}
        for k, (name, turns) in enumerate(zip(names, turning, strict=True))
    }
    return {"joint_error_rad": rms_max(error[:, turning]), "joints": each}


def _object_errors(record: RunRecord, index: int) -> dict[str, Any]:
    """Return what is told of one object: errors of its pose while it is in sight, and how long it is."""
    time, axis = record.time, record.symmetric_axis.get(record.objects[index])
    visible = record.seen[:, index] >= TUNING.visible
    counted = visible & (record.status[:, index] > 0)
    if visible.any():
        counted &= time >= time[np.argmax(visible)] + TUNING.settled
    missed = visible & (time >= time[np.argmax(visible)] + TUNING.settled) & (record.status[:, index] == 0)
    difference = record.poses_estimated[:, index, 4:] - record.poses_true[:, index, 4:]
    position = 1e3 * np.linalg.norm(difference, axis=-1)
    rotation = np.degrees(record.rotation_error(index))
    # A frame in which the object is in sight but not tracked counts as an infinite error, not as no error.
    position, rotation = np.where(missed, np.inf, position), np.where(missed, np.inf, rotation)
    counted |= missed
    return {
        "position_error_mm": _median_p95(position[counted]),
        "rotation_error_deg": _median_p95(rotation[counted]),
        "symmetric_axis": axis,
        "visible_share": round(float(visible.mean()), 4),
    }


def alarms(ring: Array) -> list[dict[str, Any]]:
    """Return the drift monitor's ring as a list, in order of time."""
    rows = [row for row in ring.reshape(-1, ALARM_LOG_FIELDS) if row[0] >= 0]
    rows.sort(key=lambda row: float(row[0]))
    return [{"time": round(float(row[0]), 4), "kind": AlarmKind(int(row[1])).name.lower()} for row in rows]


def _median_p95(values: Array) -> dict[str, float | None]:
    if values.size == 0:
        return {"median": None, "p95": None}
    median, p95 = np.percentile(values, [50, 95], method="higher")
    return {"median": _finite(float(median)), "p95": _finite(float(p95))}


def _number(value: Any) -> float | None:
    """Return a number as JSON knows it; None where there is none."""
    return float(value) if math.isfinite(value) else None


def _finite(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def within(summary: Mapping[str, Any], *, millimetres: float = 5.0, degrees: float = 5.0) -> dict[str, bool]:
    """Return which of the bounds of the closed loop a run keeps.

    Args:
        summary: as of `summarize`.
        millimetres: that an object's median position may be off.
        degrees: that its median rotation may be.

    Returns:
        ``tracked`` (every object that was visible at all), ``untouched``, ``reached``, ``weighed`` (the payload).
    """
    tracked = True
    for entry in summary["objects"].values():
        if entry["visible_share"] <= 0:
            continue
        position, rotation = entry["position_error_mm"]["median"], entry["rotation_error_deg"]["median"]
        tracked &= position is not None and position <= millimetres
        tracked &= rotation is not None and rotation <= degrees
    true, estimated = summary["payload"]["mass_true"], summary["payload"]["mass_estimated"]
    return {
        "tracked": tracked,
        "untouched": summary["contacts"] == 0 and (summary["clearance_min_mm"] or 0.0) > 0.0,
        "reached": summary["goal"]["reached"],
        "weighed": bool(true) and estimated is not None and abs(estimated - true) <= TUNING.weighed * true,
    }


def table(summary: Mapping[str, Any]) -> str:
    """Return the summary as a table for the terminal."""

    def figure(value: float | None, form: str) -> str:
        return "–".rjust(int(form.split(".")[0] or 0)) if value is None else format(value, form)

    lines = []
    if summary["objects"]:
        lines.append(f"{'object':<14}{'position [mm]':>22}{'rotation [°]':>22}{'visible':>10}")
        lines.append(f"{'':<14}{'median':>12}{'p95':>10}{'median':>12}{'p95':>10}{'share':>10}")
    for name, entry in summary["objects"].items():
        position, rotation = entry["position_error_mm"], entry["rotation_error_deg"]
        axis = f" (about {entry['symmetric_axis']}: free)" if entry["symmetric_axis"] else ""
        lines.append(
            f"{name:<14}{figure(position['median'], '12.2f')}{figure(position['p95'], '10.2f')}"
            f"{figure(rotation['median'], '12.2f')}{figure(rotation['p95'], '10.2f')}"
            f"{entry['visible_share']:>10.0%}{axis}"
        )
    payload, goal = summary["payload"], summary["goal"]
    lines += [""] * bool(lines) + [f"{'joint error':<22}{'rms':>10}{'max':>10}"]
    for name, entry in summary["arm"]["joints"].items():
        rms, most = (figure(entry[key], ".1e") for key in ("rms", "max"))
        lines.append(f"{name:<22}{rms:>10}{most:>10} {entry['unit']}")
    arm = summary["arm"]["joint_error_rad"]
    lines.append("")
    if arm["rms"] is not None:
        lines.append(f"arm        joint error {figure(arm['rms'], '.1e')} rad rms, {figure(arm['max'], '.1e')} max")
    truth = f", true {payload['mass_true']:.3f} kg" if payload["mass_true"] is not None else ""
    lines.append(
        f"payload    {figure(payload['mass_estimated'], '.3f')} ± {figure(payload['mass_std'], '.3f')} kg{truth}"
    )
    if goal["error_mm"] is not None:
        lines.append(_goal_line(goal))
    if "task" in summary:
        lines += task_lines(summary["task"])
    else:
        lines.append(
            f"clearance  {figure(summary['clearance_min_mm'], '.0f')} mm at the least, {summary['contacts']} contacts"
        )
    alarms = ", ".join(f"{a['kind']} at {a['time']:.2f} s" for a in summary["alarms"])
    lines.append(f"alarms     {alarms or 'none'}")
    lines += _told_besides(summary)
    timing = summary["timing"]
    if timing:
        shares = ", ".join(f"{name} {share:.0%}" for name, share in timing["systems"].items())
        lines.append(f"speed      {timing['real_time_factor']:.2f} × real time ({shares})")
    return "\n".join(lines)


def _told_besides(summary: Mapping[str, Any]) -> list[str]:
    """Return a line each of cameras, unknown things, health, brakes and the preview, as far as there are any."""
    lines = []
    each = {"camera": summary["calibration"]} if "calibration" in summary else summary.get("calibrations", {})
    for name, found in each.items():
        before, after = (found.get("error", found["claimed"])[when]["shown_aside_mm"] for when in ("before", "after"))
        lines.append(f"{name:<10} shows the table {before:.1f} mm aside as told, {after:.1f} mm as corrected")
    if summary.get("things"):
        names = ", ".join(f"{name} ({entry['status']})" for name, entry in summary["things"].items())
        lines.append(f"besides    {names}")
    if "health" in summary:
        lacking = ", ".join(f"{each['reason']} ({each['what']})" for each in summary["health"])
        lines.append(f"health     {lacking or 'nothing is lacking'}")
    if "brakes" in summary:
        stops = summary["brakes"]
        causes = ", ".join(f"{cause} {count}" for cause, count in stops["causes"].items())
        lines.append(
            f"brakes     {stops['count']}, {stops['seconds']:.2f} s in all" + (f" ({causes})" if causes else "")
        )
    if "preview" in summary:
        lines.append(_preview_line(summary["preview"]))
    return lines


def _goal_line(goal: Mapping[str, Any]) -> str:
    """Return whether the goal was reached, and where that is known, why not."""
    why = f": {goal['why']}" if "why" in goal else ""
    return f"goal       {'reached' if goal['reached'] else 'missed'}, {goal['error_mm']:.1f} mm off{why}"


def _preview_line(preview: Mapping[str, Any]) -> str:
    """Return how far off what was foreseen of the tool was, beside how far it went meanwhile."""
    off, goes = (
        f"{each['median']:.0f} mm (p95 {each['p95']:.0f})"
        for each in (preview["tool_error_mm"], preview["tool_moved_mm"])
    )
    ahead, inside = f"{preview['ahead_s']:.0f} s ahead", f"{preview['inside_95']:.0%} within the told 95 %"
    return f"preview    {ahead} the tool is off by {off} and goes {goes}; {inside}"


def task_lines(task: Mapping[str, Any]) -> list[str]:
    """Return how a task of steps ended, for the terminal: each step, where things were put, and what was touched.

    Hands touch what they take, so that clearance says nothing here: contacts that no step asks for do.
    """
    ends = {"done": "done", "failed": "failed"}
    steps: dict[int, str] = {}
    held, put = "", set[str]()
    for event in task.get("events", ()):
        if event["what"] == "grasped":
            held = event.get("object", "")
        elif event["what"] == "released":
            put.add(event.get("object", held))
        name = " ".join(filter(None, (event["kind"], event.get("object"))))
        ended = ends.get(event["what"])
        steps[event["step"]] = f"{name} {ended} at {event['time']:.1f} s" if ended else f"{name} under way"
    told = ", ".join(steps[k] for k in sorted(steps)) or "not begun"
    why = f": {task['why']}" if "why" in task else ""
    lines = [f"task       {task['outcome']}{why} ({told})"]
    for name, off in task.get("placed", {}).items():
        if name not in put:
            continue  # it stands where it stood
        lines.append(f"placed     {name} {off['off_mm']:.1f} mm and {off['off_deg']:.1f}° off its goal")
    if "collisions" in task:
        count = sum(task["collisions"].values())
        lines.append(f"contacts   {count or 'none'} that no step asks for")
    return lines
