"""Measured logs: read, check, write, resample; every bad input has its clear error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_diagram.errors import LogError
from twin_diagram.logs import (
    Log,
    check,
    fingerprint,
    is_regular,
    log_from_columns,
    read_log,
    resample,
    uniform,
    unwrapped,
    write_columns,
    write_log,
)
from twin_diagram.logs.differentiation import motion
from twin_diagram.logs.spikes import unspiked
from twin_diagram.model.model import Model

JOINTS = tuple(f"panda_joint{i + 1}" for i in range(7))
MODEL = Model.load("arms/panda.urdf")
MIDDLE = 0.5 * (MODEL.lower + MODEL.upper)


def healthy(count: int = 400, rate: float = 200.0) -> Log:
    time = np.arange(count) / rate
    k = np.arange(1, 8)
    phase = np.outer(time, 1.0 + 0.3 * k)
    position = MIDDLE + 0.3 * np.sin(phase)
    velocity = 0.3 * (1.0 + 0.3 * k) * np.cos(phase)
    return Log(time, JOINTS, position, velocity=velocity, torque=5.0 * np.cos(phase), position_commanded=position)


def same(a: Log, b: Log) -> bool:
    left, right = a.columns(), b.columns()
    return list(left) == list(right) and all(np.array_equal(left[name], right[name]) for name in left)


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_round_trip(tmp_path: Path, suffix: str) -> None:
    log = healthy()
    path = tmp_path / "deep" / f"run{suffix}"
    write_log(log, path)
    again = read_log(path)
    assert same(log, again)
    assert check(again, MODEL.limits) == []
    write_log(again, path)
    assert same(log, read_log(path))
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_names_of_joints_may_hold_what_parts_cells(tmp_path: Path) -> None:
    names = ("slide, left", 'the "big" one', "#1", "<b>ü</b>" + 60 * "x")
    log = Log(np.arange(12) / 100.0, names, np.ones((12, 4)), torque=np.ones((12, 4)))
    write_log(log, tmp_path / "a.csv")
    assert same(log, read_log(tmp_path / "a.csv"))


@settings(max_examples=40)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=10, max_size=20))
def test_any_number_is_written_without_loss(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("logs") / "x.csv"
    count = len(values)
    columns = {
        "time": np.arange(count) / 7.0,
        "position_measured.a": np.array(values),
        "torque_measured.a": np.ones(count),
    }
    write_columns(columns, path)
    log = read_log(path)
    assert np.array_equal(log.position[:, 0], values)
    assert np.array_equal(log.time, columns["time"])


def test_what_a_log_offers() -> None:
    log = healthy()
    assert log.period == pytest.approx(0.005)
    part = log.select(["panda_joint3", "panda_joint1"]).between(0.5, 1.0)
    assert part.joints == ("panda_joint3", "panda_joint1")
    np.testing.assert_array_equal(part.position, log.position[100:201, [2, 0]])
    assert part.torque_commanded is None
    with pytest.raises(ValueError, match="read-only"):
        log.position[0, 0] = 1.0
    with pytest.raises(LogError, match="'elbow' is missing"):
        log.select(["elbow"])
    commanded = Log(log.time, JOINTS, log.position, torque_commanded=log.torque)
    np.testing.assert_array_equal(commanded.motor_torque, log.torque)
    with pytest.raises(LogError, match="neither torque_measured nor torque_commanded"):
        _ = Log(log.time, JOINTS, log.position).motor_torque
    with pytest.raises(LogError, match="position_measured is"):
        Log(log.time, JOINTS, log.position[:5])


def csv(count: int = 20, **columns: object) -> str:
    table = {"time": [0.01 * k for k in range(count)], "position_measured.a": [0.1 * k for k in range(count)]}
    table["torque_measured.a"] = [1.0] * count
    table.update(columns)  # type: ignore[arg-type]
    names = [name for name, values in table.items() if values is not None]
    rows = [",".join(str(table[name][k]) for name in names) for k in range(count)]
    return "\n".join([",".join(names), *rows]) + "\n"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "# " + text,
        lambda text: text.replace("\n", ",\n"),
        lambda text: text.replace("\n", ",mode,,\n", 1).replace("1.0\n", "1.0,RUN,,\n"),
        lambda text: "# my log, at one time\n#\n\n" + text,
        lambda text: "# my log\n# " + text.replace("\n", "\n# s,rad,N·m\n", 1),
        lambda text: text.replace("0.02,", "# here it was pushed, 3 times\n0.02,") + "# end\n",
        lambda text: text.replace("\n", "\n[s],(rad),Nm\n", 1),
        lambda text: text.replace("\n", ",mode\ns,,N m,\n", 1).replace("1.0\n", "1.0,RUN\n"),
    ],
    ids=[
        "names behind #, as NumPy writes them",
        "a comma at each line's end",
        "words in columns of no signal",
        "comments above the names",
        "names and units among comments",
        "comments amid and below the numbers",
        "a line of units",
        "units of some columns",
    ],
)
def test_what_other_loggers_write_beside_the_format(tmp_path: Path, change: Callable[[str], str]) -> None:
    (tmp_path / "plain.csv").write_text(csv())
    (tmp_path / "other.csv").write_text(change(csv()))
    plain, other = (read_log(tmp_path / name) for name in ("plain.csv", "other.csv"))
    assert other.joints == plain.joints
    for attribute in ("time", "position", "torque"):
        np.testing.assert_array_equal(getattr(other, attribute), getattr(plain, attribute))


def test_a_line_of_units_is_heeded(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(csv().replace("\n", "\nms,deg,kN.m\n".replace("N.m", "N·m"), 1), encoding="utf-8")
    log = read_log(path)
    assert log.notes == (f"{path}: line 2 tells units; ms, deg, kN·m are made SI units",)
    np.testing.assert_allclose(log.time, 1e-5 * np.arange(20))
    np.testing.assert_allclose(log.position[:, 0], np.radians(0.1 * np.arange(20)))
    np.testing.assert_allclose(log.motor_torque, 1000.0)


def test_units_behind_the_names_are_heeded(tmp_path: Path) -> None:
    """As spreadsheets and plotting tools write them; such a log was said to have no column `time`."""
    path, lines = tmp_path / "log.csv", csv().split("\n", 1)
    path.write_text("time [ms],position_measured.a (deg),torque_measured.a [ N·m ]\n" + lines[1], encoding="utf-8")
    log = read_log(path)
    assert log.joints == ("a",) and log.notes == (f"{path}: line 1 tells units; ms, deg are made SI units",)
    np.testing.assert_allclose(log.time, 1e-5 * np.arange(20))
    np.testing.assert_allclose(log.position[:, 0], np.radians(0.1 * np.arange(20)))


@pytest.mark.parametrize(
    ("head", "line"),
    [
        ("time [s],position_measured.a [rad],torque_measured.a [kg]\n", 1),
        ("time,position_measured.a,torque_measured.a\ns,rad,kg\n", 2),
    ],
)
def test_what_is_no_unit_of_a_column_is_said(head: str, line: int, tmp_path: Path) -> None:
    """Not that time is no number: the line is one of units."""
    path = tmp_path / "log.csv"
    path.write_text(head + csv().split("\n", 1)[1], encoding="utf-8")
    with pytest.raises(LogError, match=f"line {line}: torque_measured.a is in 'kg', which is none of "):
        read_log(path)


def changed(values: list[object], index: int, value: object) -> list[object]:
    values[index] = value
    return values


TIMES: list[object] = [0.01 * k for k in range(20)]
ONES: list[object] = [1.0] * 20
BAD_TEXT = {
    "is empty": "",
    "holds 0 sample": "time,position_measured.a,torque_measured.a\n",
    "holds 3 sample": csv(3),
    "has no column `time`": csv(time=None),
    "has no column `position_measured": csv(**{"position_measured.a": None}),
    "line 7: torque_measured.a is not a number": csv(**{"torque_measured.a": changed(ONES[:], 5, "nan")}),
    "line 7: torque_measured.a is inf, not finite": csv(**{"torque_measured.a": changed(ONES[:], 5, "inf")}),
    "line 7: torque_measured.a is 'oops', not a number": csv(**{"torque_measured.a": changed(ONES[:], 5, "oops")}),
    "line 7: torque_measured.a is empty": csv(**{"torque_measured.a": changed(ONES[:], 5, "")}),
    r"line 9: time 0\.06 is the same as": csv(time=changed(TIMES[:], 7, 0.06)),
    r"line 9: time 0\.0 is before": csv(time=changed(TIMES[:], 7, 0.0)),
    r"line 6 has 2 cell\(s\), the first line names 3": csv().replace("0.04,0.4,1.0", "0.04,0.4"),
    r"line 6 has 4 cell\(s\), the first line names 3": csv().replace("0.04,0.4,1.0", "0.04,0.4,1.0,2"),
    r"line 6 has 0 cell\(s\)": csv().replace("0.04,0.4,1.0", ""),
    "column 'time' is there 2 times": csv().replace("position_measured.a", "time"),
    "too few digits": csv(time=[1.7e9 + (k // 7) for k in range(20)]),
    "is the same as .* leave one of each": "".join(
        line * (1 if line[0] == "t" else 3) for line in csv().splitlines(True)
    ),
    "semicolons": csv().replace(",", ";"),
    "separated by semicolons": csv()
    .replace(",", ";")
    .replace(".", ",")
    .replace("position_measured,", "position_measured."),
    r"separated by tabs; .*--columns reads others": csv().replace(",", "\t"),
    "its first line must name the columns; it is 'my log'": "# of today\nmy log\n" + csv(),
    "line 9: torque_measured.a is inf, not finite": "# my log\n"
    + csv(**{"torque_measured.a": changed(ONES[:], 5, "inf")}).replace("0.02,", "# a note\n0.02,"),
    "line 2: torque_measured.a is in 'mA', which is none of N·m,": csv().replace("\n", "\ns,rad,mA\n", 1),
    "line 2: time is 'now', not a number": csv().replace("\n", "\nnow,rad,N·m\n", 1),
    "has torque_measured.b but no position_measured.b": csv(**{"torque_measured.b": ONES}),
}


def test_decimal_commas_and_a_lacking_line_of_names_are_said(tmp_path: Path) -> None:
    """A spreadsheet set to German writes `0,5`; a log without names said that it had no column `time`."""
    path, (names, *rows) = tmp_path / "log.csv", csv().splitlines()
    commas = [[f"{float(cell):.3f}".replace(".", ",") for cell in row.split(",")] for row in rows]
    for cells, said in (
        (commas, f"line 2 has {2 * len(commas[0])} cell.*; decimals are written with points"),
        ([[f'"{cell}"' for cell in row] for row in commas], "'0,000', not a number; decimals are written with points"),
    ):
        path.write_text("\n".join([names, *(",".join(row) for row in cells)]))
        with pytest.raises(LogError, match=said):
            read_log(path)
    path.write_text("\n".join(rows))
    with pytest.raises(LogError, match="line 1 holds numbers; a line above them must name the columns"):
        read_log(path)


def test_a_joint_without_torque_is_left_out(tmp_path: Path) -> None:
    """Fingers' drives tell none; where the model needs the joint, its absence is explained."""
    path = tmp_path / "log.csv"
    path.write_text(csv(**{"position_measured.b": ["nan"] * 20, "velocity_estimated.b": ONES}))
    log = read_log(path)
    assert log.joints == ("a",) and log.velocity is None
    assert log.notes == (f"{path}: b has no torque_measured and is left out",)
    columns = {name: values for name, values in healthy().columns().items() if name != f"torque_measured.{JOINTS[2]}"}
    with pytest.raises(LogError, match=f"joint '{JOINTS[2]}' of the model is missing.*has no torque"):
        check(log_from_columns(columns, "log", str), MODEL.limits)


@pytest.mark.parametrize("written", ["not at all", "as NaN"])
def test_a_joint_without_velocity_leaves_the_others_theirs(tmp_path: Path, written: str) -> None:
    """A gripper's drive tells none; that took the whole arm's, and of an arm's own joint positions tell it now."""
    log = healthy()
    columns = log.columns()
    for signal in ("position_measured", "torque_measured"):
        columns[f"{signal}.finger"] = columns[f"{signal}.{JOINTS[0]}"]
    if written == "as NaN":
        columns["velocity_estimated.finger"] = np.full(len(log), np.nan)
    write_columns(columns, tmp_path / "log.csv")
    found = read_log(tmp_path / "log.csv")
    assert found.lacking("velocity_estimated") == ("finger",)
    assert [w.code for w in check(found, MODEL.limits)] == ["unknown_joint"]
    assert same(found.select(JOINTS), log)
    write_log(found, tmp_path / "again.csv")
    assert same(read_log(tmp_path / "again.csv"), found)

    columns = {name: values for name, values in columns.items() if name != f"velocity_estimated.{JOINTS[2]}"}
    found = log_from_columns(columns, "log", str).select(JOINTS)
    (warning,) = check(found, MODEL.limits)
    assert warning.message == f"log: velocity_estimated is not there of {JOINTS[2]}; there, positions alone tell it"
    rest, alone = [k for k in range(7) if k != 2], replace(log, velocity=None)
    moves, whole, bare = motion(found), motion(log), motion(alone)
    np.testing.assert_allclose(moves.velocity[:, rest], whole.velocity[:, rest], atol=1e-12)
    np.testing.assert_allclose(moves.acceleration[:, 2], bare.acceleration[:, 2], atol=1e-12)
    assert np.all(np.isfinite(motion(uniform(found, 150.0)).acceleration))
    assert unspiked(found)[0] is found


def test_a_joint_whose_torque_is_only_commanded_is_left_out_where_others_are_measured(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(csv(**{"position_measured.b": ONES, "torque_commanded.b": ONES}))
    log = read_log(path)
    assert log.joints == ("a",) and log.notes == (f"{path}: b has no torque_measured and is left out",)
    columns = healthy().columns()
    columns[f"torque_commanded.{JOINTS[2]}"] = columns.pop(f"torque_measured.{JOINTS[2]}")
    with pytest.raises(LogError, match=f"joint '{JOINTS[2]}' of the model is missing.*has no torque_measured"):
        check(log_from_columns(columns, "log", str), MODEL.limits)


def test_angles_that_jump_by_a_turn_go_on() -> None:
    log = healthy()
    high = replace(log, position=log.position + np.pi - log.position[:1])  # starts at half a turn, and crosses it
    wrapped = replace(high, position=(high.position + np.pi) % (2.0 * np.pi) - np.pi, position_commanded=high.position)
    assert np.any(np.abs(np.diff(wrapped.position, axis=0)) > np.pi)
    whole, (warning,) = unwrapped(wrapped, MODEL.limits.revolute)
    assert warning.code == "wrapped" and "jumps by a turn" in warning.message
    moved = whole.position - whole.position[0]
    np.testing.assert_allclose(moved, high.position - high.position[0], atol=1e-9)
    assert whole.position_commanded is not None
    assert fingerprint(whole) == fingerprint(wrapped)
    assert unwrapped(log, MODEL.limits.revolute) == (log, [])
    lost = log.position.copy()
    lost[50, 2] -= 5.0  # a dropped sample is no turn
    assert unwrapped(replace(log, position=lost), MODEL.limits.revolute)[1] == []


@pytest.mark.parametrize("message", BAD_TEXT)
def test_bad_text_is_refused(tmp_path: Path, message: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(BAD_TEXT[message])
    with pytest.raises(LogError, match=message) as error:
        read_log(path)
    assert "\n" not in str(error.value)


def test_bad_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such log file"):
        read_log(tmp_path / "none.csv")
    with pytest.raises(LogError, match="is a folder, and no ROS 2 bag: it has no metadata"):
        read_log(tmp_path)
    for name, message in (
        ("x.txt", r"none of \.csv, \.npz, a ROS bag .* and an LCM log"),
        ("x.csv.gz", "an LCM log; unpack it first"),
        ("x.csv#topic", "only ROS bags and LCM logs hold several streams"),
        ("x.npz", "damaged"),
    ):
        (tmp_path / name.partition("#")[0]).write_bytes(b"hello")
        with pytest.raises(LogError, match=message):
            read_log(tmp_path / name)
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(LogError, match="not a text file"):
        read_log(tmp_path / "x.csv")
    np.savez(tmp_path / "o.npz", time=np.array([object()]))
    with pytest.raises(LogError, match="Python objects"):
        read_log(tmp_path / "o.npz")
    np.savez(tmp_path / "r.npz", time=np.arange(20.0), **{"position_measured.a": np.arange(19.0)})
    with pytest.raises(LogError, match=r"time has 20 samples, position_measured\.a has 19"):
        read_log(tmp_path / "r.npz")
    np.savez(tmp_path / "t.npz", time=np.array(["a", "b"]))
    with pytest.raises(LogError, match="not numbers"):
        read_log(tmp_path / "t.npz")
    np.savez(tmp_path / "d.npz", time=np.zeros((3, 3)))
    with pytest.raises(LogError, match=r"2-dimensional.* position_measured\.JOINT"):
        read_log(tmp_path / "d.npz")
    with pytest.raises(LogError, match=r"written as \.csv or \.npz"):
        write_log(healthy(), tmp_path / "x.txt")


@settings(max_examples=150)
@given(st.binary(max_size=300))
def test_noise_never_crashes_the_reader(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    folder = tmp_path_factory.mktemp("noise")
    for name in ("x.csv", "x.npz"):
        (folder / name).write_bytes(noise)
        with pytest.raises(LogError):
            read_log(folder / name)


def test_forms_of_good_text(tmp_path: Path) -> None:
    """What spreadsheets and Windows make of a CSV file."""
    path = tmp_path / "log.csv"
    expected = log_from_columns(read_columns_of(csv(), path), "x", str)
    for text in (
        "\ufeff" + csv(),
        csv().replace("\n", "\r\n"),
        csv() + "\n\n",
        csv().replace("time,", '"time", '),
        csv().replace("0.04,0.4,1.0", '"0.04", 0.4 ,1'),
        csv(extra=[2.0] * 20, **{"other.a": [3.0] * 20}),
    ):
        path.write_bytes(text.encode())
        assert same(read_log(path), expected)


def read_columns_of(text: str, path: Path) -> dict[str, np.ndarray]:
    path.write_text(text)
    return read_log(path).columns()


def codes(log: Log, model: Model | None = MODEL) -> list[str]:
    return [warning.code for warning in check(log, model.limits)]


def test_units_are_checked() -> None:
    log = healthy()
    degrees = Log(log.time, JOINTS, np.degrees(log.position), torque=log.torque)
    with pytest.raises(LogError, match="looks like degrees"):
        check(degrees, MODEL.limits)
    with pytest.raises(LogError, match="looks like an encoder's counts"):
        check(replace(log, velocity=None, position=np.round(log.position * 2**13)), MODEL.limits)
    with pytest.raises(LogError, match="positions in degrees but velocities in rad/s"):
        check(Log(log.time, JOINTS, np.degrees(log.position), velocity=log.velocity, torque=log.torque))
    with pytest.raises(LogError, match="velocities in degrees per second"):
        check(Log(log.time, JOINTS, log.position, velocity=np.degrees(log.velocity), torque=log.torque))
    for scale, name in ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")):
        with pytest.raises(LogError, match=name):
            check(Log(log.time * scale, JOINTS, log.position, torque=log.torque))
    with pytest.raises(LogError, match="too far"):
        check(Log(log.time * 60.0, JOINTS, log.position, torque=log.torque))
    epoch = Log(log.time + 1.7e9, JOINTS, log.position, velocity=log.velocity, torque=log.torque)
    assert check(epoch, MODEL.limits) == []


def test_doubtful_logs_are_named() -> None:
    log = healthy()
    kept = np.r_[0:100, 150:300, 310:400]
    gap = Log(log.time[kept], JOINTS, log.position[kept], torque=log.torque[kept])
    (warning,) = check(gap, MODEL.limits)
    assert warning.code == "gap"
    assert "2 gap(s)" in warning.message and "0.255 s" in warning.message
    (warning,) = check(Log(log.time[kept] + 1.7e9, JOINTS, log.position[kept], torque=log.torque[kept]), MODEL.limits)
    assert f"at {1.7e9 + log.time[99]:.3f}".rstrip("0") in warning.message  # 1.7e+09 tells nobody where
    jitter = log.time + 0.3 * log.period * np.random.default_rng(0).uniform(-1.0, 1.0, len(log))
    assert codes(Log(jitter, JOINTS, log.position, torque=log.torque)) == ["jitter"]
    slow = Log(log.time, JOINTS, log.position, velocity=0.5 * log.velocity, torque=log.torque)
    assert set(codes(slow)) == {"velocity_scale"}
    strong = Log(log.time, JOINTS, log.position, torque=100.0 * log.torque)
    assert set(codes(strong)) == {"torque_beyond_limits"}
    far = Log(log.time, JOINTS, log.position + 0.5 * (MODEL.upper - MODEL.lower), torque=log.torque)
    assert set(codes(far)) == {"beyond_limits"}
    still = Log(log.time, JOINTS, np.tile(MIDDLE, (len(log), 1)), torque=np.zeros_like(log.position))
    assert set(codes(still)) == {"no_motion", "no_torque"}
    extra = Log(
        log.time,
        (*JOINTS, "finger"),
        np.hstack([log.position, log.position[:, :1]]),
        torque=np.hstack([log.torque, log.torque[:, :1]]),
    )
    (warning,) = check(extra, MODEL.limits)
    assert (warning.code, warning.joint) == ("unknown_joint", "finger")
    with pytest.raises(LogError, match="joint 'panda_joint7' of the model is missing"):
        check(log.select(JOINTS[:6]), MODEL.limits)


def test_noise_raises_no_alarm() -> None:
    """Encoder noise and a poor velocity estimate are no unit slips."""
    rng = np.random.default_rng(3)
    log = healthy()
    noisy = Log(
        log.time,
        JOINTS,
        np.round(log.position / 1e-3) * 1e-3,
        velocity=log.velocity + rng.normal(scale=0.1, size=log.position.shape),
        torque=log.torque + rng.normal(size=log.position.shape),
    )
    assert codes(noisy) == []


def test_resampling_keeps_the_signal() -> None:
    log = healthy()
    times = np.linspace(0.1, 1.9, 777)
    fine = resample(log, times)
    k = np.arange(1, 8)
    phase = np.outer(times, 1.0 + 0.3 * k)
    np.testing.assert_allclose(fine.position, MIDDLE + 0.3 * np.sin(phase), atol=1e-8)
    assert fine.torque is not None
    np.testing.assert_allclose(fine.torque, 5.0 * np.cos(phase), atol=2e-4)
    assert uniform(log) is log
    jitter = log.time + 0.2 * log.period * np.sin(np.arange(len(log)) * 1.7)
    regular = uniform(resample(log, np.clip(jitter, 0.0, log.time[-1])[1:-1]))
    assert is_regular(regular.time)
    phase = np.outer(regular.time, 1.0 + 0.3 * k)
    np.testing.assert_allclose(regular.position, MIDDLE + 0.3 * np.sin(phase), atol=1e-7)
    assert uniform(log, 50.0).period == pytest.approx(0.02)
    with pytest.raises(LogError, match="not within"):
        resample(log, np.array([0.0, 99.0]))
    with pytest.raises(LogError, match="must rise"):
        resample(log, np.array([0.5, 0.5]))


def test_measured_runs(data_dir: Path) -> None:
    model = Model.load(data_dir / "kuka_kr300" / "kr300.urdf")
    for name in ("A", "B"):
        log = read_log(data_dir / "kuka_kr300" / f"trajectory_{name}.csv")
        assert check(log, model.limits) == []
        assert log.joints == model.joints
        assert log.period == pytest.approx(0.004)
