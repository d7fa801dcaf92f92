"""Fusing wrist wrench and IMU: their laws against point masses, and a payload that the filter is honest about."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.estimation_bench import HOME, JOINTS, twin_terms
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws, skew
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.disturbance import creep_std
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.fault_isolation import alarming, keep_score
from twin_diagram.estimation.sensors import Instant, LinkImu, WristWrench
from twin_diagram.estimation.sensors.wrist_wrench import point_moment
from twin_diagram.scenario import Filter, SensorSpec

SIMS = Path(__file__).resolve().parents[3] / "sims" / "benchmarks"
if str(SIMS) not in sys.path:
    sys.path.insert(0, str(SIMS))


@functools.cache
def terms() -> ArmTerms:
    return twin_terms()


def wrench() -> WristWrench:
    sensor = WristWrench(terms(), "panda_link7")
    sensor.declare(slice(25, 31), slice(21, 25))
    return sensor


def instant(seed: int, **more: np.ndarray) -> Instant:
    rng = np.random.default_rng(seed)
    x = np.concatenate([HOME + rng.normal(0, 0.3, 7), rng.normal(0, 1.5, 7), np.zeros(7), [1.4, 0.1, -0.05, 0.3]])
    return Instant(np.concatenate([x, np.zeros(6)]), 7, 4, rng.normal(0, 4.0, 7), **more)


@pytest.mark.parametrize("seed", range(3))
def test_wrench_of_a_point_mass_in_motion(seed: int) -> None:
    """Mass times the acceleration of the very point, at its lever: the frame's own way to accelerate is another."""
    from pydrake.math import RigidTransform

    now = instant(seed)
    mass, centre = now.x[21], now.x[22:25] / now.x[21]
    there = LinkFrame(terms(), "panda_link7", RigidTransform(centre)).motion(now.q, now.v)
    here = LinkFrame(terms(), "panda_link7").motion(now.q, now.v)
    force = mass * (there.J_v @ now.acceleration + there.bias_a + [0.0, 0.0, 9.81])
    expected = np.concatenate([np.cross(there.p_WF - here.p_WF, force), force])
    reading = wrench().linear(now).reading
    np.testing.assert_allclose(here.R_WF @ reading[3:], expected[3:], atol=1e-9)
    np.testing.assert_allclose(here.R_WF @ reading[:3], expected[:3], atol=1e-9)


def test_moment_of_turning_is_differentiated_exactly() -> None:
    rng = np.random.default_rng(2)
    load = np.array([1.2, 0.1, -0.2, 0.3])
    turning = skew(rng.normal(size=3)) + skew(rng.normal(size=3)) @ skew(rng.normal(size=3))
    _, by = point_moment(load, turning)
    for i in range(4):
        step = np.eye(4)[i] * 1e-6
        slope = (point_moment(load + step, turning)[0] - point_moment(load - step, turning)[0]) / 2e-6
        np.testing.assert_allclose(by[:, i], slope, atol=1e-8)


def test_unknown_load_times_unknown_acceleration() -> None:
    """The reading's mean and spread against many draws: a product of two unknowns is no linear matter."""
    rng = np.random.default_rng(3)
    root = np.zeros((31, 31))
    root[14:25, 14:25] = rng.normal(size=(11, 11)) * np.r_[np.full(7, 1.0), 0.3, 0.3, 0.3, 0.3][:, None]
    P, by = root @ root.T, np.zeros((7, 31))
    by[:, 14:21] = rng.normal(size=(7, 7)) * 0.3
    base = instant(4)
    x = base.x.copy()
    x[7:14] = 0.0
    sensor = wrench()
    now = Instant(x, 7, 4, base.acceleration, by, np.zeros((7, 7)), P)
    linear = sensor.linear(now)
    drawn = rng.normal(size=(8000, 31)) @ root.T
    readings = np.empty((len(drawn), 3))
    for k, d in enumerate(drawn):
        readings[k] = sensor.linear(Instant(x + d, 7, 4, base.acceleration + by @ d)).reading[3:]
    found = (linear.jacobian @ P @ linear.jacobian.T + linear.noise)[3:, 3:]
    spread = np.cov(readings.T)
    np.testing.assert_allclose(readings.mean(axis=0), linear.reading[3:], atol=0.06 * np.sqrt(spread.diagonal().max()))
    np.testing.assert_allclose(found, spread, atol=0.08 * spread.diagonal().max())
    alone = linear.jacobian @ P @ linear.jacobian.T
    assert np.trace(spread) > 1.1 * np.trace(alone[3:, 3:])  # the first order alone would be too sure


def test_first_reading_of_a_start_teaches_no_load() -> None:
    """How the arm accelerates is not known before a step was made."""
    ekf = Ekf(terms(), Filter(parameters=["payload"]))
    ekf.add(WristWrench(terms(), "panda_link7"))
    ekf.start(HOME, np.zeros(7), terms().inverse_dynamics(HOME, np.zeros(7), 0.0), 0.0)
    before = ekf.belief.P[21, 21]
    ekf.update("wrench", np.array([0.0, 0.0, 0.0, 0.0, 0.0, 25.0]))
    assert ekf.belief.P[21, 21] > 0.1 * before  # 0.0004 if it counted as still


def test_learnt_load_counts_at_once_in_the_acceleration() -> None:
    """Between two take-overs by the physics an IMU's reading must follow θ as the filter has it now."""
    arm = ArmTerms(terms().plant, [f"panda_joint{i}" for i in range(1, 8)], tool_frame="panda_tcp")
    ekf = Ekf(arm, Filter(parameters=["payload"]))
    imu = LinkImu(arm, "panda_link7")
    ekf.add(imu)
    tau = arm.inverse_dynamics(HOME, np.zeros(7), 0.0)
    ekf.start(HOME, np.zeros(7), tau, 0.0)
    ekf.predict(tau, 0.005)
    without = ekf.linear(imu, ekf.belief.x, ekf.belief.P, 0).reading
    x = ekf.belief.x.copy()
    x[21:25] = [0.02, 0.0, 0.0, 0.003]
    found = ekf.linear(imu, x, ekf.belief.P, 0).reading - without
    arm.set_payload(x[21:25])
    a = np.linalg.solve(arm.mass_matrix(HOME), tau - arm.inverse_dynamics(HOME, np.zeros(7), 0.0))
    expected = LinkFrame(arm, "panda_link7").motion(HOME, np.zeros(7))
    np.testing.assert_allclose(found[3:], expected.R_WF.T @ (expected.J_v @ a), rtol=0.05, atol=1e-3)
    assert np.abs(found[3:]).max() > 0.05


def test_links_of_one_name_in_two_models_are_told_apart() -> None:
    """A sensor without a link of its own is on the arm's last, whatever else bears that name."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    from twin_diagram.estimation.sensors.from_scenario import make_sensor
    from twin_diagram.scenario.resources import models_dir

    plant = MultibodyPlant(0.0)
    for side in ("left", "right"):
        (model,) = Parser(plant, side).AddModels(str(models_dir() / "arms" / "ur5e.urdf"))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link", model))
    plant.Finalize()
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    name = plant.GetModelInstanceName(plant.GetModelInstanceByName("right::ur5e"))
    arm = ArmTerms(plant, [f"{name}::{joint}_joint" for joint in names])
    for kind in ("imu", "wrench", "body_pose"):
        sensor = make_sensor(arm, SensorSpec(kind=kind))
        _, _, J = sensor.frame.jacobian(np.full(6, 0.3))  # type: ignore[attr-defined]
        assert np.linalg.matrix_rank(J) == 6


def test_load_that_jumps_opens_the_payload_and_does_not_throw_the_arm() -> None:
    """At rest friction hides 1.5 kg from the joints; the wrench insists, and only what explains it is opened."""
    level = np.full(7, 20.0)
    arm = ArmTerms(twin_terms().plant, JOINTS, tool_frame="panda_tcp", laws=Laws(dry=lambda q, v, tau: (level, level)))
    ekf, still = Ekf(arm, Filter(parameters=["payload"])), np.zeros(7)
    ekf.add(WristWrench(arm, "panda_link7"))
    tau = arm.inverse_dynamics(HOME, still, 0.0)
    light = WristWrench(arm, "panda_link7")
    light.declare(slice(0, 0), slice(21, 25))
    load = np.zeros(25)
    load[:7] = HOME
    for k in range(200):
        if k == 100:
            opened, std = ekf.belief.header[Entry.OPENINGS], np.sqrt(ekf.belief.P[21, 21])
            load[21:25] = [1.5, 0.0, 0.0, 0.27]
        ekf.observe(HOME, still, tau, 0.005 * k)
        ekf.update("wrench", light.linear(Instant(load, 7, 4, still)).reading, 0.005 * k)
        assert np.abs(ekf.belief.v).max() < 0.01
        assert np.abs(ekf.belief.q - HOME).max() < 1e-4
    assert std < 0.3
    assert ekf.belief.header[Entry.OPENINGS] == opened + 1
    assert ekf.counters()["wrench"]["refused"] >= 10
    assert abs(ekf.belief.theta[0] - 1.5) < 0.15


def test_much_learnt_at_once_does_not_wait_for_the_physics() -> None:
    """What is learnt counts to first order until its turn comes; kilograms do not wait, grams do."""
    for load, waits in ((2.0, False), (0.02, True)):
        ekf, still = Ekf(terms(), Filter(parameters=["payload"], parameter_rate=1.0)), np.zeros(7)
        ekf.add(WristWrench(ekf.terms, "panda_link7"))
        tau = ekf.terms.inverse_dynamics(HOME, still, 0.0)
        ekf.start(HOME, still, tau, 0.0)
        ekf.predict(tau, 0.005)
        ekf.belief.theta[0] += load
        learnt = ekf.belief.theta.copy()
        ekf.predict(tau, 0.005)
        assert np.array_equal(ekf.belief.model, learnt) != waits


def test_stiction_that_nobody_watches_may_let_go() -> None:
    """Friction holds a joint for sure as long as its encoder says so; without, it may have begun to move."""
    level, still = np.full(7, 4.0), np.zeros(7)
    arm = ArmTerms(twin_terms().plant, JOINTS, tool_frame="panda_tcp", laws=Laws(dry=lambda q, v, tau: (level, level)))
    ekf, tau = Ekf(arm, Filter()), arm.inverse_dynamics(HOME, still, 0.0)
    for k in range(60):
        ekf.observe(HOME, still, tau, 0.005 * k)
    watched = np.sqrt(ekf.belief.P.diagonal()[7:14])
    for _ in range(60):
        ekf.predict(tau, 0.005)
    blind = np.sqrt(ekf.belief.P.diagonal()[7:14])
    assert np.all(watched < 2e-3)
    assert np.all(blind > 0.01)
    assert np.all(blind < 0.5)
    np.testing.assert_allclose(ekf.belief.q, HOME, atol=1e-3)  # it is not said to have moved
    np.testing.assert_allclose(creep_std(np.full(7, 0.1), level), 0.0, atol=1e-6)
    assert np.all(creep_std(np.full(7, 0.1), level, np.full(7, 0.2**2)) > 0.9 * level)


def test_push_sideways_opens_no_payload() -> None:
    """A contact's force that no load explains stays refused."""
    ekf = Ekf(twin_terms(), Filter(parameters=["payload"]))
    ekf.add(WristWrench(ekf.terms, "panda_link7"))
    still = np.zeros(7)
    tau = ekf.terms.inverse_dynamics(HOME, still, 0.0)
    for k in range(200):
        ekf.observe(HOME, still, tau, 0.005 * k)
        R, _ = LinkFrame(ekf.terms, "panda_link7").pose(HOME)
        ekf.update("wrench", np.concatenate([np.zeros(3), R.T @ [60.0 * (k >= 100), 0.0, 0.0]]), 0.005 * k)
    assert ekf.belief.header[Entry.OPENINGS] == 0
    assert ekf.belief.theta[0] < 0.2


def test_likelihood_ratio_of_a_change() -> None:
    """White innovations do not alarm; a change of one parameter does, at once."""
    rng = np.random.default_rng(5)
    score, W = np.zeros((4, 5)), rng.normal(size=(6, 4))
    groups = [slice(0, 2), slice(2, 4)]
    for _ in range(5000):
        keep_score(score, W, rng.normal(size=6))
        assert not alarming(score, groups)
    heard = 0
    for k in range(20):
        keep_score(score, W, rng.normal(size=6) + W[:, 3] * 2.0)
        heard = heard or (k + 1 if alarming(score, groups) else 0)
    assert 0 < heard <= 10


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1102, 1103])
def test_camera_and_imu_carry_on_without_encoders(seed: int) -> None:
    pytest.importorskip("mujoco")
    from hrt_bench import ours, scores
    from hrt_bench.estimate import Kinematics
    from hrt_truth.hidden import Hidden
    from hrt_truth.motion import pick_and_place
    from hrt_truth.sensors import Case, sense
    from hrt_truth.world import run

    case = Case(Hidden.draw(seed, mass=1.0), duration=8.0)
    streams, truth = sense(case, run(case.hidden, *pick_and_place(seed, case.duration)))
    setup = ours.Setup(missing=(("encoders", 3.0, np.inf),), predict=False)
    found = ours.run(streams, setup, Kinematics())
    assert scores.hand_error(found, truth)[600:].max() < 0.1
    assert scores.honesty(found, truth)["nees"] < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1101, 1111))
def test_two_kilograms_with_all_sensors(seed: int) -> None:
    """Against MuJoCo: what the filter says of its own error holds, and more sensors make it smaller."""
    pytest.importorskip("mujoco")
    from hrt_bench import ours
    from hrt_bench.estimate import Kinematics
    from hrt_truth.hidden import Hidden
    from hrt_truth.motion import pick_and_place
    from hrt_truth.sensors import Case, sense
    from hrt_truth.world import run

    case = Case(Hidden.draw(seed, mass=2.0), duration=5.0)
    streams, truth = sense(case, run(case.hidden, *pick_and_place(seed, case.duration)))
    at = [100, 200, 400, 600, 800, 1000]
    std = {}
    for sensors in (("encoders",), ("encoders", "wrench"), ("encoders", "imu"), ours.ALL):
        found = ours.run(streams, ours.Setup(sensors=sensors, predict=False), Kinematics())
        error, std[sensors] = np.abs(found.mass - 2.0)[at], found.extra["theta_std"][at, 0]
        assert np.all(error < 3.0 * std[sensors]), (sensors, error, std[sensors])
        for name in sensors[1:]:
            rows = found.extra[f"outcome_{name}"]
            good = np.ones(len(rows), dtype=bool)
            if name == "camera":
                good = truth.outliers[rows[:, 0].astype(int)] == 0.0
            assert np.mean(rows[good, 1] == 0.0) < 0.01, name
    assert np.all(std[ours.ALL] < std["encoders",])
