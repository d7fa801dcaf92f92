"""Logs that arms' own software writes: ROS bags by `rosbags`, LCM logs by Drake; each is read back as what went in."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drake import lcmt_iiwa_status, lcmt_panda_status
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.lcm import DrakeLcm

from twin_diagram.cli import main
from twin_diagram.errors import LogError
from twin_diagram.logs import Log, check, read_log, write_log
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import load_model_for

PANDA = "arms/panda.urdf"
MODEL = Model.load(PANDA)
MIDDLE = 0.5 * (MODEL.lower + MODEL.upper)
BEGIN = 1_700_000_000_000_000_000
"""When it was recorded [ns since 1970]."""


def healthy(count: int = 600, rate: float = 200.0) -> Log:
    """What the model itself needs for a smooth motion."""
    time = np.arange(count) / rate
    k = np.arange(1, 8)
    phase = np.outer(time, 1.0 + 0.3 * k)
    position = MIDDLE + 0.3 * np.sin(phase)
    velocity = 0.3 * (1.0 + 0.3 * k) * np.cos(phase)
    acceleration = -0.3 * (1.0 + 0.3 * k) ** 2 * np.sin(phase)
    torque = MODEL.inverse_dynamics(position, velocity, acceleration)
    return Log(time, MODEL.joints, position, velocity=velocity, torque=torque, position_commanded=position)


HEALTHY = healthy()


# ROS bags.


@dataclass
class State:
    """One joint state; an empty signal is not given."""

    names: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]
    stamp: int
    topic: str = "/joint_states"


def write_bag(path: Path, states: Sequence[State], received: Callable[[int], int] | None = None) -> Path:
    """A bag: `x.mcap` alone, or a folder with its index, as `ros2 bag record` leaves it."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    header, time, message = (
        kinds[f"{package}/msg/{name}"]
        for package, name in (("std_msgs", "Header"), ("builtin_interfaces", "Time"), ("sensor_msgs", "JointState"))
    )
    plugin = rosbag2.StoragePlugin.SQLITE3 if path.suffix == ".db3" else rosbag2.StoragePlugin.MCAP
    folder = path.with_suffix("") if path.suffix else path
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        topics: dict[str, Any] = {}
        for k, state in enumerate(states):
            if state.topic not in topics:
                topics[state.topic] = writer.add_connection(state.topic, "sensor_msgs/msg/JointState", typestore=store)
            stamp = time(sec=state.stamp // 10**9, nanosec=state.stamp % 10**9)
            values = [np.array(x, dtype=float) for x in (state.position, state.velocity, state.effort)]
            raw = store.serialize_cdr(
                message(header(stamp, ""), list(state.names), *values), "sensor_msgs/msg/JointState"
            )
            writer.write(topics[state.topic], received(k) if received else state.stamp, raw)
    if path.suffix:
        next(folder.glob(f"*{path.suffix}")).rename(path)
    return path


def states_of(log: Log, order: Sequence[int] | None = None, late: int = 0, topic: str = "/joint_states") -> list[State]:
    """A log's messages, joints in another order, stamps late [ns]."""
    order = list(range(len(log.joints))) if order is None else list(order)
    assert log.velocity is not None and log.torque is not None
    stamps = BEGIN + late + np.round(log.time * 1e9).astype(np.int64)
    names = [log.joints[k] for k in order]
    return [
        State(names, log.position[i, order], log.velocity[i, order], log.torque[i, order], int(stamps[i]), topic)  # type: ignore[arg-type]
        for i in range(len(log))
    ]


def same(found: Log, wanted: Log) -> None:
    """All that a joint state can hold."""
    assert found.joints == wanted.joints
    assert np.allclose(found.time, wanted.time - wanted.time[0], rtol=0, atol=1e-9)
    for name in ("position", "velocity", "torque"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name)), name


@pytest.mark.parametrize("name", ["run.mcap", "run.db3", "run"])
def test_a_bag_holds_what_went_in(tmp_path: Path, name: str) -> None:
    found = read_log(write_bag(tmp_path / name, states_of(HEALTHY)))
    same(found, HEALTHY)
    assert found.time[0] == 0.0
    assert check(found, MODEL.limits) == []


def test_joints_may_change_their_order_and_messages_overtake_each_other(tmp_path: Path) -> None:
    states = states_of(HEALTHY)
    other = states_of(HEALTHY, [6, 5, 4, 3, 2, 1, 0])
    mixed = [b if i % 3 else a for i, (a, b) in enumerate(zip(states, other, strict=True))]
    mixed[10], mixed[11] = mixed[11], mixed[10]
    mixed.insert(20, mixed[19])  # said twice
    same(read_log(write_bag(tmp_path / "x.mcap", mixed)), HEALTHY)


def test_a_gripper_that_shares_the_topic(tmp_path: Path) -> None:
    """Its joints are brought to the arm's times where they have an effort, and left out where they have none."""
    fingers = [State(["finger"], [0.01 * k], [0.2], [1.0 + k], BEGIN + 2_500_000 + 50_000_000 * k) for k in range(58)]
    states = sorted([*states_of(HEALTHY), *fingers], key=lambda state: state.stamp)
    found = read_log(write_bag(tmp_path / "a.mcap", states))
    assert found.joints == (*HEALTHY.joints, "finger")
    inside = (HEALTHY.time >= 0.0025) & (HEALTHY.time <= 0.0025 + 0.05 * 57)
    assert np.array_equal(found.position[:, :7], HEALTHY.position[inside])
    assert found.position[:, 7] == pytest.approx(0.2 * (HEALTHY.time[inside] - 0.0025), abs=1e-9)
    assert [w.code for w in check(found, MODEL.limits)] == ["unknown_joint"]

    elsewhere = [replace(state, stamp=state.stamp + 10**11) for state in fingers]
    found = read_log(write_bag(tmp_path / "c.mcap", [*states_of(HEALTHY), *elsewhere]))
    same(found, HEALTHY)
    assert [w.code for w in check(found, MODEL.limits)] == ["left_out"] and "other times" in found.notes[0]

    idle = [State(s.names, s.position, s.velocity, [0.0], s.stamp) for s in fingers]
    states = sorted([*states_of(HEALTHY), *idle], key=lambda state: state.stamp)
    found = read_log(write_bag(tmp_path / "b.mcap", states))
    same(found, HEALTHY)
    assert [(w.code, "finger" in w.message) for w in check(found, MODEL.limits)] == [("left_out", True)]


def test_a_gripper_without_velocity_leaves_the_arm_its_own(tmp_path: Path) -> None:
    """Its driver says NaN for one, or nothing; both took those of the arm."""
    named = [
        State([*s.names, "finger"], [*s.position, 0.01], [*s.velocity, np.nan], [*s.effort, 1.0 + k], s.stamp)
        for k, s in enumerate(states_of(HEALTHY))
    ]
    found = read_log(write_bag(tmp_path / "one.mcap", named))
    assert found.lacking("velocity_estimated") == ("finger",)
    same(found.select(HEALTHY.joints), HEALTHY)

    fingers = [State(["finger"], [0.01 * k], [], [1.0 + k], BEGIN + 50_000_000 * k) for k in range(60)]
    states = sorted([*states_of(HEALTHY), *fingers], key=lambda state: state.stamp)
    found = read_log(write_bag(tmp_path / "own.mcap", states))
    assert found.joints == (*HEALTHY.joints, "finger") and HEALTHY.velocity is not None
    own = found.select(HEALTHY.joints).velocity
    assert own is not None and np.array_equal(own, HEALTHY.velocity[: len(own)])
    assert [w.code for w in check(found, MODEL.limits)] == ["unknown_joint"]


def test_stamps_that_are_not_set_give_way_to_the_times_of_arrival(tmp_path: Path) -> None:
    states = states_of(HEALTHY)
    stamps = [state.stamp for state in states]
    for state in states:
        state.stamp = 0
    same(read_log(write_bag(tmp_path / "x.mcap", states, lambda k: stamps[k])), HEALTHY)


def test_first_messages_without_a_stamp_are_left_out(tmp_path: Path) -> None:
    """Beside stamps since 1970 a stamp of zero is none; it counts where a simulation's clock begins."""
    states = states_of(HEALTHY)
    begun = [replace(state, stamp=0) for state in states[:3]] + states[3:]
    found = read_log(write_bag(tmp_path / "a.mcap", begun))
    assert len(found) == len(HEALTHY) - 3
    np.testing.assert_allclose(found.position, HEALTHY.position[3:])
    np.testing.assert_allclose(found.time, HEALTHY.time[3:] - HEALTHY.time[3], atol=1e-9)
    simulated = [replace(state, stamp=state.stamp - BEGIN) for state in states]
    same(read_log(write_bag(tmp_path / "b.mcap", simulated)), HEALTHY)


def test_a_topic_is_named_where_there_are_several(tmp_path: Path) -> None:
    left, right = (states_of(HEALTHY, topic=f"/{side}/joint_states") for side in ("left", "right"))
    path = write_bag(tmp_path / "two.mcap", [*left, *right])
    with pytest.raises(LogError, match=r"/left/joint_states, /right/joint_states; name one, as two\.mcap#/left"):
        read_log(path)
    same(read_log(f"{path}#/left/joint_states"), HEALTHY)
    with pytest.raises(LogError, match="no joint states on '/up'"):
        read_log(f"{path}#/up")


def test_bags_that_are_no_logs(tmp_path: Path) -> None:
    states = states_of(HEALTHY)

    def fails(name: str, changed: list[State], match: str) -> None:
        with pytest.raises(LogError, match=match) as error:
            read_log(write_bag(tmp_path / f"{name}.mcap", changed, lambda k: BEGIN + k))
        assert "\n" not in str(error.value)

    fails("none", [State(s.names, s.position, s.velocity, [], s.stamp) for s in states], "no effort")
    again = [State(s.names, s.position, s.velocity, s.effort, s.stamp) for s in states]
    fails("twice", [*states, *again], r"goes back by 2\.995 s; it looks like several runs")
    fails("short", states[:4], r"holds 4 sample\(s\)")
    fails("odd", [State(states[0].names, [1.0], [], [], BEGIN)], "7 names but 1 of position")
    fails("twins", [State(["a", "a"], [1.0, 1.0], [], [1.0, 1.0], BEGIN)], "names a joint twice")
    holes = [State(s.names, s.position, s.velocity, [np.nan, *s.effort[1:]], s.stamp) for s in states]
    found = read_log(write_bag(tmp_path / "holes.mcap", holes))
    assert found.joints == HEALTHY.joints[1:]
    with pytest.raises(LogError, match=r"joint 'panda_joint1' of the model is missing.*\(left out panda_joint1"):
        check(found, MODEL.limits)
    for name in ("a.mcap", "b.db3", "c.bag"):
        (tmp_path / name).write_bytes(b"no bag at all")
        with pytest.raises(LogError, match="cannot be read as a ROS bag"):
            read_log(tmp_path / name)
    with pytest.raises(LogError, match="no such log file"):
        read_log(tmp_path / "absent.mcap")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="is a folder, and no ROS 2 bag"):
        read_log(tmp_path / "empty")


def test_without_rosbags_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.mcap").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(LogError, match=r"pip install 'twin-diagram\[ros\]'"):
        read_log(tmp_path / "x.mcap")


# LCM logs.


def panda(log: Log, k: int) -> lcmt_panda_status:
    assert log.velocity is not None and log.torque is not None and log.position_commanded is not None
    message = lcmt_panda_status()
    message.utime = BEGIN // 1000 + round(log.time[k] * 1e6)
    message.num_joints = len(log.joints)
    zeros = [0.0] * len(log.joints)
    for name in message.__slots__:
        if name.startswith("joint_"):
            setattr(message, name, zeros)
    message.joint_position = log.position[k].tolist()
    message.joint_position_desired = log.position_commanded[k].tolist()
    message.joint_velocity = log.velocity[k].tolist()
    message.joint_torque = log.torque[k].tolist()
    return message


def iiwa(log: Log, k: int) -> lcmt_iiwa_status:
    """Torques as FRI counts them: against the joint."""
    assert log.velocity is not None and log.torque is not None and log.position_commanded is not None
    message = lcmt_iiwa_status()
    message.utime = BEGIN // 1000 + round(log.time[k] * 1e6)
    message.num_joints = len(log.joints)
    message.joint_position_measured = log.position[k].tolist()
    message.joint_velocity_estimated = log.velocity[k].tolist()
    message.joint_position_commanded = log.position_commanded[k].tolist()
    message.joint_torque_measured = (-log.torque[k]).tolist()
    for name in ("joint_position_ipo", "joint_torque_commanded", "joint_torque_external"):
        setattr(message, name, [0.0] * len(log.joints))
    return message


def write_lcm(path: Path, messages: Sequence[tuple[str, bytes]]) -> Path:
    """By LCM itself, as Drake carries it along."""
    bus = DrakeLcm(f"file://{path}?mode=w")
    for k, (channel, message) in enumerate(messages):
        bus.Publish(channel, message, time_sec=0.001 * k)
    del bus
    return path


def status(log: Log, make: Callable[[Log, int], Any], channel: str) -> list[tuple[str, bytes]]:
    return [(channel, make(log, k).encode()) for k in range(len(log))]


@pytest.mark.parametrize(("make", "channel"), [(panda, "PANDA_STATUS"), (iiwa, "IIWA_STATUS")])
def test_an_lcm_log_holds_what_went_in(tmp_path: Path, make: Callable[[Log, int], Any], channel: str) -> None:
    messages = status(HEALTHY, make, channel)
    messages.insert(5, ("SOMETHING_ELSE", b"\x00" * 40))
    messages.insert(0, (channel, lcmt_panda_status().encode()))  # the arm is not there yet
    found = read_log(write_lcm(tmp_path / "lcmlog-2026-01-01.00", messages))
    assert found.numbered
    model, log, [warning] = load_model_for(found, PANDA)
    assert warning.code == "torque_side" and "--torque-side link" in warning.message
    assert load_model_for(found, PANDA, torque_side="link")[2] == []
    same(log, HEALTHY)
    assert log.position_commanded is not None
    assert np.array_equal(log.position_commanded, HEALTHY.position)
    assert model.joints == log.joints
    assert not log.numbered


def test_an_lcm_log_of_another_arm_or_of_two(tmp_path: Path) -> None:
    two = [*status(HEALTHY, panda, "LEFT"), *status(HEALTHY, panda, "RIGHT")]
    path = write_lcm(tmp_path / "two.lcm", two)
    with pytest.raises(LogError, match=r"several arms: LEFT, RIGHT; name one, as two\.lcm#LEFT"):
        read_log(path)
    same(read_log(f"{path}#RIGHT").select(HEALTHY.joints), HEALTHY)
    with pytest.raises(LogError, match="no arm's status on channel 'UP'; its channels are LEFT, RIGHT"):
        read_log(f"{path}#UP")
    six = HEALTHY.select(HEALTHY.joints[:6])
    found = read_log(write_lcm(tmp_path / "six.lcm", status(six, panda, "PANDA_STATUS")))
    with pytest.raises(LogError, match="tells of 6 joints without naming them; the model's arm has 7"):
        check(found, MODEL.limits)
    changed = [*status(HEALTHY, panda, "A"), *status(six, panda, "A")]
    with pytest.raises(LogError, match="event 600 on A: tells of"):
        read_log(write_lcm(tmp_path / "changed.lcm", changed))
    with pytest.raises(LogError, match="holds no arm's status"):
        read_log(write_lcm(tmp_path / "other.lcm", [("X", b"hello")]))
    again = [*status(HEALTHY, panda, "A"), *status(HEALTHY, panda, "A")]
    with pytest.raises(LogError, match="several runs"):
        read_log(write_lcm(tmp_path / "again.lcm", again))


def test_a_log_that_was_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    path = write_lcm(tmp_path / "x.lcm", status(HEALTHY, panda, "PANDA_STATUS"))
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    assert len(read_log(path)) == len(HEALTHY) - 1
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + b"?" + whole[middle:])
    with pytest.raises(LogError, match="damaged"):
        read_log(path)
    path.write_bytes(b"hello")
    with pytest.raises(LogError, match="does not begin as LCM logs do"):
        read_log(path)


@settings(max_examples=60)
@given(st.binary(max_size=120))
def test_noise_never_crashes_the_readers(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    folder = tmp_path_factory.mktemp("noise")
    header = struct.pack(">4sqqII", b"\xed\xa1\xda\x01", 0, 0, 1, 20)
    for name, content in (("x.lcm", noise), ("y.lcm", header + noise), ("x.mcap", b"\x89MCAP0\r\n" + noise)):
        (folder / name).write_bytes(content)
        with pytest.raises(LogError) as error:
            read_log(folder / name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["mcap", "lcm"])
def test_predict_takes_them(tmp_path: Path, kind: str) -> None:
    """The command sees no difference between a log and its CSV file."""
    if kind == "mcap":
        path = write_bag(tmp_path / "x.mcap", states_of(HEALTHY))
    else:
        path = write_lcm(tmp_path / "x.lcm", status(HEALTHY, panda, "PANDA_STATUS"))
    write_log(HEALTHY, tmp_path / "x.csv")
    for name in (path.name, "x.csv"):
        out = str(tmp_path / f"{name}.npz")
        assert main(["predict", "--model", PANDA, "--log", str(tmp_path / name), "--out", out]) == 0
    with np.load(tmp_path / f"{path.name}.npz") as a, np.load(tmp_path / "x.csv.npz") as b:
        assert a.files == b.files
        for name in a.files:
            assert a[name] == pytest.approx(b[name], abs=1e-6), name
