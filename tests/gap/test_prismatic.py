"""An arm on a rail, from its logs to the report: prismatic joints are told in N and m, revolute ones as ever."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import gap_bench as bench
from tests.signals.test_units import SHAPED, gantry, on_both
from twin_diagram.errors import LogError
from twin_diagram.gap.candidates.records import sentence
from twin_diagram.gap.correction.named_effects import sentence_of, specs_of
from twin_diagram.gap.experiments import advice, trajectories
from twin_diagram.gap.findings import Estimate, Finding, Separation, Verdict
from twin_diagram.gap.report import charts, gap_json, pictures
from twin_diagram.gap.report import page as report
from twin_diagram.gap.report.comparison import Shown, show
from twin_diagram.gap.report.section_gap import lost
from twin_diagram.gap.report.subject import Subject
from twin_diagram.gap.residuals.prepared_logs import prepare
from twin_diagram.gap.residuals.regressors import Terms, given_load, levers, slow_speed
from twin_diagram.gap.verdict.locating import CONDITIONS, said
from twin_diagram.gap.verdict.posterior import unit_of
from twin_diagram.gap.workflow import Gap, run_gap
from twin_diagram.logs import Log, check, write_log
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import predict
from twin_diagram.scenario import ArmModel, EffectSpec

JOINTS = ("rail", "shoulder")
DRY = on_both("coulomb_friction", torque=[15.0, 2.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gantry")


@pytest.fixture(scope="module")
def model(folder: Path) -> Model:
    return Model.load(ArmModel(model=str(gantry(folder)), joints=list(JOINTS), tool_frame=""))


@pytest.fixture(scope="module")
def gap(model: Model, folder: Path) -> Gap:
    for k, name in enumerate(("a", "c")):
        write_log(bench.run(model, [DRY], seed=1000 + k), folder / f"{name}.csv")
    return run_gap(gantry(folder), [folder / "a.csv"], folder / "c.csv", folder / "out")


@pytest.fixture(scope="module")
def shown(model: Model) -> Shown:
    fit, held = (bench.run(model, seed=1010 + k, duration=2.5) for k in range(2))
    return show(model, model, [fit], held, np.full(2, 0.03))


def test_what_is_slow_on_a_rail_is_told_in_metres(model: Model) -> None:
    records = prepare(model, [bench.run(model, seed=1010, duration=2.9)])
    np.testing.assert_allclose(levers(records), [0.25, 1.0])
    terms = Terms(records, given_load(records), slow_speed(records))
    assert terms.resting(0) == pytest.approx(0.004, rel=0.5) and terms.resting(1) >= 0.016


def text_of(page: str) -> str:
    page = re.sub(r'src="data:[^"]*"', "", re.sub(r"<style>.*?</style>", "", page, flags=re.S))
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page)).split())


def finding_of(spec: EffectSpec, prismatic: frozenset[str] = frozenset({"rail"})) -> Finding:
    """As the search would have it, each value with its joint's unit."""
    parameters: dict[str, Estimate | dict[str, Estimate]] = {}
    for key, values in spec.parameters.items():
        units = [unit_of(spec.name, key, joint in prismatic) for joint in spec.joints]
        if len(values) == len(spec.joints):
            each = zip(spec.joints, values, units, strict=True)
            parameters[key] = {joint: Estimate(x, 0.01 * abs(x), unit) for joint, x, unit in each}
        else:
            parameters[key] = {spec.joints[0]: Estimate(list(values), [0.1] * len(values), units[0])}
    return Finding(spec.name, tuple(spec.joints), (), parameters, 0.95)


def verdict(*findings: Finding) -> Verdict:
    near = (
        Separation("coulomb_friction on rail", "viscous_friction on rail", 4.2, advice.SPEEDS),
        Separation("coulomb_friction on shoulder", "backlash on shoulder", 5.2, advice.SLOW),
        Separation("coulomb_friction on shoulder", "backlash on rail", 6.2, advice.SLOW),
        Separation("payload on upper", "gravity_tilt", 6.3, advice.STATIC),
    )
    return Verdict("named", False, findings, (), near, np.full(2, 0.05))


# From logs to the files.


@pytest.mark.long
def test_json_has_each_joints_own_unit(gap: Gap, folder: Path) -> None:
    """Metres and newtons are found, and told; the truth is 15 N and 2 N·m."""
    answer = json.loads((folder / "out" / "gap.json").read_text())
    assert answer["verdict"] == "named"
    (effect,) = answer["effects"]
    assert effect["name"] == "coulomb_friction" and effect["joints"] == list(JOINTS)
    torque = effect["parameters"]["torque"]
    assert {joint: value["unit"] for joint, value in torque.items()} == {"rail": "N", "shoulder": "N·m"}
    assert torque["rail"]["value"] == pytest.approx(15.0, rel=5e-3)
    assert torque["shoulder"]["value"] == pytest.approx(2.0, rel=5e-3)
    before = answer["gap"]["torque_rms"]["holdout"]["before"]
    assert before["rail"] == pytest.approx(15.0, rel=0.05)
    assert {joint for pair in answer["separation"] for joint in JOINTS if joint in pair["a"]} == set(JOINTS)
    assert all("rad/s or m/s" in near["experiment"] for near in answer["separation"] if "rad/s" in near["experiment"])


@pytest.mark.long
def test_report_tells_newtons_and_millimetres(gap: Gap, folder: Path) -> None:
    text = text_of((folder / "out" / "report.html").read_text())
    assert re.search(r"Dry friction of 15(\.0\d)? N on rail, (2|1\.99\d|2\.00\d) N·m on shoulder\.", text)
    before, after = gap.shown.holdout_rms()
    assert re.search(rf"{before[0]:.1f} → [\d.]+ N residual force of rail", text)
    rolled = gap.shown.holdout.rollout_before
    assert rolled is not None
    assert f"{1e3 * rolled[0]:.1f} →" in text and "mm error of motions predicted 0.2 s ahead, rail, held out" in text
    assert "mrad error of motions predicted 0.2 s ahead, shoulder, held out" in text
    assert "joint given corrected noise gap left unit rail" in text
    assert "Residual torque and force, run that was held out" in text
    assert "in radians, or metres where the joint is prismatic" in text
    assert "of prismatic joints (rail): the force in N, the position in m" in text
    for wrong in ("N·m residual force", "N residual torque", "given [N·m]"):
        assert wrong not in text
    assert after[0] < 0.01 * before[0]


@pytest.mark.long
def test_the_corrected_model_says_itself_so(gap: Gap, folder: Path) -> None:
    """Also when it is read again from its folder, with its joints as they were."""
    again = Model.load(folder / "out" / "model")
    for corrected in (gap.corrected, again):
        said = "; ".join(sentence(effect) for effect in corrected.effects)
        assert re.search(r"dry friction of 15(\.0\d)? N on rail", said) and "N·m on shoulder" in said


@pytest.mark.long
def test_predict_writes_newtons(gap: Gap, folder: Path, model: Model) -> None:
    """Without friction, a push along the rail is mass times acceleration and weight along it."""
    predict(folder / "out" / "model", folder / "c.csv", folder / "p.csv")
    columns = np.genfromtxt(folder / "p.csv", delimiter=",", names=True, deletechars="")
    measured = np.genfromtxt(folder / "c.csv", delimiter=",", names=True, deletechars="")
    push = columns["torque_predicted.rail"][100:-100]
    assert np.sqrt(np.mean((push - measured["torque_measured.rail"][100:-100]) ** 2)) < 0.5
    weight = 9.81 * 10.0 * 0.6  # the cart and the upper arm, on a rail that rises by 0.6
    assert np.median(push) == pytest.approx(weight, abs=16.0)


# The report of what else could be found.


@pytest.mark.parametrize("name", SHAPED)
def test_every_effect_in_a_report(model: Model, shown: Shown, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the rail alone nothing is said of torques, angles or turns; on both joints each has its unit."""
    monkeypatch.setattr(report, "pictures", lambda subject: "")  # they say nothing of parameters, and take long
    alone = finding_of(on_both(name, ("rail",), **{key: x[:1] for key, x in SHAPED[name].items()}))
    told = report.page(Subject(verdict(alone), shown, model, model, "gantry.urdf"))
    block = text_of(told.split('<div class="effect">')[1].split("</section>")[0])
    for never in ("N·m", "rad ", "mrad", "kg·m²", "angle", "revolution"):
        assert never not in block.replace("± 0.0040 rad ", "")  # a ripple's phase
    assert sentence_of(alone, model.prismatic)[1:] in block
    both = finding_of(on_both(name))
    text = text_of(report.page(Subject(verdict(both), shown, model, model, "gantry.urdf")))
    for value in both.parameters.values():
        assert isinstance(value, dict)
        for estimate in value.values():
            assert estimate.unit in ("1", "") or f" {estimate.unit} " in text


def test_a_curve_is_of_positions_and_forces(model: Model, shown: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "pictures", lambda subject: "")
    curve = [-0.5, 0.0, 0.5, -20.0, 0.0, 30.0]
    for joint, heads in (("rail", "position [m] force [N]"), ("shoulder", "angle [rad] torque [N·m]")):
        finding = finding_of(on_both("joint_spring", (joint,), curve=curve))
        assert heads in text_of(report.page(Subject(verdict(finding), shown, model, model, "gantry.urdf")))


def test_axes_are_in_the_joints_units(shown: Shown) -> None:
    picture = pictures.residual_pictures(shown.holdout, 0, 0.03, False, prismatic=True)
    assert 'aria-label="residual force of rail"' in picture
    words = set(re.findall(r">([^<>]+)</text>", picture))
    assert {"measured − model [N]", "velocity [m/s]", "position [m]", "acceleration [m/s²]"} <= words
    assert not any("rad" in word or "N·m" in word for word in words)
    words = set(re.findall(r">([^<>]+)</text>", pictures.residual_pictures(shown.holdout, 1, 0.03, False)))
    assert {"measured − model [N·m]", "velocity [rad/s]", "angle [rad]", "acceleration [rad/s²]"} <= words


def test_bars_share_a_scale_with_their_unit_alone() -> None:
    """Where there is nothing beside them, 2 mm are not drawn as a hair beside 300 mrad."""
    size = np.array([2.0, 300.0, 150.0])
    svg = charts.bars(["a", "b", "c"], size, size, None, ["mm", "mrad", "mrad"], changed=False)
    wide = [float(x) for x in re.findall(r'width="([\d.]+)" height="13"', svg)]
    assert wide[0] == wide[1] == pytest.approx(2.0 * wide[2], rel=1e-3)
    assert all(text in svg for text in ("2.00 mm", "300 mrad", "150 mrad"))
    most = np.array([1.0, 3141.6, 3141.6])
    svg = charts.bars(["a", "b", "c"], size, size, None, ["mm", "mrad", "mrad"], most=most)
    assert "&gt; 1.00 mm" in svg and "&gt; 300" not in svg


def test_a_slide_is_lost_beyond_its_travel(model: Model, shown: Shown) -> None:
    own = Subject(verdict(), shown, model, model, "gantry.urdf")
    np.testing.assert_allclose(lost(own), [2.0, np.pi])
    far = replace(shown, holdout=replace(shown.holdout, rollout_before=np.array([9.0, 0.1])))
    assert "> 2000 mm error" in text_of(report.page(replace(own, shown=far)))


def test_an_arm_of_prismatic_joints_alone(tmp_path: Path) -> None:
    text = gantry(tmp_path).read_text().replace('type="revolute"', 'type="prismatic"')
    (tmp_path / "xy.urdf").write_text(text)
    model = Model.load(ArmModel(model=str(tmp_path / "xy.urdf"), joints=list(JOINTS), tool_frame=""))
    logs = [bench.run(model, seed=1020 + k, duration=2.5) for k in range(2)]
    own = show(model, model, logs[:1], logs[1], np.full(2, 0.03))
    made = trajectories.design(advice.SLOW, trajectories.visited(model, logs), [])
    assert made is not None
    subject = Subject(verdict(), own, model, model, "xy.urdf", [(made, "experiments/1.csv")])
    page = text_of(report.page(subject))
    assert "given [N] noise" in page and "all joints together" in page and "in metres" in page
    assert "N·m" not in page and "rad" not in page


# Places and experiments.


def test_where_is_said_of_positions() -> None:
    assert said("angle", prismatic=True) == "with position" and said("angle", prismatic=False) == "with angle"
    assert all(said(key, prismatic=True) == CONDITIONS[key] for key in CONDITIONS if key != "angle")


def test_experiments_are_worded_for_their_joints(shown: Shown) -> None:
    near = gap_json.contents(verdict(), shown)["separation"]
    assert [pair["experiment"] for pair in near] == [
        "sweep each joint at constant speeds from 0.02 m/s to its limit, both ways",
        "reverse slowly at 0.02 rad/s, about many angles",
        "reverse slowly at 0.02 rad/s or m/s, about many angles or positions",
        advice.STATIC,
    ]
    for text in trajectories.MAKERS:
        assert advice.worded(text, ["shoulder"], shown.prismatic) == text


@pytest.mark.parametrize("text", list(trajectories.MAKERS))
def test_experiments_keep_to_a_short_slow_slide(model: Model, text: str) -> None:
    """One that goes 4 cm at 15 mm/s at most, as lifts do."""
    seen = trajectories.visited(model, [bench.run(model, seed=1030, duration=4.0)])
    seen = replace(
        seen,
        lower=np.array([0.0, seen.lower[1]]),
        upper=np.array([0.04, seen.upper[1]]),
        poses=np.clip(seen.poses, [0.0, -9.0], [0.04, 9.0]),
        run=np.clip(seen.run, [0.0, -9.0], [0.04, 9.0]),
        speed=np.array([0.015, seen.speed[1]]),
    )
    made = trajectories.design(text, seen, ["rail"])
    assert made is not None and made.title == advice.worded(text, ["rail"], {"rail"})
    assert np.all(made.position[:, 0] >= 0.0) and np.all(made.position[:, 0] <= 0.04)
    speed = np.diff(made.position[:, 0]) / trajectories.TUNING.period
    if text in (advice.SLOW, advice.SPEEDS, advice.STATIC, advice.FAST):
        assert np.all(np.abs(speed) <= 1.02 * 0.015)
    if text == advice.SLOW:
        assert "reverse_slowly_at_0_02_m_s" == made.slug
        crawling = np.abs(np.abs(speed) - 0.015) < 1e-6
        assert np.sum(np.diff(np.sign(speed[crawling])) != 0) >= 15  # it turns where it is asked to, and is not clipped


def test_no_speed_beyond_the_descriptions_limit(folder: Path) -> None:
    slow = folder / "slow.urdf"
    slow.write_text(gantry(folder).read_text().replace('velocity="2"', 'velocity="0.03"'))
    model = Model.load(ArmModel(model=str(slow), joints=list(JOINTS), tool_frame=""))
    seen = trajectories.visited(model, [bench.run(model, seed=1031, duration=3.0)])
    assert seen.speed[0] == pytest.approx(0.027) and seen.prismatic == {"rail"}


# What the log's check says.


def test_a_rail_in_millimetres_is_no_arm_in_degrees(model: Model) -> None:
    log = bench.run(model, seed=1040, duration=3.0)
    millimetres = Log(log.time, JOINTS, log.position * [1e3, 1.0], torque=log.torque)
    with pytest.raises(LogError, match=r"position_measured.rail reaches .* -1 to 1 m; it looks like millimetres"):
        check(millimetres, model.limits)
    degrees = Log(log.time, JOINTS, log.position * [1.0, 180.0 / np.pi], torque=log.torque)
    with pytest.raises(LogError, match=r"position_measured.shoulder .* rad; it looks like degrees"):
        check(degrees, model.limits)
    assert check(log, model.limits) == []


def test_a_force_beyond_its_limit_is_one(model: Model) -> None:
    log = bench.run(model, seed=1041, duration=3.0)
    assert log.torque is not None
    strong = Log(log.time, JOINTS, log.position, torque=log.torque * [20.0, 1.0])
    (warning,) = check(strong, model.limits)
    assert re.search(r"the force of rail reaches .* its limit is 300 \(N, joint side\)", warning.message)


def test_joints_that_hold_a_curve_and_a_stiffness_are_told_apart(model: Model) -> None:
    """A finding of one name on both kinds of joint: one sentence, each part in its own units."""
    curve = finding_of(on_both("joint_spring", ("rail",), curve=[-0.5, 0.0, 0.5, -20.0, 0.0, 30.0])).parameters
    line = finding_of(on_both("joint_spring", ("shoulder",), stiffness=[9.0], rest_angle=[0.3])).parameters
    finding = Finding("joint_spring", JOINTS, (), {**curve, **line}, 0.9)
    assert len(specs_of(finding)) == 2
    assert sentence_of(finding, model.prismatic) == (
        "a spring on rail whose force follows a curve of the position, -20 to 30 N between -0.5 and 0.5 m; "
        "a spring of 9 N·m/rad on shoulder, at rest at 0.3 rad"
    )
