"""Arguments of a wrong kind, as users give them to what they call first, end in one line that tells what is wanted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin_diagram as td
from twin_diagram.errors import ArgumentError
from twin_diagram.estimation import ArmTerms
from twin_diagram.gap import prepare
from twin_diagram.model import predict
from twin_diagram.planning import Mpc
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.scenario import Camera, Drift, Registration, models_dir

SCENARIO = td.load_scenario("tabletop", ["twin.camera=null"])
MODEL = td.Model.load(models_dir() / "arms" / "ur5e.urdf")
LOG = td.Log(np.arange(3.0), ("a",), np.zeros((3, 1)), torque=np.zeros((3, 1)))
CALLS: dict[str, tuple[Callable[[], Any], str]] = {
    "a scenario for its twin": (lambda: td.make_twin(SCENARIO), "a Twin .*field `twin`.*not a Scenario"),
    "a name for a scenario": (lambda: td.run_scenario("tabletop"), "load_scenario.*not a str"),
    "a twin for a scenario": (lambda: td.make_closed_loop(SCENARIO.twin), "a Scenario .*not a Twin"),
    "no scenario": (lambda: td.make_station(None), "not a NoneType"),
    "swapped": (lambda: td.save_scenario("a.yaml", SCENARIO), "a Scenario .*not a str"),
    "a scenario for its file": (lambda: td.load_scenario(SCENARIO), "path of a YAML file.*not a Scenario"),
    "an override that is no text": (lambda: td.load_scenario("tabletop", [3]), "FIELD=VALUE.*not an int"),
    "a path for a model": (lambda: td.Ekf("arm.urdf", td.Filter()), "Model.load.*not a str"),
    "fields for a filter": (lambda: td.Ekf(MODEL, {}), "a Filter .*not a dict"),
    "text for a number": (lambda: td.Ekf(MODEL, td.Filter(rate="fast")), "twin.filter.rate: a number"),
    "a filter for the monitor": (lambda: td.Monitor(MODEL, td.Filter()), "drift: a Drift .*not a Filter"),
    "swapped tunings": (lambda: td.DriftMonitor(MODEL, td.Filter(), Drift()), "a Filter .*not a Drift"),
    "a plant for a model": (lambda: td.AdaptiveEkf(MODEL.plant, td.Filter()), r"ArmTerms\(plant, joints\)"),
    "a model for a plant": (lambda: ArmTerms(MODEL, ["a"]), r"ArmTerms.from_model\(model\)"),
    "a model twice": (lambda: td.Model.load(MODEL), "path of a URDF.*not a Model"),
    "a model for its file": (lambda: td.run_gap(MODEL, "a.csv", "b.csv"), "path of a URDF.*not a Model"),
    "a log for its file": (lambda: predict("arm.urdf", LOG, "p.csv"), "path of a measured log.*not a Log"),
    "a log for a recording": (lambda: td.replay_log(LOG), "path of a recording.*not a Log"),
    "a file for a log": (lambda: td.write_log("a.csv", "b.csv"), "read_log.*not a str"),
    "one log for many": (lambda: prepare(MODEL, LOG), "a list of Logs is wanted, not a Log"),
    "files for logs": (lambda: prepare(MODEL, ["a.csv"]), "a list of Logs .*not a str"),
    "folders for assets": (
        lambda: td.IcpPoseEstimator(SCENARIO.twin.library, Camera(), Registration()),
        "an Asset for each name.*not a str",
    ),
    "a path where a file is not read": (lambda: td.Model("arm.urdf"), r"Model.load\(PATH\).*not a str"),
    "a path for a planner's model": (lambda: Mpc("arm.urdf", SCENARIO.twin, {}), r"Model.load\(PATH\).*not a str"),
    "a scenario for a planner's twin": (lambda: Mpc(MODEL, SCENARIO, {}), "a Twin .*not a Scenario"),
    "names for a planner's library": (lambda: Mpc(MODEL, SCENARIO.twin, ["can"]), "names with Assets.*not a list"),
    "folders for a planner's library": (lambda: Mpc(MODEL, SCENARIO.twin, SCENARIO.twin.library), "an Asset for each"),
    "a scenario for a stop monitor": (lambda: StopMonitor(MODEL, SCENARIO, {}), "a Twin .*not a Scenario"),
    "a name for an effect": (lambda: MODEL.with_effects("payload"), "Effect or EffectSpec.*not a str"),
    "a number for an effect": (lambda: MODEL.with_effects([1.0]), "Effect or EffectSpec.*not a float"),
    "too many joints": (lambda: MODEL.inverse_dynamics(*np.zeros((3, 7))), r"q has shape \(7,\).* 6 joints"),
    "too few speeds": (lambda: MODEL.forward_dynamics(np.zeros(6), np.zeros(5), np.zeros(6)), r"v has shape \(5,\)"),
    "no number, for which Drake ends the program": (lambda: MODEL.tool_pose([np.nan] * 6), "q is .*nan.*finite"),
    "no effect": (lambda: td.register(int), "derived from Effect"),
    "no sensor": (lambda: td.Ekf(MODEL, td.Filter()).add("imu"), "a Sensor .*not a str"),
}


@pytest.mark.parametrize("case", CALLS)
def test_what_is_wanted_is_told_in_one_line(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, told = CALLS[case]
    with pytest.raises(td.TwinError, match=told) as error:
        call()
    assert isinstance(error.value, ArgumentError) and "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_filter_and_a_monitor_take_a_model_or_its_terms() -> None:
    """Both give the same."""
    q, zero = np.array([0.0, -1.3, 1.4, -1.6, -1.4, 0.0]), np.zeros(6)
    states = []
    for arm in (MODEL, ArmTerms.from_model(MODEL)):
        ekf, monitor = td.Ekf(arm, td.Filter()), td.Monitor(arm)
        for k in range(5):
            ekf.observe(q, zero, MODEL.inverse_dynamics(q, zero, zero), 0.005 * k)
            monitor.watch(ekf.belief, q, zero)
        states.append(np.concatenate([ekf.belief.vector, monitor.vector]))
    np.testing.assert_array_equal(*states)
