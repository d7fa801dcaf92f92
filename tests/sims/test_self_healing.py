"""`sims/self_healing.py`: what it reports, on figures made up, and the whole of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_diagram.model.model import Model

SIMS = Path(__file__).resolve().parents[2] / "sims"


@pytest.fixture(autouse=True)
def sims(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    pytest.importorskip("mujoco", reason="needs the `demo` extra")
    monkeypatch.syspath_prepend(str(SIMS))
    yield


def made_up(swaps: list[float]) -> Any:
    """0.5 mm until 10 s, then 20 mm, for the twin 1 mm from 20 s on."""
    from mujoco_robot import healing_report as report

    at = np.arange(1, 600) * report.LOOK
    alone = np.where(at < 10.0, 5e-4, 2e-2)
    twin = np.where((at > 20.0) & bool(swaps), 1e-3, alone)
    hand = {"twin": twin, "left alone": alone}
    error = {who: np.stack([values, 2.0 * values], axis=1) for who, values in hand.items()}
    events = [{"event": "alarm", "time": 3.0}, {"event": "alarm", "time": 10.05}]
    events += [{"event": "model_swapped", "time": t} for t in swaps]
    model: Any = None
    return report.Run(("a", "b"), report.Plan(change=10.0), swaps, events, at, error, hand, model)


def test_each_phase_has_its_figure(tmp_path: Path) -> None:
    run = made_up([20.0])
    found = {who: [1e3 * run.rms(who, phase)[0] for phase in ("before", "during", "after")] for who in run.hand}
    np.testing.assert_allclose(found["twin"], [0.5, 20.0, 1.0])
    np.testing.assert_allclose(found["left alone"], [0.5, 20.0, 20.0])
    np.testing.assert_allclose(run.rms("twin", "after")[1], [1e-3, 2e-3])
    words = [text for _, text in run.marks()]
    assert words == ["the robot changes,\nalarm after 50 ms", "the model\nis mended"]
    table = run.table()
    assert "20.00" in table and "left alone" in table and "mrad" in table
    run.picture(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_a_model_that_was_never_mended(tmp_path: Path) -> None:
    run = made_up([])
    assert np.isnan(run.rms("twin", "after")[0]) and "nan" in run.table()
    run.picture(tmp_path / "picture.png")


@pytest.mark.slow
def test_the_twin_heals_itself(tmp_path: Path) -> None:
    """The whole of it: alarm, search in a process of its own, corrected model in the running loop."""
    from mujoco_robot import healing as sim

    run = sim.heal(sim.QUICK, 1001, tmp_path, say=lambda text: None)
    names = [event["event"] for event in run.events]
    assert [name for name in names if name != "alarm"][:3] == ["gap_started", "gap_verdict", "model_swapped"]
    alarm = run.events[0]["time"]
    assert sim.QUICK.change < alarm < sim.QUICK.change + 0.5, "no alarm before, and soon one after"
    lines = (tmp_path / "events.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line) for line in lines] == run.events
    found = [effect for effect in run.model.present if not effect.given]
    payload = next(effect for effect in found if effect.name == "payload")
    assert payload.parameters["mass"].value[0] == pytest.approx(sim.HIDDEN.payload, rel=0.01)
    assert {effect.name for effect in found} == {"payload", "coulomb_friction"}
    friction = {joint for effect in found if effect.name == "coulomb_friction" for joint in effect.joints}
    assert friction == set(sim.HIDDEN.friction)
    before, during, after = (run.rms("twin", phase)[0] for phase in ("before", "during", "after"))
    assert during > 10.0 * before and after < 2.0 * before
    assert run.rms("left alone", "during")[0] == during and run.rms("left alone", "after")[0] > 10.0 * after
    assert Model.load(tmp_path / "healing" / "1" / "model").present
