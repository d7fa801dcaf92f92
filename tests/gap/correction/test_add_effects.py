"""Adding what was named: parameters are refined to the truth with honest errors; changed models stay one model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.model.effects.test_effects_in_time import ARM, JOINTS, ROTORS, recorded
from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.candidates.inertial_parameters import inertia_values
from twin_diagram.gap.correction import add_effects
from twin_diagram.gap.correction.add_effects import add
from twin_diagram.gap.correction.equation_error import Hypothesis, by_torque
from twin_diagram.gap.correction.gauss_newton import Solution, minimise
from twin_diagram.gap.correction.merge_effects import merged
from twin_diagram.gap.correction.physical_coordinates import Coordinates, from_log_cholesky, log_cholesky
from twin_diagram.gap.findings import Estimate, Finding, Moment
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.residuals.whitening import estimate, noise_below
from twin_diagram.logs import Log, fingerprint, resample
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.effects import make
from twin_diagram.model.effects.inertia import point_mass
from twin_diagram.model.effects.link_inertia import InertialParameters
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual_rms
from twin_diagram.scenario import EffectSpec

LEVEL = np.array([0.3, 0.3, 0.2, 0.2, 0.05, 0.05, 0.05])
"""Of the torque noise [N·m]."""


def tuned(monkeypatch: pytest.MonkeyPatch, **values: float) -> None:
    """Has constants of `add_effects` be others."""
    monkeypatch.setattr(add_effects, "TUNING", replace(add_effects.TUNING, **values))  # type: ignore[arg-type]


def noisy(log: Log, seed: int) -> Log:
    assert log.torque is not None
    noise = np.random.default_rng(seed).normal(size=log.torque.shape) * LEVEL
    lsb = 2.0 * np.pi / 2**18
    return replace(log, torque=log.torque + noise, position=np.round(log.position / lsb) * lsb)


def per_joint(joint: str, **values: float) -> dict[str, Estimate | dict[str, Estimate]]:
    return {key: {joint: Estimate(value, 0.0, "")} for key, value in values.items()}


FINDINGS: dict[str, tuple[EffectSpec, dict[str, Estimate | dict[str, Estimate]]]] = {
    "coulomb_friction": (
        EffectSpec("coulomb_friction", [JOINTS[3]], [], {"torque": [4.0]}),
        per_joint(JOINTS[3], torque=3.0),
    ),
    "torque_constant": (
        EffectSpec("torque_constant", [JOINTS[1]], [], {"gain": [0.85]}),
        per_joint(JOINTS[1], gain=0.95),
    ),
    "payload": (
        EffectSpec("payload", [], [], {"mass": [1.5], "com": [0.02, 0.0, 0.08]}),
        {"mass": Estimate(1.0, 0.0, "kg"), "com": Estimate([0.0, 0.0, 0.05], [0.0] * 3, "m")},
    ),
    "joint_elasticity": (
        EffectSpec("joint_elasticity", [JOINTS[1]], [], {"stiffness": [3e3], "rotor_inertia": [0.3]}),
        per_joint(JOINTS[1], stiffness=2.4e3, rotor_inertia=0.1),
    ),
}


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "coulomb_friction",
        pytest.param("payload", marks=pytest.mark.slow),
        pytest.param("torque_constant", marks=pytest.mark.slow),
        pytest.param("joint_elasticity", marks=pytest.mark.slow),
    ],
)
def test_parameters_come_to_the_truth(name: str) -> None:
    """Within 3 % or two standard errors of it, whichever is more, and four in any case; these are below 15 %."""
    spec, rough = FINDINGS[name]
    step = 0.0005 if name == "joint_elasticity" else 0.001  # a plant's step damps a gear's swing as a softer gear would
    log = noisy(recorded(spec, dt=step, duration=6.0).between(0.3, 6.0), 1)
    model = Model.load(ARM)
    finding = Finding(spec.name, tuple(spec.joints), ("panda_link8",)[:0], rough, 0.9)
    result = add(model, [log], [finding])
    assert result.notes == ()
    for key, true in spec.parameters.items():
        told = result.findings[0].parameters[key]
        told = told if isinstance(told, Estimate) else told[spec.joints[0]]
        value, std = np.atleast_1d(told.value), np.atleast_1d(told.std)
        size = np.linalg.norm(true)
        assert np.linalg.norm(value - true) < max(0.03 * size, 2.0 * np.linalg.norm(std)), (key, value, std)
        assert np.all(np.abs(value - true) < 4.0 * std), (key, value, std)
        assert np.all(std < 0.15 * size)
    whole = torque_residual_rms(Model.load(replace(ARM, effects=[ROTORS, spec])), log)
    assert np.all(torque_residual_rms(result.model, log) < 1.05 * whole)


@pytest.mark.slow
def test_onset_belongs_to_its_run(tmp_path: Path) -> None:
    """In the run that it was found in, a fault starts; in later ones it is there; both survive saving."""
    spec = EffectSpec("actuator_fault", [JOINTS[3]], [], {"gain": [0.6]}, onset=1.5)
    log = noisy(recorded(spec), 2)
    later = noisy(recorded(replace(spec, onset=None)), 3)
    model = Model.load(ARM)
    finding = Finding(spec.name, (JOINTS[3],), (), per_joint(JOINTS[3], gain=0.7), 0.9, onset=Moment(0, 1.62))
    result = add(model, [log], [finding])
    onset = result.findings[0].onset
    assert onset is not None
    assert abs(onset.time - 1.5) < 0.02
    assert onset.std < 0.05
    result.model.save(tmp_path / "corrected")
    corrected = Model.load(tmp_path / "corrected")
    floor = 0.25 * LEVEL  # white noise leaves a fifth of itself below 10 Hz
    for run in (log, later):
        assert np.all(torque_residual_rms(corrected, run) < floor)
    other = replace(log, position=log.position + 1e-5)  # repeats the schedule, and is another run
    assert torque_residual_rms(corrected, other)[3] > 1.0
    assert fingerprint(resample(log, log.time[5:-5])) == fingerprint(log) != fingerprint(later)


@pytest.mark.slow
def test_rough_values_that_are_kept_are_not_taken_for_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search knows shapes and times to a grid's step only, and says nothing of their errors."""
    spec = EffectSpec("coulomb_friction", [JOINTS[3]], [], {"torque": [4.0]}, onset=1.5)
    log = noisy(recorded(spec), 2)

    def astray(hypothesis: Hypothesis, records: Records, *, coloured: bool = True) -> tuple[Hypothesis, Solution]:
        found, solution = by_torque(hypothesis, records, coloured=coloured)
        return found, replace(solution, vector=4.0 * solution.vector)

    monkeypatch.setattr("twin_diagram.gap.correction.add_effects.by_torque", astray)
    tuned(monkeypatch, most_by_motion=0)
    finding = Finding(spec.name, (JOINTS[3],), (), per_joint(JOINTS[3], torque=4.2), 0.9, onset=Moment(0, 1.6))
    result = add(Model.load(ARM), [log], [finding])
    assert "kept" in result.notes[-1]
    (told,) = result.findings
    estimate = told.parameters["torque"]
    assert isinstance(estimate, dict)
    assert estimate[JOINTS[3]].value == pytest.approx(4.2)
    assert isinstance(estimate[JOINTS[3]].std, float) and estimate[JOINTS[3]].std > 0.2
    assert told.onset is not None and told.onset.time == 1.6 and told.onset.std >= 0.1


@pytest.mark.long
def test_a_value_at_its_bound_has_an_error_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = EffectSpec("actuator_fault", [JOINTS[3]], [], {"gain": [0.6]}, onset=1.5)
    log = noisy(recorded(spec), 2)

    def whole(hypothesis: Hypothesis, records: Records, *, coloured: bool = True) -> tuple[Hypothesis, Solution]:
        return hypothesis, Solution(np.array([1.0 + 1e-9]), np.array([[1e-4]]), 0.0)

    monkeypatch.setattr("twin_diagram.gap.correction.add_effects.by_torque", whole)
    tuned(monkeypatch, most_by_motion=0)
    tuned(monkeypatch, worse=np.inf)
    finding = Finding(spec.name, (JOINTS[3],), (), per_joint(JOINTS[3], gain=0.99), 0.9, onset=Moment(0, 1.5))
    told = add(Model.load(ARM), [log], [finding]).findings[0].parameters["gain"]
    assert isinstance(told, dict)
    assert told[JOINTS[3]].value == 1.0
    assert told[JOINTS[3]].std == pytest.approx(0.01, rel=1e-3)


FRICTION = EffectSpec("coulomb_friction", list(JOINTS[:3]), [], {"torque": [3.0, 2.0, 1.0]})


def values(model: Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return model.inverse_dynamics(q, v, np.zeros_like(q))


@pytest.mark.parametrize(
    ("there", "more", "together"),
    [
        (FRICTION, EffectSpec("coulomb_friction", [JOINTS[1]], [], {"torque": [-0.5]}), {"torque": [3.0, 1.5, 1.0]}),
        (FRICTION, EffectSpec("coulomb_friction", [JOINTS[4]], [], {"torque": [0.5]}), None),
        (
            EffectSpec("payload", [], [], {"mass": [2.0], "com": [0.0, 0.0, 0.1]}),
            EffectSpec("payload", [], [], {"mass": [-1.0], "com": [0.0, 0.0, 0.1]}),
            {"mass": [1.0], "com": [0.0, 0.0, 0.1]},
        ),
        (
            EffectSpec("torque_constant", [JOINTS[0]], [], {"gain": [0.9]}),
            EffectSpec("torque_constant", [JOINTS[0]], [], {"gain": [0.8]}),
            {"gain": [0.72]},
        ),
        (
            EffectSpec("joint_spring", [JOINTS[0]], [], {"stiffness": [30.0], "rest_angle": [0.1]}),
            EffectSpec("joint_spring", [JOINTS[0]], [], {"stiffness": [10.0], "rest_angle": [0.5]}),
            {"stiffness": [40.0], "rest_angle": [0.2]},
        ),
    ],
)
def test_coefficients_add_up(there: EffectSpec, more: EffectSpec, together: dict[str, list[float]] | None) -> None:
    model = Model.load(replace(ARM, effects=[there]))
    effects = merged(model.effects, [more])
    result = model.with_effects(effects)
    spread: dict[tuple[str, str], Any] = {
        (joint, key): value
        for effect in result.effects
        for key, parameter in effect.parameters.items()
        for joint, value in zip(
            effect.joints or ("",),
            [parameter.value.tolist()] if not effect.joints else parameter.value.tolist(),
            strict=True,
        )
    }
    if together is not None:
        for key, expected in together.items():
            wanted = [expected] if not there.joints else expected
            for joint, value in zip(there.joints or [""], wanted, strict=True):
                np.testing.assert_allclose(spread[joint, key], np.array(value))


def test_what_is_taken_away_must_be_there() -> None:
    model = Model.load(replace(ARM, effects=[FRICTION]))
    less = EffectSpec("coulomb_friction", [JOINTS[0]], [], {"torque": [-3.5]})
    with pytest.raises(ModelError, match="not within"):
        model.with_effects(merged(model.effects, [less]))
    gone = merged(model.effects, [replace(less, parameters={"torque": [-3.0]})])
    assert sorted(joint for effect in gone for joint in effect.joints) == list(JOINTS[1:3])


STATED = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="2"/><origin xyz="0.2 0 0"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<dynamics damping="0.7" friction="1.5"/></joint></robot>"""


def test_less_than_the_description_states(tmp_path: Path) -> None:
    """What a description says too much of is taken away in whatever loads the model, but no more than there is."""
    (tmp_path / "stated.urdf").write_text(STATED, encoding="utf-8")
    given = Model.load(tmp_path / "stated.urdf")
    less = [
        EffectSpec("coulomb_friction", ["j"], [], {"torque": [-0.5]}),
        EffectSpec("viscous_friction", ["j"], [], {"damping": [-0.3]}),
    ]
    given.with_effects(merged(given.effects, less)).save(tmp_path / "corrected")
    model = Model.load(tmp_path / "corrected")
    v, zero = np.array([[2.0], [-2.0]]), np.zeros((2, 1))
    law = model.inverse_dynamics(zero, v, zero) - model.inverse_dynamics(zero, zero, zero)
    np.testing.assert_allclose(law[:, 0], [1.8, -1.8], atol=1e-9)
    back = [replace(spec, parameters={k: [-x for x in y] for k, y in spec.parameters.items()}) for spec in less]
    again = merged(model.effects, back)
    assert [effect.name for effect in again] == ["coulomb_friction"]  # the description's own
    for spec in less:
        doubled = replace(spec, parameters={key: [4.0 * x[0]] for key, x in spec.parameters.items()})
        with pytest.raises(ModelError, match="not within"):
            given.with_effects(merged(given.effects, [doubled]))


def test_friction_that_falls_during_a_run() -> None:
    model = Model.load(replace(ARM, effects=[FRICTION]))
    less = EffectSpec("coulomb_friction", [JOINTS[0]], [], {"torque": [-1.0]}, onset=2.0)
    result = model.with_effects(merged(model.effects, [less]))
    time = np.linspace(0.0, 4.0, 401)
    q, v = np.zeros((401, 7)), np.full((401, 7), 0.3)
    law = result.inverse_dynamics(q, v, np.zeros_like(q), time=time) - Model.load(
        replace(ARM, effects=[])
    ).inverse_dynamics(q, v, np.zeros_like(q))
    np.testing.assert_allclose(law[:, 0], np.where(time < 2.0, 3.0, 2.0), atol=1e-9)


@settings(max_examples=40, deadline=None)
@drawn(st.lists(st.floats(-1.5, 1.5), min_size=10, max_size=10))
def test_any_coordinates_are_a_physical_body(coordinates: list[float]) -> None:
    mass, centre, inertia = from_log_cholesky(np.array(coordinates))
    xx, yy, zz, xy, xz, yz = inertia
    moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    assert mass > 0.0
    assert moments[0] > 0.0
    assert moments[0] + moments[1] > moments[2] * (1.0 - 1e-9)
    again = log_cholesky(mass, centre, inertia)
    assert np.allclose(from_log_cholesky(again)[2], inertia, rtol=1e-3, atol=1e-3 * np.max(np.abs(inertia)))


def test_link_coordinates_start_where_they_are() -> None:
    model = Model.load(ARM)
    spec = EffectSpec(
        "inertial_parameters",
        [],
        ["panda_link4"],
        {"mass": [-0.5], "com": [0.01, 0.02, -0.01], "inertia": [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]},
    )
    part = Coordinates.of(model, spec)
    again = part.effect(part.start())
    for key, value in spec.parameters.items():
        np.testing.assert_allclose(again.parameters[key], value, atol=1e-9)


def test_rough_link_parameters_are_about_the_links_own_centre() -> None:
    """What a search finds is about the link's origin; an effect made of it adds just that to the link."""
    model = Model.load(ARM)
    added = point_mass(1.0, np.array([0.1, 0.02, -0.08]))
    values = inertia_values(*link_inertia(model, "panda_link4"))(added, 1e-12 * np.eye(10))
    spec = EffectSpec("inertial_parameters", [], ["panda_link4"], {key: list(x) for key, (x, _) in values.items()})
    effect = make(spec)
    assert isinstance(effect, InertialParameters)
    np.testing.assert_allclose(effect.difference(model.bodies.links), added, atol=1e-9)


def test_standard_errors_cover() -> None:
    """A line in noise that hangs together within clusters: the sandwich covers where the plain errors do not."""
    rng = np.random.default_rng(0)
    x, clusters = np.linspace(0.0, 1.0, 600), np.repeat(np.arange(60), 10)
    hits = 0
    for _ in range(200):
        y = 2.0 * x + rng.normal(size=600) * 0.3 + np.repeat(rng.normal(size=60), 10)
        fit = minimise(
            lambda p, y=y: y - p[0] * x,  # type: ignore[misc]
            np.array([1.0]),
            np.array([1e-4]),
            clusters,
            (np.zeros(1), np.full(1, np.inf)),
        )
        hits += abs(fit.vector[0] - 2.0) < 1.96 * np.sqrt(fit.covariance[0, 0])
    assert 180 <= hits <= 198


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_floor_of_coloured_noise(memory: float) -> None:
    """Read off the noise's spectrum, it is what the low-pass leaves of the noise itself."""
    rng = np.random.default_rng(5)
    noise = lfilter([1.0], [1.0, -memory], rng.normal(size=(40_000, 2)) * [0.1, 3.0], axis=0)
    floor = noise_below(estimate(noise, [20_000, 20_000]), 50.0)
    np.testing.assert_allclose(floor, np.std(lowpass(noise, 50.0), axis=0), rtol=0.02)


def swung(path: Path, nameless: float) -> tuple[Model, Log, float]:
    """An arm of one joint with dry friction that is not in its description, and something that has no name."""
    text = STATED.replace('<dynamics damping="0.7" friction="1.5"/>', "")
    path.write_text(text, encoding="utf-8")
    model, true = Model.load(path), 2.0
    time = np.arange(0.0, 8.0, 0.005)
    w, size = np.array([1.1, 2.3, 3.7]), np.array([0.5, 0.3, 0.1])
    phase = np.outer(time, w)
    q, v, a = np.sin(phase) @ size, np.cos(phase) @ (size * w), -np.sin(phase) @ (size * w**2)
    torque = model.inverse_dynamics(q[:, None], v[:, None], a[:, None])[:, 0] + true * np.tanh(v / 1e-3)
    torque = torque + nameless * np.sign(v) * np.sqrt(np.abs(v)) + np.random.default_rng(3).normal(size=len(q)) * 0.05
    return model, Log(time, ("j",), position=q[:, None], torque=torque[:, None], source="swung"), true


@pytest.mark.parametrize("nameless", [0.0, 1.5])
def test_laws_that_are_not_exact_end_no_worse_than_they_began(
    nameless: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where weights by the colour of what is left lead astray, all samples count alike; rough values are the last."""
    model, log, true = swung(tmp_path / "one.urdf", nameless)
    hypothesis = Hypothesis.of(model, [EffectSpec("coulomb_friction", ["j"], [], {"torque": [1.5]})])
    plain, solution = by_torque(hypothesis, prepare(model, [log]), coloured=False)
    if nameless == 0.0:
        assert abs(solution.vector[0] - true) < 0.01
    least = torque_residual_rms(plain.model(solution.vector), log)

    def astray(start: Hypothesis, records: Records, *, coloured: bool = True) -> tuple[Hypothesis, Any]:
        found, answer = by_torque(start, records, coloured=coloured)
        return found, replace(answer, vector=2.0 * answer.vector) if coloured else answer

    tuned(monkeypatch, most_by_motion=0)
    monkeypatch.setattr("twin_diagram.gap.correction.add_effects.by_torque", astray)
    finding = Finding("coulomb_friction", ("j",), (), per_joint("j", torque=1.1 * float(solution.vector[0])), 0.9)
    result = add(model, [log], [finding])
    assert len(result.notes) == 1
    assert np.all(torque_residual_rms(result.model, log) < 1.01 * least)
    told = result.findings[0].parameters["torque"]
    assert isinstance(told, dict)
    assert abs(float(np.sum(told["j"].value)) - solution.vector[0]) < 0.01
