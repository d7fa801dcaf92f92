"""Foreign logs: columns by their own names, in their own units, from a map or a published layout."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from twin_diagram.errors import LogError
from twin_diagram.logs import read_log, write_log
from twin_diagram.logs.column_map import column_map, parse
from twin_diagram.logs.measured_log import Log
from twin_diagram.logs.presets import PRESETS
from twin_diagram.logs.torque_constants import TorqueConstants

SAMPLES = 20


def motion(n: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.arange(SAMPLES) * 0.002, *(rng.normal(size=(SAMPLES, n)) for _ in range(3))


def table(path: Path, columns: dict[str, Any], mark: str = ",") -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [mark.join(columns), *(mark.join(v if isinstance(v, str) else repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def libfranka(path: Path, t: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> Path:
    columns: dict[str, Any] = {"time": 1e3 * t, "success_rate": np.ones(len(t))}
    for name, values in (("state.q", q), ("state.q_d", q), ("state.dq", v), ("state.dq_d", v), ("state.tau_J", tau)):
        columns |= {f"{name}[{k}]": values[:, k] for k in range(7)}
    columns |= {f"state.tau_ext_hat_filtered[{k}]": 0.0 * tau[:, k] for k in range(7)}
    columns |= {f"cmd.tau_J_d[{k}]": -tau[:, k] for k in range(7)}
    return table(path, columns, mark=", ")


def franka_ros(path: Path, t: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> Path:
    stamp = [f"{1_600_000_000_000_000_000 + round(1e9 * s)}" for s in t]
    columns: dict[str, Any] = {"%time": stamp, "field.header.frame_id": ["panda_link0"] * len(t)}
    for name, values in (("tau_J", tau), ("q", q), ("dq", v)):
        columns |= {f"field.{name}{k}": values[:, k] for k in range(7)}
    return table(path, columns)


def ur_rtde(path: Path, t: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> Path:
    columns: dict[str, Any] = {"timestamp": t + 5000.0}
    for name, values in (
        ("target_q", q + 1.0),
        ("actual_q", q),
        ("actual_qd", v),
        ("actual_current", tau / 12.5),
        ("actual_current_as_torque", tau),
    ):
        columns |= {f"{name}_{k}": values[:, k] for k in range(6)}
    return table(path, columns, mark=" ")


def iiwa_fri(path: Path, t: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> Path:
    columns: dict[str, Any] = {"index": np.arange(len(t)), "time": t, "record_time_nsec": 1e18 + 1e9 * t}
    # The interface counts measured torques against the joint, as an iiwa's status messages do.
    for name, values in (("mp", q), ("ip", q + 1.0), ("mt", -tau), ("et", 0.0 * tau)):
        columns |= {f"{name}{k + 1}": values[:, k] for k in range(7)}
    return table(path, columns)


@pytest.mark.parametrize(
    ("write", "given", "has_velocity"),
    [
        (libfranka, "libfranka", True),
        (franka_ros, "franka_ros", True),
        (ur_rtde, "ur_rtde_torque", True),
        (ur_rtde, {"preset": "ur_rtde", "torque_measured": {"torque_constant": 12.5}}, True),
        (iiwa_fri, "iiwa_fri", False),
    ],
    ids=["libfranka", "franka_ros", "ur_rtde_torque", "ur_rtde", "iiwa_fri"],
)
def test_published_layouts_are_read(write: Callable[..., Path], given: Any, has_velocity: bool, tmp_path: Path) -> None:
    n = 6 if write is ur_rtde else 7
    t, q, v, tau = motion(n)
    path = write(tmp_path / "foreign.csv", t, q, v, tau)
    if isinstance(given, dict):
        (tmp_path / "map.yaml").write_text(yaml.safe_dump(given))
        given = tmp_path / "map.yaml"
    log = read_log(path, given)
    assert log.numbered and len(log.joints) == n and log.link_side == (write is not ur_rtde)
    np.testing.assert_allclose(log.time, t, atol=3e-7)
    np.testing.assert_allclose(log.position, q, rtol=1e-12)
    np.testing.assert_allclose(log.motor_torque, tau, rtol=1e-12)
    assert (log.velocity is not None) == has_velocity
    if log.velocity is not None:
        np.testing.assert_allclose(log.velocity, v, rtol=1e-12)
    names = [f"joint_{k}" for k in range(n)]
    assert log.select(names).joints == tuple(names)


def test_what_a_map_says_goes_before_its_preset() -> None:
    fields = {"time": {"column": "t", "unit": "ms"}, "torque_measured": {"unit": "mN·m"}}
    meaning = parse({"preset": "ur_rtde_torque", **fields}, "map.yaml")
    assert (meaning.time.name, meaning.time.scale) == ("t", 1e-3)
    assert meaning.signals["torque_measured"][5].name == "actual_current_as_torque_5"
    assert meaning.signals["torque_measured"][5].scale == 1e-3
    with pytest.raises(LogError, match="torque_measured: is a mapping"):
        parse({"preset": "ur_rtde", "torque_measured": None}, "map.yaml")


def test_presets_cite_where_their_names_come_from() -> None:
    for name, preset in PRESETS.items():
        assert len(preset.source) > 20 and preset.side in ("motor", "link"), name


def test_units_signs_and_constants_of_each_column(tmp_path: Path) -> None:
    t, q, v, tau = motion(2)
    columns = {"ms": 1e3 * t, "note": ["a b"] * SAMPLES, "sh": np.degrees(q[:, 0]), "lift": -1e3 * q[:, 1]}
    columns |= {"v0": v[:, 0] * 30.0 / np.pi, "v1": 1e3 * v[:, 1], "i_sh": -1e3 * tau[:, 0] / 11.0, "f": tau[:, 1]}
    path = table(tmp_path / "own.csv", columns, mark=";")
    (tmp_path / "map.yaml").write_text(
        """
joints: [shoulder, lift]
time: {column: ms, unit: ms}
position_measured: {columns: [sh, lift], unit: [deg, mm], sign: [1, -1]}
velocity_estimated: {column: "v{i}", unit: [rpm, mm/s]}
torque_measured: {columns: [i_sh, f], unit: [mA, N], torque_constant: [11.0, 1.0], sign: [-1, 1]}
"""
    )
    log = read_log(path, tmp_path / "map.yaml")
    assert log.joints == ("shoulder", "lift") and not log.numbered
    np.testing.assert_allclose(log.position, q, rtol=1e-12)
    np.testing.assert_allclose(log.velocity, v, rtol=1e-12)
    np.testing.assert_allclose(log.torque, tau, rtol=1e-12)
    np.testing.assert_allclose(log.time, t, atol=1e-12)


def test_any_list_tells_how_many_joints_there_are(tmp_path: Path) -> None:
    """Columns by a pattern, a constant for each joint: the names were asked for, whatever the model calls them."""
    t, q, _, tau = motion(2)
    path = table(tmp_path / "own.csv", {"time": t, "q1": q[:, 0], "q2": q[:, 1], "i1": tau[:, 0], "i2": tau[:, 1] / 2})
    given = {"position_measured": {"column": "q{i}", "first": 1}}
    given |= {"torque_measured": {"column": "i{i}", "first": 1, "unit": "A", "torque_constant": [1.0, 2.0]}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(given))
    log = read_log(path, tmp_path / "map.yaml")
    assert log.numbered and len(log.joints) == 2
    np.testing.assert_allclose(log.torque, tau, rtol=1e-6)


def test_names_may_be_patterns_and_npz_may_be_foreign(tmp_path: Path) -> None:
    t, q, _, tau = motion(2)
    np.savez(tmp_path / "a.npz", time=t, **{f"{j}/q": q[:, k] for k, j in enumerate("ab")}, t5=tau[:, 0], t6=tau[:, 1])
    given = {"joints": ["a", "b"], "position_measured": {"column": "{joint}/q"}}
    given |= {"torque_commanded": {"column": "t{i}", "first": 5}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(given))
    log = read_log(tmp_path / "a.npz", tmp_path / "map.yaml")
    np.testing.assert_allclose(log.position, q)
    np.testing.assert_allclose(log.motor_torque, tau)
    assert log.torque is None
    write_log(log, tmp_path / "own.csv")
    assert isinstance(read_log(tmp_path / "own.csv"), Log)


@pytest.mark.parametrize("mark", [",", " "])
def test_the_line_of_names_may_be_a_comment(mark: str, tmp_path: Path) -> None:
    """As NumPy's `savetxt` writes a header."""
    t, q, _, tau = motion(2)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(GOOD))
    names = mark.join(["time", "q0", "q1", "t0", "t1"])
    np.savetxt(tmp_path / "a.csv", np.column_stack([t, q, tau]), delimiter=mark, header=names)
    log = read_log(tmp_path / "a.csv", tmp_path / "map.yaml")
    np.testing.assert_allclose(log.position, q)
    np.testing.assert_allclose(log.motor_torque, tau)


@pytest.mark.parametrize("mark", [",", ";", " "])
def test_comments_and_a_line_of_units_are_no_samples(mark: str, tmp_path: Path) -> None:
    """A map tells units itself; where the file says another one, nobody knows which is right."""
    t, q, _, tau = motion(2)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(GOOD))
    columns = {"time": t, "q0": q[:, 0], "q1": q[:, 1], "t0": tau[:, 0], "t1": list(tau[:, 1])}
    names, *rows = table(tmp_path / "a.csv", columns, mark).read_text().splitlines()
    units = mark.join(["s", "rad", "rad", "Nm", "Nm"])
    path = tmp_path / "b.csv"
    path.write_text("\n".join(["# q0 of today", names, units, *rows[:7], "# a note", *rows[7:], "# end"]))
    log = read_log(path, tmp_path / "map.yaml")
    np.testing.assert_allclose(log.position, q)
    np.testing.assert_allclose(log.motor_torque, tau)
    text = path.read_text()
    path.write_text(text.replace(rows[8], mark.join([*rows[8].split(mark)[:4], "oops"])))
    with pytest.raises(LogError, match="line 13: t1 is 'oops', not a number"):
        read_log(path, tmp_path / "map.yaml")
    path.write_text(text.replace("rad", "deg", 1))
    with pytest.raises(
        LogError, match=r"line 3: 'q0' is in 'deg', and .*map\.yaml reads it in 'rad': tell `unit: deg`"
    ):
        read_log(path, tmp_path / "map.yaml")


@pytest.mark.parametrize("mark", [";", "\t", " "])
def test_decimals_may_have_commas_where_cells_are_parted_by_something_else(mark: str, tmp_path: Path) -> None:
    """As a spreadsheet writes them in most of Europe."""
    t, q, _, tau = motion(2)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(GOOD))
    columns = {"time": t, "q0": q[:, 0], "q1": q[:, 1], "t0": tau[:, 0], "t1": tau[:, 1]}
    path = table(tmp_path / "a.csv", columns, mark)
    path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_allclose(read_log(path, tmp_path / "map.yaml").position, q)
    path.write_text(path.read_text().replace("q1", "angle"))
    with pytest.raises(LogError, match=r"no column 'q1', .* its columns are time, q0, angle, t0, t1"):
        read_log(path, tmp_path / "map.yaml")


@pytest.mark.parametrize("place", [0, 5])
def test_a_column_at_either_end_may_have_no_name(place: int, tmp_path: Path) -> None:
    """As pandas writes its index, parted by tabs, and loggers that end each line with one."""
    t, q, _, tau = motion(2)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(GOOD))
    columns = {"time": t, "q0": q[:, 0], "q1": q[:, 1], "t0": tau[:, 0], "t1": tau[:, 1]}
    path = table(tmp_path / "a.csv", columns, "\t")
    rows = [line.split("\t") for line in path.read_text().splitlines()]
    for number, row in enumerate(rows):
        row.insert(place, "" if number == 0 or place else f"{number}")
    path.write_text("".join("\t".join(row) + "\n" for row in rows))
    log = read_log(path, tmp_path / "map.yaml")
    np.testing.assert_allclose(log.position, q)
    np.testing.assert_allclose(log.motor_torque, tau)


def test_samples_that_lack_something_are_left_out_and_told(tmp_path: Path) -> None:
    """As recorders write signals of several rates: what came with another one is empty."""
    t, q, _, tau = motion(2)
    columns: dict[str, Any] = {"time": t, "q0": q[:, 0], "q1": q[:, 1], "t0": tau[:, 0], "t1": list(tau[:, 1])}
    for k, nothing in ((3, ""), (4, "null"), (9, "NaN")):
        columns["t1"][k] = nothing
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(GOOD))
    log = read_log(table(tmp_path / "a.csv", columns), tmp_path / "map.yaml")
    kept = np.delete(np.arange(SAMPLES), [3, 4, 9])
    np.testing.assert_allclose(log.position, q[kept])
    np.testing.assert_allclose(log.time, t[kept] - t[0], atol=1e-12)
    assert log.notes == (
        f"{tmp_path / 'a.csv'}: left out 3 of {SAMPLES} samples, which lack something, most often 't1', in 3",
    )
    columns["q0"] = [""] * SAMPLES
    with pytest.raises(LogError, match=f"each of {SAMPLES} samples lacks .* most often 'q0'"):
        read_log(table(tmp_path / "a.csv", columns), tmp_path / "map.yaml")
    columns["q0"] = [*q[:-1, 0], "inf"]
    with pytest.raises(LogError, match=f"line {SAMPLES + 1}: position_measured.a is inf"):
        read_log(table(tmp_path / "a.csv", columns), tmp_path / "map.yaml")


def test_currents_without_constants_wait_for_them(tmp_path: Path) -> None:
    """A preset of currents goes with `--torque-constants`, too."""
    t, q, _, tau = motion(2)
    columns = {"time": t, "q0": q[:, 0], "q1": q[:, 1], "t0": 1e3 * tau[:, 0] / 11.0, "t1": 1e3 * tau[:, 1] / 7.5}
    meaning = {**GOOD, "torque_measured": {"column": "t{i}", "unit": "mA"}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(meaning))
    log = read_log(table(tmp_path / "a.csv", columns), tmp_path / "map.yaml")
    with pytest.raises(LogError, match="holds currents; --torque-constants"):
        _ = log.motor_torque
    with pytest.raises(LogError, match="torque_measured: torque_constant: is missing"):
        parse({**meaning, "torque_commanded": {"column": "t{i}"}}, "map.yaml")
    np.testing.assert_allclose(TorqueConstants((11.0, 7.5)).applied(log, ["a", "b"]).motor_torque, tau)


GOOD: dict[str, Any] = {
    "joints": ["a", "b"],
    "position_measured": {"column": "q{i}"},
    "torque_measured": {"column": "t{i}"},
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"torque_measured": {"column": "i{i}", "unit": ["A", "N·m"]}}, "torque_constant: is missing"),
        ({"torque_measured": {"column": "i{i}", "unit": "A", "torque_constant": [1.0]}}, "has 1 entries"),
        ({"torque_measured": {"column": "i{i}", "unit": "A", "torque_constant": -2.0}}, "not positive"),
        ({"torque_measured": {"column": "i{i}", "torque_constant": 2.0}}, "goes with a current"),
        ({"torque_measured": {"column": "i{i}", "unit": "V"}}, "'V' is none of"),
        ({"position_measured": {"column": "q{i}", "unit": "A"}}, "'A' is none of"),
        ({"position_measured": {"column": "q{i}", "sign": 2}}, "neither 1 nor -1"),
        ({"position_measured": {"column": "q{i}", "sign": "x"}}, "'x' is not a number"),
        ({"position_measured": {"column": "q{i}", "sings": 1}}, "'sings' is no field"),
        ({"position_measured": {"column": "q"}}, "tell 2 joints apart"),
        ({"position_measured": {"column": "q{k}"}}, "tell 2 joints apart"),
        ({"position_measured": {"columns": ["q0"]}}, "there are 2 joints"),
        ({"position_measured": {"column": "q{i}", "columns": ["a", "b"]}}, "needs one of"),
        ({"position_measured": {"column": "q{i}", "first": True}}, "not a whole number"),
        ({"position_measured": "q"}, "is a mapping"),
        ({"time": {"column": "t", "unit": "h"}}, "'h' is none of"),
        ({"time": {"column": "t", "unit": ["ms"]}}, "['ms'] is none of"),
        ({"time": "t"}, "names a column"),
        ({"positions": {}}, "'positions' is no field"),
        ({"preset": "kuka"}, "'kuka' is none of"),
        ({"joints": ["a", "a"]}, "names one twice"),
        ({"joints": "a"}, "list of names"),
    ],
)
def test_what_cannot_be_is_refused_by_the_fields_name(change: dict[str, Any], said: str) -> None:
    with pytest.raises(LogError, match=r"map\.yaml") as caught:
        parse(GOOD | change, "map.yaml")
    assert said in str(caught.value)
    (field,) = change
    assert field in str(caught.value)


@pytest.mark.parametrize("missing", ["position_measured", "torque_measured", "joints"])
def test_what_a_log_needs_must_be_named(missing: str) -> None:
    with pytest.raises(LogError, match=missing):
        parse({key: value for key, value in GOOD.items() if key != missing}, "map.yaml")


def test_files_that_do_not_fit_are_refused_in_one_line(tmp_path: Path) -> None:
    t, q, v, tau = motion(7)
    path = libfranka(tmp_path / "franka.csv", t, q, v, tau)
    with pytest.raises(LogError, match="no such map of columns; the presets are libfranka"):
        read_log(path, "nothing.yaml")
    with pytest.raises(LogError, match="has none of the columns timestamp, actual_q_0"):
        read_log(path, "ur_rtde_torque")
    with pytest.raises(LogError, match="has no column 'field"):
        read_log(franka_ros(tmp_path / "r.csv", t, q, v, tau), _without(tmp_path))
    text = path.read_text().splitlines()
    path.write_text("\n".join([*text[:5], text[5] + ", 1", *text[6:]]))
    with pytest.raises(LogError, match="line 6 has 52 cell"):
        read_log(path, "libfranka")
    path.write_text("\n".join([*text[:5], text[5].replace(",", ", x", 2), *text[6:]]))
    with pytest.raises(LogError, match=r"line 6: state.q\[0\] is 'x"):
        read_log(path, "libfranka")
    path.write_text(text[0])
    with pytest.raises(LogError, match=r"holds 0 sample\(s\)"):
        read_log(path, "libfranka")
    with pytest.raises(LogError, match="bags and LCM logs name their signals"):
        (tmp_path / "a.mcap").write_bytes(b"")
        read_log(tmp_path / "a.mcap", "libfranka")
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(LogError, match="YAML mapping"):
        column_map(tmp_path / "list.yaml")


def _without(folder: Path) -> Path:
    path = folder / "more.yaml"
    path.write_text(yaml.safe_dump({"preset": "franka_ros", "position_commanded": {"column": "field.q_d{i}"}}))
    return path
