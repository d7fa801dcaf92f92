"""From logs to ten parameters: truth found again, claims that hold, bad logs refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.interpolate import make_interp_spline

from tests.estimation.weighing.conftest import Recorder
from twin_diagram.assets.building.measured import SIX
from twin_diagram.errors import LogError
from twin_diagram.estimation.weighing import (
    ArmDoubt,
    EmptyRun,
    Excitation,
    LoadedRun,
    Shape,
    ShapePrior,
    Weighing,
    WeighingError,
    coloured_noise,
    torque_fit,
    weigh,
)
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.estimation.weighing.torque_data import hand_change, read_run
from twin_diagram.estimation.weighing.torque_fit import by_pose, doubted
from twin_diagram.estimation.weighing.weighing import VERDICTS, about, verdict
from twin_diagram.logs.measured_log import Log
from twin_diagram.model import Model
from twin_diagram.model.rigid_body.mass_properties import about_centre
from twin_diagram.model.rigid_body.rigid_tree import transform_inertia

GAIN = np.array([0.02, -0.015, 0.01, -0.02, 0.015, -0.01, 0.012])
BIAS = np.array([0.3, -0.2, 0.1, 0.2, -0.3, 0.1, -0.1])
SENSORS: dict[str, Any] = {"gain": GAIN, "bias": BIAS, "viscous": 0.3, "dry": 0.2}


@pytest.fixture(scope="module")
def both(
    recorder: Recorder, iiwa_link: Model, excitation: Excitation, X_TO: RigidTransform, off_centre: np.ndarray
) -> tuple[Log, Log]:
    """With the object and without, hardly any noise."""
    loaded = recorder(iiwa_link, excitation, X_TO, off_centre, noise=1e-4, seed=1, **SENSORS)
    return loaded, recorder(iiwa_link, excitation, noise=1e-4, seed=2, **SENSORS)


def test_truth_is_found_again_through_gains_offsets_and_frictions(
    both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape, off_centre: np.ndarray
) -> None:
    sure = replace(ArmDoubt(), hand=(1e-6, 1e-7, 1e-9), pose=(1e-7, 1e-7))
    found = weigh(iiwa_link, [LoadedRun(both[0], X_TO)], [EmptyRun(both[1])], ShapePrior.none(box), "link", sure)
    mass, centre, inertia = about_centre(off_centre)
    assert found.mass == pytest.approx(mass, rel=2e-4)
    np.testing.assert_allclose(found.centre, centre, atol=5e-5)
    np.testing.assert_allclose(found.moments, np.linalg.eigvalsh(inertia), rtol=0.01)
    np.testing.assert_allclose(found.gain, GAIN, atol=5e-4)
    np.testing.assert_allclose(found.fit.beside[:, 0], BIAS, atol=0.02)
    np.testing.assert_allclose(found.fit.beside[:, 1], 0.3 * (1.0 + GAIN), atol=0.01)
    np.testing.assert_allclose(found.fit.beside[:, 2], 0.2 * (1.0 + GAIN), atol=0.01)
    assert np.all(found.gain_std < 2e-3)
    assert found.verdicts["mass"] == found.verdicts["moment_1"] == "measured"


def test_gains_that_are_taken_for_right_spoil_the_moments(
    both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape, off_centre: np.ndarray
) -> None:
    blind = replace(ArmDoubt(), gain=1e-6)
    found = weigh(iiwa_link, [LoadedRun(both[0], X_TO)], [EmptyRun(both[1])], ShapePrior.none(box), "link", blind)
    moments = np.linalg.eigvalsh(about_centre(off_centre)[2])
    assert abs(found.mass / off_centre[0] - 1.0) > 0.005
    assert np.max(np.abs(found.moments / moments - 1.0)) > 0.03


def displaced(
    log: Log, model: Model, excitation: Excitation, X_TO: RigidTransform, way: np.ndarray, change: np.ndarray
) -> Log:
    """The log of an object whose parameters (10) about the tool are off by the change times the way (N,)."""
    _, (q, v, a) = excitation.sampled(200.0)
    extra = way[:, None] * (Held.in_tool(model, X_TO).regressor(model, q, v, a) @ change)
    assert log.torque is not None
    return replace(log, torque=log.torque + (1.0 + GAIN) * extra)


def test_what_creeps_in_the_hand_is_found_where_that_is_told(
    both: tuple[Log, Log],
    iiwa_link: Model,
    excitation: Excitation,
    X_TO: RigidTransform,
    box: Shape,
    off_centre: np.ndarray,
) -> None:
    """By 6 mm and 1.7° in all, evenly."""
    moments = np.linalg.eigvalsh(about_centre(off_centre)[2])
    steps = np.array([0.002, -0.001, 0.002, 0.01, 0.01, -0.005])
    moved = displaced(
        both[0], iiwa_link, excitation, X_TO, np.linspace(-1.0, 1.0, len(both[0])), by_pose(off_centre) @ steps
    )
    off = []
    for creep in ((0.0, 0.0), (0.006, 0.03)):
        runs = [LoadedRun(moved, X_TO)], [EmptyRun(both[1])]
        found = weigh(iiwa_link, *runs, ShapePrior.none(box), "link", replace(ArmDoubt(), creep=creep))
        off.append(float(np.abs(found.moments / moments - 1.0).max()))
    assert off[1] < 0.03 and off[0] > 5.0 * off[1], off


def test_what_slips_all_at_once_is_found_where_it_is_told_when(
    both: tuple[Log, Log],
    iiwa_link: Model,
    excitation: Excitation,
    X_TO: RigidTransform,
    box: Shape,
    off_centre: np.ndarray,
) -> None:
    """By 3 mm and 1.7° a quarter of the time after the begin, as a bottle did; taken for steady it spoils moments."""
    moments = np.linalg.eigvalsh(about_centre(off_centre)[2])
    way = np.where(np.arange(len(both[0])) < 0.27 * len(both[0]), -1.0, 1.0)
    steps = np.array([0.001, -0.0005, 0.001, 0.01, 0.01, -0.005])
    moved = displaced(both[0], iiwa_link, excitation, X_TO, way, by_pose(off_centre) @ steps)
    off = []
    for told in (way, None):
        runs = [LoadedRun(moved, X_TO, way=told)], [EmptyRun(both[1])]
        found = weigh(iiwa_link, *runs, ShapePrior.none(box), "link", replace(ArmDoubt(), creep=(0.003, 0.03)))
        off.append(float(np.abs(found.moments / moments - 1.0).max()))
    assert off[0] < 0.08 and off[1] > 3.0 * off[0], off
    with pytest.raises(WeighingError, match="way: "):
        LoadedRun(moved, X_TO, way=way[1:])


def test_speeds_that_are_late_are_found(
    iiwa_link: Model, excitation: Excitation, X_TO: RigidTransform, box: Shape, off_centre: np.ndarray
) -> None:
    """As in what moves in steps: terms of speed are those of half a step earlier."""
    time, (q, v, a) = excitation.sampled(200.0)
    logs = []
    for loaded in (True, False):
        late = v - 0.00125 * a
        torque = iiwa_link.inverse_dynamics(q, late, a) + 0.3 * v
        if loaded:
            torque = torque + Held.in_tool(iiwa_link, X_TO).regressor(iiwa_link, q, late, a) @ off_centre
        logs.append(Log(time, iiwa_link.joints, q, torque=torque))
    moments, residual = np.linalg.eigvalsh(about_centre(off_centre)[2]), []
    for lag in (0.0, 2e-3):
        runs = [LoadedRun(logs[0], X_TO)], [EmptyRun(logs[1])]
        found = weigh(iiwa_link, *runs, ShapePrior.none(box), "link", replace(ArmDoubt(), lag=lag))
        residual.append(float(found.noise.max()))
    assert residual[1] < 0.1 * residual[0], residual
    np.testing.assert_allclose(found.moments, moments, rtol=0.03)


def test_a_doubted_mass_takes_information_away_as_added_variance_does() -> None:
    root = np.random.default_rng(0).normal(size=(10, 10))
    matrix, truth = root @ root.T, np.arange(1.0, 11.0)
    told, right = doubted(matrix, matrix @ truth, 0.3)
    variance = np.linalg.inv(matrix)
    variance[0, 0] += 0.09
    np.testing.assert_allclose(np.linalg.inv(told), variance, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.solve(told, right), truth, rtol=1e-6)


def test_motor_side_torques_tell_as_much(
    recorder: Recorder, iiwa: Model, excitation: Excitation, X_TO: RigidTransform, box: Shape, off_centre: np.ndarray
) -> None:
    loaded = recorder(iiwa, excitation, X_TO, off_centre, noise=1e-3, seed=1, **SENSORS)
    empty = recorder(iiwa, excitation, noise=1e-3, seed=2, **SENSORS)
    found = weigh(iiwa, [LoadedRun(loaded, X_TO)], [EmptyRun(empty)], ShapePrior(box), "motor")
    assert found.mass == pytest.approx(off_centre[0], rel=2e-3)
    np.testing.assert_allclose(found.moments, np.linalg.eigvalsh(about_centre(off_centre)[2]), rtol=0.05)


@pytest.mark.long
def test_told_errors_hold_the_truth(
    recorder: Recorder,
    iiwa_link: Model,
    excitation: Excitation,
    X_TO: RigidTransform,
    box: Shape,
    off_centre: np.ndarray,
) -> None:
    held, squares = [], []
    for seed in range(5):
        random = np.random.default_rng(seed)
        sensors = {
            "gain": 0.01 * random.normal(size=7), "bias": 0.2 * random.normal(size=7),
            "viscous": random.uniform(0.0, 0.5, 7), "dry": random.uniform(0.0, 0.5, 7), "noise": 0.2,
        }  # fmt: skip
        loaded = recorder(iiwa_link, excitation, X_TO, off_centre, seed=100 + seed, **sensors)
        empty = recorder(iiwa_link, excitation, seed=200 + seed, **sensors)
        found = weigh(iiwa_link, [LoadedRun(loaded, X_TO)], [EmptyRun(empty)], ShapePrior(box))
        low, high = found.interval()
        held.append((low <= off_centre) & (off_centre <= high))
        squares.append(
            (off_centre - found.parameters) @ np.linalg.solve(found.covariance, off_centre - found.parameters)
        )
        mass, centre, inertia = about_centre(off_centre)
        assert abs(found.mass / mass - 1.0) < 0.01
        assert np.linalg.norm(found.centre - centre) < 0.003
        assert np.max(np.abs(found.moments - np.linalg.eigvalsh(inertia)) / found.errors["moments"]) < 3.5
        assert np.max(found.errors["moments"] / found.moments) < 0.4
        np.testing.assert_array_less(np.abs(found.gain - sensors["gain"]), 4.5 * found.gain_std)
    assert np.mean(held) >= 0.88
    assert 3.0 < np.mean(squares) < 16.0  # χ² with ten degrees of freedom


@pytest.mark.long
def test_a_summary_is_of_one_body(both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape) -> None:
    found: Weighing = weigh(iiwa_link, [LoadedRun(both[0], X_TO)], [EmptyRun(both[1])], ShapePrior(box))
    mass, centre, inertia = about_centre(found.parameters)
    assert found.mass == pytest.approx(mass)
    np.testing.assert_allclose(found.centre, centre)
    np.testing.assert_allclose(found.axes @ np.diag(found.moments) @ found.axes.T, inertia, atol=1e-15)
    assert set(found.verdicts.values()) <= set(VERDICTS)
    table = found.as_dict()
    assert table["mass"]["value"] == found.mass
    assert table["centre"]["std"] == found.errors["centre"].tolist()
    assert np.shape(table["covariance"]) == (10, 10)
    again = weigh(iiwa_link, [LoadedRun(both[0], X_TO)], [EmptyRun(both[1])], ShapePrior(box))
    np.testing.assert_array_equal(again.parameters, found.parameters)


def test_an_even_object_that_hardly_moves_is_known_by_its_shape(
    recorder: Recorder, iiwa_link: Model, plain: Excitation, X_TO: RigidTransform, box: Shape
) -> None:
    slow = replace(plain, coefficients=0.02 * plain.coefficients)
    loaded = recorder(iiwa_link, slow, X_TO, box.even(0.5), noise=0.2, seed=1)
    empty = recorder(iiwa_link, slow, noise=0.2, seed=2)
    found = weigh(iiwa_link, [LoadedRun(loaded, X_TO)], [EmptyRun(empty)], ShapePrior(box))
    assert found.verdicts["mass"] == "measured"
    words = [found.verdicts[f"moment_{k}"] for k in (1, 2, 3)]
    assert "measured" not in words  # that the middle is the centre says of a hidden load what torques do not
    assert "from shape alone" in words
    np.testing.assert_allclose(found.moments, np.linalg.eigvalsh(about_centre(box.even(found.mass))[2]), rtol=0.05)


@pytest.mark.long
def test_a_single_run_a_matrix_and_a_bare_shape_will_do(
    both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape
) -> None:
    usual = weigh(iiwa_link, [LoadedRun(both[0], X_TO)], [EmptyRun(both[1])], ShapePrior(box))
    matrix: Any = X_TO.GetAsMatrix4()
    found = weigh(iiwa_link, LoadedRun(both[0], matrix), EmptyRun(both[1]), box)
    # A matrix is made a rotation again, which changes last bits: the fit ends within 0.002 deviations of its mode, and
    # the mean of its 3000 draws is as sure as 0.018. In relative terms that depends on the processor.
    std = np.sqrt(np.diag(usual.posterior.covariance))
    assert (np.abs(found.parameters - usual.parameters) < 0.018 * std).all()
    own = found.measured()
    assert own.mass == found.mass and own.mass_std == found.errors["mass"]
    np.testing.assert_array_equal(own.inertia, found.inertia)
    # In other axes errors are those of the bodies that are drawn, turned.
    R = RollPitchYaw(0.4, -0.3, 0.9).ToRotationMatrix().matrix()
    _, centres, inertias = about_centre(found.posterior.bodies)
    there = own.turned(R)
    np.testing.assert_allclose(there.centre_std, about(centres @ R.T, there.centre), rtol=1e-9)
    off = about(np.einsum("ij,njk,lk->nil", R, inertias, R), there.inertia)
    np.testing.assert_allclose(there.inertia_std, [off[at] for at in SIX], rtol=1e-9)
    assert own.by["mass"] == "measured" and VERDICTS.index(own.by["inertia"]) >= VERDICTS.index(
        found.verdicts["moment_1"]
    )


def test_logs_that_are_no_runs_and_poses_that_are_none_are_refused(
    both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape
) -> None:
    log, run = both[0], LoadedRun(both[0], X_TO)
    nothing: Any = None
    for loaded, empty, words in (
        ([log], [], "loaded: Log is no LoadedRun"),
        ([run], [log], "empty: Log is no EmptyRun"),
        ([], [], "no run with the object"),
    ):
        with pytest.raises(WeighingError, match=words):
            weigh(iiwa_link, loaded, empty, box)  # type: ignore[arg-type]
    for pose in (np.zeros((4, 4)), [1.0, 2.0], "here", nothing):
        with pytest.raises(WeighingError, match="X_TO must be a pose"):
            LoadedRun(log, pose)  # type: ignore[arg-type]


def test_the_words_of_a_verdict() -> None:
    assert [verdict(share) for share in (0.95, 0.9, 0.5, 0.3, 0.1, -0.2)] == [
        "measured", "measured", "partly", "partly", "from shape alone", "from shape alone",
    ]  # fmt: skip


def test_an_object_moved_in_the_hand(off_centre: np.ndarray) -> None:
    slopes = by_pose(off_centre)
    step = 1e-4
    moved = transform_inertia(RigidTransform([0.0, step, 0.0])) @ off_centre
    np.testing.assert_allclose(slopes[:, 1] * step, moved - off_centre, atol=1e-8)
    assert np.all(slopes[0] == 0.0)
    np.testing.assert_allclose(slopes[1:4, 5], np.cross([0, 0, 1], off_centre[1:4]), atol=1e-6)


def test_fingers_elsewhere_change_the_hand(iiwa: Model) -> None:
    change = hand_change(iiwa, {"left_finger_sliding_joint": -0.03, "right_finger_sliding_joint": 0.03})
    assert np.all(change[:-1] == 0.0)
    mass, moment, inertia = change[-1, 0], change[-1, 1:4], change[-1, 4:7]
    assert mass == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(moment, 0.0, atol=1e-9)  # symmetric
    # Two fingers of 50 g go from 11.5 mm (the joints' places) to 41.5 mm off the middle.
    expected = 2 * 0.05 * (0.0415**2 - 0.0115**2)
    assert sorted(inertia)[1:] == pytest.approx([expected, expected], rel=1e-6)
    assert sorted(inertia)[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(hand_change(iiwa, {}) == 0.0)


def test_bad_logs_are_refused(both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape) -> None:
    good = both[0]

    def tried(log: Log) -> Weighing:
        return weigh(iiwa_link, [LoadedRun(log, X_TO)], [EmptyRun(both[1])], ShapePrior(box))

    with pytest.raises(WeighingError, match="shorter than 3 s"):
        tried(good.between(0.0, 2.0))
    spoilt = np.array(good.torque)
    spoilt[100, 2] = np.nan
    with pytest.raises(WeighingError, match="torque holds values that are not finite"):
        tried(replace(good, torque=spoilt))
    with pytest.raises(LogError, match="neither torque_measured"):
        tried(replace(good, torque=None))
    with pytest.raises(LogError, match="missing"):
        tried(replace(good, joints=tuple(f"elbow_{k}" for k in range(7))))
    with pytest.raises(WeighingError, match="do not rise"):
        tried(replace(good, time=good.time[::-1]))
    with pytest.raises(WeighingError, match="samples a second"):
        tried(Log(good.time[::20], good.joints, good.position[::20], torque=np.array(good.torque)[::20]))
    with pytest.raises(WeighingError, match="no joint outside the arm"):
        read_run(iiwa_link, EmptyRun(good, {"iiwa_joint_3": 0.1}))
    with pytest.raises(WeighingError, match="stands at nan"):
        read_run(iiwa_link, EmptyRun(good, {"left_finger_sliding_joint": float("nan")}))
    with pytest.raises(WeighingError, match="at least one"):
        weigh(iiwa_link, [], [EmptyRun(good)], ShapePrior(box))
    with pytest.raises(WeighingError, match="torques at the link"):
        weigh(iiwa_link, [LoadedRun(good, X_TO)], [], ShapePrior(box), "motor")


def test_torques_that_come_late_are_moved_back(
    both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape, off_centre: np.ndarray
) -> None:
    """A simulator's torques are of its last step; at 100 N·m/s 2.5 ms are 0.25 N·m, ten times what is looked for."""

    def late(log: Log, seconds: float) -> Log:
        torque = make_interp_spline(log.time, np.array(log.torque), k=3)(np.maximum(log.time - seconds, 0.0))
        return replace(log, torque=torque)

    loaded, empty = (late(log, 0.004) for log in both)
    found = weigh(iiwa_link, [LoadedRun(loaded, X_TO)], [EmptyRun(empty)], ShapePrior(box))
    assert found.delay == pytest.approx(0.004, abs=5e-5)
    assert found.mass == pytest.approx(off_centre[0], rel=1e-3)
    np.testing.assert_allclose(found.moments, np.linalg.eigvalsh(about_centre(off_centre)[2]), rtol=0.03)


def test_joints_that_stick_for_a_moment_spoil_little(
    both: tuple[Log, Log], iiwa_link: Model, X_TO: RigidTransform, box: Shape, off_centre: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Where a joint turns round, friction is not what its law says for some hundredths of a second."""

    def sticking(log: Log, seed: int) -> Log:
        speed = np.gradient(np.array(log.position), log.period, axis=0)
        noise = 0.02 * np.random.default_rng(seed).normal(size=speed.shape)
        return replace(log, torque=np.array(log.torque) + noise + 0.3 * (np.abs(speed) < 0.04))

    loaded, empty = sticking(both[0], 0), sticking(both[1], 1)

    def found() -> Weighing:
        return weigh(iiwa_link, [LoadedRun(loaded, X_TO)], [EmptyRun(empty)], ShapePrior.none(box))

    ours = found()
    moments = np.linalg.eigvalsh(about_centre(off_centre)[2])
    assert np.all(np.abs(ours.moments - moments) < 3.0 * ours.errors["moments"])
    monkeypatch.setattr(torque_fit, "TUNING", torque_fit.Tuning(rare=1e9))
    monkeypatch.setattr(coloured_noise, "TUNING", coloured_noise.Tuning(rare=1e9))
    plain = found()
    assert np.all(ours.errors["moments"] < 0.85 * plain.errors["moments"])
