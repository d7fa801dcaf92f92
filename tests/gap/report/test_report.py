"""The report is one file that reads well whatever was found; gap.json keeps to its layout; experiments keep to "
"limits."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import gap_bench as bench
from twin_diagram.gap.candidates.records import RECORDS
from twin_diagram.gap.correction.named_effects import effects_of, sentence_of, specs_of
from twin_diagram.gap.experiments import advice, trajectories
from twin_diagram.gap.findings import Alternative, Estimate, Finding, Moment, Separation, Verdict
from twin_diagram.gap.report import charts, gap_json, numbers, words
from twin_diagram.gap.report import page as report
from twin_diagram.gap.report.comparison import Shown, above_noise, compare, show, told_of_held_out
from twin_diagram.gap.report.pictures import binned, picture
from twin_diagram.gap.report.subject import Subject
from twin_diagram.gap.workflow import accepted
from twin_diagram.model.effects import make
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import rollout_rms, torque_residual_rms

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

NOISE = 0.0275
"""What 0.1 N·m of white noise at 250 Hz leaves below 10 Hz [N·m]."""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(bench.arm(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def shown(model: Model) -> Shown:
    fit, held = (bench.run(model, [bench.dry()], seed=k, duration=4.0) for k in (1, 2))
    corrected = model.with_effects([*model.effects, *effects_of(bench.friction_finding())])
    return show(model, corrected, [fit], held, np.full(2, NOISE))


def subject(model: Model, shown: Shown, verdict: Verdict, **changes: object) -> Subject:
    added = [effect for finding in verdict.findings for effect in effects_of(finding)]
    corrected = model.with_effects([*model.effects, *added]) if added else model
    return Subject(verdict, shown, model, corrected, **{"name": "arm.urdf", **changes})  # type: ignore[arg-type]


VOID = {"meta", "img", "br", "rect", "circle", "line", "polyline"}


class Balance(HTMLParser):
    """Checks that tags close in order, and collects text and what would be loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loads += [value or "" for key, value in attrs if key in ("src", "srcset", "data", "xlink:href")]
        self.loads += [value or "" for key, value in attrs if key == "href" and tag != "a"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text.append(data)


def read(html: str) -> str:
    """A page's text, after a look at its structure: nothing open, nothing loaded from elsewhere, no script."""
    page = Balance()
    page.feed(html)
    assert page.open == []
    assert all(load.startswith("data:") for load in page.loads)
    assert "<script" not in html and "@import" not in html and not re.search(r"url\((?!data:)", html)
    return " ".join("".join(page.text).split())


# The page.


def test_named(model: Model, shown: Shown) -> None:
    verdict = bench.verdict("named", [bench.friction_finding(), bench.payload_finding()])
    text = read(report.page(subject(model, shown, verdict)))
    assert "The model lacks dry friction on elbow and a payload." in text
    for finding in verdict.findings:
        assert words.upper_first(sentence_of(finding)) in text
    assert "It could also be: a wrong torque constant on elbow (2 %)" in text
    assert "3.000 ± 0.020 N·m" in text and "(0.0100 ± 0.0010, 0.0000 ± 0.0010, 0.3000 ± 0.0040) m" in text
    assert "at velocity reversals" in text and "repeat with a known payload" in text
    assert "+- name: coulomb_friction" in text  # the model's difference
    before, after = shown.holdout_rms()
    assert numbers.number(before[1]) in text and numbers.number(after[1]) in text
    assert "very likely" in text and "practically certain" in text


def test_what_the_model_has_too_much_of_is_not_said_to_be_lacking(model: Model, shown: Shown) -> None:
    less = bench.friction_finding(-1.0)
    had = model.with_effects([make(bench.dry())])
    text = read(report.page(subject(had, shown, bench.verdict("named", [less]))))
    assert "The model has more than the arm of dry friction on elbow." in text and "The model lacks" not in text
    assert "Less coulomb friction than the model has, on elbow" in text
    both = words.headline(bench.verdict("named", [bench.payload_finding(), less]))
    assert both == "The model lacks a payload. It has more than the arm of dry friction on elbow."
    torque = {"shoulder": Estimate(2.0, 0.1, "N·m"), "elbow": Estimate(-1.0, 0.1, "N·m")}
    mixed = replace(less, joints=("shoulder", "elbow"), parameters={"torque": torque})
    assert words.headline(bench.verdict("named", [mixed])) == (
        "The model has another amount of dry friction on shoulder and elbow."
    )
    assert sentence_of(mixed) == "other coulomb friction than the model has, on shoulder, elbow"


def test_no_gap_is_not_said_to_be_closed_to_no_percent(model: Model, shown: Shown) -> None:
    loud = replace(shown, noise_floor=10.0 * shown.holdout_rms()[0])
    text = read(report.page(subject(model, loud, bench.verdict("named", [bench.friction_finding()]))))
    assert "of the gap above the noise is closed" not in text and "no gap" in text


def test_words_of_pictures_cannot_leave_their_attribute() -> None:
    assert 'aria-label="a&quot;&gt;b"' in picture("", 'a">b')


def test_what_is_next_to_impossible_and_what_holds_the_named_law_are_said_so(model: Model, shown: Shown) -> None:
    """Neither a rival of 0 % nor a wider law at distance 0 makes a name less sure."""
    finding = bench.friction_finding()
    never = replace(finding.alternatives[0], probability=0.001)
    wider = Separation("coulomb_friction on elbow", "stribeck_friction on elbow", 0.0, "reverse slowly")
    told = replace(bench.verdict("named", [replace(finding, alternatives=(never,))]), separation=(wider,))
    text = read(report.page(subject(model, shown, told)))
    assert "could also be" not in text
    assert "what it has more is too small to show here; reverse slowly" in text
    far = replace(told, separation=(replace(wider, distance=9.0),))
    assert "too small to show" not in read(report.page(subject(model, shown, far)))


def test_what_suits_the_runs_as_well_is_said_to_have_been_decided_by_how_usual_it_is(
    model: Model, shown: Shown
) -> None:
    """A distance of 0 alone would not say what then decided."""
    near = Separation("payload on wrist_3_link", "inertial_parameters on forearm_link", 0.0, "static poses")
    told = replace(bench.verdict("named", [bench.friction_finding()]), separation=(near,))
    assert "how usual each is decided, not the data; static poses" in read(report.page(subject(model, shown, told)))
    far = replace(told, separation=(replace(near, distance=1.1),))
    assert "how usual each is" not in read(report.page(subject(model, shown, far)))


def test_where_nothing_was_found_nothing_is_said_to_come_near_it(model: Model, shown: Shown) -> None:
    text = read(report.page(subject(model, shown, bench.verdict("none", []))))
    assert "comes near" not in text and "no effect that the model lacks" in text
    assert "nothing has a name yet" in read(report.page(subject(model, shown, bench.verdict("unknown", []))))


def test_a_held_out_run_that_exercises_nothing_proves_nothing(shown: Shown) -> None:
    """It neither confirms nor denies; one that gets worse denies."""
    verdict = bench.verdict("named", [bench.friction_finding()])
    assert shown.is_exercised() and accepted(verdict, shown)
    same = replace(shown, holdout=replace(shown.holdout, after=shown.holdout.before))
    assert not same.is_exercised() and not same.shrinks() and accepted(verdict, same)
    worse = replace(shown, holdout=replace(shown.holdout, after=1.1 * shown.holdout.before))
    assert worse.is_exercised() and not accepted(verdict, worse)


def test_one_joint_mended_at_anothers_cost_denies_a_name(shown: Shown) -> None:
    """Though the gap shrinks on the whole: by more than noise differs from run to run, from noise that is as large."""
    verdict = bench.verdict("named", [bench.friction_finding()])
    shrunk = np.array(shown.holdout.after)
    mended = int(np.argmax(shown.holdout_rms()[0] / shown.noise_floor))
    other = (mended + 1) % len(shown.joints)
    least = 1.25 * max(shown.holdout_rms()[0][other], 1.25 * shown.noise_floor[other])
    for factor, allowed in ((0.7, True), (0.98, True), (1.02, False), (1.3, False)):
        shrunk[:, other] = factor * least * np.where(np.arange(len(shrunk)) % 2, 1.0, -1.0)
        tried = replace(shown, holdout=replace(shown.holdout, after=shrunk))
        assert tried.shrinks() and tried.worsens() != allowed
        assert accepted(verdict, tried) == allowed


def test_a_gap_that_a_corrected_model_makes_counts(shown: Shown) -> None:
    """Where the given one left noise alone."""
    made = np.array(shown.holdout.after)
    made[:, 0] = 30.0 * NOISE * np.where(np.arange(len(made)) % 2, 1.0, -1.0)
    worse = replace(shown, holdout=replace(shown.holdout, after=made))
    before, after = (above_noise(x, NOISE) for x in worse.holdout_rms())
    assert shown.left_over() < 0.05
    assert worse.left_over() == pytest.approx(np.linalg.norm(after) / np.linalg.norm(before), rel=1e-6)


def test_a_held_out_run_that_is_another_robots_is_told(shown: Shown) -> None:
    """As where a load was put down between the runs: the line that people read does not say that little is left."""
    assert shown.unexplained() == () and told_of_held_out(shown, ()) == []
    other = np.array(shown.holdout.before)
    other[:, 1] += 200.0 * NOISE * np.sign(np.sin(shown.holdout.time))
    held = replace(shown, holdout=replace(shown.holdout, before=other, after=other))
    joint = shown.joints[1]
    assert joint in held.unexplained() and joint in told_of_held_out(held, held.unexplained())[0]
    plain = bench.verdict("none", [])
    assert "The model explains these runs" in words.headline(plain)
    assert f"not the held-out one, on {joint}" in words.headline(replace(plain, unexplained=(joint,)))
    found = bench.verdict("named", [bench.friction_finding()])
    assert f"The held-out run is not explained on {joint}." in words.headline(replace(found, unexplained=(joint,)))


@pytest.mark.long
def test_several_joints_are_lines_of_one_table(model: Model, shown: Shown) -> None:
    """A column per parameter, and what is sure although the kind of dry friction is not."""
    first, second = (Estimate(value, 0.1, "N·m") for value in (3.0, 4.0))
    rival = Alternative("stribeck_friction", ("elbow",), (), 0.6)
    finding = Finding(
        "coulomb_friction", ("shoulder", "elbow"), (), {"torque": {"shoulder": first, "elbow": second}}, 0.4, (rival,)
    )
    html = report.page(subject(model, shown, bench.verdict("named", [finding])))
    text = read(html)
    assert "joint torque shoulder 3.00 ± 0.10 N·m elbow 4.00 ± 0.10 N·m".replace(" ", "") in text.replace(" ", "")
    assert "In all of these there is dry friction" in text
    other = replace(finding, alternatives=(replace(rival, name="torque_constant"),))
    text = read(report.page(subject(model, shown, bench.verdict("named", [other]))))
    assert "In all of these there is dry friction" not in text


def test_several_links_are_lines_of_one_table_and_not_told_one_by_one(model: Model, shown: Shown) -> None:
    mass, com = Estimate(32.0, 24.0, "kg"), Estimate([0.1, 0.0, 0.0], [0.2, 0.1, 0.1], "m")
    inertia = Estimate([0.0] * 6, [0.01] * 6, "kg·m²")
    each = {key: {"upper": x, "lower": x} for key, x in (("mass", mass), ("com", com), ("inertia", inertia))}
    links = Finding("inertial_parameters", (), ("upper", "lower"), each, 0.999)
    text = read(report.page(subject(model, shown, bench.verdict("named", [links]))))
    assert "upper and lower is other than described; motion tells sums of these numbers better than each" in text
    assert "+32" not in text, "no mass without its error"
    assert "link" + "mass" + "centre of mass" + "inertia" + "upper32 ± 24 kg" in text and "joint" + "mass" not in text


def test_what_stands_in_the_bars_drawing_can_be_read() -> None:
    """Names of a UR's joints are whole, and the noise's mark crosses no value: at 0.7 of the way it did."""
    residual = np.array([0.00946, 0.00874])
    svg = charts.bars(["shoulder_pan_joint", "elbow_joint"], residual, residual, np.array([0.0135, 0.0115]), "N·m")
    assert ">shoulder_pan_joint<title>" in svg
    marks = [float(x) for x in re.findall(r'<line x1="([\d.]+)"', svg)]
    values = [float(x) for x in re.findall(r'<text x="([\d.]+)" y="[\d.]+" class="value">', svg)]
    assert len(marks) == 2 and len(values) == 4
    for mark, *texts in zip(marks, values[::2], values[1::2], strict=True):
        assert all(not x < mark < x + 11 * charts.LETTER for x in texts), (mark, texts)


def test_a_lost_arm_says_no_more_than_that() -> None:
    svg = charts.bars(["a", "b"], np.array([4e5, 2.0]), np.array([3.0, 1.0]), None, "mrad", most=3141.6)
    assert "&gt; 3142 mrad" in svg and "e+05" not in svg and "2.00 mrad" in svg


def test_remainder_is_said(model: Model, shown: Shown) -> None:
    text = read(report.page(subject(model, shown, bench.verdict("named", [bench.friction_finding()], remainder=True))))
    assert "Something more is there that no effect of the catalogue explains." in text
    assert "Structure is left beside what was named" in text


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("none", "The model explains these runs. Nothing is missing that they could show."),
        ("unknown", "Something is missing from the model, and no effect of the catalogue explains it."),
    ],
)
def test_without_names(model: Model, kind: str, says: str) -> None:
    effects = [] if kind == "none" else [bench.dry()]
    fit, held = (bench.run(model, effects, seed=k, duration=3.0) for k in (1, 2))
    own = show(model, model, [fit], held, np.full(2, NOISE))
    text = read(report.page(subject(model, own, bench.verdict(kind))))
    assert says in text
    assert "corrected" not in text.lower()  # there is no such model to speak of
    assert "noise" in text


def test_what_was_left_before_is_not_said_to_be_noise(model: Model, shown: Shown) -> None:
    """Of a model that was corrected before, `none` says that nothing is new."""
    before, _ = shown.holdout_rms()
    verdict = replace(bench.verdict("none"), recorded=before)
    text = read(report.page(subject(model, shown.uncorrected(), verdict)))
    assert "Nothing new is missing: these runs leave no more than was left when this model was corrected." in text
    assert "What is left is noise" not in text and "explains these runs" not in text and "but for noise" not in text
    assert f"the noise is {numbers.number(NOISE)}" in text


def test_smoothed_logs_are_not_said_to_be_free_of_noise(model: Model) -> None:
    logs = [bench.run(model, seed=k, duration=3.0) for k in (1, 2)]
    own = show(model, model, logs[:1], logs[1], np.full(2, 1e-9))
    np.testing.assert_allclose(own.noise_floor, 5e-4 * np.sqrt(np.mean(own.fit[0].torque ** 2, axis=0)), rtol=1e-9)


def test_pages_repeat_to_the_byte(model: Model, shown: Shown) -> None:
    verdict = bench.verdict("named", [bench.friction_finding()])
    assert report.page(subject(model, shown, verdict)) == report.page(subject(model, shown, verdict))


def test_hostile_names_are_text(model: Model, shown: Shown) -> None:
    name = '<b>"arm"</b>&amp;<script>alert(1)</script>'
    html = report.page(subject(model, shown, bench.verdict("unknown"), name=name, notes=["<img src=x>"]))
    assert "alert(1)" in html
    assert name.split("&")[0] in read(html)


def test_onset_is_marked_and_said(model: Model, shown: Shown) -> None:
    finding = bench.friction_finding(onset=bench.begin(0, 1.5))
    text = read(report.page(subject(model, shown, bench.verdict("named", [finding]))))
    assert "from 1.500 ± 0.01 s on" in text
    assert text.count("· fitted run") == 1  # where the onset is


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium")
def test_a_browser_shows_it(model: Model, shown: Shown, tmp_path: Path) -> None:
    from PIL import Image

    page = tmp_path / "report.html"
    page.write_text(report.page(subject(model, shown, bench.verdict("named", [bench.friction_finding()]))))
    picture = tmp_path / "report.png"
    flags = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    subprocess.run(
        [str(BROWSER), *flags, "--window-size=1100,3000", f"--screenshot={picture}", page.as_uri()],
        check=True,
        capture_output=True,
        timeout=120,
    )
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    for colour in ((217, 119, 43), (36, 99, 166)):  # both models are drawn
        assert np.sum(np.all(np.abs(pixels.astype(int) - colour) < 12, axis=1)) > 1000


# Words and numbers.


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e3))
def test_value_is_within_its_rounded_error(value: float, std: float) -> None:
    said = numbers.with_error(Estimate(value, std, "1"))
    number, error = (float(part) for part in said.split(" ± "))
    assert abs(number - value) <= 0.51 * max(std, 1e-3 * abs(value))
    assert error == pytest.approx(std, rel=0.06)


@pytest.mark.parametrize(
    ("share", "said"), [(0.0, "0 %"), (0.004, "< 1 %"), (0.5, "50 %"), (0.996, "> 99 %"), (1.0, "100 %")]
)
def test_no_share_is_rounded_to_certainty(share: float, said: str) -> None:
    assert words.percent(share) == said


def test_every_name_of_the_catalogue_has_words() -> None:
    from twin_diagram.model.effects import REGISTRY

    along = {name for name, cls in REGISTRY.items() if cls.__module__.startswith("twin_diagram.model.effects.")}
    assert along == set(RECORDS) and all(words.title(name) and words.explanation(name) for name in along)


def test_binned_medians_follow_a_curve() -> None:
    x = np.linspace(-1.0, 1.0, 4001)
    centres, medians = binned(x, x**3)
    np.testing.assert_allclose(medians, centres**3, atol=2e-3)
    centres, medians = binned(np.zeros(5), np.arange(5.0))  # a joint that does not move
    assert centres.tolist() == [0.0] and medians.tolist() == [2.0]


# gap.json.


def test_layout_of_gap_json(shown: Shown) -> None:
    verdict = bench.verdict("named", [bench.friction_finding(onset=bench.begin(0, 1.5)), bench.payload_finding()])
    answer = json.loads(gap_json.text(gap_json.contents(verdict, shown)))
    assert list(answer) == ["verdict", "remainder", "effects", "where", "gap", "separation"]
    friction, payload = answer["effects"]
    assert set(friction) == {
        "name", "joints", "links", "parameters", "confidence", "alternatives", "onset", "end"
    }  # fmt: skip
    assert friction["parameters"] == {"torque": {"elbow": {"value": 3.0, "std": 0.02, "unit": "N·m"}}}
    assert friction["onset"] == 1.5 and friction["end"] is None
    assert payload["parameters"]["mass"] == {"value": 0.5, "std": 0.01, "unit": "kg"}
    assert payload["parameters"]["com"]["value"] == [0.01, 0.0, 0.3]
    assert payload["joints"] == [] and payload["links"] == ["lower"]
    assert friction["alternatives"] == [{"name": "torque_constant", "joints": ["elbow"], "probability": 0.02}]
    torque, position = answer["gap"]["torque_rms"], answer["gap"]["rollout_position_rms"]
    assert set(torque) == {"fit", "holdout", "noise_floor"}
    assert set(torque["fit"]) == set(torque["holdout"]) == set(position["holdout"]) == {"before", "after"}
    assert set(torque["holdout"]["after"]) == set(position["holdout"]["before"]) == set(bench.JOINTS)
    assert answer["where"] == [
        {"joint": "elbow", "share": 0.9, "condition": "at velocity reversals", "time": [0.4, 7.1]}
    ]
    assert set(answer["separation"][0]) == {"a", "b", "distance", "experiment"}


def test_onset_says_its_log_where_there_are_several(model: Model) -> None:
    logs = [bench.run(model, seed=k, duration=3.0) for k in range(3)]
    shown = show(model, model, logs[:2], logs[2], np.full(2, 0.05))
    verdict = bench.verdict("named", [bench.friction_finding(onset=bench.begin(1, 8.0))])
    assert gap_json.contents(verdict, shown)["effects"][0]["onset"] == {"log": 1, "time": 8.0}


@pytest.mark.long
def test_a_page_counts_logs_as_gap_json_does(model: Model) -> None:
    """One that went silent was parted into two runs, but is one file."""
    logs = [replace(bench.run(model, seed=k, duration=3.0), source=name) for k, name in enumerate("aabh")]
    shown = show(model, model, logs[:3], logs[3], np.full(2, 0.05))
    late = bench.verdict("named", [bench.friction_finding(onset=bench.begin(2, 1.5))])
    late = replace(late, where=(replace(late.where[0], log=2),))
    text = read(report.page(subject(model, shown, late)))
    assert "against 2 fitted runs" in text and "s of log 2 on" in text and "7.10 s of log 2" in text
    one = replace(shown, fit=shown.fit[:2])
    assert "of log" not in read(report.page(subject(model, one, bench.verdict("unknown"))))


def test_no_number_that_is_not_json(shown: Shown) -> None:
    finding = bench.friction_finding(parameters={"torque": {"elbow": Estimate(np.nan, np.inf, "N·m")}})
    answer = json.loads(gap_json.text(gap_json.contents(bench.verdict("named", [finding]), shown)))
    assert answer["effects"][0]["parameters"]["torque"]["elbow"] == {"value": None, "std": None, "unit": "N·m"}


# The gap.


def test_figures_are_those_of_predict(model: Model) -> None:
    log = bench.run(model, [bench.dry()], seed=3, duration=3.0)
    corrected = model.with_effects([*model.effects, *effects_of(bench.friction_finding())])
    run = compare(model, corrected, log, held_out=True, horizon=0.2)
    for values, each in ((run.before, model), (run.after, corrected)):
        np.testing.assert_allclose(np.sqrt(np.mean(values**2, axis=0)), torque_residual_rms(each, log), rtol=1e-9)
    for rolled, each in ((run.rollout_before, model), (run.rollout_after, corrected)):
        assert rolled is not None
        np.testing.assert_allclose(rolled, rollout_rms(each, log), rtol=1e-6)


def test_the_gap_closes_to_the_noise(shown: Shown) -> None:
    before, after = shown.holdout_rms()
    assert before[1] == pytest.approx(3.0, rel=0.1)  # the friction
    assert after[1] < 0.06  # the noise, below 10 Hz
    assert shown.has_gap().tolist() == [False, True]
    assert shown.left_over() < 0.05


@given(st.floats(0.0, 1e3), st.floats(1e-6, 1e3))
def test_noise_is_taken_off_in_squares(signal: float, noise: float) -> None:
    whole = np.array([np.hypot(signal, noise)])
    assert above_noise(whole, np.array([noise]))[0] == pytest.approx(signal, rel=1e-5, abs=1e-5 * noise)


# A finding as effects.


def test_specs_follow_what_each_joint_holds() -> None:
    curve = Estimate([0.0, 1.0, 2.0, 0.0, 5.0, 6.0], [0.0] * 6, "rad, N·m")
    finding = Finding(
        "joint_spring",
        ("shoulder", "elbow"),
        (),
        {
            "stiffness": {"elbow": Estimate(4.0, 0.1, "N·m/rad")},
            "rest_angle": {"elbow": Estimate(0.2, 0.01, "rad")},
            "curve": {"shoulder": curve},
        },
        0.9,
    )
    one, other = specs_of(finding)
    assert (one.joints, set(one.parameters)) == (["shoulder"], {"curve"})
    assert (other.joints, other.parameters) == (["elbow"], {"stiffness": [4.0], "rest_angle": [0.2]})
    assert len(effects_of(finding)) == 2


def test_shared_parameters_are_one() -> None:
    torque = {joint: Estimate(0.4, 0.1, "N·m") for joint in bench.JOINTS}
    damping = {joint: Estimate(0.1, 0.1, "N·m·s/rad") for joint in bench.JOINTS}
    finding = Finding("coupled_friction", bench.JOINTS, (), {"damping": damping, "torque": torque}, 0.9)
    (spec,) = specs_of(finding)
    assert spec.parameters == {"damping": [0.1], "torque": [0.4]}


def test_less_than_the_model_has_is_said_all_the_same() -> None:
    assert "elbow" in sentence_of(bench.friction_finding(torque=-1.0))


# Experiments.


@pytest.mark.parametrize("text", list(trajectories.MAKERS))
def test_experiments_stay_where_the_arm_has_been(model: Model, text: str) -> None:
    seen = trajectories.visited(model, [bench.run(model, seed=k) for k in (1, 2)])
    made = trajectories.design(text, seen, ["elbow"])
    assert made is not None and made.moved == ("elbow",)
    q, step = made.position, trajectories.TUNING.period
    assert np.all(q >= seen.lower - 1e-12) and np.all(q <= seen.upper + 1e-12)
    assert np.all(np.abs(np.diff(q, axis=0)) / step <= 1.02 * seen.speed + 1e-9)
    assert np.all(np.abs(np.diff(q, axis=0)) / step <= model.velocity_limit)
    assert np.allclose(np.diff(made.time), step) and made.time[-1] < 600.0
    assert list(made.columns()) == ["time", "position_commanded.shoulder", "position_commanded.elbow"]
    np.testing.assert_array_equal(q, trajectories.design(text, seen, ["elbow"]).position)  # type: ignore[union-attr]


@pytest.mark.parametrize("text", list(trajectories.MAKERS))
@pytest.mark.parametrize("stated", [True, False])
def test_experiments_never_jump(model: Model, tmp_path: Path, text: str, stated: bool) -> None:
    """Also where the run was cut in motion, far from the middle, and where the description states a speed of zero."""
    if not stated:
        (tmp_path / "arm.urdf").write_text(bench.URDF.replace('velocity="3"', 'velocity="0"'))
        model = Model.load(tmp_path / "arm.urdf")
    run = bench.run(model, seed=3)
    moving = float(run.time[np.argmax(np.abs(np.gradient(run.position[:, 1], run.time))[:1000])])
    seen = trajectories.visited(model, [run.between(moving, 7.0)])
    made = trajectories.design(text, seen, model.joints)
    assert made is not None
    step = trajectories.TUNING.period
    speed = np.diff(made.position, axis=0, prepend=made.position[:1], append=made.position[-1:]) / step
    acceleration = np.abs(np.diff(speed, axis=0)) / step
    assert np.all(acceleration < 4.0 * np.maximum(seen.acceleration, 2.0 * seen.speed))


def test_slow_reversals_are_slow_and_turn(model: Model) -> None:
    seen = trajectories.visited(model, [bench.run(model, seed=1)])
    made = trajectories.design(advice.SLOW, seen, ["elbow"])
    assert made is not None
    speed = np.diff(made.position[:, 1]) / trajectories.TUNING.period
    crawling = np.abs(np.abs(speed) - 0.02) < 1e-6
    assert np.sum(crawling) > 1000
    assert np.sum(np.diff(np.sign(speed[crawling])) != 0) >= 15


def test_speeds_span_what_was_seen(model: Model) -> None:
    seen = trajectories.visited(model, [bench.run(model, seed=1)])
    made = trajectories.design(advice.SPEEDS, seen, ["shoulder"])
    assert made is not None
    speed = np.abs(np.diff(made.position[:, 0])) / trajectories.TUNING.period
    assert np.sum(np.abs(speed - 0.02) < 1e-3) > 100 and speed.max() > 0.5 * seen.speed[0]
    assert np.ptp(made.position[:, 1]) == 0.0


def test_every_experiment_that_can_be_asked_for_has_a_motion() -> None:
    asked = {value for name, value in vars(advice).items() if name.isupper() and isinstance(value, str)}
    assert asked == set(trajectories.MAKERS)
    made = trajectories.design("ask the robot's maker", trajectories.Visited((), *[np.zeros((0, 0))] * 6), [])
    assert made is None


def test_what_is_of_the_same_name_at_other_times_is_told_beside_it(shown: Shown) -> None:
    """Two loads, one of which comes twice: an entry per name is the layout."""

    def held(mass: float, onset: float, end: float) -> Finding:
        size = {"mass": Estimate(mass, 0.01, "kg")}
        return Finding("payload", (), ("lower",), size, 0.9, onset=Moment(0, onset), end=Moment(0, end))

    friction = bench.friction_finding(1.0)
    found = (held(1.5, 2.0, 6.0), friction, held(0.6, 7.0, 8.5), held(1.5, 9.0, 9.5))
    verdict = Verdict("named", False, found, (), (), np.ones(2))
    load, dry = gap_json.contents(verdict, shown)["effects"]
    assert (load["onset"], load["end"], load["parameters"]["mass"]["value"]) == (2.0, 6.0, 1.5)
    told = [(one["onset"], one["end"], one["parameters"]["mass"]["value"], one["links"]) for one in load["others"]]
    assert told == [(7.0, 8.5, 0.6, ["lower"]), (9.0, 9.5, 1.5, ["lower"])]
    assert "others" not in dry
