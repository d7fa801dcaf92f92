"""Naming on closed-form truth: torques of an independent model, with noise, hidden in a log."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.gap.naming import name
from twin_diagram.gap.residuals.prepared_logs import prepare
from twin_diagram.gap.residuals.whitening import estimate
from twin_diagram.gap.verdict.locating import CONDITIONS
from twin_diagram.logs import Log
from twin_diagram.logs.dejittering import dejittered
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec

JOINTS = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]
HOME = np.array([0.2, -1.2, 1.3, -0.9, -1.0, 0.3])
GIVEN = Model.load(ArmModel(model="arms/ur5e.urdf", tool_frame=""))
NOISE = 0.006 * GIVEN.effort_limit


def log_of(effects: list[EffectSpec], seed: int = 0, duration: float = 10.0, rate: float = 250.0) -> Log:
    """Multi-sines, the torque that the model with effects needs for them, white noise and an 18-bit encoder."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * rate)) / rate
    q, v, a = np.tile(HOME, (len(time), 1)), np.zeros((len(time), 6)), np.zeros((len(time), 6))
    for frequency in (0.1, 0.2, 0.3, 0.5, 0.7):
        w = 2.0 * np.pi * frequency
        size, phase = 0.09 * rng.normal(size=6) / frequency**0.5, rng.uniform(0.0, 2.0 * np.pi, 6)
        q += size * np.sin(w * time[:, None] + phase)
        v += size * w * np.cos(w * time[:, None] + phase)
        a -= size * w**2 * np.sin(w * time[:, None] + phase)
    truth = Model.load(ArmModel(model="arms/ur5e.urdf", tool_frame="", effects=effects))
    tau = truth.inverse_dynamics(q, v, a) + NOISE * rng.normal(size=q.shape)
    count = 2.0 * np.pi / 2**18
    return Log(time, tuple(JOINTS), np.round(q / count) * count, torque=tau)


def test_nothing_is_found_where_nothing_is() -> None:
    verdict = name(GIVEN, [log_of([], seed=1)])
    assert verdict.verdict == "none"
    assert not verdict.remainder and not verdict.findings and not verdict.where


@pytest.mark.parametrize(
    ("spec", "tolerance"),
    [
        pytest.param(
            EffectSpec("viscous_friction", ["elbow_joint"], [], {"damping": [8.0]}), 0.1, marks=pytest.mark.slow
        ),
        pytest.param(
            EffectSpec("coulomb_friction", ["shoulder_lift_joint"], [], {"torque": [7.0]}), 0.1, marks=pytest.mark.slow
        ),
        pytest.param(
            EffectSpec("reflected_inertia", ["wrist_1_joint"], [], {"inertia": [0.6]}), 0.1, marks=pytest.mark.slow
        ),
        pytest.param(EffectSpec("torque_bias", ["wrist_2_joint"], [], {"torque": [-0.8]}), 0.1, marks=pytest.mark.slow),
    ],
    ids=lambda value: value.name if isinstance(value, EffectSpec) else "",
)
def test_one_effect_is_named(spec: EffectSpec, tolerance: float) -> None:
    verdict = name(GIVEN, [log_of([spec])])
    assert verdict.verdict == "named"
    assert [(f.name, list(f.joints)) for f in verdict.findings] == [(spec.name, spec.joints)]
    finding = verdict.findings[0]
    ((key, (expected,)),) = spec.parameters.items()
    per_joint = finding.parameters[key]
    assert isinstance(per_joint, dict)
    got = per_joint[spec.joints[0]]
    assert got.value == pytest.approx(expected, rel=tolerance)
    assert abs(float(np.asarray(got.value)) - expected) < 5.0 * float(np.asarray(got.std))
    assert finding.confidence > 0.5 and len(finding.alternatives) <= 3
    assert verdict.where[0].joint == spec.joints[0]
    assert verdict.where[0].condition in CONDITIONS.values()


@pytest.mark.slow
def test_payload_is_named_with_its_centre() -> None:
    spec = EffectSpec("payload", [], [], {"mass": [1.5], "com": [0.03, -0.02, 0.1]})
    verdict = name(GIVEN, [log_of([spec])])
    assert [(f.name, f.links) for f in verdict.findings] == [("payload", (GIVEN.last_link,))]
    mass = verdict.findings[0].parameters["mass"]
    assert not isinstance(mass, dict)
    assert mass.value == pytest.approx(1.5, rel=0.05)


def test_several_logs_are_one_fit() -> None:
    spec = EffectSpec("viscous_friction", ["elbow_joint"], [], {"damping": [8.0]})
    records = prepare(GIVEN, [log_of([spec], seed=k) for k in range(2)])
    assert len(records.lengths) == 2 and sum(records.lengths) == len(records.residual)
    assert set(records.owner.tolist()) == {0, 1}


def test_late_stamps_on_even_samples_are_dejittered() -> None:
    log = log_of([], seed=3)
    rng = np.random.default_rng(0)
    late = Log(log.time + 2e-4 * rng.normal(size=len(log.time)), log.joints, log.position, torque=log.torque)
    assert np.allclose(dejittered(late).time, log.time, atol=3e-5)


def test_whitening_makes_coloured_noise_white() -> None:
    rng = np.random.default_rng(0)
    noise = np.zeros((4000, 1))
    drive = rng.normal(size=4000)
    for k in range(1, 4000):
        noise[k] = 0.8 * noise[k - 1] + drive[k]
    white = estimate(noise, [4000]).all(noise)[0]
    assert np.std(white) == pytest.approx(1.0, rel=0.05)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.05


@pytest.mark.slow
def test_a_push_that_goes_on_may_last_longer_than_half_a_log() -> None:
    wrench = [14.0, -9.0, 12.0, 0.0, 0.0, 0.0]
    push = EffectSpec("external_force", [], ["wrist_3_link"], {"wrench": wrench})
    plain, pushed = log_of([], seed=4), log_of([push], seed=4)
    assert plain.torque is not None and pushed.torque is not None
    torque = np.where(plain.time[:, None] < 3.2, plain.torque, pushed.torque)
    verdict = name(GIVEN, [Log(plain.time, plain.joints, plain.position, torque=torque)])
    (finding,) = verdict.findings
    assert (finding.name, finding.links) == ("external_force", ("wrist_3_link",))
    assert finding.onset is not None and finding.onset.time == pytest.approx(3.2, abs=0.05) and finding.end is None
    estimate_of = finding.parameters["wrench"]
    assert not isinstance(estimate_of, dict)
    np.testing.assert_allclose(np.ravel(estimate_of.value)[:3], wrench[:3], rtol=0.1)
