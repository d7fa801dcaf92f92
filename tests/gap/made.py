"""Records of an arm that swings, made without any filter, and what effects' laws make of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import Terms, given_load
from twin_diagram.model.effects import Effect, make
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec

Array = npt.NDArray[np.float64]

ARM = Model.load(ArmModel(model="arms/ur5e.urdf", tool_frame=""))
HOME = np.array([0.2, -1.2, 1.3, -0.9, -1.0, 0.3])
RATE, BAND, STRIDE = 200.0, 20.0, 5
PAN, LIFT, ELBOW, WRIST = 0, 1, 2, 5


def swing(seconds: float, seed: int = 5) -> tuple[Array, Array, Array, Array]:
    """Times, and positions, velocities and accelerations of two sines per joint."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    q, v, a = np.tile(HOME, (len(time), 1)), np.zeros((len(time), 6)), np.zeros((len(time), 6))
    for frequency, size in ((0.4, 0.3), (1.1, 0.08)):
        w = 2.0 * np.pi * frequency
        angle = w * time[:, None] + rng.uniform(0.0, 6.0, 6)
        q += size * np.sin(angle)
        v += size * w * np.cos(angle)
        a -= size * w**2 * np.sin(angle)
    return time, q, v, a


def record(
    model: Model, time: Array, q: Array, v: Array, a: Array, *, extra: Array | float = 0.0, index: int = 0
) -> Record:
    """One log's, whose torque is the model's and something more."""
    given = model.inverse_dynamics(q, v, a, time=time)
    slick = model.with_effects([effect for effect in model.effects if not effect.dry])
    cut = round(0.3 * RATE)
    return Record(
        index=index,
        source=f"log {index}",
        mark=f"mark {index}",
        time=time,
        rate=RATE,
        band=BAND,
        q=q,
        v=v,
        a=a,
        torque=given + extra,
        given=given,
        passed=slick.inverse_dynamics(q, v, a, time=time),
        shaken=np.zeros(q.shape[1]),
        kept=np.arange(cut, len(time) - cut, STRIDE),
        period=1.0 / RATE,
    )


def terms_of(records: Records, slow: float = 1e-3) -> Terms:
    return Terms(records, given_load(records), np.full(records.n, slow))


@cache
def swinging() -> Terms:
    """Five seconds of the bare arm."""
    return terms_of(Records(ARM, (record(ARM, *swing(5.0)),)))


def effect(name: str, joints: Sequence[str] = (), links: Sequence[str] = (), **values: float | list[float]) -> Effect:
    parameters = {key: np.atleast_1d(value).tolist() for key, value in values.items()}
    return make(EffectSpec(name, list(joints), list(links), parameters))


def everywhere(name: str, **values: float) -> Effect:
    """The same on every joint."""
    return effect(name, ARM.joints, **{key: [value] * 6 for key, value in values.items()})


@cache
def worn() -> Terms:
    """Of an arm whose given model has all that may be taken away again."""
    effects = [
        everywhere("viscous_friction", damping=2.0),
        everywhere("coulomb_friction", torque=4.0),
        everywhere("load_dependent_friction", coefficient=0.1),
        everywhere("reflected_inertia", inertia=0.5),
        effect("joint_spring", ARM.joints, stiffness=[20.0] * 6, rest_angle=[0.0] * 6),
        effect("payload", links=[ARM.last_link], mass=3.0, com=[0.0, 0.0, 0.0]),
    ]
    model = ARM.with_effects(effects)
    return terms_of(Records(model, (record(model, *swing(2.0)),)))


def law(terms: Terms, candidate: Candidate, values: Mapping[str, Array]) -> Array:
    """What the arm's model with a candidate's effect needs beyond the given one's (ΣD, n)."""
    given = terms.records.model
    joints = [given.joints[j] for j in candidate.joints]
    spec = EffectSpec(candidate.name, joints, list(candidate.links), {k: list(x) for k, x in values.items()})
    model = given.with_effects([*given.effects, make(spec)])
    needed = terms.records.reduce(lambda r: model.inverse_dynamics(r.q, r.v, r.a, time=r.time, seen=r.torque) - r.given)
    return np.asarray(needed)


def told(candidate: Candidate, coefficients: Array) -> dict[str, Array]:
    """The parameters of coefficients."""
    values = candidate.parameters(coefficients, np.eye(len(coefficients)))
    return {key: value for key, (value, _) in values.items()}


def torque(terms: Terms, candidate: Candidate, coefficients: Array) -> Array:
    """What a candidate says that it adds (ΣD, n)."""
    result = np.zeros_like(terms.records.residual)
    result[:, list(candidate.rows)] = candidate.columns @ coefficients
    return result


def disagreement(terms: Terms, candidate: Candidate, coefficients: Sequence[float]) -> float:
    """Of a candidate's torque with the law's, as a share of the law's."""
    c = np.array(coefficients, dtype=float)
    wanted = law(terms, candidate, told(candidate, c))
    return float(np.linalg.norm(torque(terms, candidate, c) - wanted) / np.linalg.norm(wanted))


def sized(terms: Terms, candidate: Candidate) -> Array:
    """Root mean square of each column at its prior's deviation, over the joint's torque."""
    columns = candidate.columns[:, 0] * candidate.spread
    return np.asarray(np.sqrt(np.mean(columns**2, axis=0)) / terms.torque_size[candidate.joints[0]])
