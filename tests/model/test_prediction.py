"""Predictions against truth made by another engine, against closed forms, and through files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.errors import LogError, ModelError
from twin_diagram.logs import Log, read_columns, read_log, write_log
from twin_diagram.logs.differentiation import inner, lowpass, motion
from twin_diagram.logs.measured_log import SIGNALS
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import (
    load_model_for,
    position_predicted,
    predict,
    rollout_rms,
    torque_predicted,
    torque_residual,
    torque_residual_rms,
)
from twin_diagram.model.rollout import rollout
from twin_diagram.scenario import ArmModel, EffectSpec
from twin_diagram.scenario.resources import models_dir

mujoco = pytest.importorskip("mujoco")

JOINTS = tuple(f"panda_joint{i + 1}" for i in range(7))
HOME = np.array([0.1, -0.4, 0.2, -1.9, 0.1, 1.6, 0.3])
ROTORS = np.array([0.6, 0.6, 0.46, 0.46, 0.2, 0.2, 0.2])
DAMPING = np.array([3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 0.5])
ARM = ArmModel(
    model="arms/panda.urdf",
    tool_frame="",
    effects=[
        EffectSpec("reflected_inertia", list(JOINTS), [], {"inertia": ROTORS.tolist()}),
        EffectSpec("viscous_friction", list(JOINTS), [], {"damping": DAMPING.tolist()}),
    ],
)


def reference(t: float) -> tuple[np.ndarray, np.ndarray]:
    k = np.arange(1, 8)
    amplitude, w = 0.35 - 0.02 * k, 1.5 + 0.5 * k
    return HOME + amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)


@pytest.fixture(scope="module")
def truth() -> Log:
    """A run of the arm in MuJoCo: PD control on top of feed-forward, logged at 500 Hz without noise."""
    model = mujoco.MjModel.from_xml_path(str(models_dir() / "arms" / "panda.urdf"))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.timestep = 2.5e-4
    model.dof_armature[:], model.dof_damping[:] = ROTORS, DAMPING
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = reference(0.0)
    rows: list[np.ndarray] = []
    before = np.zeros(7)
    feed = Model.load("arms/panda.urdf")
    for k in range(8 * 1500):
        q, v = reference(data.time)
        if k % 8 == 0:
            gravity = feed.bias(q, np.zeros(7))
        tau = gravity + 400.0 * (q - data.qpos) + 40.0 * (v - data.qvel)
        data.qfrc_applied[:] = tau
        if k % 8 == 0:
            # A torque held over a step acts half a step late; its mean with the one before is what acts now.
            rows.append(np.concatenate([[data.time], data.qpos, data.qvel, 0.5 * (tau + before) if rows else tau]))
        before = tau
        mujoco.mj_step(model, data)
    table = np.array(rows)
    return Log(table[:, 0], JOINTS, table[:, 1:8], velocity=table[:, 8:15], torque=table[:, 15:22])


MODEL = Model.load(ARM)
BARE = Model.load("arms/panda.urdf")


def test_torque_of_another_engines_motion(truth: Log) -> None:
    size = np.sqrt(np.mean(truth.motor_torque**2, axis=0))
    assert np.all(torque_residual_rms(MODEL, truth) < 2e-3 * size + 2e-3)
    without = replace(truth, velocity=None)
    assert np.all(torque_residual_rms(MODEL, without) < 2e-3 * size + 2e-3)
    assert np.all(torque_residual_rms(BARE, truth) > 0.3), "the effects matter"


@pytest.mark.long
def test_motion_of_another_engines_torque(truth: Log) -> None:
    after = rollout_rms(MODEL, truth, 0.2)
    before = rollout_rms(BARE, truth, 0.2)
    assert np.all(after < 1e-5)
    assert np.all(after < 0.01 * before)


def test_noise_passes_without_bias(truth: Log) -> None:
    rng = np.random.default_rng(0)
    count = 2.0 * np.pi / 2**18
    noisy = replace(
        truth,
        position=np.round(truth.position / count) * count,
        velocity=truth.velocity + rng.normal(scale=1e-3, size=truth.position.shape),
        torque=truth.motor_torque + rng.normal(scale=0.3, size=truth.position.shape),
    )
    # White noise of 0.3 N·m below 10 Hz of 250 Hz is 0.3 · sqrt(10/250) = 0.06 N·m.
    assert np.all(torque_residual_rms(MODEL, noisy) < 0.08)
    assert np.all(rollout_rms(MODEL, noisy) < 6e-3)


def test_lagging_velocity_is_left_out(truth: Log) -> None:
    assert truth.velocity is not None
    late = np.vstack([np.repeat(truth.velocity[:1], 5, axis=0), truth.velocity[:-5]])
    scaled = 1.03 * truth.velocity
    for velocity in (late, scaled):
        assert np.all(torque_residual_rms(MODEL, replace(truth, velocity=velocity)) < 0.05)


def test_rollouts_to_some_samples_alone_tell_of_those_between(truth: Log) -> None:
    short = truth.between(0.0, 2.0)
    every, some = position_predicted(MODEL, short), position_predicted(MODEL, short, every=4)
    away, apart = np.std(every - short.position), np.std(some - every)
    assert apart < 0.1 * away + 1e-5


def test_each_position_is_rolled_out_from_its_own_past(truth: Log) -> None:
    """The samples before the horizon start at the log's begin; a wrong torque later does not reach earlier samples."""
    short = truth.between(0.0, 1.0)
    predicted = position_predicted(MODEL, short, 0.2)
    np.testing.assert_array_equal(predicted[0], short.position[0])
    assert np.max(np.abs(predicted - short.position)) < 2e-3
    wrong = short.motor_torque.copy()
    wrong[300:] += 5.0
    touched = np.abs(position_predicted(MODEL, replace(short, torque=wrong), 0.2) - predicted).max(axis=1) > 1e-12
    assert np.array_equal(np.flatnonzero(touched), np.arange(300, len(short)))
    # A rollout of one sample is one integration step from it.
    one = position_predicted(MODEL, short, short.period)
    assert np.max(np.abs(one - short.position)[60:-60]) < 1e-6


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_torques_that_no_arm_could_answer_end_in_no_words_of_numpy(truth: Log) -> None:
    """A joint whose drive logs another unit: 20 lines of `overflow encountered in matmul` stood on the terminal."""
    log = truth.between(0.0, 1.0)
    assert log.torque is not None
    wild = replace(log, torque=log.torque * np.where(np.arange(7) == 1, 1e9, 1.0))
    model = Model.load(ARM)
    assert position_predicted(model, wild).shape == log.position.shape
    assert rollout_rms(model, wild)[1] > 1e3 or not np.isfinite(rollout_rms(model, wild)[1])


def test_irregular_times(truth: Log) -> None:
    rng = np.random.default_rng(1)
    kept = np.sort(rng.choice(len(truth), size=int(0.8 * len(truth)), replace=False))
    ragged = Log(
        truth.time[kept], JOINTS, truth.position[kept], velocity=truth.velocity[kept], torque=truth.torque[kept]
    )
    assert torque_predicted(MODEL, ragged).shape == ragged.position.shape
    assert np.all(torque_residual_rms(MODEL, ragged) < 0.05)
    assert np.all(rollout_rms(MODEL, ragged) < 1e-4)


def sliding_joint(level: float, inertia: float, *, damping: float = 0.0) -> Model:
    """One joint about the vertical with dry friction; the other six of the arm are held by enough of it."""
    torque = [level] + [1e3] * 6
    effects = [EffectSpec("coulomb_friction", list(JOINTS), [], {"torque": torque})]
    effects.append(EffectSpec("viscous_friction", [JOINTS[0]], [], {"damping": [damping]}))
    plain = Model.load("arms/panda.urdf")
    added = inertia - plain.mass_matrix(HOME)[0, 0]
    effects.append(EffectSpec("reflected_inertia", [JOINTS[0]], [], {"inertia": [added]}))
    return Model.load(ArmModel(model="arms/panda.urdf", tool_frame="", effects=effects))


@pytest.mark.long
@pytest.mark.parametrize("period", [pytest.param(0.001, marks=pytest.mark.slow), 0.004, 0.02])
def test_dry_friction_stops_and_holds(period: float) -> None:
    """A joint sent off at v0 stops after v0² I / 2F, and stays there under any torque below the level."""
    level, inertia, v0 = 6.0, 3.0, 0.8
    model = sliding_joint(level, inertia)
    steps = round(1.0 / period)
    v = np.zeros((2, 7))
    v[0, 0] = v0
    tau = np.tile(model.with_effects([]).bias(HOME, np.zeros(7)), (steps + 1, 2, 1))
    tau[:, 1, 0] = 0.999 * level
    end = rollout(model, np.tile(HOME, (2, 1)), v, tau, period)
    travelled = end - HOME
    assert travelled[0, 0] == pytest.approx(v0**2 * inertia / (2.0 * level), rel=0.01)
    np.testing.assert_allclose(travelled[1], 0.0, atol=1e-9)
    np.testing.assert_allclose(travelled[0, 1:], 0.0, atol=1e-6)
    tau[:, 1, 0] = 1.5 * level
    end = rollout(model, np.tile(HOME, (2, 1)), 0.0 * v, tau, period)
    assert end[1, 0] - HOME[0] == pytest.approx(0.5 * 0.5 * level / inertia, rel=0.01)


def test_light_and_damped_joint_is_stable() -> None:
    """A damper that would blow an explicit step up: the joint follows τ/D."""
    model = sliding_joint(0.0, 1.5, damping=5e3)
    tau = np.tile(model.with_effects([]).bias(HOME, np.zeros(7)), (51, 1, 1))
    tau[:, :, 0] = 100.0
    end = rollout(model, HOME[None], np.zeros((1, 7)), tau, 0.004)
    assert end[0, 0] - HOME[0] == pytest.approx(100.0 / 5e3 * 0.2, rel=0.02)


def test_bias_and_spring_reach_the_rollout(truth: Log) -> None:
    """Every effect of a model counts in both predictions alike: truth under it is explained by it alone."""
    spec = [
        EffectSpec("torque_bias", [JOINTS[1]], [], {"torque": [3.0]}),
        EffectSpec("joint_spring", [JOINTS[3]], [], {"stiffness": [40.0], "rest_angle": [-1.5]}),
        EffectSpec("payload", [], [], {"mass": [0.8], "com": [0.0, 0.0, 0.1]}),
        EffectSpec("gravity_tilt", [], [], {"roll": [0.02], "pitch": [0.01]}),
    ]
    model = Model.load(replace(ARM, effects=[*ARM.effects, *spec]))
    smooth = motion(truth)
    tau = model.inverse_dynamics(smooth.position, smooth.velocity, smooth.acceleration)
    log = replace(truth, torque=tau)
    assert np.all(torque_residual_rms(model, log) < 1e-2)
    assert np.all(rollout_rms(model, log) < 1e-4)
    assert torque_residual_rms(MODEL, log)[1] > 2.0


def test_lowpass_is_the_contracts() -> None:
    """Zero phase; 4th order forward and backward: half the amplitude at the cutoff; a constant passes."""
    rate = 500.0
    time = np.arange(4000) / rate
    for frequency, gain in ((1.0, 1.0), (10.0, 0.5), (40.0, 0.0)):
        wave = np.sin(2.0 * np.pi * frequency * time)
        out = lowpass(wave[:, None], rate)[:, 0]
        part = inner(time)
        assert np.dot(out[part], wave[part]) / np.dot(wave[part], wave[part]) == pytest.approx(gain, abs=4e-3)
    np.testing.assert_allclose(lowpass(np.full((300, 2), 7.0), rate), 7.0)
    slow = np.random.default_rng(0).normal(size=(50, 1))
    np.testing.assert_array_equal(lowpass(slow, 20.0), slow)
    assert inner(np.arange(11) * 0.1).tolist() == [False] * 3 + [True] * 5 + [False] * 3


def test_files(tmp_path: Path, truth: Log) -> None:
    short = truth.between(0.0, 1.0)
    order = [3, 0, 1, 2, 6, 5, 4]
    shuffled = short.select([JOINTS[k] for k in order])
    write_log(shuffled, tmp_path / "log.csv")
    MODEL.save(tmp_path / "corrected")
    assert predict(tmp_path / "corrected", tmp_path / "log.csv", tmp_path / "out" / "p.csv") == []
    columns = read_columns(tmp_path / "out" / "p.csv")
    expected = [f"{s}_predicted.{joint}" for s in ("torque", "position") for joint in JOINTS]
    assert list(columns) == ["time", *expected]
    np.testing.assert_array_equal(columns["time"], short.time)
    for k, joint in enumerate(JOINTS):
        expected_torque = torque_predicted(MODEL, short)[:, k]
        np.testing.assert_allclose(columns[f"torque_predicted.{joint}"], expected_torque, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(columns[f"position_predicted.{joint}"], short.position[:, k], atol=2e-3)
    predict(tmp_path / "corrected", tmp_path / "log.csv", tmp_path / "p.npz")
    with np.load(tmp_path / "p.npz") as archive:
        assert set(archive.files) == set(columns)
        for name in columns:
            np.testing.assert_array_equal(archive[name], columns[name])


def test_of_a_log_that_is_all_ends_no_misfit_is_told(tmp_path: Path, truth: Log) -> None:
    write_log(truth.between(0.0, 0.5), tmp_path / "log.csv")
    said: list[str] = []
    predict("arms/panda.urdf", tmp_path / "log.csv", tmp_path / "p.csv", say=said.append)
    assert len(said) == 1 and "too short" in said[0]


@pytest.mark.long
def test_what_nobody_logged_is_no_misfit(tmp_path: Path, truth: Log) -> None:
    """A spline through half a second of silence was told as ten times the misfit that there is."""
    said: dict[str, list[str]] = {"whole": [], "parted": []}
    silent = (truth.time > 0.4) & (truth.time < 0.9)
    cut = {name: values[~silent] for name in SIGNALS.values() if (values := getattr(truth, name)) is not None}
    logs = {"whole": truth.between(0.9, 10.0), "parted": replace(truth, time=truth.time[~silent], **cut)}
    for name, log in logs.items():
        write_log(log, tmp_path / "log.csv")
        predict("arms/panda.urdf", tmp_path / "log.csv", tmp_path / f"{name}.csv", say=said[name].append)
    assert said["parted"][0].endswith("the longest stretch without a gap:")
    assert said["parted"][1:] == said["whole"]
    written = {name: read_columns(tmp_path / f"{name}.csv") for name in logs}
    del written["whole"]["time"]
    for name in written["whole"]:  # after the silence, as if nothing had been before
        after = written["parted"][name][written["parted"]["time"] >= logs["whole"].time[0]]
        np.testing.assert_allclose(after, written["whole"][name], atol=5e-3)  # it was 0.2


def test_bad_input_leaves_nothing_behind(tmp_path: Path, truth: Log) -> None:
    write_log(truth.between(0.0, 1.0).select(JOINTS[:6]), tmp_path / "log.csv")
    out = tmp_path / "p.csv"
    with pytest.raises(LogError, match="'panda_joint7' of the model is missing"):
        predict("arms/panda.urdf", tmp_path / "log.csv", out)
    with pytest.raises(ModelError, match="no such file"):
        predict("arms/none.urdf", tmp_path / "log.csv", out)
    write_log(truth.between(0.0, 1.0), tmp_path / "log.csv")
    for horizon in (0.0, -1.0, 5.0, float("nan")):
        with pytest.raises(LogError, match="horizon"):
            predict("arms/panda.urdf", tmp_path / "log.csv", out, horizon)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv"]


def test_positions_are_predicted_in_the_turn_that_the_log_tells(truth: Log, tmp_path: Path) -> None:
    short = truth.between(0.0, 1.0)
    high = np.pi - short.position[len(short) // 2]  # crosses half a turn at mid-run
    wrapped = (short.position + high + np.pi) % (2.0 * np.pi) - np.pi
    assert np.any(np.abs(np.diff(wrapped, axis=0)) > 6.0)
    write_log(replace(short, position=wrapped), tmp_path / "log.csv")
    predict("arms/panda.urdf", tmp_path / "log.csv", tmp_path / "out.csv", 0.02)
    columns = read_columns(tmp_path / "out.csv")
    predicted = np.stack([columns[f"position_predicted.{joint}"] for joint in JOINTS], axis=1)
    near = np.abs(predicted - wrapped)[20:]
    assert np.median(near) < 0.05 and np.mean(near > 6.0) < 0.01  # but for samples at which it jumps itself


def test_joints_of_model_and_log_meet(truth: Log) -> None:
    """A log that holds the fingers brings them in; one that does not leaves them rigid."""
    short = truth.between(0.0, 0.5)
    model, log, warnings = load_model_for(short, "arms/panda_hand.urdf")
    hangs_on = model.last_link
    assert (model.joints, log.joints, warnings) == (JOINTS, JOINTS, [])
    fingers = ("panda_finger_joint1", "panda_finger_joint2")
    both = Log(
        short.time,
        (*fingers, *JOINTS),
        np.hstack([np.full((len(short), 2), 0.02), short.position]),
        torque=np.hstack([np.full((len(short), 2), 0.1), short.motor_torque]),
    )
    model, log, warnings = load_model_for(both, "arms/panda_hand.urdf")
    assert set(model.joints) == {*JOINTS, *fingers} and model.last_link == hangs_on == "panda_link7"
    assert log.joints == model.joints
    assert torque_residual(model, log).shape[1] == 9
    assert warnings == []


def test_ten_measured_seconds_are_predicted_twice_alike(data_dir: Path) -> None:
    log = read_log(data_dir / "kuka_kr300" / "trajectory_A.csv")
    model = Model.load(scenario.ArmModel(model=str(data_dir / "kuka_kr300" / "kr300.urdf"), tool_frame=""))
    first = position_predicted(model, log)
    np.testing.assert_array_equal(first, position_predicted(model, log))
